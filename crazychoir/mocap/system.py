"""A motion capture system, read with `motioncapture` in a process of its own.

The library may hang, and must not block this process.
"""

import asyncio
import contextlib
import importlib.util
import socket
import sys
from asyncio.subprocess import DEVNULL, Process
from collections.abc import Mapping
from dataclasses import dataclass

from crazychoir.errors import CodecError, ConfigError
from crazychoir.mocap.frames import parse_frame
from crazychoir.mocap.reader import READER_MESSAGES
from crazychoir.mocap.source import (
    FRAME_TIMEOUT,
    ReportText,
    SourceComplaints,
    TakeFrame,
)
from crazychoir.runtime.clock import Clock


@dataclass(frozen=True, slots=True)
class AttemptTiming:
    """Deadlines of one reader process, and the pauses between two attempts."""

    start_deadline: float = 15.0
    """s: time in which the reader must load its libraries."""
    end_deadline: float = 5.0
    """s: time in which a killed process must end."""
    first_pause: float = 1.0
    """s: time until the second attempt; doubled with each further one."""
    longest_pause: float = 30.0
    """s: longest time between two attempts."""


ATTEMPT_TIMING = AttemptTiming()


RECEIVE_SIZE = 1 << 16
"""Most bytes of a datagram."""
SYSTEM_PROGRAMS = {
    "vicon": "Vicon Tracker or Nexus, with its DataStream,",
    "optitrack": "Motive, with its NatNet stream,",
    "qualisys": "Qualisys Track Manager, with its real-time output,",
    "vrpn": "its VRPN server",
}
"""The program that each system needs."""
SYSTEM_PORTS = {"vicon": 801, "qualisys": 22223, "vrpn": 3883}
"""TCP port of each system, by the manuals of DataStream, QTM (real-time protocol) and VRPN.

OptiTrack has UDP ports alone.
"""
MOCAP_LIBRARY = "motioncapture"
"""The library."""
MOCAP_EXTRA = "mocap"
"""The extra of this package that installs the library."""
LIBRARY_ADVICE = f"pip install 'crazychoir[{MOCAP_EXTRA}]'"
"""Command that installs the library."""


def has_library() -> bool:
    """Return whether the library is installed."""
    return importlib.util.find_spec(MOCAP_LIBRARY) is not None


class _AttemptFailed(Exception):
    """The reason why an attempt ended."""


class SystemSource:
    """Vicon, OptiTrack, Qualisys, VRPN or the library's mock.

    Each attempt is a new process with deadlines: to start, to connect, and `FRAME_TIMEOUT`
    between two frames. A process that misses its deadline is reported and killed, and the next attempt follows
    later. Ages are exact, because the process uses the same clock.

    system: name of the system
    hostname: host of the system
    options: further options of the library
    deadline: s to connect
    say: reports a text; None: to the log
    Raises ConfigError if the library is not installed.
    """

    live = True

    def __init__(
        self,
        clock: Clock,
        system: str,
        hostname: str,
        options: Mapping[str, object] | None = None,
        deadline: float = 5.0,
        say: ReportText | None = None,
    ) -> None:
        if not has_library():
            raise ConfigError(
                f'[mocap] source = "{system}"',
                f"no module {MOCAP_LIBRARY}",
                f"the extra {MOCAP_EXTRA}",
                f"{LIBRARY_ADVICE}.",
            )
        self.clock = clock
        self.where = f"{system} at {hostname}"
        self.state = "starting"
        self.again = 0
        self.malformed = 0
        """Datagrams that were no frames."""
        self._deadline = deadline
        settings = {"hostname": hostname, **(options or {})}
        self._words = [system, *(f"{key}={value}" for key, value in settings.items())]
        self._running = f"Is {SYSTEM_PROGRAMS.get(system, system)} running there?"
        self._complain = SourceComplaints(self.where, say)
        self._wait = ATTEMPT_TIMING.first_pause

    async def run(self, take: TakeFrame) -> None:
        """Run one reader after another."""
        while True:
            try:
                await self._attempt(take)
            except _AttemptFailed as failed:
                self.state = "trying again"
                self._complain(
                    self.clock.now(),
                    str(failed),
                    f"{failed} Trying again in {self._wait:g} s.",
                )
            self.again += 1
            await self.clock.sleep(self._wait)
            self._wait = min(2.0 * self._wait, ATTEMPT_TIMING.longest_pause)

    async def _attempt(self, take: TakeFrame) -> None:
        """Run one reader until it fails. Raises _AttemptFailed then."""
        ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        with ours:
            with its:
                process = await asyncio.create_subprocess_exec(
                    sys.executable,
                    "-m",
                    "crazychoir.mocap.reader",
                    str(its.fileno()),
                    *self._words,
                    pass_fds=[its.fileno()],
                    stdin=DEVNULL,
                    stdout=DEVNULL,
                )
            try:
                await self._read(ours, take)
            finally:
                await _kill_process(process)

    async def _read(self, ours: socket.socket, take: TakeFrame) -> None:
        self.state = "starting"
        await self._next(
            ours,
            ATTEMPT_TIMING.start_deadline,
            f"its reader does not start within {ATTEMPT_TIMING.start_deadline:g} s.",
        )
        self.state = "connecting"
        hangs = f"no connection within {self._deadline:g} s; its library waits for ever if no server answers."
        await self._next(ours, self._deadline, hangs)
        # The library of Vicon returns at once, whether or not a system answers.
        self.state = "waiting for its first frame"
        silent = f"no frame within {FRAME_TIMEOUT:g} s: nothing answers, or it sends nothing."
        while True:
            data = await self._next(ours, FRAME_TIMEOUT, silent)
            try:
                frame = parse_frame(data)
            except CodecError:
                self.malformed += 1
                continue
            self.state = "connected"
            silent = f"connected, and no frame for {FRAME_TIMEOUT:g} s."
            self._wait = ATTEMPT_TIMING.first_pause
            take(frame, max(0.0, self.clock.now() - frame.time))

    async def _next(self, ours: socket.socket, seconds: float, otherwise: str) -> bytes:
        """Return the next datagram of a reader.

        seconds: s: deadline
        otherwise: what is wrong if none arrives
        Raises _AttemptFailed if there is none, or if the reader reports an error.
        """
        try:
            async with asyncio.timeout(seconds):
                data = await asyncio.get_running_loop().sock_recv(ours, RECEIVE_SIZE)
        except TimeoutError:
            raise _AttemptFailed(f"{otherwise} {self._running}") from None
        except OSError as error:
            raise _AttemptFailed(f"its reader is gone: {error.strerror}.") from error
        if not data:
            raise _AttemptFailed("its reader has ended.")
        if data.startswith(READER_MESSAGES.failed):
            raise _AttemptFailed(
                f"{data.removeprefix(READER_MESSAGES.failed).decode(errors='replace')}. {self._running}"
            )
        return data


async def _kill_process(process: Process) -> None:
    """Kill the process: it may hang."""
    with contextlib.suppress(ProcessLookupError):
        process.kill()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(ATTEMPT_TIMING.end_deadline):
            await process.wait()
