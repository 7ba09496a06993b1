"""What a controller sends: communication handlers make the messages that the drone, or its simulation, obeys."""

from typing import Protocol

import numpy as np

from crazychoir.types import FPQR, FRPY, XYZ, Acc, Command, Drive, FullState, Vec, Vel

STOP = XYZ("stop", np.zeros(5))


class CommunicationHandler(Protocol):
    """Makes the messages of one kind, as a swarm file names it."""

    topic: str
    kind: str

    @property
    def idle(self) -> Command:
        """Motors off."""
        ...

    def message(self, u: Vec) -> Command:
        """The command of the input u, which may be kept."""
        ...

    def steady(self, weight: float) -> Command | None:
        """What keeps a drone of this weight in N in the air when nothing is known; None: whatever it does now."""
        ...


class FPQRSender:
    """Sends force and body rates p, q, r, from u (4,) = thrust N, rates rad/s."""

    topic = "cmd"
    kind = "fpqr"
    idle: Command = FPQR(np.zeros(4))

    def message(self, u: Vec) -> FPQR:
        """The command of u (4,), not copied."""
        return FPQR(u)

    def steady(self, weight: float) -> FPQR:
        """Hover thrust without rates."""
        return FPQR(np.array([weight, 0.0, 0.0, 0.0]))


class FRPYSender:
    """Sends force, roll, pitch and the rate of the yaw, from u (4,) = thrust N, angles rad, rad/s."""

    topic = "cmd"
    kind = "frpy"
    idle: Command = FRPY(np.zeros(4))

    def message(self, u: Vec) -> FRPY:
        """The command of u (4,), not copied."""
        return FRPY(u)

    def steady(self, weight: float) -> FRPY:
        """Hover thrust, level."""
        return FRPY(np.array([weight, 0.0, 0.0, 0.0]))


class VelSender:
    """Sends velocities, from u (4,) = velocity m/s world, yaw rate rad/s."""

    topic = "cmd"
    kind = "vel"
    idle: Command = STOP

    def message(self, u: Vec) -> Vel:
        """The command of u (4,), not copied."""
        return Vel(u)

    def steady(self, weight: float) -> Vel:
        """Stay."""
        return Vel(np.zeros(4))


class FullStateSender:
    """Sends full states, from u (14,) laid out as FullState.flat: the firmware flies them."""

    topic = "cmd"
    kind = "fullstate"
    idle: Command = STOP

    def message(self, u: Vec) -> FullState:
        """The command of u (14,), not copied."""
        return FullState(u)

    def steady(self, weight: float) -> None:
        """Where that would be, nobody knows who knows nothing."""
        return


class AccSender:
    """Sends accelerations to a double integrator, from u (3,) m/s2 world."""

    topic = "cmd"
    kind = "acc"
    idle: Command = STOP

    def message(self, u: Vec) -> Acc:
        """The command of u (3,), not copied."""
        return Acc(u)

    def steady(self, weight: float) -> Acc:
        """Neither faster nor slower."""
        return Acc(np.zeros(3))


class DriveSender:
    """Sends speed and turn rate to a unicycle, from u (2,) = m/s, rad/s."""

    topic = "cmd"
    kind = "drive"
    idle: Command = Drive(np.zeros(2))

    def message(self, u: Vec) -> Drive:
        """The command of u (2,), not copied."""
        return Drive(u)

    def steady(self, weight: float) -> Drive:
        """Stay."""
        return Drive(np.zeros(2))


class XYZSender:
    """Sends places to the planner on board, from u (5,) = place m world, yaw rad, duration s."""

    topic = "cmd"
    kind = "xyz"
    idle: Command = STOP

    def message(self, u: Vec) -> XYZ:
        """A straight line at constant velocity from where its set-point is now."""
        return XYZ("line", u)

    def steady(self, weight: float) -> None:
        """The planner on board needs nobody."""
        return
