"""States, references and commands: frozen, SI, typed. These are the message types; there is no second set.

World frame ENU, z up; quaternions [x, y, z, w]; angular velocity in the body frame.
The numbers of one value lie in one flat array, so that a compiled law and the wire take it as it is.
"""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

Vec = npt.NDArray[np.float64]
Mat = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Words = npt.NDArray[np.uint64]
Bools = npt.NDArray[np.bool_]
Point = Sequence[float] | Vec
STILL: Vec = np.zeros(3)
"""The acceleration of who is not known to accelerate."""
STILL.setflags(write=False)


class Wire(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """A value that may travel: immutable, encoded as an array of its fields."""


class Pose(Wire, frozen=True, array_like=True, gc=False):
    """What motion capture measures of one rigid body.

    flat: (7,) = p (3,) m world, q (4,) body to world;  age: s, since the cameras saw it.
    """

    flat: Vec
    age: float = 0.0

    @property
    def p(self) -> Vec:
        """(3,) m, world."""
        return self.flat[0:3]

    @property
    def q(self) -> Vec:
        """(4,) [x, y, z, w], body to world."""
        return self.flat[3:7]


class State(Wire, frozen=True, array_like=True, gc=False):
    """A drone's estimate of itself, or what is heard of a neighbour.

    flat: (13,) = p (3,) m, v (3,) m/s, q (4,), w (3,) rad/s body;  age: s, since it was measured;  a: (3,) m/s2, world,
    that the drone has commanded in the tick before: its reference and its control together, after all limits and the
    collision filter, without gravity. It is not measured, and the drone follows late. Zero on the ground, with motors
    cut and where nobody knows it, as in the truth of a world. Flown by the firmware's control: that of the reference.
    Between messages a law is told the last a that was heard of a neighbour, while p moves on; after the topic's maximum
    age the neighbour is absent, and its acceleration counts as none.
    """

    flat: Vec
    age: float = 0.0
    a: Vec = STILL

    @classmethod
    def at(cls, p: Point, v: Point = (0.0, 0.0, 0.0)) -> "State":
        """A level state at p (3,) m with velocity v (3,) m/s."""
        return cls(np.array([*p, *v, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))

    @property
    def p(self) -> Vec:
        """(3,) m, world."""
        return self.flat[0:3]

    @property
    def v(self) -> Vec:
        """(3,) m/s, world."""
        return self.flat[3:6]

    @property
    def q(self) -> Vec:
        """(4,) [x, y, z, w], body to world."""
        return self.flat[6:10]

    @property
    def w(self) -> Vec:
        """(3,) rad/s, body."""
        return self.flat[10:13]


class Acceleration(Wire, frozen=True, array_like=True, gc=False):
    """Reference of a double-integrator law: a (3,) m/s2 world, yaw rad."""

    a: Vec
    yaw: float = 0.0


class Velocity(Wire, frozen=True, array_like=True, gc=False):
    """Reference of a single-integrator law: v (3,) m/s world, yaw rad."""

    v: Vec
    yaw: float = 0.0


class FullState(Wire, frozen=True, array_like=True, gc=False):
    """Reference of a flat output: flat (14,) = p m, v m/s, a m/s2, j m/s3 (each (3,), world), yaw rad, yaw' rad/s."""

    flat: Vec

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
        """p, v, a, j: (3,) each, world; yaw rad; yaw_rate rad/s."""
        return cls(np.array([*p, *v, *a, *j, yaw, yaw_rate], dtype=float))

    @property
    def p(self) -> Vec:
        """(3,) m, world."""
        return self.flat[0:3]

    @property
    def v(self) -> Vec:
        """(3,) m/s, world."""
        return self.flat[3:6]

    @property
    def a(self) -> Vec:
        """(3,) m/s2, world."""
        return self.flat[6:9]

    @property
    def yaw(self) -> float:
        """rad."""
        return float(self.flat[12])


class Goto(Wire, frozen=True, array_like=True, gc=False):
    """Ask for a point-to-point flight: p (3,) m world, yaw rad, duration s (0: as fast as the limits allow)."""

    p: Vec
    yaw: float = 0.0
    duration: float = 0.0


class FPQR(Wire, frozen=True, array_like=True, gc=False):
    """Command: flat (4,) = thrust N, body rates p, q, r rad/s."""

    flat: Vec

    @property
    def thrust(self) -> float:
        """N, along the body's z."""
        return float(self.flat[0])


class FRPY(Wire, frozen=True, array_like=True, gc=False):
    """Command: flat (4,) = thrust N, roll, pitch rad, yaw rate rad/s.

    Roll and pitch are those of R = Rz(yaw) Ry(pitch) Rx(roll), body to world: positive pitch is nose down.
    """

    flat: Vec


class Vel(Wire, frozen=True, array_like=True, gc=False):
    """Command: flat (4,) = velocity (3,) m/s world, yaw rate rad/s."""

    flat: Vec


class Acc(Wire, frozen=True, array_like=True, gc=False):
    """Command to a double integrator: flat (3,) = acceleration m/s2, world."""

    flat: Vec


class Drive(Wire, frozen=True, array_like=True, gc=False):
    """Command to a unicycle: flat (2,) = speed v m/s along its heading, turn rate w rad/s."""

    flat: Vec


class XYZ(Wire, frozen=True, array_like=True, gc=False):
    """Command to the planner on board: flat (5,) = p (3,) m world, yaw rad, duration s.

    verb: "take_off" and "land" use z of p, "go_to" all; "stop" none: motors off.
    """

    verb: str
    flat: Vec


Command = FPQR | FRPY | Vel | XYZ | FullState | Acc | Drive


class Status(Wire, frozen=True, array_like=True, gc=False):
    """How a drone is: what `status`, the live table and the public key show.

    phase: of flight;  task: of the mission, and its progress;  round: of the running exchange;  cost: of the plan, NaN
    before;  relaxed: value of the program's relaxation, as far as it is known, else NaN;  sent, lost, resent, dropped:
    messages between drones since the start;  suspect, gone: ids of silent members;  process, host: where it runs;
    note: the last trouble;  stopped: an emergency stop of the swarm is in force for it;  grave: somebody should
    act upon the note;  hosts, offsets, offset_errors: s that others' clocks are ahead of its own, within how much.
    """

    phase: str
    task: str = ""
    round: int = 0
    cost: float = float("nan")
    relaxed: float = float("nan")
    sent: int = 0
    lost: int = 0
    resent: int = 0
    dropped: int = 0
    suspect: list[int] = []
    gone: list[int] = []
    process: str = ""
    host: str = ""
    note: str = ""
    stopped: bool = False
    grave: bool = False
    hosts: list[str] = []
    offsets: list[float] = []
    offset_errors: list[float] = []


class Body(Wire, frozen=True, array_like=True, gc=False):
    """How a drone's simulated body is.

    harm: what has broken it, empty if nothing has;  flying: it is in the air, flown there by commands;  cut: its motors
    are off until its world is started again.
    """

    harm: str = ""
    flying: bool = False
    cut: bool = False


class LinkStatus(Wire, frozen=True, array_like=True, gc=False):
    """How the way to a drone is that a radio reaches, and what the drone says of itself.

    state: "connecting", "up", "degraded", "lost" or "absent", and "refused" if it cannot fly so;  silence: s since its
    last packet;  latency: s, there and back, 95 of 100;  answered: share of echoes that were;  rssi: dBm;  battery:
    V;  supervisor: bits of its firmware's;  flying: its motors turn;  problems: why it may not take off, in words;
    release: of its firmware;  refused: plans that its firmware has not taken;  reconnected: how often;  astray: how the
    body that the cameras take for it has moved otherwise, empty if it has not. What is not known is NaN.
    """

    state: str
    silence: float = float("inf")
    latency: float = float("nan")
    answered: float = float("nan")
    rssi: float = float("nan")
    battery: float = float("nan")
    supervisor: int = 0
    flying: bool = False
    problems: list[str] = []
    release: str = ""
    refused: int = 0
    reconnected: int = 0
    astray: str = ""


class Plan(Wire, frozen=True, array_like=True, gc=False):
    """The path of a drone with a planner on board, sent to all other drones that have one."""

    way: Mat
    """(k, 25): the path that it flies, see safety/collision/agreed/paths.py; (0, 25) on the ground."""
    since: float
    """Seconds since it began to fly that path."""
    offer: Mat
    """(k, 25): the path that it wants to fly instead; (0, 25) without one."""
    due: float
    """Seconds until the offered path would begin."""
    number: int
    """Number of the offer. Its upper bits are the incarnation of the sender."""
    agreed: dict[int, int]
    """By drone id: the number of the offer that the sender has granted, -1 for none.

    A drone that is missing here is not known to fly.
    """
    awaits: Vec
    """(3,) m, world: where it wants to rest but finds no room; (0,) if there is no such place."""


class Failure(Wire, frozen=True, array_like=True, gc=False):
    """What an algorithm that has failed at `agent` sends in place of its message: the reason."""

    agent: int
    reason: str


Reference = Acceleration | FullState | Goto | Velocity
Heard = dict[int, State]


class PerNeighbor(dict[int, Any]):
    """A payload a neighbour: `PerNeighbor({j: value})` sends each value to its j alone."""
