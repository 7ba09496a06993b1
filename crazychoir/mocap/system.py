"""A motion capture system, read through `motioncapture` by a process of its own, which may hang as it likes."""

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
"""s that the reader gets to load its libraries."""
ENDED = 5.0
"""s that a killed process gets to be gone."""
FIRST, LONGEST = 1.0, 30.0
"""s between two attempts: the first, and the longest, doubled each time."""
LARGEST = 1 << 16
"""Bytes of a datagram."""
PROGRAMS = {
    "vicon": "Vicon Tracker or Nexus, with its DataStream,",
    "optitrack": "Motive, with its NatNet stream,",
    "qualisys": "Qualisys Track Manager, with its real-time output,",
    "vrpn": "its VRPN server",
}
"""What has to run there."""
MODULE, EXTRA = "motioncapture", "mocap"


class _Failed(Exception):
    """Why an attempt has ended."""


class SystemSource:
    """Vicon, OptiTrack, Qualisys, VRPN or the library's mock; raises ConfigError if the library is not installed.

    Each attempt is a new process with deadlines: to start, to connect, and SILENT s between two frames. One that misses
    its deadline is named and killed, and the next is made later. Ages are exact: the process has our clock.
    deadline: s to connect.
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
        self._deadline = deadline
        settings = {"hostname": hostname, **(options or {})}
        self._words = [system, *(f"{key}={value}" for key, value in settings.items())]
        self._running = f"Is {PROGRAMS.get(system, system)} running there?"
        self._complain = Complaints(self.where, say)
        self._wait = FIRST

    async def run(self, take: Take) -> None:
        """One reader after the other."""
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
        """One reader, until it fails."""
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
        """The next datagram of a reader; raises _Failed if there is none, or if it says that it has failed."""
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
    """Kill it: it may hang."""
    with contextlib.suppress(ProcessLookupError):
        process.kill()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(ENDED):
            await process.wait()
