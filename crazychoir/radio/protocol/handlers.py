"""From commands to packets: one radio handler a kind of command, by the paper's names. No I/O, no clock.

A drone whose pose is its own estimate, by lighthouse, flow deck or anchors, is flown by the same handlers: who sees it
is not what it is sent.
"""

import math
from typing import Any

import numpy as np

from crazychoir.control.senders import STOP
from crazychoir.errors import CodecError
from crazychoir.numerics.math3d import GRAVITY, flat_attitude, quaternion
from crazychoir.platforms import Platform
from crazychoir.radio.protocol.compressed import compressed
from crazychoir.radio.protocol.crtp import FORMS, Packet
from crazychoir.simulation.motor_level.motor_control import BASE_THRUST
from crazychoir.simulation.onboard.planner import body_rates
from crazychoir.simulation.onboard.units import (
    FULL,
    roll_pitch_yaw_rate_raw,
    thrust_raw,
)
from crazychoir.types import FPQR, FRPY, XYZ, Command, FullState, Pose, Vel

ALL = 0
"""Mask of groups: every drone that hears it."""
LARGEST = 32_767
"""mm, mm/s, mm/s2, mrad/s: what 16 bits hold."""


class RadioHandler:
    """What all have. kind: as a swarm file names it;  form: of what it sends in flight;  platform: of the drone;
    thrust: command a newton.
    """

    kind: str
    form: str
    needs_thrust = False
    """Whether it must know what a newton is on board."""

    def __init__(self, platform: Platform, thrust: float = 0.0) -> None:
        self.platform = platform
        self.thrust = thrust
        self._streamed_last = (
            True  # somebody before us may have, and be it by cflib's close_link
        )

    @property
    def parameters(self) -> dict[str, float]:
        """Of the firmware, without which the commands would mean something else."""
        return {}

    def packets(self, command: Any) -> list[Packet]:
        """What says this command; CodecError for what is no number, and for what no packet holds."""
        if not np.all(np.isfinite(command.flat)):
            raise CodecError(
                f"{type(command).__name__} {command.flat.tolist()}: finite numbers are allowed."
            )
        return (
            self.planned(command)
            if isinstance(command, XYZ)
            else self.setpoint(command)
        )

    def setpoint(self, command: Any) -> list[Packet]:
        """What says a command of its kind, which the firmware holds until the next one, 0.5 s at most."""
        raise CodecError(
            f"{type(command).__name__} for a drone that is sent {self.kind}."
        )

    def planned(self, command: XYZ) -> list[Packet]:
        """What says this to the planner on board; after set-points it is told then that they have ended (`relax`).

        In this order: a planner in control without a plan switches the motors off (crazyflie-firmware since 2023.11).
        One that is to land flies: it is told of their end by itself, once its planner has answered.
        """
        relax = self.relax
        ends = command.verb in (
            "land",
            "stop",
        )  # said again with each: the first may be lost
        self._streamed_last = self._streamed_last and ends
        x, y, z, yaw, duration = command.flat.tolist()
        match command.verb:
            case "stop":
                before = [FORMS["stop"].packet()] if relax else []
                return [*before, FORMS["planner_stop"].packet(ALL), *relax]
            case "go_to" | "line":
                line = int(command.verb == "line")
                return [
                    FORMS["go_to"].packet(ALL, 0, line, x, y, z, yaw, duration),
                    *relax,
                ]
            case "take_off" if duration > 0.0:
                return [FORMS["take_off"].packet(ALL, z, yaw, False, duration), *relax]
            case "land" if duration > 0.0:
                return [FORMS["land"].packet(ALL, z, yaw, False, duration)]
        plans = "stop, go_to, line, and take_off and land, which take some time"
        raise CodecError(
            f"no plan {command.verb!r} of {duration:g} s; there are {plans}."
        )

    @property
    def relax(self) -> list[Packet]:
        """What gives the planner control again, if it may have lost it."""
        return [FORMS["notify_setpoint_stop"].packet(0)] if self._streamed_last else []

    def _streamed(self, packet: Packet) -> list[Packet]:
        self._streamed_last = True
        return [packet]


class _Thrust(RadioHandler):
    """Set-points with a thrust: roll and pitch as rates or as angles."""

    needs_thrust = True
    angles = 0
    form = "rpyt"

    @property
    def parameters(self) -> dict[str, float]:
        """The modes of roll, pitch and yaw."""
        return {
            "flightmode.stabModeRoll": self.angles,
            "flightmode.stabModePitch": self.angles,
            "flightmode.stabModeYaw": 0,
        }

    def setpoint(self, command: FPQR | FRPY) -> list[Packet]:
        """One; its thrust is held 2 s."""
        thrust, roll, pitch, yaw_rate = command.flat.tolist()
        raw = round(min(max(self.thrust * thrust, 0.0), FULL))
        return self._streamed(
            FORMS[self.form].packet(
                *roll_pitch_yaw_rate_raw(roll, pitch, yaw_rate), raw
            )
        )


class RadioHandlerFPQR(_Thrust):
    """Thrust and body rates."""

    kind = "fpqr"


class RadioHandlerFRPY(_Thrust):
    """Thrust, roll, pitch and yaw rate: what a drone whose link fails can fly on with, level, for 2 s."""

    kind = "frpy"
    angles = 1


class _OnBoard(RadioHandler):
    """Velocities and places are the firmware's to control."""

    @property
    def parameters(self) -> dict[str, float]:
        """Thrust of hovering, to which its control of climbs adds."""
        base = BASE_THRUST * thrust_raw(self.platform.weight, self.platform.firmware)
        return {"posCtlPid.thrustBase": round(base)}


class RadioHandlerVel(_OnBoard):
    """Velocity in the world and yaw rate; and the end of them."""

    kind = "vel"
    form = "velocity_world"

    def setpoint(self, command: Vel) -> list[Packet]:
        """One."""
        vx, vy, vz, rate = command.flat.tolist()
        return self._streamed(FORMS[self.form].packet(vx, vy, vz, math.degrees(rate)))


class RadioHandlerXYZ(_OnBoard):
    """Places, for the planner on board."""

    kind = "xyz"
    form = "go_to"


class RadioHandlerFullState(_OnBoard):
    """A flat output, with the attitude and body rates that follow from it; and the end of them."""

    kind = "fullstate"
    form = "full_state"

    def setpoint(self, command: FullState) -> list[Packet]:
        """One, in thousandths."""
        s = command.flat
        a = tuple(s[6:9])
        j = tuple(s[9:12])
        yaw = float(s[12])
        axes = flat_attitude((a[0], a[1], a[2] + GRAVITY), yaw)
        q = quaternion(np.array(axes).T)
        w = body_rates(a, j, yaw, float(s[13]))
        milli = [round(1e3 * float(x)) for x in (*s[0:9], *w)]
        if max(map(abs, milli)) > LARGEST:
            found = [x / 1e3 for x in milli]
            raise CodecError(
                f"full state {found}: {LARGEST / 1e3:g} m, m/s, m/s2 and rad/s are allowed at most."
            )
        return self._streamed(
            FORMS[self.form].packet(*milli[:9], compressed(np.array(q)), *milli[9:])
        )


HANDLERS: dict[str, type[RadioHandler]] = {
    handler.kind: handler
    for handler in (
        RadioHandlerFPQR,
        RadioHandlerFRPY,
        RadioHandlerVel,
        RadioHandlerXYZ,
        RadioHandlerFullState,
    )
}
"""By what a drone is sent."""


def pose_packet(pose: Pose) -> Packet:
    """What tells a drone where it is."""
    return FORMS["external_pose"].packet(*pose.flat.tolist())


def position_packet(pose: Pose) -> Packet:
    """What tells a drone where it is, and not how it is turned."""
    return FORMS["external_position"].packet(*pose.p.tolist())


def emergency() -> list[Packet]:
    """Motors off for good, said in both ways that firmware knows."""
    return [FORMS["emergency_stop"].packet(), FORMS["supervisor_stop"].packet()]


def idles(command: Command) -> bool:
    """Whether this command asks for motors that are off."""
    if isinstance(command, XYZ):
        return command.verb == STOP.verb
    return isinstance(command, FPQR | FRPY) and not command.flat.any()
