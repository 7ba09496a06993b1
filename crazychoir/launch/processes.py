"""The agents of a run as processes of this machine: start, output, end, and results."""

import asyncio
import contextlib
import math
import signal
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.agent.mission_runner import MISSION_TIMES
from crazychoir.bus.codec import decode, encode
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import CodecError, ProcessFailed
from crazychoir.files.user_folders import CACHE_WARNING
from crazychoir.launch.fork_server import ForkedProcess, ForkServer
from crazychoir.numerics.kernel_cache import COMPILING_MESSAGE, share_with_children
from crazychoir.planning.point_to_point import PEAK_SPEED, compute_flight_time
from crazychoir.runtime.worker_thread import add_signal_handler
from crazychoir.types import FullState

END_GRACE = 20.0
"""Seconds beside the time for landing that processes get to end after SIGTERM.

Then they are killed.
"""
ORPHAN_GRACE = 8.0
"""Seconds that agents get after the end of their owner process.

They notice it within 3 s and end. Agents that have never heard of the owner wait longer.
"""


@dataclass(frozen=True, slots=True)
class OwnerRestarts:
    """How often an owner process (see `Owner`) is started again if it ends before its agents."""

    most_starts: int = 5
    """Most restarts of one owner within `period`."""
    period: float = 600.0
    """Seconds in which these starts are counted."""
    refused_exit_code: int = 2
    """Exit code of a program that has refused its input; it is not started again."""


OWNER_RESTARTS = OwnerRestarts()


@dataclass(frozen=True, slots=True)
class ProcessOutputLimits:
    """Sizes of what child processes write, in bytes."""

    chunk: int = 1 << 16
    """Bytes of output read at once."""
    line: int = 1 << 20
    """Largest length of a line, bytes; a longer line is passed on in parts."""
    results: int = 1 << 30
    """Largest size of the results of one process, bytes.

    The codec limits the size of each result, and the swarm file limits their number.
    """


PROCESS_OUTPUT_LIMITS = ProcessOutputLimits()


Say = Callable[[str], None]
Results = dict[int, dict[str, Any]]
Children = dict[tuple[int, ...], ForkedProcess]


@dataclass(frozen=True)
class Owner:
    """A process that owns something which agents need: a world, the cameras or a dongle."""

    name: str
    """Name for the user."""
    module: str
    """Module that is run."""
    options: tuple[str, ...] = ()
    """Its options on the command line."""
    again: bool = False
    """Whether it is started again if it ends before its agents.

    This makes sense if what it owns, such as a dongle, still exists.
    """
    ids: tuple[int, ...] | None = None
    """Drones that need it, None for all.

    If the owner ends for good, agents that fly only such drones are ended too.
    """


WORLD_OWNER = Owner("world", "crazychoir.cli.fly.world")
AGENT_MODULE = "crazychoir.cli.fly.agent"
"""Module that runs as an agent."""
SWARM_OPTION = "--swarm"
"""Option of agents and owners with the swarm file."""


@dataclass(frozen=True, slots=True)
class SwarmLauncher:
    """Starts the processes of a swarm."""

    server: ForkServer
    """Makes the processes."""
    path: Path
    """The swarm file; the results lie beside it during the run."""

    def result_file(self, group: tuple[int, ...]) -> Path:
        """Return the file for the results of an agent with these drones."""
        return self.path.with_name(f"result-{group[0]}")

    async def start_agent(self, group: tuple[int, ...]) -> ForkedProcess:
        """Start an agent with these drones, which waits until all agents are released."""
        ids = [word for i in group for word in ("--id", str(i))]
        return await self.server.start(
            AGENT_MODULE,
            *(SWARM_OPTION, str(self.path)),
            *ids,
            *("--child", str(self.result_file(group))),
            is_held=True,
        )

    def release_agents(self) -> None:
        """Let all agents run.

        Agents that ran earlier would slow down the starts of the others.
        """
        self.server.release()

    async def start_owner(self, owner: Owner) -> ForkedProcess:
        """Start the process of an owner."""
        words = (SWARM_OPTION, str(self.path), *owner.options, "--child")
        return await self.server.start(owner.module, *words)

    @contextlib.asynccontextmanager
    async def pass_on_own_output(self, say: Say) -> AsyncIterator[None]:
        """Pass on what the fork server itself prints, during the block."""
        async with self.server.open_output() as output:
            reading = asyncio.create_task(_pass_on_lines(output, say))
            try:
                yield
            except ProcessFailed:
                self.server.end()
                await reading  # if the server has failed, it has said why
                raise
            finally:
                reading.cancel()


async def run_children(
    launcher: SwarmLauncher,
    groups: list[tuple[int, ...]],
    config: SwarmConfig,
    say: Say,
    all_wait: Callable[[], bool] = lambda: False,
    owners: Sequence[Owner] = (),
) -> Results:
    """Start one process for each group, wait for their ends, and return the results of their drones.

    launcher: starts the processes
    groups: drones of each process
    config: the swarm
    say: called with each line that a process prints
    all_wait: returns whether all drones still wait for the start. If a process ends without a result
        while they wait, all are ended, because the start would never come.
    owners: owners of the world, the cameras and the dongles, which are started too
    Returns {drone id: result}, without the drones that have no result.
    Raises ProcessFailed if a process cannot be started.
    """
    say = _drop_repetitions(say)
    children: Children = {}
    async with contextlib.AsyncExitStack() as stack:
        stack.enter_context(share_with_children(launcher.path.parent))
        await stack.enter_async_context(launcher.pass_on_own_output(say))
        for owner in owners:
            await stack.enter_async_context(_run_owner(launcher, owner, children, say))
        await _run_agents(launcher, groups, children, config, say, all_wait)
    results: Results = {}
    for group in children:
        results |= read_results(launcher.result_file(group))
    return results


async def _run_agents(
    launcher: SwarmLauncher,
    groups: list[tuple[int, ...]],
    children: Children,
    config: SwarmConfig,
    say: Say,
    all_wait: Callable[[], bool],
) -> None:
    """Start one process for each group, and wait until all have ended.

    A signal is passed on to the started processes; after it no further process is started.
    """

    async def start_all() -> None:
        for group in groups:
            children[group] = await launcher.start_agent(group)
        launcher.release_agents()

    async def until_its_end(group: tuple[int, ...]) -> None:
        child = children[group]
        await _pass_on_output(child, say)
        if read_results(launcher.result_file(group)):
            return
        drones = f"drone(s) {', '.join(map(str, group))}"
        say(f"{drones}: no result: the process {_describe_end(child)}")
        if all_wait():
            say(f"{drones}: ended before the start: the others wait no more")
            _signal_all(children.values(), signal.SIGTERM)

    def pass_on(number: signal.Signals) -> None:
        starting.cancel()
        _signal_all(children.values(), number)

    starting = asyncio.create_task(start_all())
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        add_signal_handler(number, pass_on, number)
    try:
        await asyncio.wait([starting])
        if not starting.cancelled():
            starting.result()
        await asyncio.gather(*map(until_its_end, children))
    finally:
        starting.cancel()
        await _end_all(
            [child for child in children.values() if child.returncode is None],
            compute_patience(config),
        )


@contextlib.asynccontextmanager
async def _run_owner(
    launcher: SwarmLauncher, owner: Owner, agents: Children, say: Say
) -> AsyncIterator[None]:
    """Run an owner process during the block: it starts before the agents and ends after them."""
    child = await launcher.start_owner(owner)
    over = asyncio.Event()
    now = asyncio.get_running_loop().time

    async def watch() -> None:
        nonlocal child
        starts = [-math.inf] * OWNER_RESTARTS.most_starts  # times of the last starts, s
        await _pass_on_output(child, say)
        while (
            owner.again
            and starts[0] < now() - OWNER_RESTARTS.period
            and not over.is_set()
            and child.returncode != OWNER_RESTARTS.refused_exit_code
        ):
            say(f"{owner.name}: its owner {_describe_end(child)}: started again")
            starts = [*starts[1:], now()]
            try:
                child = await launcher.start_owner(owner)
            except ProcessFailed as failed:
                say(f"{owner.name}: {failed}")
                break
            if over.is_set():
                await _end_all([child], END_GRACE)
            await _pass_on_output(child, say)
        if over.is_set():
            return
        # Refused at the first start: none of its drones has ever flown.
        refused = (
            child.returncode == OWNER_RESTARTS.refused_exit_code
            and starts[-1] == -math.inf
        )
        say(
            f"{owner.name}: its owner {_describe_end(child)}: its drones {'do not fly' if refused else 'stop'}"
        )
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(
                0.0
                if child.returncode == OWNER_RESTARTS.refused_exit_code
                else ORPHAN_GRACE
            ):
                await over.wait()
        needed = [
            agent
            for ids, agent in agents.items()
            if owner.ids is None or {*ids} <= {*owner.ids}
        ]
        _signal_all(
            [agent for agent in needed if agent.returncode is None], signal.SIGTERM
        )

    watching = asyncio.create_task(watch())
    try:
        yield
    finally:
        over.set()
        if child.returncode is None:
            await _end_all([child], END_GRACE)
        await watching


def write_results(path: Path, results: Results) -> None:
    """Write the results of a process for its parent, in the encoding of messages.

    A file of its own keeps them apart from the output of the mission.
    Raises ProcessFailed if there is no room for it.
    """
    try:
        path.write_bytes(encode(results, PROCESS_OUTPUT_LIMITS.results))
    except OSError as error:
        reason = f"its result is lost: {path.parent}: {error.strerror or error}. Set TMPDIR to a folder with more room."
        raise ProcessFailed(f"drones {', '.join(map(str, results))}", reason) from error


def read_results(path: Path) -> Results:
    """Return the results that a process has written; empty if it ended before it wrote them."""
    try:
        results: Results = decode(path.read_bytes(), PROCESS_OUTPUT_LIMITS.results)
    except (OSError, CodecError):
        return {}
    return results


def compute_patience(config: SwarmConfig) -> float:
    """Return the seconds that processes get to land their drones and end.

    The landing may begin at the top of the fence, and may be delayed by up to the landing_deadline of MISSION_TIMES.
    END_GRACE is added for the end of the processes.
    """
    flight = config.flight
    height = config.fence.max[2] - flight.ground
    top = FullState.at((0.0, 0.0, height))
    floor = np.zeros(3)
    fastest = compute_flight_time(
        top, floor, 0.0, flight.speed_limit, flight.acceleration_limit
    )
    return (
        max(PEAK_SPEED * height / flight.landing_speed, fastest)
        + MISSION_TIMES.landing_deadline
        + END_GRACE
    )


async def _pass_on_output(child: ForkedProcess, say: Say) -> None:
    """Pass on the output of a process, line by line, until it ends."""
    await _pass_on_lines(child.stdout, say)
    await child.wait()


async def _pass_on_lines(output: asyncio.StreamReader, say: Say) -> None:
    """Pass on an output, line by line, until its end."""
    rest = b""
    while chunk := await output.read(PROCESS_OUTPUT_LIMITS.chunk):
        *lines, rest = (rest + chunk).split(b"\n")
        if len(rest) > PROCESS_OUTPUT_LIMITS.line:
            lines = [*lines, rest]
            rest = b""
        for line in lines:
            say(line.decode(errors="replace").rstrip())
    if rest:
        say(rest.decode(errors="replace").rstrip())


def _drop_repetitions(say: Say) -> Say:
    """Return a function that passes on lines but drops repetitions.

    All processes may report the same missing compiled code. Of these lines only the first of each
    cache is passed on, and the line about compiling appears once.
    """
    told: list[str] = []

    def passed(line: str) -> None:
        cache = line.removeprefix(CACHE_WARNING).partition(":")[0]
        reason = None
        if line == COMPILING_MESSAGE:
            reason = line
        elif line.startswith(CACHE_WARNING):
            reason = cache
        if reason is None or reason not in told:
            say(line)
        if reason is not None:
            told.append(reason)

    return passed


def _describe_end(child: ForkedProcess) -> str:
    """Return how a process has ended, in words."""
    code = child.returncode
    if code is None or code >= 0:
        return f"ended with code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:  # a real-time signal without a name
        return f"was ended by signal {-code}"


def _signal_all(children: Iterable[ForkedProcess], number: signal.Signals) -> None:
    for child in children:
        with contextlib.suppress(ProcessLookupError):
            child.send_signal(number)


async def _end_all(children: list[ForkedProcess], seconds: float) -> None:
    """Ask every process to land and exit; kill those still running after `seconds`."""
    if not children:
        return
    _signal_all(children, signal.SIGTERM)
    waits = [asyncio.create_task(child.wait()) for child in children]
    _, late = await asyncio.wait(waits, timeout=seconds)
    for child in children if late else []:
        with contextlib.suppress(ProcessLookupError):
            child.kill()
    await asyncio.wait(waits)
