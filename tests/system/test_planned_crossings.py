"""Drones that fly by their planners on board cross, whole and with downwash, while messages are lost in bursts."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from system.flights import TICK, fly, swarm_of

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.safety.collision.agreed.path_limits import PLACE_SPEED
from crazychoir.safety.collision.agreed.paths import PATH_SEARCH
from crazychoir.types import FullState

pytestmark = pytest.mark.system
N, RADIUS, SPEED, TIME, LAW = 6, 1.5, 0.8, 30.0, 20.0
ARRIVED = 0.1
CLEAR = 0.24


def circle(draw, n=N):
    """Places (n, 3) m around a circle, off it by chance, each clear of all others."""
    angles = 2.0 * np.pi * np.arange(n) / n
    flat = RADIUS * np.column_stack([np.cos(angles), np.sin(angles)]) + draw.uniform(
        -0.1, 0.1, (n, 2)
    )
    return np.column_stack([flat, draw.uniform(0.5, 2.0, n)])


def places(pattern, seed, n=N):
    """Starts and goals, (n, 3) m each."""
    draw = np.random.default_rng(seed)
    starts = circle(draw, n)
    if pattern == "antipodal":
        return starts, np.roll(circle(draw, n), -(n // 2), axis=0)
    order = np.arange(n)
    while np.any(order == np.arange(n)):
        order = draw.permutation(n)
    return starts, starts[order]


class Crosses(CFGuidance):
    """Up, one go_to to its goal, where it stays until all are there; down."""

    def __init__(self, start, goal):
        self.start, self.goal = start, goal

    async def mission(self):
        await self.take_off(float(self.start[2]))
        await self.rendezvous()
        begins = self.member.clock.now()
        await self.go_to(self.goal)
        while (
            math.dist(self.state.p, self.goal) > ARRIVED
            and self.member.clock.now() < begins + TIME
        ):
            await self.sleep(0.05)
        arrived = self.member.clock.now() - begins
        await self.rendezvous("there")
        there = math.dist(self.state.p, self.goal) < ARRIVED
        await self.land()
        return {"success": there, "arrived": arrived}


class Streams(CFDistributedFeedback):
    """A straight line of FullStates that waits for no other drone."""

    def __init__(self, start, goal):
        self.start, self.goal, self.duration, self.steps, self.arrived = (
            start,
            goal,
            LAW,
            0,
            None,
        )

    def height(self):
        return float(self.start[2])

    def step(self, me, heard):
        t, line = self.steps / self.rate, self.goal - self.start
        self.steps += 1
        far = math.dist(me.p, self.goal) > ARRIVED
        self.arrived = None if far else t if self.arrived is None else self.arrived
        share = SPEED * t / np.linalg.norm(line)
        v = SPEED * line / np.linalg.norm(line) if share < 1.0 else np.zeros(3)
        return FullState.at(self.start + min(share, 1.0) * line, v)

    async def mission(self):
        return await super().mission() | {"arrived": self.arrived}


class Mission:
    """All drones cross; by: Crosses or Streams."""

    def __init__(self, by, starts, goals):
        self.by, self.starts, self.goals = by, starts, goals

    def guidance(self, i, config):
        return self.by(self.starts[i], self.goals[i])


def crossing(by, pattern, seed, method="cells", senders=("xyz",) * N):
    """The flights of a crossing."""
    starts, goals = places(pattern, seed, len(senders))
    return fly_across(by, starts, goals, seed, method, senders)


def fly_across(by, starts, goals, seed, method="cells", senders=("xyz",) * N):
    """Return the flights from starts to goals, (n, 3) m each."""
    drones = [
        {
            "id": k,
            "home": [*starts[k, :2].tolist(), 0.0],
            "uri": "sim://motors",
            "platform": "cf21",
            "role": sender,
        }
        for k, sender in enumerate(senders)
    ]
    roles = [{"name": sender, "sender": sender} for sender in dict.fromkeys(senders)]
    config = SwarmConfig.of(
        {
            "name": "crossing",
            "drones": drones,
            "roles": roles,
            "seed": seed,
            "graph": "complete",
            "network": {"loss": 0.1, "burst": 4.0},
            "collision": {"method": method},
        }
    )
    return fly(config, Mission(by, starts, goals))


def nearest(flights):
    """The smallest scaled distance of any two, m: below 0.24 their ellipsoids have met."""
    p = np.array([flight.p for flight in flights.values()])
    d = (p[:, None] - p[None]) * [1.0, 1.0, 0.4]
    return float(np.linalg.norm(d, axis=3)[~np.eye(len(p), dtype=bool)].min())


def arrived(flights):
    """Return s after the start at which the last drone was at its goal for good; infinite if a drone never was."""
    times = [flight.result.get("arrived") for flight in flights.values()]
    return math.inf if None in times else max(times)


def kept_clear(flights):
    assert nearest(flights) >= CLEAR
    assert arrived(flights) <= TIME
    assert all(flight.result["success"] for flight in flights.values())


class FliesAlong(CFDistributedFeedback):
    """A line of FullStates along x, evenly faster for 1.5 s, then at one speed."""

    def __init__(self, speed):
        self.speed, self.duration, self.steps = speed, 5.0, 0

    def step(self, me, heard):
        t = self.steps / self.rate
        self.steps += 1
        share = min(t / 1.5, 1.0)
        ahead = self.speed * (0.5 * share * min(t, 1.5) + max(t - 1.5, 0.0))
        a = self.speed / 1.5 if share < 1.0 else 0.0
        return FullState.at(
            np.array([ahead, 0.0, 1.0]),
            np.array([share * self.speed, 0.0, 0.0]),
            np.array([a, 0.0, 0.0]),
        )


def test_a_drone_that_is_sent_places_keeps_up_with_the_fastest_of_its_paths():
    speed = PATH_SEARCH.speed_excess * PLACE_SPEED
    mission = SimpleNamespace(guidance=lambda i, config: FliesAlong(speed))
    flight = fly(swarm_of([("cf21", "xyz")], 0.0), mission)[0]
    fast = np.array(flight.wanted)[:, 3] >= speed - 1e-6
    assert TICK * fast.sum() > 3.0
    assert np.linalg.norm(flight.errors[fast], axis=1).max() < 0.12


@pytest.mark.slow
def test_without_cells_they_meet():
    assert nearest(crossing(Crosses, "antipodal", 0, method="off")) < CLEAR


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["antipodal", "permutation"])
@pytest.mark.parametrize("by", [Crosses, Streams])
@pytest.mark.parametrize("seed", range(50))
def test_six_cross_in_fifty_ways(by, pattern, seed):
    kept_clear(crossing(by, pattern, seed))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_both_kinds_of_drones_respect_each_other(seed):
    kept_clear(
        crossing(
            Streams,
            "antipodal",
            seed,
            senders=("fpqr", "xyz", "fpqr", "xyz", "vel", "xyz"),
        )
    )


class FollowsLine(CFGuidance):
    """Up, along a trajectory of its own from its start to its goal, down."""

    def __init__(self, start, goal):
        self.start = start
        self.goal = goal

    async def mission(self):
        await self.take_off(float(self.start[2]))
        await self.rendezvous()
        begins = self.member.clock.now()
        await self.fly(minimum_snap([self.start, self.goal], [0.0, 5.0]))
        arrived = self.member.clock.now() - begins
        await self.rendezvous("there")
        await self.land()
        return {"success": True, "arrived": arrived}


def test_drones_that_meet_on_their_trajectories_keep_clear_of_each_other():
    ends = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    flights = fly_across(FollowsLine, ends, ends[::-1], 0, senders=("xyz", "xyz"))
    assert nearest(flights) >= CLEAR
    assert arrived(flights) <= 14.0
