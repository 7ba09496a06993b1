"""From commands to the firmware on board: one class a kind of command, by the paper's names."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from crazychoir.numerics.math3d import GRAVITY, flat_attitude, quaternion
from crazychoir.simulation.onboard.commander import HIGH_LEVEL
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.planner import OK, body_rates
from crazychoir.simulation.onboard.units import thrust_raw
from crazychoir.types import FPQR, FRPY, XYZ, Command, FullState, Vel


class MotorCtrl(ABC):
    """What all have: a drone's firmware, and the way to stop it."""

    def __init__(self, onboard: Onboard) -> None:
        self.onboard = onboard

    @abstractmethod
    def send(self, command: Any) -> bool:
        """Obey a command of this kind; False if it is not taken."""

    def cut(self) -> None:
        """Stop the motors for good."""
        self.onboard.emergency_stop()


class _Thrust(MotorCtrl):
    """Set-points with a thrust: roll and pitch as rates or as angles."""

    angles = 0

    def __init__(self, onboard: Onboard) -> None:
        super().__init__(onboard)
        for axis, mode in (("Roll", self.angles), ("Pitch", self.angles), ("Yaw", 0)):
            onboard.set(f"flightmode.stabMode{axis}", mode)

    def unlock(self) -> None:
        """The packet without thrust that the firmware wants first."""
        if self.onboard.record["locked_thrust"]:
            self.onboard.rpyt_raw(0.0, 0.0, 0.0, 0.0)


class MotorCtrlFPQR(_Thrust):
    """Thrust and body rates, followed by the firmware's rate controller."""

    def send(self, command: FPQR) -> bool:
        """Held until the next one, 0.5 s at most; False if it is not taken."""
        self.unlock()
        return self.onboard.fpqr(*command.flat.tolist())


class MotorCtrlFRPY(_Thrust):
    """Thrust, roll, pitch and yaw rate, followed by the firmware's attitude controller."""

    angles = 1

    def send(self, command: FRPY) -> bool:
        """Held until the next one, 0.5 s at most; False if it is not taken."""
        self.unlock()
        return self.onboard.frpy(*command.flat.tolist())


class MotorCtrlVel(MotorCtrl):
    """Velocity in the world and yaw rate."""

    def send(self, command: Vel) -> bool:
        """Held until the next one, 0.5 s at most; False if it is not taken."""
        return self.onboard.velocity(command.flat[0:3], float(command.flat[3]))


class MotorCtrlFullState(MotorCtrl):
    """A flat output, with the attitude and body rates that follow from it."""

    def send(self, command: FullState) -> bool:
        """Held until the next one, 0.5 s at most; False if it is not taken."""
        s = command.flat
        a = tuple(s[6:9])
        j = tuple(s[9:12])
        yaw = float(s[12])
        axes = flat_attitude((a[0], a[1], a[2] + GRAVITY), yaw)
        q = quaternion(np.array(axes).T)
        return self.onboard.full_state(
            np.array([*s[0:9], *q, *body_rates(a, j, yaw, float(s[13]))])
        )


class MotorCtrlXYZ(MotorCtrl):
    """The planner on board: take-off, go_to, landing, stop."""

    def send(self, command: XYZ) -> bool:
        """Fly it; False if the firmware refuses. It takes over from streamed set-points.

        duration 0: take-off and landing by the firmware's speeds.
        """
        onboard = self.onboard
        x, y, z, yaw, duration = command.flat.tolist()
        if onboard.record["priority"] > HIGH_LEVEL:
            onboard.notify_setpoint_stop()
        if command.verb == "stop":
            onboard.stop()
            return True
        if command.verb in ("go_to", "line"):
            return (
                onboard.go_to((x, y, z), yaw, duration, linear=command.verb == "line")
                == OK
            )
        climb = onboard.take_off if command.verb == "take_off" else onboard.land
        return climb(z, duration or None, yaw) == OK


CONTROLS: dict[str, type[MotorCtrl]] = {
    "fpqr": MotorCtrlFPQR,
    "frpy": MotorCtrlFRPY,
    "vel": MotorCtrlVel,
    "xyz": MotorCtrlXYZ,
    "fullstate": MotorCtrlFullState,
}
"""By what a drone is sent, as a swarm file names it."""
TAKES: dict[str, type[Command]] = {
    "fpqr": FPQR,
    "frpy": FRPY,
    "vel": Vel,
    "xyz": XYZ,
    "fullstate": FullState,
}


BASE_THRUST = 0.8
"""Of hovering, to which the firmware's control of climbs adds; about what its constant is for a bare Crazyflie. With
more, the integral of the climb, which grows while the rotors spin up on the floor, throws the drone up."""


class CrazyflieLink:
    """The way to one drone with firmware: commands of one kind, and those of its planner, which every drone takes.

    Motors that wait for it are armed by the first command that turns them.
    """

    def __init__(self, onboard: Onboard, kind: str) -> None:
        self.onboard = onboard
        self._controls = {
            XYZ: MotorCtrlXYZ(onboard),
            TAKES[kind]: CONTROLS[kind](onboard),
        }
        self._arms = onboard.firmware.needs_arming
        if kind in ("vel", "xyz", "fullstate"):
            base = BASE_THRUST * thrust_raw(onboard.platform.weight, onboard.firmware)
            onboard.set("posCtlPid.thrustBase", base)

    def send(self, command: Command) -> None:
        """Held until the next one; what the firmware refuses is not obeyed."""
        if self._arms and not self.onboard.record["armed"] and command.flat.any():
            self.onboard.arm()
        self._controls[type(command)].send(command)

    def cut(self) -> None:
        """Stop the motors for good."""
        self.onboard.emergency_stop()
