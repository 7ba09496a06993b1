"""Communication handlers: they make the messages that the drone, or its simulation, obeys."""

from typing import Protocol

import numpy as np

from crazychoir.types import FPQR, FRPY, XYZ, Acc, Command, Drive, FullState, Vec, Vel

STOP_COMMAND = XYZ("stop", np.zeros(5))
"""The command that stops a planner on board."""


class CommunicationHandler(Protocol):
    """Makes the messages of one kind."""

    topic: str
    """Topic of the messages."""
    kind: str
    """Name of the kind in a swarm file."""

    @property
    def idle(self) -> Command:
        """The command for motors off."""
        ...

    def message(self, u: Vec) -> Command:
        """Return the command for the input u; the command may hold u itself, not a copy."""
        ...

    def steady(self, weight: float) -> Command | None:
        """Return the command that keeps a drone in the air while its state is unknown.

        weight: N
        Returns None if the drone should continue as it does.
        """
        ...


class FPQRSender:
    """Sends force and body rates p, q, r, from u (4,): thrust N, rates rad/s."""

    topic = "cmd"
    kind = "fpqr"
    idle: Command = FPQR(np.zeros(4))

    def message(self, u: Vec) -> FPQR:
        """Return the command of u (4,), not copied."""
        return FPQR(u)

    def steady(self, weight: float) -> FPQR:
        """Return hover thrust without rates."""
        return FPQR(np.array([weight, 0.0, 0.0, 0.0]))


class FRPYSender:
    """Sends force, roll, pitch and yaw rate, from u (4,): thrust N, angles rad, rate rad/s."""

    topic = "cmd"
    kind = "frpy"
    idle: Command = FRPY(np.zeros(4))

    def message(self, u: Vec) -> FRPY:
        """Return the command of u (4,), not copied."""
        return FRPY(u)

    def steady(self, weight: float) -> FRPY:
        """Return hover thrust, level."""
        return FRPY(np.array([weight, 0.0, 0.0, 0.0]))


class VelSender:
    """Sends velocities, from u (4,): velocity m/s world, yaw rate rad/s."""

    topic = "cmd"
    kind = "vel"
    idle: Command = STOP_COMMAND

    def message(self, u: Vec) -> Vel:
        """Return the command of u (4,), not copied."""
        return Vel(u)

    def steady(self, weight: float) -> Vel:
        """Return zero velocity."""
        return Vel(np.zeros(4))


class FullStateSender:
    """Sends references to a firmware that follows them itself, from u (14,), as FullState.flat."""

    topic = "cmd"
    kind = "fullstate"
    idle: Command = STOP_COMMAND

    def message(self, u: Vec) -> FullState:
        """Return the command of u (14,), not copied."""
        return FullState(u)

    def steady(self, weight: float) -> None:
        """Return None: without a state the place to stay at is unknown."""
        return


class AccSender:
    """Sends accelerations to a double integrator, from u (3,) m/s2 world."""

    topic = "cmd"
    kind = "acc"
    idle: Command = STOP_COMMAND

    def message(self, u: Vec) -> Acc:
        """Return the command of u (3,), not copied."""
        return Acc(u)

    def steady(self, weight: float) -> Acc:
        """Return zero acceleration."""
        return Acc(np.zeros(3))


class DriveSender:
    """Sends speed and turn rate to a unicycle, from u (2,): m/s, rad/s."""

    topic = "cmd"
    kind = "drive"
    idle: Command = Drive(np.zeros(2))

    def message(self, u: Vec) -> Drive:
        """Return the command of u (2,), not copied."""
        return Drive(u)

    def steady(self, weight: float) -> Drive:
        """Return zero speed."""
        return Drive(np.zeros(2))


class XYZSender:
    """Sends places to the planner on board, from u (5,): place m world, yaw rad, duration s."""

    topic = "cmd"
    kind = "xyz"
    idle: Command = STOP_COMMAND

    def message(self, u: Vec) -> XYZ:
        """Return a straight line at constant velocity from the present set-point."""
        return XYZ("line", u)

    def steady(self, weight: float) -> None:
        """Return None: the planner on board continues alone."""
        return
