"""Translate commands into packets: one radio handler for each kind of command.

The names are those of the paper. No I/O, no clock. A drone that estimates its own pose, by
lighthouse, flow deck or anchors, uses the same handlers: the packets do not depend on the source of
the pose.
"""

import math
from typing import Any

import numpy as np

from crazychoir.control.senders import STOP_COMMAND
from crazychoir.errors import CodecError
from crazychoir.numerics.math3d import STANDARD_GRAVITY, flat_attitude, quaternion
from crazychoir.platforms import Platform
from crazychoir.radio.protocol.compressed import pack_quaternion
from crazychoir.radio.protocol.crtp import PACKET_FORMS, Packet
from crazychoir.simulation.motor_level.motor_control import BASE_THRUST_SHARE
from crazychoir.simulation.onboard.planner import compute_flat_body_rates
from crazychoir.simulation.onboard.units import (
    FULL_THRUST_COMMAND,
    convert_roll_pitch_yaw_rate_to_raw,
    convert_thrust_to_raw,
)
from crazychoir.types import FPQR, FRPY, XYZ, Command, FullState, Pose, Vel

ALL_GROUPS = 0
"""Group mask of every drone that receives the packet."""
LARGEST_INT16 = 32_767
"""Largest value in 16 bits: mm, mm/s, mm/s2, mrad/s."""


class RadioHandler:
    """The common part of all handlers.

    platform: platform of the drone
    thrust: thrust command a newton
    """

    kind: str
    """Kind of command, as a swarm file names it."""
    form: str
    """Form of the packets in flight."""
    needs_thrust = False
    """True if the handler must know the thrust command a newton."""

    def __init__(self, platform: Platform, thrust: float = 0.0) -> None:
        self.platform = platform
        self.thrust = thrust
        # True at the start: another program may have sent set-points before, for example cflib's
        # close_link.
        self._streamed_last = True

    @property
    def parameters(self) -> dict[str, float]:
        """Firmware parameters without which the commands would have another meaning."""
        return {}

    def packets(self, command: Any) -> list[Packet]:
        """Return the packets of a command.

        Raises CodecError for values that are not finite or do not fit into a packet.
        """
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
        """Return the packets of a set-point of this kind.

        The firmware holds a set-point until the next one, 0.5 s at most.
        """
        raise CodecError(
            f"{type(command).__name__} for a drone that is sent {self.kind}."
        )

    def planned(self, command: XYZ) -> list[Packet]:
        """Return the packets of a command for the planner on board.

        After set-points they end with `relax`. The order matters: a planner that has control but no
        plan switches the motors off (crazyflie-firmware since 2023.11). A drone that is to land
        flies: it gets `relax` separately, once its planner has answered.
        """
        relax = self.relax
        # After these, `relax` is sent again with each further command: the first may be lost.
        ends = command.verb in (
            "land",
            "stop",
        )
        self._streamed_last = self._streamed_last and ends
        x, y, z, yaw, duration = command.flat.tolist()
        match command.verb:
            case "stop":
                before = [PACKET_FORMS["stop"].packet()] if relax else []
                return [
                    *before,
                    PACKET_FORMS["planner_stop"].packet(ALL_GROUPS),
                    *relax,
                ]
            case "go_to" | "line":
                line = int(command.verb == "line")
                return [
                    PACKET_FORMS["go_to"].packet(
                        ALL_GROUPS, 0, line, x, y, z, yaw, duration
                    ),
                    *relax,
                ]
            case "take_off" if duration > 0.0:
                return [
                    PACKET_FORMS["take_off"].packet(
                        ALL_GROUPS, z, yaw, False, duration
                    ),
                    *relax,
                ]
            case "land" if duration > 0.0:
                return [
                    PACKET_FORMS["land"].packet(ALL_GROUPS, z, yaw, False, duration)
                ]
        plans = "stop, go_to, line, and take_off and land, which take some time"
        raise CodecError(
            f"no plan {command.verb!r} of {duration:g} s; there are {plans}."
        )

    @property
    def relax(self) -> list[Packet]:
        """Packets that give control back to the planner, if set-points may have taken it."""
        return (
            [PACKET_FORMS["notify_setpoint_stop"].packet(0)]
            if self._streamed_last
            else []
        )

    def _streamed(self, packet: Packet) -> list[Packet]:
        self._streamed_last = True
        return [packet]


class _ThrustHandler(RadioHandler):
    """Set-points with a thrust; roll and pitch are rates or angles."""

    needs_thrust = True
    angles = 0
    """1: roll and pitch are angles; 0: they are rates."""
    form = "rpyt"

    @property
    def parameters(self) -> dict[str, float]:
        """Modes of roll, pitch and yaw."""
        return {
            "flightmode.stabModeRoll": self.angles,
            "flightmode.stabModePitch": self.angles,
            "flightmode.stabModeYaw": 0,
        }

    def setpoint(self, command: FPQR | FRPY) -> list[Packet]:
        """Return one set-point; the firmware holds its thrust for 2 s."""
        thrust, roll, pitch, yaw_rate = command.flat.tolist()
        raw = round(min(max(self.thrust * thrust, 0.0), FULL_THRUST_COMMAND))
        return self._streamed(
            PACKET_FORMS[self.form].packet(
                *convert_roll_pitch_yaw_rate_to_raw(roll, pitch, yaw_rate), raw
            )
        )


class RadioHandlerFPQR(_ThrustHandler):
    """Thrust and body rates."""

    kind = "fpqr"


class RadioHandlerFRPY(_ThrustHandler):
    """Thrust, roll, pitch and yaw rate.

    If the link fails, the drone can fly on with this, level, for 2 s.
    """

    kind = "frpy"
    angles = 1


class _OnboardHandler(RadioHandler):
    """Velocities and positions, which the firmware controls."""

    @property
    def parameters(self) -> dict[str, float]:
        """Thrust of hovering, which the firmware's climb control starts from."""
        base = BASE_THRUST_SHARE * convert_thrust_to_raw(
            self.platform.weight, self.platform.firmware
        )
        return {"posCtlPid.thrustBase": round(base)}


class RadioHandlerVel(_OnboardHandler):
    """Velocity in the world and yaw rate."""

    kind = "vel"
    form = "velocity_world"

    def setpoint(self, command: Vel) -> list[Packet]:
        """Return one set-point."""
        vx, vy, vz, rate = command.flat.tolist()
        return self._streamed(
            PACKET_FORMS[self.form].packet(vx, vy, vz, math.degrees(rate))
        )


class RadioHandlerXYZ(_OnboardHandler):
    """Positions for the planner on board."""

    kind = "xyz"
    form = "go_to"


class RadioHandlerFullState(_OnboardHandler):
    """A flat output with its attitude and body rates."""

    kind = "fullstate"
    form = "full_state"

    def setpoint(self, command: FullState) -> list[Packet]:
        """Return one set-point, in thousandths of the SI units."""
        s = command.flat
        a = tuple(s[6:9])
        j = tuple(s[9:12])
        yaw = float(s[12])
        axes = flat_attitude((a[0], a[1], a[2] + STANDARD_GRAVITY), yaw)
        q = quaternion(np.array(axes).T)
        w = compute_flat_body_rates(a, j, yaw, float(s[13]))
        milli = [round(1e3 * float(x)) for x in (*s[0:9], *w)]
        if max(map(abs, milli)) > LARGEST_INT16:
            found = [x / 1e3 for x in milli]
            raise CodecError(
                f"full state {found}: {LARGEST_INT16 / 1e3:g} m, m/s, m/s2 and rad/s are allowed at most."
            )
        return self._streamed(
            PACKET_FORMS[self.form].packet(
                *milli[:9], pack_quaternion(np.array(q)), *milli[9:]
            )
        )


RADIO_HANDLERS: dict[str, type[RadioHandler]] = {
    handler.kind: handler
    for handler in (
        RadioHandlerFPQR,
        RadioHandlerFRPY,
        RadioHandlerVel,
        RadioHandlerXYZ,
        RadioHandlerFullState,
    )
}
"""Handler of each kind of command."""


def pose_packet(pose: Pose) -> Packet:
    """Return the packet that tells a drone its pose."""
    return PACKET_FORMS["external_pose"].packet(*pose.flat.tolist())


def position_packet(pose: Pose) -> Packet:
    """Return the packet that tells a drone its position, without its attitude."""
    return PACKET_FORMS["external_position"].packet(*pose.p.tolist())


def emergency_packets() -> list[Packet]:
    """Return the packets that stop the motors for good, in both forms that firmware knows."""
    return [
        PACKET_FORMS["emergency_stop"].packet(),
        PACKET_FORMS["supervisor_stop"].packet(),
    ]


def is_idle_command(command: Command) -> bool:
    """Return whether this command asks for motors that are off."""
    if isinstance(command, XYZ):
        return command.verb == STOP_COMMAND.verb
    return isinstance(command, FPQR | FRPY) and not command.flat.any()
