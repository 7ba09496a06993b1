"""The tick of a process: a straight line of stages that flies all its drones.

    poses -> estimate -> publish -> decide -> judge -> follow -> avoid -> control -> command

Each stage does its work for all drones that tick, before the next stage begins. So the law of each
drone has the states of this tick from all neighbours in this process.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.filters.row_filter import estimate_by_hand
from crazychoir.filters.rows import FilterKind
from crazychoir.filters.state_filter import StateFilter
from crazychoir.flight.batch import Batch, Course
from crazychoir.flight.stages import (
    avoid_drones,
    control_drones,
    estimate_drones,
    find_late_rows,
    find_rows_to_judge,
    follow_rows,
    publish_drones,
)
from crazychoir.flight.world_rows import CommandTable, WorldRows
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace import Airspace
from crazychoir.safety.airspace.airspace_frames import AirspaceFrames
from crazychoir.safety.collision.avoidance import make_nearest, make_planes
from crazychoir.types import Pose

COUNT_INTERVAL_NS = NS_PER_SECOND
"""ns between two counts of the states that are sent."""


class TickedDrone(Protocol):
    """The Python parts of a drone that a tick calls for its record."""

    filter: StateFilter
    """Its filter."""

    def publish_state(self) -> None:
        """Publish the state of this tick."""
        ...

    def judge(self, now: float) -> None:
        """Decide what the drone does in this tick, at `now` in s."""
        ...

    def seek(self) -> None:
        """Ask others for the states of drones that are not heard."""
        ...

    def note_evasion(self) -> None:
        """Note which drone this one evades, or that it evades no more."""
        ...

    def send_input(self) -> None:
        """Send the input in its record."""
        ...

    def publish_command(self) -> None:
        """Publish the input that compiled code has given to the world."""
        ...

    def publish_reference(self) -> None:
        """Publish the full state that the drone flies."""
        ...

    def command_by_hand(self, now: float) -> None:
        """Compute a command in Python at `now` in s, and send it."""
        ...

    def count_messages(self, sent: int, lost: int) -> None:
        """Count states that were sent to other drones, and those of them that were lost."""
        ...

    def fail(self, error: BaseException) -> None:
        """React to an error in one of these."""
        ...


class FlightTick:
    """Flies the drones of a process, a tick for each frame of poses.

    A drone without a pose for one and a half periods ticks by the clock, see `tick_late_drones`.

    bus: of the process
    size: largest number of drones
    rate: Hz, of the poses of the drones; the largest if they differ
    """

    def __init__(self, bus: Bus, size: int = 1, rate: float = 100.0) -> None:
        self._bus = bus
        self.clock = bus.clock
        self.batch = Batch(size, rate)
        self.deciders: list[Callable[[int], None]] = []
        """Called with the time in ns when all states of a tick are published: laws decide then."""
        self.observers: list[Callable[[], None]] = []
        """Called when all commands of a tick are sent."""
        self._drones: list[TickedDrone] = []
        self._filtered_by_hand: list[int] = []
        self._worlds: list[WorldRows] = []
        self.airspace: Airspace | None = None
        """Which drones are near; None if no drone avoids others."""
        self.frames: AirspaceFrames | None = None
        """Exchanges states with other processes; None without them."""
        self._planes = make_planes()
        self._near = make_nearest()
        self._found = np.zeros(size, np.int64)
        self._work = np.empty(13)
        self._planned = np.empty(14)
        self._is_due = False
        self._count_due_ns = 0
        self._patience_ns = np.zeros(size, np.int64)

    def add(self, drone: TickedDrone, index: int, period: float) -> None:
        """Let this drone tick.

        index: of its record
        period: s, of its poses
        """
        assert index == len(self._drones)  # noqa: S101 - records are added in order
        self._drones.append(drone)
        self._patience_ns[index] = round(1.5 * period * NS_PER_SECOND)
        if self.batch.filters.rows["kind"][index] == FilterKind.BY_HAND:
            self._filtered_by_hand.append(index)

    def see(self, index: int, pose: Pose | None) -> None:
        """Let a drone tick in the next pass of the loop, with a pose or without."""
        self.batch.drones["ticks"][index] = 1
        if pose is not None:
            self._call(index, self._store_pose, index, pose)
        self._make_due()

    def _make_due(self) -> None:
        """Run the stages in the next pass of the loop."""
        if not self._is_due:
            self._is_due = True
            self.clock.soon(self.run)

    def connect_world(
        self, ids: tuple[int, ...], commands: CommandTable, kinds: dict[int, str]
    ) -> WorldRows:
        """Return the way of poses and commands for a world of this process.

        ids: of its drones, in the order of its rows
        commands: of the world
        kinds: kind of command of each drone
        """
        rows = WorldRows(self.batch, ids, commands, self._make_due)
        for i, place in self.batch.places.items():
            if i in ids and kinds[i] in commands.kinds:
                drone = self.batch.drones[place]
                drone["has_world_row"] = drone["sends_rows"]
        self._worlds.append(rows)
        return rows

    def _store_pose(self, index: int, pose: Pose) -> None:
        """Write a pose into the record of the filter."""
        row = self.batch.filters.rows[index]
        row["pose"] = pose.flat
        row["pose_age"] = pose.age
        row["has_pose"] = 1

    def tick_late_drones(self) -> None:
        """Let the drones tick that have had no tick for one and a half periods."""
        now_ns = self.clock.now_ns()
        count = find_late_rows(
            self.batch.drones, self._patience_ns, now_ns, self._found
        )
        for index in self._found[:count].tolist():
            self.see(index, None)

    def run(self) -> None:
        """Do all stages of the tick for the drones that are due."""
        self._is_due = False
        try:
            self._run_stages(self.clock.now_ns())
        finally:
            self.batch.drones["ticks"] = 0
            self.batch.filters.rows["has_pose"] = 0

    def _run_stages(self, now_ns: int) -> None:
        """Do the stages in their order.

        now_ns: ns: the present time
        """
        now = now_ns / NS_PER_SECOND
        batch = self.batch
        drones = batch.drones
        self._estimate(now_ns, now)
        for index in self._find_read(DRONE_TOPICS.state):
            self._call(index, self._drones[index].publish_state)
        seekers = self._hear(now)
        for decide in self.deciders:
            decide(now_ns)
        self._judge(now)
        follow_rows(drones, batch.plans, now, self._planned)
        self._avoid(seekers, now)
        self._command(now)
        for observe in self.observers:
            observe()
        self._count_messages(now_ns)

    def _estimate(self, now_ns: int, now: float) -> None:
        """Estimate the states of the drones that tick."""
        batch = self.batch
        filters = batch.filters
        for index in self._filtered_by_hand:
            if batch.drones["ticks"][index]:
                row = filters.rows[index]
                state_filter = self._drones[index].filter
                self._call(index, estimate_by_hand, row, state_filter, now)
        estimate_drones(
            batch.drones,
            batch.plans,
            filters.rows,
            filters.history,
            now_ns,
            now,
            self._work,
            self._planned,
        )

    def _judge(self, now: float) -> None:
        """Decide what each drone does in this tick."""
        batch = self.batch
        count = find_rows_to_judge(
            batch.drones, batch.plans, batch.guards, now, self._planned, self._found
        )
        for index in self._found[:count].tolist():
            self._call(index, self._drones[index].judge, now)

    def _hear(self, now: float) -> list[int]:
        """Let the drones hear each other's states; return the places of the drones that must ask."""
        airspace = self.airspace
        if airspace is None:
            return []
        drones = self.batch.drones
        publish_drones(drones, airspace.states, airspace.times, airspace.numbers, now)
        if self.frames is not None:
            self.frames.hear()
        seekers = set(airspace.step())
        if self.frames is not None:
            self.frames.send()
        if not seekers:
            return []
        listeners = drones["listener"].tolist()
        return [index for index, one in enumerate(listeners) if one in seekers]

    def _avoid(self, seekers: list[int], now: float) -> None:
        """Keep the drones clear of each other.

        seekers: places of the drones that must ask others for states
        """
        airspace = self.airspace
        if airspace is None:
            return
        batch = self.batch
        drones = batch.drones
        for index in seekers:
            is_flying = drones["course"][index] == Course.FOLLOW
            if drones["is_running"][index] and is_flying:
                self._call(index, self._drones[index].seek)
        count = avoid_drones(
            drones,
            batch.plans,
            batch.avoids,
            airspace.near.listeners,
            airspace.near.motions,
            now,
            self._planes,
            self._near,
            self._found,
        )
        for index in self._found[:count].tolist():
            self._call(index, self._drones[index].note_evasion)

    def _command(self, now: float) -> None:
        """Compute and send the commands."""
        batch = self.batch
        count = control_drones(batch.drones, batch.controls, now, self._found)
        for world in self._worlds:
            world.send()
        is_computed = batch.drones["is_computed"]
        for index in self._found[:count].tolist():
            drone = self._drones[index]
            if is_computed[index]:
                self._call(index, drone.send_input)
            else:
                self._call(index, drone.command_by_hand, now)
        self._publish_commands()

    def _publish_commands(self) -> None:
        """Publish what the drones fly and are commanded, where it is read."""
        drones = self.batch.drones
        for index in self._find_read(DRONE_TOPICS.command):
            if drones["is_computed"][index] and drones["has_world_row"][index]:
                self._call(index, self._drones[index].publish_command)
        for index in self._find_read(DRONE_TOPICS.reference):
            if drones["course"][index] != Course.NOTHING:
                self._call(index, self._drones[index].publish_reference)

    def _find_read(self, topic: Topic) -> list[int]:
        """Return the places of the drones that tick and have a reader of this topic."""
        addresses = self._bus.find_read_addresses(topic)
        if not addresses:
            return []
        ticks = self.batch.drones["ticks"]
        places = self.batch.places
        found = [places.get(i, -1) for i in addresses]
        return [index for index in found if index >= 0 and ticks[index]]

    def _count_messages(self, now_ns: int) -> None:
        """Add the states that were sent without a message to the counters of the ports, now and then."""
        if now_ns < self._count_due_ns:
            return
        self._count_due_ns = now_ns + COUNT_INTERVAL_NS
        drones = self.batch.drones
        for index in np.flatnonzero(drones["sent"]).tolist():
            sent = int(drones["sent"][index])
            lost = int(drones["lost"][index])
            self._drones[index].count_messages(sent, lost)
        drones["sent"] = 0
        drones["lost"] = 0
        if self.airspace is not None:
            self.airspace.report_messages()

    def _call(self, index: int, work: Callable[..., Any], *arguments: Any) -> Any:
        """Do the work of one drone; its error does not keep another drone from its command."""
        try:
            return work(*arguments)
        except BaseException as error:  # noqa: BLE001 - the drone decides
            self.batch.drones[index]["ticks"] = 0
            self._drones[index].fail(error)
        return None
