"""Laws for places that are known before the flight: a trajectory in time, and a list of targets."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from crazychoir.config.tables import FlightTable
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.planning.point_to_point import compute_flight_time
from crazychoir.planning.trajectory import Trajectory
from crazychoir.types import FullState, Goto, Heard, Point, State, Vec


@dataclass(frozen=True, slots=True)
class TimedFlightLimits:
    """How long timed flights last, when a target counts as reached, and how often a way is
    recorded.
    """

    rest_time: float = 1.0
    """s: time after the end of a trajectory in which the drone comes to rest."""
    reached_distance: float = 0.05
    """m: distance from a target at which it counts as reached."""
    duration_factor: float = 1.5
    """Duration of a law for targets, as a multiple of the planned time."""
    way_interval: float = 0.1
    """s: time between two rows of a way."""


TIMED_FLIGHT_LIMITS = TimedFlightLimits()


class Way:
    """The places of a drone during its law, by its own estimate.

    rows: [t s, x, y, z m], ten a second.
    """

    def __init__(self) -> None:
        self.rows: list[list[float]] = []
        self._began = 0.0

    def note(self, now: float, p: Vec) -> float:
        """Record the place p (3,) m, and return the s since the first record."""
        self._began = self._began if self.rows else now
        t = now - self._began
        if (
            not self.rows
            or t >= self.rows[-1][0] + TIMED_FLIGHT_LIMITS.way_interval - 1e-6
        ):
            self.rows.append([round(t, 4), *np.round(p, 4).tolist()])
        return t


@contextlib.asynccontextmanager
async def record_way(guidance: CFGuidance, way: Way) -> AsyncIterator[None]:
    """Record where a drone is while the block runs.

    async with noted(self, way):
        await self.fly(...)
    """

    async def note() -> None:
        while True:
            way.note(guidance.member.clock.now(), guidance.state.p)
            await guidance.sleep(TIMED_FLIGHT_LIMITS.way_interval)

    task = asyncio.create_task(note(), name=f"drone {guidance.id} way")
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


class TimedFlight(CFDistributedFeedback):
    """Flies a trajectory in the time of its law. The law begins at all drones of a team together.

    The result also holds mark_errors_m (one a mark), tracking_rms_m, tracking_max_m, and way, see
    `Way`.

    trajectory: begins above the drone's home, where its take-off ends.
    marks: s at which the distance from the trajectory is recorded.
    """

    def __init__(self, trajectory: Trajectory, marks: Sequence[float] = ()) -> None:
        self.trajectory = trajectory
        self.marks = tuple(marks)
        self.duration = trajectory.duration + TIMED_FLIGHT_LIMITS.rest_time
        self.way = Way()
        self._at_marks = list[float]()
        self._off = list[float]()

    def height(self) -> float:
        """Return the height at which the trajectory begins, in m above the ground."""
        return (
            float(self.trajectory.sample(0.0).p[2]) - self.member.config.flight.ground
        )

    def step(self, me: State, heard: Heard) -> FullState:
        """Return the point of the trajectory that is due now."""
        t = self.way.note(self.member.clock.now(), me.p)
        wanted = self.trajectory.sample(t)
        off = float(np.linalg.norm(me.p - wanted.p))
        self._off.append(off)
        while (
            len(self._at_marks) < len(self.marks)
            and t >= self.marks[len(self._at_marks)] - 1e-9
        ):
            self._at_marks.append(off)
        return wanted

    async def mission(self) -> dict[str, Any]:
        """Run the law, and add how well it was flown."""
        result = await super().mission()
        off = np.array(self._off)
        figures = {
            "tracking_rms_m": float(np.sqrt(np.mean(off**2))),
            "tracking_max_m": float(off.max()),
        }
        return {
            **result,
            **figures,
            "mark_errors_m": self._at_marks,
            "way": self.way.rows,
        }


class TargetList(CFDistributedFeedback):
    """Flies to targets, one after the other: to the next one
    within TIMED_FLIGHT_LIMITS.reached_distance m of the present one.

    The result also holds reached_s, the s of the law at which each target was reached, and way, see
    `Way`.

    targets: (3,) m each, world.
    home: where the drone stands before the flight.
    flight: limits from which the duration of the law follows.
    """

    rate = 20.0

    def __init__(
        self, targets: Sequence[Point], home: Point, flight: FlightTable
    ) -> None:
        self.targets = [np.asarray(p, float) for p in targets]
        start = np.array([home[0], home[1], flight.ground + flight.takeoff_height])
        self.duration = TIMED_FLIGHT_LIMITS.duration_factor * compute_planned_time(
            [start, *self.targets], flight
        )
        self.way, self._reached = Way(), list[float]()

    def step(self, me: State, heard: Heard) -> Goto:
        """Return the first target that is not reached yet, or the last one."""
        t = self.way.note(self.member.clock.now(), me.p)
        k = len(self._reached)
        if (
            k < len(self.targets)
            and np.linalg.norm(me.p - self.targets[k])
            <= TIMED_FLIGHT_LIMITS.reached_distance
        ):
            self._reached.append(t)
        return Goto(self.targets[min(len(self._reached), len(self.targets) - 1)])

    async def mission(self) -> dict[str, Any]:
        """Run the law, and add when each target was reached."""
        return {
            **await super().mission(),
            "reached_s": [round(t, 2) for t in self._reached],
            "way": self.way.rows,
        }


def compute_planned_time(places: Sequence[Vec], flight: FlightTable) -> float:
    """Return the s that a drone needs from each place to the next, as fast as the limits allow.

    The drone is at rest at each place.
    """
    v = flight.speed_limit
    a = flight.acceleration_limit
    pairs = pairwise(places)
    return sum(
        compute_flight_time(FullState.at(start), goal, 0.0, v, a)
        for start, goal in pairs
    )
