"""Commands as set-points of the firmware: one class a kind of command, with the paper's names."""

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.numerics.kernels import kernel, matrix, real, wholes
from crazychoir.numerics.math3d import STANDARD_GRAVITY, flat_attitude, quaternion
from crazychoir.simulation.onboard.commander import (
    SETPOINT_PRIORITIES,
    position,
    stream_thrust_setpoint,
    velocity,
)
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.planner import (
    compute_flat_body_rates,
)
from crazychoir.simulation.onboard.record import Fleet, rows
from crazychoir.simulation.onboard.supervisor import request_arming
from crazychoir.simulation.onboard.units import convert_thrust_to_raw
from crazychoir.types import (
    FPQR,
    FRPY,
    XYZ,
    Command,
    FullState,
    Ints,
    Mat,
    Vel,
)


@kernel(rows, matrix, wholes, wholes)
def stream_thrust_setpoints(
    fleet: Fleet, inputs: Mat, is_new: Ints, needs_arming: Ints
) -> None:
    """Stream the new set-points of all drones.

    The first set-point that turns the motors arms a drone that needs arming.

    inputs: (n, 4): rows as u of `give_thrust_setpoint`
    is_new: (n,): 1 for a drone with a new set-point
    needs_arming: (n,): 1 for a drone with a firmware that must be armed
    """
    for i in range(inputs.shape[0]):
        if is_new[i] == 0:
            continue
        u = inputs[i]
        is_idle = u[0] == 0.0 and u[1] == 0.0 and u[2] == 0.0 and u[3] == 0.0
        if needs_arming[i] != 0 and fleet[i].armed == 0 and not is_idle:
            request_arming(fleet, i)
        stream_thrust_setpoint(fleet, i, u)


@kernel(rows, matrix, wholes, real)
def stream_motion_setpoints(
    fleet: Fleet, inputs: Mat, is_new: Ints, are_places: float
) -> None:
    """Stream the new set-points of position or velocity of all drones.

    A set-point with a number that is not finite is ignored.

    inputs: (n, 4): velocity (3,) m/s, world, and yaw rate rad/s; or position (3,) m, world, and heading rad
    is_new: (n,): 1 for a drone with a new set-point
    are_places: above 0 if the inputs are positions
    """
    for i in range(inputs.shape[0]):
        x = inputs[i, 0]
        y = inputs[i, 1]
        z = inputs[i, 2]
        yaw = inputs[i, 3]
        if is_new[i] == 0 or not math.isfinite(x + y + z + yaw):
            continue
        if are_places > 0.0:
            position(fleet, i, x, y, z, math.degrees(yaw), SETPOINT_PRIORITIES.crtp)
        else:
            velocity(fleet, i, x, y, z, math.degrees(yaw), SETPOINT_PRIORITIES.crtp)


class MotorCtrl(ABC):
    """Base of all kinds: the firmware of a drone, and how to cut its motors."""

    def __init__(self, onboard: Onboard) -> None:
        self.onboard = onboard

    @abstractmethod
    def send(self, command: Any) -> bool:
        """Give the firmware a command of this kind; return False if it is refused."""

    def cut(self) -> None:
        """Stop the motors for good, within 40 ms."""
        self.onboard.emergency_stop()


class _MotorCtrlThrust(MotorCtrl):
    """Set-points with a thrust: roll and pitch as rates (angles = 0) or as angles (1)."""

    angles = 0

    def __init__(self, onboard: Onboard) -> None:
        super().__init__(onboard)
        for axis, mode in (("Roll", self.angles), ("Pitch", self.angles), ("Yaw", 0)):
            onboard.set(f"flightmode.stabMode{axis}", mode)

    def send(self, command: FPQR | FRPY) -> bool:
        """Give a set-point, valid until the next one or for 0.5 s; return False if it is refused.

        A thrust that is locked in the firmware is unlocked first.
        """
        return self.onboard.setpoints.stream(command.flat)


class MotorCtrlFPQR(_MotorCtrlThrust):
    """Thrust and body rates, followed by the rate controller of the firmware."""


class MotorCtrlFRPY(_MotorCtrlThrust):
    """Thrust, roll, pitch and yaw rate, followed by the attitude controller of the firmware."""

    angles = 1


class MotorCtrlVel(MotorCtrl):
    """Velocity in the world and yaw rate."""

    def send(self, command: Vel) -> bool:
        """Give a set-point, valid until the next one or for 0.5 s; return False if it is refused."""
        return self.onboard.setpoints.velocity(
            command.flat[0:3], float(command.flat[3])
        )


class MotorCtrlFullState(MotorCtrl):
    """A flat output, with the attitude and body rates that follow from it."""

    def send(self, command: FullState) -> bool:
        """Give a set-point, valid until the next one or for 0.5 s; return False if it is refused."""
        s = command.flat
        a = tuple(s[6:9])
        j = tuple(s[9:12])
        yaw = float(s[12])
        axes = flat_attitude((a[0], a[1], a[2] + STANDARD_GRAVITY), yaw)
        q = quaternion(np.array(axes).T)
        return self.onboard.setpoints.full_state(
            np.array([*s[0:9], *q, *compute_flat_body_rates(a, j, yaw, float(s[13]))])
        )


class MotorCtrlXYZ(MotorCtrl):
    """The planner on board: take-off, go_to, landing, stop."""

    def send(self, command: XYZ) -> bool:
        """Start the plan; return False if the firmware refuses, or a number is not finite.

        The planner takes over from streamed set-points. A duration of 0 means the take-off and
        landing speeds of the firmware.
        """
        if not np.all(np.isfinite(command.flat)):
            return False
        onboard = self.onboard
        x, y, z, yaw, duration = command.flat.tolist()
        if onboard.record["priority"] > SETPOINT_PRIORITIES.high_level:
            onboard.notify_setpoint_stop()
        if command.verb == "stop":
            onboard.planner.stop()
            return True
        if command.verb in ("go_to", "line"):
            return (
                onboard.planner.go_to(
                    (x, y, z), yaw, duration, linear=command.verb == "line"
                )
                == FIRMWARE_RESULTS.done
            )
        climb = (
            onboard.planner.take_off
            if command.verb == "take_off"
            else onboard.planner.land
        )
        return climb(z, duration or None, yaw) == FIRMWARE_RESULTS.done


MOTOR_CONTROLS: dict[str, type[MotorCtrl]] = {
    "fpqr": MotorCtrlFPQR,
    "frpy": MotorCtrlFRPY,
    "vel": MotorCtrlVel,
    "xyz": MotorCtrlXYZ,
    "fullstate": MotorCtrlFullState,
}
"""Class that controls a drone, by the kind of command in the swarm file."""
MOTOR_COMMAND_TYPES: dict[str, type[Command]] = {
    "fpqr": FPQR,
    "frpy": FRPY,
    "vel": Vel,
    "xyz": XYZ,
    "fullstate": FullState,
}

"""Command type of each kind of command."""

BASE_THRUST_SHARE = 0.8
"""Share of the hover thrust to which the climb control of the firmware adds.

It is about what the firmware's constant is for a bare Crazyflie. With a larger share the integral
of the climb control, which grows while the rotors spin up on the floor, throws the drone up.
"""


class CrazyflieLink:
    """The link to one drone with firmware: commands of one kind, and those of its planner.

    The first command that turns the motors arms a drone that needs arming.
    """

    def __init__(self, onboard: Onboard, kind: str) -> None:
        self.onboard = onboard
        self._controls = {
            XYZ: MotorCtrlXYZ(onboard),
            MOTOR_COMMAND_TYPES[kind]: MOTOR_CONTROLS[kind](onboard),
        }
        self._arms = onboard.firmware.needs_arming
        if kind in ("vel", "xyz", "fullstate"):
            base = BASE_THRUST_SHARE * convert_thrust_to_raw(
                onboard.platform.weight, onboard.firmware
            )
            onboard.set("posCtlPid.thrustBase", base)

    def send(self, command: Command) -> None:
        """Pass the command to the firmware, which holds it until the next one.

        A command that the firmware refuses has no effect.
        """
        if self._arms and not self.onboard.record["armed"] and command.flat.any():
            self.onboard.arm()
        self._controls[type(command)].send(command)

    def cut(self) -> None:
        """Stop the motors for good."""
        self.onboard.emergency_stop()
