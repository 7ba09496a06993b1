"""Many drones on this machine: one process in virtual time, or processes of agents in real time; and the score."""

import asyncio
import contextlib
import json
import math
import random
import signal
import socket
import sys
import tempfile
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from crazychoir.agent import VERSION, Agent
from crazychoir.bus.local import OBSERVER, Bus
from crazychoir.bus.topics import LOG, STATUS, TRUTH, Topic
from crazychoir.bus.zenoh import ZenohLink
from crazychoir.errors import ConfigError
from crazychoir.guidance.base import LAW
from crazychoir.guidance.mission import Mission, has
from crazychoir.math3d import Vec
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock, run_virtual, run_wall
from crazychoir.runtime.mailbox import Call
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.simulation.trace import Trace
from crazychoir.swarm.config import SwarmConfig
from crazychoir.types import State, Status

SETTLED = 0.01
"""m, from the goal: a formation is settled when every drone stays within it."""
GRACE = 20.0
"""s that processes get to end after SIGTERM, before they are killed."""
LOGGED = 1000
"""Log lines that a score keeps: the newest."""

Watch = Callable[["Score"], None]


@dataclass
class Score(Actor):
    """What an observer sees of a swarm: states, statuses, distances, lengths flown, distance from a goal.

    It is as large after an hour as after a minute.
    errors: (s since the law began, m of the drone that is farthest from its goal), the last time that anybody was
    beyond SETTLED, and the newest.
    """

    bus: Bus
    ids: tuple[int, ...]
    goal: dict[int, Vec] = field(default_factory=dict)
    watch: Watch = lambda score: None
    name: str = "score"
    address: int = OBSERVER

    def __post_init__(self) -> None:
        self.statuses: dict[int, Status] = {}
        self.log: deque[str] = deque(maxlen=LOGGED)
        self.min_separation = float("inf")
        self.flown: dict[int, float] = dict.fromkeys(self.ids, 0.0)
        self.errors: list[tuple[float, float]] = []
        self._seen: dict[int, tuple[Vec, Vec, float]] = {}
        self._law = False
        self._started = self._ended = float("nan")
        if self.address not in self.bus.ports:
            self.bus.port(self.address)
        for i in self.ids:
            self._listen(TRUTH, i, partial(self._moved, i))
            self._listen(STATUS, i, partial(self._told, i))
            self._listen(LOG, i, self._logged)

    def _listen(self, topic: Topic, i: int, function: Callable[[Any, float], None]) -> None:
        self.bus.subscribe(topic, i, self.address, Call(self.bus.clock, function))

    async def run(self) -> None:
        """Look at the whole swarm as often as truth comes."""
        async for _ in self.bus.clock.ticks(TRUTH.rate):
            self._look()
            self.watch(self)

    def _moved(self, i: int, state: State, age: float) -> None:
        seen = self._seen.get(i)
        if seen is not None:
            self.flown[i] += math.dist(state.p.tolist(), seen[0].tolist())
        self._seen[i] = (state.p, state.v, self.bus.clock.now() - age)

    def _logged(self, line: str, age: float) -> None:
        self.log.append(line)

    def _told(self, i: int, status: Status, age: float) -> None:
        self.statuses[i] = status
        now = self.bus.clock.now()
        flying = status.phase in ("hovering", "mission") and status.task == LAW
        if not self._law and self.goal and flying:
            self._law, self._started = True, now
        if self._law and status.task == "landing" and np.isnan(self._ended):
            self._ended = now

    def _look(self) -> None:
        if len(self._seen) < len(self.ids):
            return
        now = self.bus.clock.now()
        p, v, when = (np.array(column) for column in zip(*(self._seen[i] for i in self.ids), strict=True))
        if len(p) > 1:
            gaps = pdist(p + (now - when)[:, None] * v)
            self.min_separation = min(self.min_separation, float(gaps.min()))
        if self._law and np.isnan(self._ended):
            far = max(float(np.linalg.norm(self._seen[i][0] - self.goal[i])) for i in self.goal)
            beyond = [error for error in self.errors if error[1] > SETTLED]
            self.errors = [*beyond[-1:], (now - self._started, far)]

    def formation(self) -> dict[str, float | None]:
        """formation_error_m at the end of the law, settling_s until all stay within 1 cm of the goal (null: never)."""
        if not self.errors:
            return {}
        late = [t for t, far in self.errors if far > SETTLED]
        settled = (late[-1] if late else 0.0) if self.errors[-1][1] <= SETTLED else None
        return {"formation_error_m": self.errors[-1][1], "settling_s": settled}

    def messages(self) -> dict[str, int]:
        """Totals over the drones, from their last statuses."""
        of = self.statuses.values()
        return {name: sum(getattr(status, name) for status in of) for name in ("sent", "lost", "resent")}


def goal_of(mission: Mission, config: SwarmConfig) -> dict[int, Vec]:
    """Where the drones are to be, if the mission says so."""
    return {i: np.asarray(p) for i, p in mission.goal(config).items()} if has(mission, "goal") else {}


def fly_fast(config: SwarmConfig, mission: Mission, watch: Watch | None = None) -> dict[str, Any]:
    """The whole swarm in this process, in virtual time."""
    began = time.perf_counter()

    async def main(clock: Clock) -> dict[str, Any]:
        trace = Trace()
        agent = Agent(clock, config, mission, config.ids, trace=trace)
        score = Score(agent.bus, config.ids, goal_of(mission, config), watch or (lambda score: None))
        agent.services.append(score)
        results = await agent.run()
        rounds = max(drone.communicator.rounds for drone in agent.drones.values())
        counters = [drone.port.counters for drone in agent.drones.values()]
        messages = {name: sum(getattr(c, name) for c in counters) for name in ("sent", "lost", "resent")}
        wall = time.perf_counter() - began
        return summary(config, mission, results, score, clock.now(), wall) | {
            "messages": messages, "rounds": rounds, "digest": trace.digest(),
        }  # fmt: skip

    return run_virtual(main)


def summary(
    config: SwarmConfig,
    mission: Mission,
    results: dict[int, dict[str, Any]],
    score: Score,
    simulated: float,
    wall: float,
    here: tuple[int, ...] | None = None,
) -> dict[str, Any]:
    """The object that `run --json` prints.

    here: the drones that were started here, None for all: they decide on the success. What is measured from outside
    is of the whole swarm. The mission's own report needs the results of all drones, and is left out without them.
    """
    here = config.ids if here is None else here
    reasons = {i: r.get("reason", "no result") for i, r in sorted(results.items()) if not r.get("success")}
    absent = [i for i in here if i not in results]
    separation = score.min_separation
    of_mission = mission.report(config, results) if here == config.ids and has(mission, "report") else {}
    reached = bool(of_mission.pop("success", True))
    return {
        "mission": config.mission,
        "success": reached and not reasons and not absent,
        "drones": len(config.ids),
        "here": list(here),
        "simulated_s": simulated,
        "wall_s": wall,
        "real_time_factor": simulated / wall,
        "min_separation_m": separation if np.isfinite(separation) else None,
        "messages": score.messages(),
        "rounds": max((status.round for status in score.statuses.values()), default=0),
        "digest": None,
        "reasons": of_mission.pop("reasons", {}) | reasons,
        "absent": absent,
        "flown_m": {i: round(length, 4) for i, length in score.flown.items()},
        "log": list(score.log),
        "results": results,
        **of_mission,
        **score.formation(),
    }


# Real time ------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def swarm_file(config: SwarmConfig) -> Iterator[Path]:
    """The swarm as a file, while it flies: for its processes, and for who wants to look into it."""
    with tempfile.TemporaryDirectory(prefix=f"crazychoir-{config.name}-") as folder:
        path = Path(folder) / "swarm.json"
        path.write_text(config.dumps())
        yield path


def fly_real(
    path: Path, config: SwarmConfig, mission: Mission, options: Iterable[str] = (), watch: Watch | None = None,
    say: Callable[[str], None] = lambda line: None, here: tuple[int, ...] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """One process a group of the swarm file, over Zenoh; this process looks on.

    path: the file of `config`, for the processes;  here: the drones to start, None for all: whole groups.
    """
    began = time.perf_counter()
    groups = [group for group in config.groups() if here is None or any(i in here for i in group)]

    async def main(clock: Clock) -> dict[str, Any]:
        link = observer(clock, config)
        address = next(iter(link.bus.ports))
        score = Score(link.bus, config.ids, goal_of(mission, config), watch or (lambda score: None), address=address)
        async with attached(link, score):
            results = await _run_children(groups, path, list(options), say)
        wall = time.perf_counter() - began
        return summary(config, mission, results, score, wall, wall, here)

    return run_wall(main)


def observer(clock: Clock, config: SwarmConfig) -> ZenohLink:
    """The link of an observer under a name and an address of its own: many may look on at once, from many hosts."""
    draw = random.SystemRandom()
    bus = Bus(clock, process=f"observer-{draw.getrandbits(32):08x}", host="observer")
    bus.port(OBSERVER + 1 + draw.getrandbits(24), draw.getrandbits(32))
    return observer_link(bus, config)


def observer_link(bus: Bus, config: SwarmConfig) -> ZenohLink:
    """The network as an observer sees it: connected to every process of the swarm file, listening nowhere known."""
    return ZenohLink(
        bus, config.name, listen=["tcp/127.0.0.1:0"], connect=list(config.endpoints().values()),
        incarnation=random.SystemRandom().getrandbits(62), version=VERSION, lease=config.lease,
    )  # fmt: skip


@contextlib.asynccontextmanager
async def attached(link: ZenohLink, *actors: Actor) -> AsyncIterator[None]:
    """On the network, with these actors at work; afterwards all have stopped."""
    link.open()
    serving = asyncio.create_task(Supervisor(link.bus.clock, "observer").run([link, *actors]))
    try:
        yield
    finally:
        serving.cancel()
        await asyncio.wait([serving])


async def _run_children(
    groups: list[tuple[int, ...]], path: Path, options: list[str], say: Callable[[str], None]
) -> dict[int, dict[str, Any]]:
    children = [await _spawn(group, path, options) for group in groups]
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, _terminate, children)
    try:
        ends = await asyncio.gather(*(_result(child, say) for child in children))
    finally:
        await _end([child for child in children if child.returncode is None])
    return {int(i): result for part in ends for i, result in part.items()}


async def _spawn(group: tuple[int, ...], path: Path, options: list[str]) -> asyncio.subprocess.Process:
    ids = [word for i in group for word in ("--id", str(i))]
    command = [sys.executable, "-m", "crazychoir.cli.agent", "--swarm", str(path), *ids, "--json", "--child", *options]
    return await asyncio.create_subprocess_exec(
        *command,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C reaches this process alone, which passes it on once
    )


async def _result(child: asyncio.subprocess.Process, say: Callable[[str], None]) -> dict[str, Any]:
    """What a child says on standard output when it ends; its standard error, line by line, meanwhile."""
    assert child.stdout is not None  # noqa: S101 - it was asked for

    async def pass_on() -> None:
        assert child.stderr is not None  # noqa: S101
        async for line in child.stderr:
            say(line.decode(errors="replace").rstrip())

    out, _ = await asyncio.gather(child.stdout.read(), pass_on())
    await child.wait()
    try:
        parsed: dict[str, Any] = json.loads(out)["results"]
    except (ValueError, KeyError):
        return {}
    return parsed


def _terminate(children: list[asyncio.subprocess.Process]) -> None:
    for child in children:
        with contextlib.suppress(ProcessLookupError):
            child.terminate()


async def _end(children: list[asyncio.subprocess.Process]) -> None:
    """Ask every child to land and exit; kill what does not."""
    if not children:
        return
    _terminate(children)
    waits = [asyncio.create_task(child.wait()) for child in children]
    _, late = await asyncio.wait(waits, timeout=GRACE)
    for child in children if late else []:
        with contextlib.suppress(ProcessLookupError):
            child.kill()
    await asyncio.wait(waits)


def apart(config: SwarmConfig, processes: int | None) -> SwarmConfig:
    """The same swarm under a name and on ports of its own, in so many processes: two runs side by side never meet."""
    groups = [list(map(int, part)) for part in np.array_split(config.ids, processes)] if processes else None
    suffix = f"{random.SystemRandom().getrandbits(32):08x}"
    changes: dict[str, Any] = {"name": f"{config.name[:30]}-{suffix}"}
    if groups:
        changes["processes"] = [group for group in groups if group]
    changed = config.replace(**changes)
    return changed.replace(base_port=free_ports([group[0] for group in changed.groups()]))


def free_ports(offsets: list[int], attempts: int = 200) -> int:
    """A base port such that base + offset is free for each offset."""
    draw = random.SystemRandom()
    for _ in range(attempts):
        base = draw.randrange(20_000, 60_000 - max(offsets))
        if all(_free(base + offset) for offset in offsets):
            return base
    raise ConfigError("base_port", f"no free block for {len(offsets)} processes", "free ports", "Set base_port.")


def _free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
