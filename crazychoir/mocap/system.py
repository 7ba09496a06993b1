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

from crazychoir.errors import CodecError, ConfigError
from crazychoir.mocap.frames import parse
from crazychoir.mocap.reader import FAILED
from crazychoir.mocap.source import SILENT, Complaints, Say, Take
from crazychoir.runtime.clock import Clock

STARTED = 15.0
"""Seconds in which the reader must load its libraries."""
ENDED = 5.0
"""Seconds in which a killed process must end."""
FIRST = 1.0
"""Seconds until the second attempt; doubled with each further one."""
LONGEST = 30.0
"""Seconds: longest time between two attempts."""
LARGEST = 1 << 16
"""Most bytes of a datagram."""
PROGRAMS = {
    "vicon": "Vicon Tracker or Nexus, with its DataStream,",
    "optitrack": "Motive, with its NatNet stream,",
    "qualisys": "Qualisys Track Manager, with its real-time output,",
    "vrpn": "its VRPN server",
}
"""The program that each system needs."""
MODULE = "motioncapture"
"""The library."""
EXTRA = "mocap"
"""The extra of this package that installs the library."""


class _Failed(Exception):
    """The reason why an attempt ended."""


class SystemSource:
    """Vicon, OptiTrack, Qualisys, VRPN or the library's mock.

    Each attempt is a new process with deadlines: to start, to connect, and SILENT s between two
    frames. A process that misses its deadline is reported and killed, and the next attempt follows
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
        say: Say | None = None,
    ) -> None:
        if importlib.util.find_spec(MODULE) is None:
            do = f"pip install 'crazychoir[{EXTRA}]'"
            raise ConfigError(
                f'[mocap] source = "{system}"',
                f"no module {MODULE}",
                f"the extra {EXTRA}",
                f"{do}.",
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
        self._running = f"Is {PROGRAMS.get(system, system)} running there?"
        self._complain = Complaints(self.where, say)
        self._wait = FIRST

    async def run(self, take: Take) -> None:
        """Run one reader after another."""
        while True:
            try:
                await self._attempt(take)
            except _Failed as failed:
                self.state = "trying again"
                self._complain(
                    self.clock.now(),
                    str(failed),
                    f"{failed} Trying again in {self._wait:g} s.",
                )
            self.again += 1
            await self.clock.sleep(self._wait)
            self._wait = min(2.0 * self._wait, LONGEST)

    async def _attempt(self, take: Take) -> None:
        """Run one reader until it fails. Raises _Failed then."""
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
                await _end(process)

    async def _read(self, ours: socket.socket, take: Take) -> None:
        self.state = "starting"
        await self._next(
            ours, STARTED, f"its reader does not start within {STARTED:g} s."
        )
        self.state = "connecting"
        hangs = f"no connection within {self._deadline:g} s; its library waits for ever where nobody answers."
        await self._next(ours, self._deadline, hangs)
        self.state = "connected"
        while True:
            data = await self._next(
                ours, SILENT, f"connected, and no frame for {SILENT:g} s."
            )
            try:
                frame = parse(data)
            except CodecError:
                self.malformed += 1
                continue
            self._wait = FIRST
            take(frame, max(0.0, self.clock.now() - frame.time))

    async def _next(self, ours: socket.socket, seconds: float, otherwise: str) -> bytes:
        """Return the next datagram of a reader.

        seconds: s: deadline
        otherwise: what is wrong if none arrives
        Raises _Failed if there is none, or if the reader reports an error.
        """
        try:
            async with asyncio.timeout(seconds):
                data = await asyncio.get_running_loop().sock_recv(ours, LARGEST)
        except TimeoutError:
            raise _Failed(f"{otherwise} {self._running}") from None
        except OSError as error:
            raise _Failed(f"its reader is gone: {error.strerror}.") from error
        if not data:
            raise _Failed("its reader has ended.")
        if data.startswith(FAILED):
            raise _Failed(
                f"{data.removeprefix(FAILED).decode(errors='replace')}. {self._running}"
            )
        return data


async def _end(process: Process) -> None:
    """Kill the process: it may hang."""
    with contextlib.suppress(ProcessLookupError):
        process.kill()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(ENDED):
            await process.wait()
