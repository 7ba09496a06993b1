"""The tick of a process: a straight line of stages that flies all its drones.

    poses -> estimate -> publish -> decide -> judge -> follow -> avoid -> control -> command

Each stage does its work for all drones that tick, before the next stage begins. So the law of each
drone has the states of this tick from all neighbours in this process.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from crazychoir.flight.batch import Batch, Course
from crazychoir.flight.stages import find_rows_to_judge, follow_rows
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.types import Pose, State


class TickedDrone(Protocol):
    """The Python parts of a drone that a tick calls for its record."""

    @property
    def is_running(self) -> bool:
        """Whether the drone may tick."""
        ...

    def estimate(self, pose: Pose | None, now: float) -> State | None:
        """Return the state at `now` in s; None before the first pose."""
        ...

    def publish_state(self) -> None:
        """Publish the state of this tick."""
        ...

    def judge(self, now: float) -> None:
        """Decide what the drone does in this tick, at `now` in s."""
        ...

    def avoid(self, now: float) -> None:
        """Keep clear of other drones, at `now` in s."""
        ...

    def command(self, now: float) -> None:
        """Send the command of this tick, at `now` in s."""
        ...

    def fail(self, error: BaseException) -> None:
        """React to an error in one of these."""
        ...


class FlightTick:
    """Flies the drones of a process, a tick for each frame of poses.

    A drone without a pose for one and a half periods ticks by the clock, see `tick_late_drones`.

    clock: of the process
    size: largest number of drones
    """

    def __init__(self, clock: Clock, size: int = 1) -> None:
        self.clock = clock
        self.batch = Batch(size)
        self.deciders: list[Callable[[], None]] = []
        """Called when all states of a tick are published: laws decide then."""
        self._drones: list[TickedDrone] = []
        self._poses: dict[int, Pose | None] = {}
        self._rows_to_judge = np.zeros(size, np.int64)
        self._is_due = False
        self._patience_ns = np.zeros(size, np.int64)

    def add(self, drone: TickedDrone, index: int, period: float) -> None:
        """Let this drone tick.

        index: of its record
        period: s, of its poses
        """
        assert index == len(self._drones)  # noqa: S101 - records are added in order
        self._drones.append(drone)
        self._patience_ns[index] = round(1.5 * period * NS_PER_SECOND)

    def see(self, index: int, pose: Pose | None) -> None:
        """Let a drone tick in the next pass of the loop, with a pose or without."""
        if pose is not None or index not in self._poses:
            self._poses[index] = pose
        if not self._is_due:
            self._is_due = True
            self.clock.soon(self.run)

    def tick_late_drones(self) -> None:
        """Let the drones tick that have had no tick for one and a half periods."""
        n = self.batch.count
        since = self.clock.now_ns() - self.batch.drones["ticked_ns"][:n]
        for index in np.flatnonzero(since > self._patience_ns[:n]).tolist():
            if self._drones[index].is_running:
                self.see(index, None)

    def run(self) -> None:
        """Do all stages of the tick for the drones that are due."""
        self._is_due = False
        poses = self._poses
        self._poses = {}
        now_ns = self.clock.now_ns()
        now = now_ns / NS_PER_SECOND
        self._estimate(poses, now_ns, now)
        drones = self.batch.drones
        for index in poses:
            if drones[index]["ticks"]:
                self._call(index, self._drones[index].publish_state)
        for decide in self.deciders:
            decide()
        self._judge(now)
        follow_rows(drones, self.batch.plans, now)
        for index in poses:
            row = drones[index]
            if row["ticks"] and row["course"] == Course.FOLLOW and row["avoids"]:
                self._call(index, self._drones[index].avoid, now)
        for index in poses:
            if drones[index]["ticks"] and drones[index]["course"] != Course.NOTHING:
                self._call(index, self._drones[index].command, now)

    def _estimate(self, poses: dict[int, Pose | None], now_ns: int, now: float) -> None:
        """Estimate the states of the drones that tick."""
        rows = self.batch.drones
        rows["ticks"] = 0
        for index, pose in poses.items():
            row = rows[index]
            row["ticked_ns"] = now_ns
            state = self._call(index, self._drones[index].estimate, pose, now)
            if state is None:
                continue
            row["ticks"] = 1
            row["is_known"] = 1
            row["state"] = state.flat
            row["age"] = state.age
            row["acceleration"] = row["commanded"]

    def _judge(self, now: float) -> None:
        """Decide what each drone does in this tick."""
        batch = self.batch
        count = find_rows_to_judge(
            batch.drones, batch.plans, batch.guards, now, self._rows_to_judge
        )
        for index in self._rows_to_judge[:count].tolist():
            self._call(index, self._drones[index].judge, now)

    def _call(self, index: int, work: Callable[..., Any], *arguments: Any) -> Any:
        """Do the work of one drone; its error does not keep another drone from its command."""
        try:
            return work(*arguments)
        except BaseException as error:  # noqa: BLE001 - the drone decides
            self.batch.drones[index]["ticks"] = 0
            self._drones[index].fail(error)
        return None
