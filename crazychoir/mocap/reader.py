"""The program that reads a motion capture system.

It is started as `python -m crazychoir.mocap.reader FD SYSTEM KEY=VALUE ...`. It is a process of its
own because connecting may hang for ever and hold the interpreter. It writes datagrams into the
socket FD: frames, and texts about its progress. It ends with the process that has started it.
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
"""Text: the library is loaded, and the program connects."""
CONNECTED: Final = b"connected"
"""Text: the program is connected."""
FAILED: Final = b"failed: "
"""Start of the text with an error."""
PR_SET_PDEATHSIG: Final = 1
"""Option of prctl: signal to send when the parent process ends."""


def main(words: list[str]) -> None:
    """Connect, and send each frame."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    out = socket.socket(fileno=int(words[0]))
    try:
        import motioncapture  # imported here: the deadline to start covers its import

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
        except BlockingIOError:
            # The receiver is late. The next frame is more useful; the numbers show the loss.
            continue


def _flat(body: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    q = body.rotation
    return np.array([*body.position, q.x, q.y, q.z, q.w], dtype=float)


def _short(name: str) -> str:
    """Return a name cut to the size in a frame.

    Two long names that become equal are doubled in the frame.
    """
    return name.encode()[:NAME].decode(errors="ignore")


if __name__ == "__main__":
    main(sys.argv[1:])
