"""What a pilot must know of its drone before it flies, and the guard that follows from it."""

from dataclasses import dataclass, field
from typing import Literal

from crazychoir.config.tables import FlightTable
from crazychoir.control.choice import Controls, make_controls
from crazychoir.control.position import FLATNESS_LIMITS
from crazychoir.filters.state_filter import StateFilter
from crazychoir.flight.batch import Batch, DroneRow
from crazychoir.flight.estimate import choose_filter
from crazychoir.flight.point_flights import compute_braking_limit
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.rules.guard import (
    FENCE_BELOW_GROUND,
    ON_BOARD_SAFETY_TABLE,
    RADIO_SAFETY_TABLE,
    SAFETY_TABLE,
    Fence,
    Guard,
    SafetyRule,
)
from crazychoir.types import Point, Vec

ReachKind = Literal["no", "seen", "own"]
"""Kinds of reach: "no" radio, a radio and "seen" by cameras, or a radio and its "own" poses."""
THRUST_SENDERS = ("fpqr", "frpy")
"""Kinds of senders that command a thrust."""


@dataclass(frozen=True, slots=True)
class FlightSetup:
    """What a pilot must know of its drone before it flies."""

    limits: FlightTable = field(default_factory=FlightTable)
    """[flight] of the swarm file."""
    room: Fence = field(default_factory=lambda: Fence.box((-3, -3, -0.2), (3, 3, 2.5)))
    """Where the drone may fly, as in the swarm file."""
    rate: float = 100.0
    """Hz, of its poses."""
    controls: Controls = field(default_factory=make_controls)
    """Its controllers and its sender."""
    limit_area: Fence | None = None
    """Area outside which the motors are cut, None for the guard's default."""
    reach: ReachKind = "no"
    """"no" for a drone in a simulated world.

    "seen" for a drone behind a radio that cameras see: poses that jump are not believed. "own" for a
    drone behind a radio that finds its own pose. Behind a radio the firmware lands the drone when
    there are no poses.
    """
    home: Point | None = None
    """(3,) m, world: place above which the drone may always be sent; None for only where it took
    off.
    """
    is_replayed: bool = False
    """Whether the body follows a recording and obeys nothing."""

    @property
    def fence(self) -> Fence:
        """Where the drone flies, from the ground up at most."""
        ground = max(self.room.low[2], self.limits.ground)
        return self.room.with_floor(
            ground if self.controls.takes_off else ground - FENCE_BELOW_GROUND
        )

    @property
    def a_max(self) -> float:
        """Acceleration in m/s2 with which the drone comes to rest from any direction."""
        return compute_braking_limit(
            self.limits,
            self.controls.platform,
            FLATNESS_LIMITS.height_share * FLATNESS_LIMITS.acceleration_share,
        )

    @property
    def period(self) -> float:
        """Seconds between two poses."""
        return 1.0 / self.rate

    @property
    def period_ns(self) -> int:
        """Nanoseconds between two poses."""
        return round(NS_PER_SECOND / self.rate)

    @property
    def has_radio(self) -> bool:
        """Whether the drone is behind a radio."""
        return self.reach != "no"

    @property
    def sends_thrust(self) -> bool:
        """Whether its commands hold a thrust."""
        return self.controls.sender.kind in THRUST_SENDERS

    @property
    def has_planner_on_board(self) -> bool:
        """Whether its firmware flies the plans."""
        return self.controls.sender.kind == "xyz"

    @property
    def safety_table(self) -> tuple[SafetyRule, ...]:
        """The safety table for its way of being reached."""
        if not self.has_radio:
            return SAFETY_TABLE
        return (
            ON_BOARD_SAFETY_TABLE if self.has_planner_on_board else RADIO_SAFETY_TABLE
        )

    def get_place_above(self, p: Vec, height: float | None) -> Vec:
        """Return (3,) m where a take-off from p to `height` m above the ground ends.

        A robot that does not take off stays where it is.

        p: (3,) m, world
        height: m, None for the height in the swarm file
        """
        goal = p.copy()
        if self.controls.takes_off:
            rise = self.limits.takeoff_height if height is None else height
            goal[2] = self.limits.ground + rise
            goal[2] = self.fence.nearest(goal)[2]
        return goal

    def make_filter(self, row: DroneRow) -> StateFilter:
        """Return a Kalman filter with the record of the drone in its batch."""
        return choose_filter(
            "kalman", self.controls, self.limits.ground, self.rate, row.filters
        )

    def make_guard(self, row: DroneRow | None = None) -> Guard:
        """Return the guard of the drone.

        row: of the drone in its batch, None for a batch of its own
        """
        row = Batch(1).add(0) if row is None else row
        k = row.index
        return Guard(
            self.fence,
            self.safety_table,
            a_max=self.a_max,
            ground=self.limits.ground,
            limit=self.limit_area,
            rows=row.batch.guards[k : k + 1],
        )
