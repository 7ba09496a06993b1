"""Scenarios in flight: missions over a bad network with crashes, partitions and cameras that do not see."""

import asyncio
import math
from collections import Counter
from itertools import combinations
from typing import Any

import msgspec
import numpy as np
from system.online import crash, drawn

from campaign import faults
from campaign.faults import Draw
from campaign.report import Report, digest
from crazychoir.agent.agent import Agent
from crazychoir.bus.impairment.rules import NetworkPartition
from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import Mission, load_mission
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock, run_virtual
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.owner import WorldOwner
from crazychoir.simulation.trace import Trace
from crazychoir.types import Acceleration, CameraFrame, FullState, Mat

BRISK = {
    "takeoff_height": 0.5,
    "speed_limit": 1.5,
    "acceleration_limit": 3.0,
    "landing_speed": 0.6,
}
IN_FLIGHT = 20.0
"""s after the first take-off at which all are told to land;  DELIVERING: the same where goods are delivered, as most
are after 20 s; a partition of 15 s keeps some waiting."""
DELIVERING = 45.0
QUICK = BRISK | {"speed_limit": 3.0, "acceleration_limit": 6.0}
LONG = 90.0
"""s after the first take-off when all are told to land if a drone is cut off for good; it must have ended by then."""
LONGEST = 120.0
"""s of virtual time in which every wait of a flight must be over."""
OUTSIDE = 0.15
"""m beyond the fence with running motors that a safety table may need to stop a drone; the limit area is 0.5 m off."""
BLIND, DRIFT, BACK = 0.1, 1.0, 2.0
"""s, m/s2, s: a drone that is not seen for t > BLIND strays by DRIFT t^2 / 2 from where it believes to be. A drone that
is tilted by 0.1 rad more than it knows strays so far. It has BACK s to correct that when it is seen again."""
BRAKING_DRIFT = 2.0
"""m/s2, instead of DRIFT for a drone with a law that runs away. It brakes at the fence as hard as it can, so it may be
tilted by 0.2 rad more than it knows."""
UNSEEN = 0.7
"""s without a pose after which a drone lands, or its motors are off: 0.5 by the safety table."""
NEWS_TIME = 2.0
"""Seconds after a delivery within which the other drones hear of it, although many messages are lost."""
LOW = 0.1
"""m above the floor: below it a drone stands, or is about to."""


class Invariants(Actor):
    """Checks at each step the distances, the fence and unseen drones, and whether all drones come down in time."""

    name = "invariants"

    def __init__(self, agent: Agent, report: Report, until: float) -> None:
        self.agent, self.report, self.until, self.killed = (
            agent,
            report,
            until,
            dict[int, float](),
        )
        self.began, self.seen, self.blind = (
            np.inf,
            dict[int, float](),
            dict[int, tuple[float, float]](),
        )
        self.alone: int | None = None
        self.runaway: int | None = None
        """The drone with a law that runs away."""
        self.ended: dict[int, float] = {}
        """s: when the mission of each drone ended."""
        self.served: dict[tuple[int, str], float] = {}
        """{(task, kind): s, when its drone noted that it has done this}."""
        self._served_by = Counter[int]()
        self._said: dict[Any, None] = {}
        self._low = agent.config.fence.min
        self._high = agent.config.fence.max

    async def run(self) -> None:
        """Check the drones a hundred times a second."""
        async for _ in self.agent.clock.ticks(100.0):
            self.look(self.agent.clock.now())

    def look(self, now: float) -> None:
        """Check the drones at one step."""
        agent = self.agent
        # Plain floats: most steps find nothing wrong, and arrays of so few drones are slow.
        p: dict[int, list[float]] = {}
        for owner in agent.owners:
            places = owner.world.states[:, 0:3].tolist()
            p.update(zip(owner.world.ids, places, strict=True))
        # A drone that falls may hit others.
        up = [i for i in agent.ids if p[i][2] > LOW and i not in self.killed]
        if up and self.began == np.inf:
            self.began = now
        if now - self.began > self.until:
            self._end(now)
        if not math.isfinite(sum(map(sum, p.values()))):
            self._find_nowhere(p, now)
        for i, drone in agent.drones.items():
            if drone.result:
                self.ended.setdefault(i, now)
            service = getattr(drone.guidance, "service", None)
            if service is not None and len(service.served) != self._served_by[i]:
                self._served_by[i] = len(service.served)
                for stop in service.served:
                    self.served.setdefault((stop["task"], stop["kind"]), now)
        self.report.checks += len(up)
        for i in up:
            unseen = now - self.seen.get(i, now)
            self._check_fence(i, p[i], unseen, now)
            self._check_unseen(i, unseen, now)
        self._check_distances({i: p[i] for i in up}, now)

    def was_cut_off(self, i: int, by: int) -> bool:
        """Return whether the mission of drone `by` ended while a partition kept it from hearing drone i."""
        network = self.agent.bus.impairment
        age = self.ended.get(by, np.inf) - network.began
        return any(
            cut.since <= age < cut.until and cut.cuts(i, by)
            for cut in network.partitions
        )

    def _end(self, now: float) -> None:
        """Tell all to land; by then a drone that is cut off for good must have ended."""
        self.began = np.nan  # said once
        ended = (
            self.alone is None
            or self.alone in self.killed
            or self.agent.drones[self.alone].result
        )
        if not ended:
            self._wrong(
                "alone",
                f"drone {self.alone}, cut off for good, still waits at {now:.2f} s",
            )
        self.agent.land_all("the scenario is over")

    def _find_nowhere(self, p: dict[int, list[float]], now: float) -> None:
        """Report each drone at a place that is not finite."""
        for i, place in p.items():
            if not all(map(math.isfinite, place)):
                self._wrong(("nowhere", i), f"drone {i} is at {place} at {now:.2f} s")

    def _check_fence(self, i: int, p: list[float], unseen: float, now: float) -> None:
        """Check that drone i at p, (3,) m, is inside the fence, or its motors are cut; unseen: s without a pose."""
        x, y, z = p
        low_x, low_y, low_z = self._low
        high_x, high_y, high_z = self._high
        beyond = max(
            low_x - x, x - high_x, low_y - y, y - high_y, low_z - z, z - high_z
        )
        if unseen > BLIND:
            self.blind[i] = (now, unseen)
        when, gap = self.blind.get(i, (-np.inf, 0.0))
        drift = BRAKING_DRIFT if i == self.runaway else DRIFT
        allowed = OUTSIDE + (0.5 * drift * gap**2 if now - when < BACK else 0.0)
        if beyond > allowed and self.agent.drones[i].pilot.mode is not Mode.CUT:
            self._wrong(
                ("fence", i),
                f"drone {i} is {beyond:.2f} m outside the fence at {now:.2f} s, motors on",
            )

    def _check_unseen(self, i: int, unseen: float, now: float) -> None:
        """Check that drone i lands, or its motors are cut, after this many s without a pose."""
        if unseen <= UNSEEN:
            return
        if self.agent.drones[i].pilot.mode not in (Mode.LAND, Mode.CUT):
            self._wrong(
                ("unseen", i),
                f"drone {i} flies on unseen for {unseen:.2f} s at {now:.2f} s",
            )

    def _check_distances(self, p: dict[int, list[float]], now: float) -> None:
        """Check that no two of these drones, each with its place in m, touch."""
        for i, j in combinations(p, 2):
            apart = math.dist(p[i], p[j])
            if apart < SWARM_LIMITS.touching_distance:
                self._wrong(
                    ("near", i, j),
                    f"drones {i} and {j} are {apart:.3f} m from each other at {now:.2f} s",
                )

    def _wrong(self, what: Any, text: str) -> None:
        if what not in self._said:
            self._said[what] = None
            self.report.wrong.append(text)


def dropouts(agent: Agent, report: Report, draw: Draw, watch: Invariants) -> None:
    """For a while the cameras do not see a drone."""
    gaps = []
    for _ in range(int(draw.integers(0, 4))):
        since, length = (
            float(draw.uniform(1.0, 15.0)),
            float(draw.choice([0.05, 0.3, 0.8, 3.0])),
        )
        gaps.append((int(draw.choice(agent.ids)), since, since + length))
        report.inject("mocap dropouts")
    if not gaps:
        return
    for owner in agent.owners:
        _cover(owner, gaps, watch)


def _cover(
    owner: WorldOwner, gaps: list[tuple[int, float, float]], watch: Invariants
) -> None:
    """Cover the cameras of a world: gaps are drones, each with the s between which it is not seen."""
    sample = owner.cameras.sample

    def covered(x: Mat, k: int) -> CameraFrame | None:
        frame = sample(x, k)
        if frame is None:
            return None
        now = owner.bus.clock.now()
        for i, since, until in gaps:
            if since <= now < until and i in owner.world.row:
                frame.seen[owner.world.row[i]] = False
        for i, is_seen in zip(owner.world.ids, frame.seen.tolist(), strict=True):
            if is_seen:
                watch.seen[i] = now
        return frame

    owner.cameras.sample = covered  # type: ignore[method-assign]


def runaway(agent: Agent, report: Report, draw: Draw) -> int | None:
    """Let the law of a drone want it out of the fence from some time on: the safety table must keep it inside.

    Returns the drone, or None: in most flights there is none.
    """
    if draw.random() < 0.7:
        return None
    i, since, angle = (
        int(draw.choice(agent.ids)),
        float(draw.uniform(2.0, 6.0)),
        float(draw.uniform(0.0, 2.0 * np.pi)),
    )
    way, pilot = np.array([np.cos(angle), np.sin(angle), 0.0]), agent.drones[i].pilot
    report.inject("runaway laws")

    def run_away(now_ns: int) -> None:
        row = pilot.row
        # What the law has not given in this tick becomes stale as ever.
        has_stepped = row.drone["reference_ns"] == now_ns
        if not has_stepped or pilot.clock.now() < since or pilot.state is None:
            return
        match row.reference:
            case Acceleration():
                pilot.follow(Acceleration(2.0 * way))
            case FullState():
                pilot.follow(FullState.at(pilot.state.p + 0.3 * way, way))

    pilot.tick.deciders.append(run_away)
    return i


def flown(
    report: Report,
    draw: Draw,
    config: SwarmConfig,
    mission: Mission,
    kills: int,
    until: float = IN_FLIGHT,
) -> Agent | None:
    """Fly it with faults; the agent afterwards, for what is to be looked at of its mission.

    until: s after the first take-off at which all are told to land; LONG: the last drone is cut off for good.
    """
    config = config.replace(
        drones=[msgspec.structs.replace(d, uri=report.world) for d in config.drones]
    )
    ids, agents = config.ids, list[Agent]()
    network = faults.rules(draw, report, ids, 0.3)
    cuts = faults.partitions(draw, report, ids, 15.0)
    if until == LONG:
        cuts.append(NetworkPartition(float(draw.uniform(2.0, 10.0)), LONGEST, ids[-1:]))
        report.inject("cut off for good")
    victims = draw.choice(ids, kills, replace=False).tolist() if kills else []
    report.inject("crashes", kills)

    async def main(clock: Clock) -> None:
        trace = Trace()
        agent = Agent(clock, config, mission, ids, trace=trace)
        agents.append(agent)
        agent.bus.impairment.replace(network, cuts)
        watch = Invariants(agent, report, until)
        watch.alone = ids[-1] if until == LONG else None
        agent.services.append(watch)
        dropouts(agent, report, draw, watch)

        def kill(i: int) -> None:
            if not agent.drones[i].result:
                watch.killed[i] = clock.now()
                crash(agent, i)

        for i in victims:
            clock.call_at(round(float(draw.uniform(1.0, 15.0)) * 1e9), kill, i)
        watch.runaway = runaway(agent, report, draw)
        async with asyncio.timeout(LONGEST):
            results = await agent.run()
        for i in ids:
            report.holds(results[i] or i in watch.killed, f"drone {i} has no result")
            mode = agent.drones[i].pilot.mode
            report.holds(
                mode in (Mode.GROUND, Mode.CUT), f"drone {i} ends {mode.value}"
            )
        report.simulated_s = clock.now()
        report.digest = digest(trace.digest(), clock.now_ns())

    run_virtual(main)
    return agents[0] if agents else None


def formation(report: Report, draw: Draw) -> None:
    """A formation by bearings, scattered at first."""
    mission = load_mission("bearing_formation")
    made = mission.swarm(None).replace(
        seed=report.seed,
        flight=BRISK,
        lost_after=2.0,
        start=3,
        start_deadline=3.0,
        mission_options={"duration": float(draw.uniform(4.0, 12.0))},
    )
    flown(report, draw, mission.scatter(made), mission, int(draw.integers(0, 2)))


def crossing(report: Report, draw: Draw) -> None:
    """Drones that fly straight at each other."""
    mission, n = load_mission("crossing"), int(draw.integers(2, 6))
    made = mission.swarm(n).replace(seed=report.seed, lost_after=2.0)
    options = {
        "pattern": "antipodal",
        "radius": 1.2,
        "low": 0.8,
        "high": 1.2,
        "jitter": 0.05,
        "duration": 8.0,
    }
    config = mission.scatter(
        made.replace(mission_options=made.mission_options | options)
    )
    flown(report, draw, config, mission, int(draw.integers(0, 2)))


def is_known(agent: Agent, task: int, kind: str, servers: list[int]) -> bool:
    """Return whether another drone has heard that this was done.

    servers: the drones that have done it
    """
    others = [agent.drones[i].guidance for i in agent.ids if i not in servers]
    return any(
        deed.task == task and deed.kind == kind
        for guidance in others
        if hasattr(guidance, "news")  # its mission has begun
        for record in guidance.news.book.records.values()
        for deed in record.deeds
    )


def may_be_unknown(
    agent: Agent, watch: Invariants, task: int, kind: str, servers: list[int]
) -> bool:
    """Return whether no other drone need have heard that this was done.

    A drone that is cut off delivers what it has on board, and no other drone hears of that. A drone with
    an ended mission hears nothing more either.

    servers: the drones that have done it
    """
    gone = {*watch.killed, watch.alone}
    others = [i for i in agent.ids if i not in servers]
    if len(agent.ids) == 2 or gone.issuperset(others):
        return True
    if kind == "pickup":
        return False
    if watch.alone in servers:
        return True
    done_at = watch.served.get((task, kind), -np.inf)
    return all(
        i in gone
        or watch.was_cut_off(servers[0], i)
        or watch.ended.get(i, np.inf) < done_at + NEWS_TIME
        for i in others
    )


def delivery(report: Report, draw: Draw) -> None:
    """Goods that appear in flight: none picked up or delivered twice, or forgotten; what one has done others know."""
    mission, until = (
        load_mission("online_delivery"),
        float(draw.choice([IN_FLIGHT, DELIVERING, LONG], p=[0.3, 0.5, 0.2])),
    )
    n, tasks, later = (
        int(draw.integers(2, 5)),
        int(draw.integers(1, 5)),
        draw.uniform(0.5, 4.5, 5).round(2).tolist(),
    )
    new = {"t": later[0], "pickup": later[1:3], "delivery": later[3:5]}
    made = drawn(
        report.seed, 0.0, drones=n, tasks=tasks, later=0, appear=[new], service_time=0.2
    )
    made = made.replace(flight=QUICK, lost_after=float(draw.choice([1.0, 5.0])))
    agent = flown(report, draw, made, mission, int(draw.integers(0, 2)), until)
    if agent is None:
        return
    watch = next(
        service for service in agent.services if isinstance(service, Invariants)
    )
    by: dict[tuple[int, str], list[int]] = {}
    for i in agent.ids:
        service = getattr(agent.drones[i].guidance, "service", None)
        for stop in service.served if service else []:
            by.setdefault((stop["task"], stop["kind"]), []).append(i)
    for (task, kind), servers in sorted(by.items()):
        names = f"{kind} of task {task} by {servers}"
        report.holds(len(servers) == 1, names)
        report.holds(
            is_known(agent, task, kind, servers)
            or may_be_unknown(agent, watch, task, kind, servers),
            f"{names}, and no other drone has heard of it",
        )
    failed = [i for i in agent.ids if not agent.drones[i].result.get("success")]
    for i in agent.ids:
        told = agent.drones[i].result.get("tasks")
        for j in (
            [task.id for task in mission.hooks.known(agent.config)]
            if told is not None
            else []
        ):
            fate, robot = told.get(str(j), ("forgotten", None))
            done = fate == "delivered" and ((j, "delivery") in by or robot in failed)
            reason = (
                i in failed
                or robot in failed
                or str(j) in agent.drones[i].result["unserved"]
            )
            left = fate in ("open", "aboard", "lost") and reason
            report.holds(
                done or left, f"drone {i} says that task {j} is {fate} (drone {robot})"
            )


KINDS = {"formation": formation, "crossing": crossing, "delivery": delivery}
