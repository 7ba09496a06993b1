"""The program that reads a motion capture system.

It is started as `python -m crazychoir.mocap.reader FD SYSTEM KEY=VALUE ...`. It is a process of its
own because connecting may hang for ever and hold the interpreter. It writes datagrams into the
socket FD: frames, and texts about its progress. It ends with the process that has started it.
"""

import ctypes
import signal
import socket
import sys
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from crazychoir.errors import error_text
from crazychoir.mocap.frames import FRAME_PROTOCOL, make_frame
from crazychoir.runtime.clock import Stopwatch


@dataclass(frozen=True, slots=True)
class ReaderMessages:
    """The texts by which the reader tells its progress."""

    connecting: bytes = b"connecting"
    """The library is loaded, and the program connects."""
    connected: bytes = b"connected"
    """The program is connected."""
    failed: bytes = b"failed: "
    """Start of the text with an error."""


READER_MESSAGES = ReaderMessages()


PR_SET_PDEATHSIG: Final = 1
"""Option of prctl: signal to send when the parent process ends."""


def main(words: list[str]) -> None:
    """Connect, and send each frame."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    out = socket.socket(fileno=int(words[0]))
    try:
        import motioncapture  # imported here: the deadline to start covers its import

        out.send(READER_MESSAGES.connecting)
        system = motioncapture.connect(
            words[1], dict(word.split("=", 1) for word in words[2:])
        )
        out.send(READER_MESSAGES.connected)
        _send_frames(system, out)
    except Exception as error:  # noqa: BLE001 - whatever a foreign library raises is told
        out.send(READER_MESSAGES.failed + error_text(error).encode()[:1000])


def _send_frames(system: Any, out: socket.socket) -> None:
    clock = Stopwatch()
    number = 0
    while True:
        system.waitForNextFrame()
        bodies = [
            (_shorten_name(name), _pose_of_body(body))
            for name, body in system.rigidBodies.items()
        ]
        frame = make_frame(number, clock.now(), bodies)
        number += 1
        try:
            out.send(frame.packed(), socket.MSG_DONTWAIT)
        except BlockingIOError:
            # The receiver is late. The next frame is more useful; the numbers show the loss.
            continue


def _pose_of_body(body: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    q = body.rotation
    return np.array([*body.position, q.x, q.y, q.z, q.w], dtype=float)


def _shorten_name(name: str) -> str:
    """Return a name cut to the size in a frame.

    Two long names that become equal are doubled in the frame.
    """
    return name.encode()[: FRAME_PROTOCOL.name_size].decode(errors="ignore")


if __name__ == "__main__":
    main(sys.argv[1:])
