"""States, references and commands: the message types of the whole package.

All values are frozen, typed and in SI units.

World frame: ENU, z up.
Quaternions: [x, y, z, w].
Angular velocity: body frame.

The numbers of one value lie in one flat array. Compiled laws and the wire use it as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import msgspec
import numpy as np
import numpy.typing as npt

Vec = npt.NDArray[np.float64]
"""A vector of numbers."""
Mat = npt.NDArray[np.float64]
"""A matrix of numbers."""
Ints = npt.NDArray[np.int64]
"""An array of integers."""
Words = npt.NDArray[np.uint64]
"""An array of unsigned 64-bit words."""
Records = Any
"""An array of records with named fields, or one record of such an array."""
Bytes = npt.NDArray[np.uint8]
"""An array of unsigned 8-bit integers."""
Bools = npt.NDArray[np.bool_]
"""An array of truth values."""
Point = Sequence[float] | Vec
"""Coordinates, as a sequence or an array."""
ZERO_ACCELERATION: Vec = np.zeros(3)
"""(3,) m/s2: zero acceleration, read-only. The default where the acceleration is not known."""
ZERO_ACCELERATION.setflags(write=False)


class Wire(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """A value that may travel between drones: immutable, encoded as an array of its fields."""


class Pose(Wire, frozen=True, array_like=True, gc=False):
    """The position and attitude of one rigid body, measured by motion capture."""

    flat: Vec
    """(7,) = p (3,) m, world; q (4,) [x, y, z, w], body to world."""
    age: float = 0.0
    """Seconds since the cameras saw the body."""

    @property
    def p(self) -> Vec:
        """(3,) m, world: position."""
        return self.flat[0:3]

    @property
    def q(self) -> Vec:
        """(4,) [x, y, z, w], body to world: attitude."""
        return self.flat[3:7]


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """The poses of all drones of a world that the cameras took in one exposure."""

    flat: Mat
    """(n, 7): rows laid out as Pose.flat, one a drone; a row counts only where `seen` is True."""
    age: float
    """Seconds since the exposure."""
    seen: Bools
    """(n,): whether the cameras saw the drone."""

    def pose(self, row: int) -> Pose | None:
        """Return the pose in this row; None if the drone was not seen."""
        return Pose(self.flat[row], self.age) if self.seen[row] else None

    def delayed(self, seconds: float) -> Self:
        """Return the frame as it is this many seconds later."""
        return replace(self, age=self.age + seconds)


class State(Wire, frozen=True, array_like=True, gc=False):
    """The state of a drone: its own estimate, or the newest state received from a neighbour.

    Between two messages of a neighbour, a law receives an extrapolated p and the last `a`. After the
    maximum age of the topic the neighbour counts as absent, and its acceleration as zero.
    """

    flat: Vec
    """(13,): position, velocity, attitude and angular velocity.

    p: (3,) m, world: position.
    v: (3,) m/s, world: velocity.
    q: (4,) [x, y, z, w], body to world: attitude.
    w: (3,) rad/s, body: angular velocity.
    """
    age: float = 0.0
    """Seconds since the state was measured."""
    a: Vec = ZERO_ACCELERATION
    """(3,) m/s2, world: acceleration that the drone commanded in the tick before, without gravity.

    It is the sum of reference and control after all limits and the collision filter. It is
    commanded, not measured: the drone follows it with a delay. When the control of the firmware
    flies the drone, it is the acceleration of the reference. It is zero on the ground, with motors
    cut, and where it is not known, such as in the truth of a world.
    """

    @classmethod
    def at(cls, p: Point, v: Point = (0.0, 0.0, 0.0)) -> "State":
        """Return a level state at p (3,) m with velocity v (3,) m/s."""
        return cls(np.array([*p, *v, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))

    @property
    def p(self) -> Vec:
        """(3,) m, world: position."""
        return self.flat[0:3]

    @property
    def v(self) -> Vec:
        """(3,) m/s, world: velocity."""
        return self.flat[3:6]

    @property
    def q(self) -> Vec:
        """(4,) [x, y, z, w], body to world: attitude."""
        return self.flat[6:10]

    @property
    def w(self) -> Vec:
        """(3,) rad/s, body: angular velocity."""
        return self.flat[10:13]


class Acceleration(Wire, frozen=True, array_like=True, gc=False):
    """Reference of a double-integrator law."""

    a: Vec
    """(3,) m/s2, world."""
    yaw: float = 0.0
    """rad."""


class Velocity(Wire, frozen=True, array_like=True, gc=False):
    """Reference of a single-integrator law."""

    v: Vec
    """(3,) m/s, world."""
    yaw: float = 0.0
    """rad."""


class FullState(Wire, frozen=True, array_like=True, gc=False):
    """Reference of a flat output: position with three derivatives, and yaw with its rate."""

    flat: Vec
    """(14,): the flat output and its derivatives.

    p: (3,) m, world.
    v: (3,) m/s, world.
    a: (3,) m/s2, world.
    j: (3,) m/s3, world.
    yaw: rad.
    yaw': rad/s.
    """

    @classmethod
    def at(
        cls,
        p: Point,
        v: Point = (0, 0, 0),
        a: Point = (0, 0, 0),
        j: Point = (0, 0, 0),
        yaw: float = 0.0,
        yaw_rate: float = 0.0,
    ) -> "FullState":
        """Return a reference made of its parts.

        p: (3,) m, world.
        v: (3,) m/s, world.
        a: (3,) m/s2, world.
        j: (3,) m/s3, world.
        yaw: rad.
        yaw_rate: rad/s.
        """
        parts = (p, v, a, j, (yaw, yaw_rate))
        return cls(np.concatenate(parts, dtype=float))

    @property
    def p(self) -> Vec:
        """(3,) m, world: position."""
        return self.flat[0:3]

    @property
    def v(self) -> Vec:
        """(3,) m/s, world: velocity."""
        return self.flat[3:6]

    @property
    def a(self) -> Vec:
        """(3,) m/s2, world: acceleration."""
        return self.flat[6:9]

    @property
    def yaw(self) -> float:
        """rad: yaw."""
        return float(self.flat[12])


class Goto(Wire, frozen=True, array_like=True, gc=False):
    """Reference that asks for a point-to-point flight."""

    p: Vec
    """(3,) m, world: goal."""
    yaw: float = 0.0
    """rad."""
    duration: float = 0.0
    """s, or 0: as fast as the limits allow."""


class FPQR(Wire, frozen=True, array_like=True, gc=False):
    """Command: thrust and body rates."""

    flat: Vec
    """(4,) = thrust N; body rates p, q, r rad/s."""

    @property
    def thrust(self) -> float:
        """N, along the z axis of the body."""
        return float(self.flat[0])


class FRPY(Wire, frozen=True, array_like=True, gc=False):
    """Command: thrust, roll, pitch and yaw rate.

    Roll and pitch are those of R = Rz(yaw) Ry(pitch) Rx(roll), body to world.
    Positive pitch is nose down.
    """

    flat: Vec
    """(4,) = thrust N; roll rad; pitch rad; yaw rate rad/s."""


class Vel(Wire, frozen=True, array_like=True, gc=False):
    """Command: velocity and yaw rate."""

    flat: Vec
    """(4,) = velocity (3,) m/s, world; yaw rate rad/s."""


class Acc(Wire, frozen=True, array_like=True, gc=False):
    """Command to a double integrator."""

    flat: Vec
    """(3,) m/s2, world: acceleration."""


class Drive(Wire, frozen=True, array_like=True, gc=False):
    """Command to a unicycle."""

    flat: Vec
    """(2,) = speed v m/s along its heading; turn rate w rad/s."""


class XYZ(Wire, frozen=True, array_like=True, gc=False):
    """Command to the planner on board."""

    verb: str
    """"take_off", "land", "go_to" or "stop".

    "take_off" and "land" use only the z of p. "go_to" uses all numbers. "stop" uses none: it turns
    the motors off.
    """
    flat: Vec
    """(5,) = p (3,) m, world; yaw rad; duration s."""


Command = FPQR | FRPY | Vel | XYZ | FullState | Acc | Drive
"""All commands that a controller or a planner gives to a body."""


class Status(Wire, frozen=True, array_like=True, gc=False):
    """The condition of a drone, as `crazychoir status`, the live table and the public copies show it.

    The public copies are JSON messages for other Zenoh programs.
    """

    phase: str
    """Phase of the flight."""
    task: str = ""
    """Task of the mission, with its progress."""
    round: int = 0
    """Round of the running exchange."""
    cost: float = float("nan")
    """Cost of the plan. NaN before there is a plan."""
    relaxed: float = float("nan")
    """Value of the relaxation of the program, as far as it is known, else NaN."""
    sent: int = 0
    """Messages sent to other drones since the start."""
    lost: int = 0
    """Messages between drones lost since the start."""
    resent: int = 0
    """Messages sent again to other drones since the start."""
    dropped: int = 0
    """Messages between drones dropped since the start."""
    suspect: list[int] = []
    """Ids of members that have been silent for a while."""
    gone: list[int] = []
    """Ids of members that count as lost."""
    process: str = ""
    """The process that runs the drone."""
    host: str = ""
    """The host of that process."""
    note: str = ""
    """The last trouble, in words."""
    stopped: bool = False
    """An emergency stop of the swarm is in force for this drone."""
    grave: bool = False
    """The note needs the attention of the operator."""
    hosts: list[str] = []
    """Other hosts with a known clock offset, in the order of `offsets`."""
    offsets: list[float] = []
    """s: how far the clock of each other host is ahead of our own."""
    offset_errors: list[float] = []
    """s: error bound of each offset."""
    link_faults: list[str] = []
    """Counts of what went wrong on the link of its process, as "full 3", without zeros."""


class Body(Wire, frozen=True, array_like=True, gc=False):
    """The condition of the simulated body of a drone."""

    harm: str = ""
    """What has broken the body. Empty if it is intact."""
    flying: bool = False
    """Commands have flown the body into the air."""
    cut: bool = False
    """The motors are off until the world is started again."""


class LinkStatus(Wire, frozen=True, array_like=True, gc=False):
    """The condition of the radio link to a drone, and what the drone reports of itself.

    Numbers that are not known are NaN.
    """

    state: str
    """"connecting", "up", "degraded", "lost", "absent" or "refused".

    "refused": the drone cannot fly in its present configuration.
    """
    silence: float = float("inf")
    """Seconds since the last packet from the drone."""
    latency: float = float("nan")
    """s: round-trip time, 95th percentile."""
    answered: float = float("nan")
    """Share of echo requests that were answered."""
    rssi: float = float("nan")
    """dBm: signal strength."""
    battery: float = float("nan")
    """V: battery voltage."""
    supervisor: int = 0
    """State bits of the supervisor in the firmware."""
    flying: bool = False
    """The motors turn."""
    problems: list[str] = []
    """Reasons why the drone may not take off, in words."""
    release: str = ""
    """Release of the firmware."""
    refused: int = 0
    """Number of plans that the firmware refused."""
    reconnected: int = 0
    """Number of reconnections."""
    astray: str = ""
    """How the motion of the drone's body differs from the motion of the drone, in words.

    The cameras may take a different body for this drone. Empty if there is no difference.
    """


class Plan(Wire, frozen=True, array_like=True, gc=False):
    """The path of a drone with a planner on board, sent to all other such drones."""

    way: Mat
    """(k, 25): the path that the drone flies, see safety/collision/agreed/paths.py.

    (0, 25) on the ground.
    """
    since: float
    """Seconds since the drone began to fly that path."""
    offer: Mat
    """(k, 25): the path that the drone wants to fly instead. (0, 25) without an offer."""
    due: float
    """Seconds until the offered path would begin."""
    number: int
    """Number of the offer. Its upper bits are the incarnation of the sender."""
    agreed: dict[int, int]
    """By drone id: the number of the offer that the sender has granted, -1 for none.

    A drone that is missing here is not known to fly.
    """
    awaits: Vec
    """(3,) m, world: where the drone wants to rest but finds no room.

    (0,) if there is no such place.
    """


class Failure(Wire, frozen=True, array_like=True, gc=False):
    """Message that a failed algorithm sends in place of its next message."""

    agent: int
    """The agent at which the algorithm failed."""
    reason: str
    """Why it failed, in words."""


Reference = Acceleration | FullState | Goto | Velocity
"""All references that a law or a plan may return."""
Heard = dict[int, State]
"""By id: the newest state of each neighbour that is heard."""


@dataclass(frozen=True)
class Malformed:
    """Stands for a message that could not be decoded; algorithms among liars take it."""

    reason: str
    """What is wrong with it, in words."""


class PerNeighbor(dict[int, Any]):
    """A separate value for each neighbour: `PerNeighbor({j: value})` sends each value to its j alone."""
