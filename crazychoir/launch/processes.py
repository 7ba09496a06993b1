"""The agents of a run as processes of this machine: started, listened to, ended; and how their results get here."""

import asyncio
import contextlib
import math
import signal
import sys
from asyncio.subprocess import DEVNULL, PIPE, STDOUT, Process
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.agent.mission_runner import LANDING_DEADLINE
from crazychoir.bus.codec import decode, encode
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import CodecError, ProcessFailed
from crazychoir.files.path_texts import child_environment
from crazychoir.files.user_folders import WARNING
from crazychoir.numerics.kernel_cache import COMPILES, shared_by_children
from crazychoir.planning.point_to_point import PEAK_SPEED, duration_for
from crazychoir.runtime.worker_thread import add_signal_handler
from crazychoir.types import FullState

GRACE = 20.0
"""s that processes get to end after SIGTERM beside the time of their landings, before they are killed."""
ORPHANED = 8.0
"""s that agents get after the end of their world's owner: they notice within 3 s and end, but for those that have never
heard of it and wait."""
STARTS_AGAIN, WITHIN = 5, 600.0
"""How often in so many s an owner is started again that ends before it is told to."""
REFUSED = 2
"""Exit code of a program that has refused what the user wrote."""
CHUNK = 1 << 16
"""Bytes read at once of what a process says; a line may be of any length, and is passed on in parts if very long."""
LONGEST = 1 << 20
LARGEST = 1 << 30
"""Bytes of the results of one process: each is limited by the codec, their number by the swarm file."""

Say = Callable[[str], None]
Results = dict[int, dict[str, Any]]
Children = dict[tuple[int, ...], Process]


@dataclass(frozen=True)
class Owner:
    """A process that owns what agents need: who it is, its module, and its options.

    again: whether it is started again if it ends before them: what it owns is still there;  ids: drones that need it,
    None: all. Agents of no others end with it for good.
    """

    name: str
    module: str
    options: tuple[str, ...] = ()
    again: bool = False
    ids: tuple[int, ...] | None = None


WORLD_OWNER = Owner("world", "crazychoir.cli.fly.world")


async def run_children(
    groups: list[tuple[int, ...]],
    path: Path,
    config: SwarmConfig,
    options: list[str],
    say: Say,
    all_wait: Callable[[], bool] = lambda: False,
    owners: Sequence[Owner] = (),
) -> Results:
    """One process a group, until all have ended; their results, of those that had one.

    path: the swarm file; results lie beside it while this runs;  all_wait: whether they still wait for each other:
    then one that ends without a result ends all, for nobody would come that they could wait for;  owners: of their
    world, cameras and dongles, that are started here too.
    """
    say = _once(say)
    files = {group: path.with_name(f"result-{group[0]}") for group in groups}
    children: Children = {}
    async with contextlib.AsyncExitStack() as stack:
        stack.enter_context(shared_by_children(path.parent))
        for owner in owners:
            await stack.enter_async_context(_owner(owner, path, children, say))
        await _run_agents(children, path, files, config, options, say, all_wait)
    results: Results = {}
    for group, child in children.items():
        found = read_results(files[group])
        results |= found
        if not found:
            say(
                f"drone(s) {', '.join(map(str, group))}: no result: the process {_end_of(child)}"
            )
    return results


async def _run_agents(
    children: Children,
    path: Path,
    files: dict[tuple[int, ...], Path],
    config: SwarmConfig,
    options: list[str],
    say: Say,
    all_wait: Callable[[], bool],
) -> None:
    """Start one a file, and stay until all have ended."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        add_signal_handler(number, _signal, children.values(), number)

    async def until_its_end(group: tuple[int, ...]) -> None:
        await _listen(children[group], say)
        if all_wait() and not read_results(files[group]):
            say(
                f"drone(s) {', '.join(map(str, group))}: ended before the start: the others wait no more"
            )
            _signal(children.values(), signal.SIGTERM)

    try:
        for group, file in files.items():
            children[group] = await _spawn(group, path, file, options)
        await asyncio.gather(*map(until_its_end, files))
    finally:
        await _end(
            [child for child in children.values() if child.returncode is None],
            patience(config),
        )


@contextlib.asynccontextmanager
async def _owner(
    owner: Owner, path: Path, agents: Children, say: Say
) -> AsyncIterator[None]:
    """An owner that the agents need: it is there before them and ends after them."""
    command = (owner.module, "--swarm", str(path), *owner.options, "--child")
    child = await _start(*command)
    over = asyncio.Event()
    now = asyncio.get_running_loop().time

    async def watch() -> None:
        nonlocal child
        starts = [-math.inf] * STARTS_AGAIN  # s, of the last ones
        await _listen(child, say)
        while (
            owner.again
            and starts[0] < now() - WITHIN
            and not over.is_set()
            and child.returncode != REFUSED
        ):
            say(f"{owner.name}: its owner {_end_of(child)}: started again")
            starts = [*starts[1:], now()]
            child = await _start(*command)
            if over.is_set():
                await _end([child], GRACE)
            await _listen(child, say)
        if over.is_set():
            return
        refused = (
            child.returncode == REFUSED and starts[-1] == -math.inf
        )  # before it ever had a drone
        say(
            f"{owner.name}: its owner {_end_of(child)}: its drones {'do not fly' if refused else 'stop'}"
        )
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(
                0.0 if child.returncode == REFUSED else ORPHANED
            ):
                await over.wait()
        needed = [
            agent
            for ids, agent in agents.items()
            if owner.ids is None or {*ids} <= {*owner.ids}
        ]
        _signal([agent for agent in needed if agent.returncode is None], signal.SIGTERM)

    watching = asyncio.create_task(watch())
    try:
        yield
    finally:
        over.set()
        if child.returncode is None:
            await _end([child], GRACE)
        await watching


def write_results(path: Path, results: Results) -> None:
    """What a process has come to, for who started it: as messages travel, and apart from what its mission prints.

    Raises ProcessFailed where there is no room for it.
    """
    try:
        path.write_bytes(encode(results, LARGEST))
    except OSError as error:
        reason = f"its result is lost: {path.parent}: {error.strerror or error}. Set TMPDIR to a folder with more room."
        raise ProcessFailed(f"drones {', '.join(map(str, results))}", reason) from error


def read_results(path: Path) -> Results:
    """The results that a process has left there; none if it has not got so far."""
    try:
        results: Results = decode(path.read_bytes(), LARGEST)
    except (OSError, CodecError):
        return {}
    return results


def patience(config: SwarmConfig) -> float:
    """s that processes get to land their drones and end: from the top of the fence down, and what may delay that."""
    flight = config.flight
    height = config.fence.max[2] - flight.ground
    top = FullState.at((0.0, 0.0, height))
    floor = np.zeros(3)
    fastest = duration_for(
        top, floor, 0.0, flight.speed_limit, flight.acceleration_limit
    )
    return (
        max(PEAK_SPEED * height / flight.landing_speed, fastest)
        + LANDING_DEADLINE
        + GRACE
    )


async def _spawn(
    group: tuple[int, ...], path: Path, result: Path, options: list[str]
) -> Process:
    ids = [word for i in group for word in ("--id", str(i))]
    return await _start(
        "crazychoir.cli.fly.agent",
        "--swarm",
        str(path),
        *ids,
        "--child",
        str(result),
        *options,
    )


async def _start(module: str, *words: str) -> Process:
    return await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        module,
        *words,
        stdin=DEVNULL,
        stdout=PIPE,
        stderr=STDOUT,
        env=child_environment(),
        start_new_session=True,  # Ctrl-C reaches this process alone, which passes it on once
    )


async def _listen(child: Process, say: Say) -> None:
    """Pass on what a process says, line by line, until it ends."""
    assert child.stdout is not None  # noqa: S101 - it was asked for
    rest = b""
    while chunk := await child.stdout.read(CHUNK):
        *lines, rest = (rest + chunk).split(b"\n")
        if len(rest) > LONGEST:
            lines = [*lines, rest]
            rest = b""
        for line in lines:
            say(line.decode(errors="replace").rstrip())
    if rest:
        say(rest.decode(errors="replace").rstrip())
    await child.wait()


def _once(say: Say) -> Say:
    """Pass on lines that all processes say for one reason from the first of them: of each cache what it lacks."""
    told: list[str] = []

    def passed(line: str) -> None:
        cache = line.removeprefix(WARNING).partition(":")[0]
        reason = (
            line if line == COMPILES else cache if line.startswith(WARNING) else None
        )
        if reason is None or reason not in told:
            say(line)
        if reason is not None:
            told.append(reason)

    return passed


def _end_of(child: Process) -> str:
    """How it has ended, in words."""
    code = child.returncode
    if code is None or code >= 0:
        return f"ended with code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:  # a real-time signal without a name
        return f"was ended by signal {-code}"


def _signal(children: Iterable[Process], number: signal.Signals) -> None:
    for child in children:
        with contextlib.suppress(ProcessLookupError):
            child.send_signal(number)


async def _end(children: list[Process], seconds: float) -> None:
    """Ask every child to land and exit; kill what does not within so long."""
    if not children:
        return
    _signal(children, signal.SIGTERM)
    waits = [asyncio.create_task(child.wait()) for child in children]
    _, late = await asyncio.wait(waits, timeout=seconds)
    for child in children if late else []:
        with contextlib.suppress(ProcessLookupError):
            child.kill()
    await asyncio.wait(waits)
