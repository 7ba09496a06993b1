"""The program that reads a motion capture system: `python -m crazychoir.mocap.reader FD SYSTEM KEY=VALUE ...`.

It is a process of its own, because connecting may hang for ever and hold the interpreter meanwhile. What it sees goes
as datagrams into the socket FD: frames, and words of how far it is. It dies with the process that has started it.
"""

import ctypes
import signal
import socket
import sys
from typing import Any, Final

import numpy as np

from crazychoir.errors import error_text
from crazychoir.mocap.frames import NAME, frame_of
from crazychoir.runtime.clock import Stopwatch

CONNECTING: Final = b"connecting"
CONNECTED: Final = b"connected"
FAILED: Final = b"failed: "
PR_SET_PDEATHSIG: Final = 1


def main(words: list[str]) -> None:
    """Connect, and send each frame."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    out = socket.socket(fileno=int(words[0]))
    try:
        import motioncapture  # what it does when it is loaded is in the time that it gets to start

        out.send(CONNECTING)
        system = motioncapture.connect(
            words[1], dict(word.split("=", 1) for word in words[2:])
        )
        out.send(CONNECTED)
        _send_frames(system, out)
    except Exception as error:  # noqa: BLE001 - whatever a foreign library raises is told
        out.send(FAILED + error_text(error).encode()[:1000])


def _send_frames(system: Any, out: socket.socket) -> None:
    clock = Stopwatch()
    number = 0
    while True:
        system.waitForNextFrame()
        bodies = [
            (_short(name), _flat(body)) for name, body in system.rigidBodies.items()
        ]
        frame = frame_of(number, clock.now(), bodies)
        number += 1
        try:
            out.send(frame.packed(), socket.MSG_DONTWAIT)
        except (
            BlockingIOError
        ):  # who reads is late: the next frame is worth more; the numbers tell
            continue


def _flat(body: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    q = body.rotation
    return np.array([*body.position, q.x, q.y, q.z, q.w], dtype=float)


def _short(name: str) -> str:
    """As much of a name as a frame takes; two long names that become the same are doubled in the frame."""
    return name.encode()[:NAME].decode(errors="ignore")


if __name__ == "__main__":
    main(sys.argv[1:])
