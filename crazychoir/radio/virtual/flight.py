"""Ports 3, 6, 7, 8, 9 and 13: the packets that fly a virtual drone.

The firmware's units become the SI units of the model.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import CodecError
from crazychoir.firmware.release import PROTOCOL_VERSION
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.protocol.compressed import unpack_quaternion
from crazychoir.radio.protocol.crtp import (
    PACKET_FORMS,
    CrtpPort,
    Packet,
    PacketForm,
)
from crazychoir.radio.virtual.commands import (
    COMMAND_FUNCTIONS,
    PACKET_UNITS,
    apply_manual,
)
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import YAW_MODES
from crazychoir.simulation.onboard.units import FULL_THRUST_COMMAND


@dataclass(frozen=True, slots=True)
class FormlessPackets:
    """Commands and channels of the packets that `PACKET_FORMS` does not describe."""

    short_lpp: int = 2
    """Command of LOCALIZATION's channel 1: a packet for an anchor."""
    packed_pose: int = 9
    """Command of LOCALIZATION's channel 1: packed poses."""
    position_channel: int = 2
    """Channel of packed positions."""
    emulated_receiver: int = 3
    """Set-point of an emulated receiver; its length depends on its content."""


FORMLESS_PACKETS = FormlessPackets()


@dataclass(frozen=True, slots=True)
class SpecialForms:
    """Names of the forms that are treated in a special way."""

    unchecked: tuple[str, ...] = ("position", "stop")
    """Set-points with a length that the firmware does not check."""
    planned: tuple[str, ...] = (
        "take_off",
        "take_off_with_velocity",
        "go_to",
        "go_to_legacy",
        "spiral",
        "start_trajectory",
    )
    """Commands by which the planner on board flies, unless a set-point has control."""


SPECIAL_FORMS = SpecialForms()


_PACKED_POSE_LAYOUT = struct.Struct("<BhhhI")
"""Layout of a packed pose."""
_PACKED_POSITION_LAYOUT = struct.Struct("<Bhhh")
"""Layout of a packed position."""


class FirmwareAssertion(CodecError):
    """A failed assertion of the firmware: a real drone restarts."""


class FlightService:
    """Takes set-points, plans, poses and requests, and counts them.

    onboard: model of the firmware
    number: last byte of the drone's address, which selects its packed pose
    firmware: release of the firmware
    device: type of the device
    read: returns a parameter by name
    write: sets a parameter by name
    """

    def __init__(
        self,
        onboard: Onboard,
        number: int,
        firmware: str,
        device: str,
        read: Callable[[str], float],
        write: Callable[[str, float], None],
    ) -> None:
        self.onboard = onboard
        self.number = number
        self.firmware = firmware
        self.device = device
        self.read = read
        self.write = write
        self._forms: dict[tuple[int, int, int], PacketForm] = {}
        for form in PACKET_FORMS.values():
            self._forms[form.port, form.channel, form.head[0] if form.head else -1] = (
                form
            )
        self.zeros = self.malformed = self.unknown = self.poses = 0
        """Counts: RPYT packets of zeros, wrong lengths, unknown packets, poses from outside."""
        self.last = ""
        """Kind of the last set-point."""
        self.refuses = False
        """True while a fault refuses arming."""
        self.external: tuple[float, ...] = ()
        """Last pose (7,) or position (3,) from outside."""
        self.planned_at: int | None = None
        """ms of the last plan that waits for the end of set-points; None without one."""

    def take(self, packet: Packet) -> Iterator[Packet]:
        """Do what a packet asks for; return the answers.

        Raises FirmwareAssertion where the firmware would restart.
        """
        port, channel, data = packet
        command = data[0] if data else -1
        if port == CrtpPort.PLATFORM:
            yield from self._platform(packet)
        elif port == CrtpPort.LOCALIZATION and (channel, command) == (
            1,
            FORMLESS_PACKETS.short_lpp,
        ):
            # The answer says that the packet was not passed on: there is no anchor.
            yield Packet(port, channel, data[:2].ljust(2, b"\0") + b"\0")
        elif port == CrtpPort.LOCALIZATION and (channel, command) == (
            1,
            FORMLESS_PACKETS.packed_pose,
        ):
            self._packed(data[1:], _PACKED_POSE_LAYOUT)
        elif (
            port == CrtpPort.LOCALIZATION
            and channel == FORMLESS_PACKETS.position_channel
        ):
            self._packed(data, _PACKED_POSITION_LAYOUT)
        elif (
            port == CrtpPort.SETPOINT
            and channel == 0
            and command == FORMLESS_PACKETS.emulated_receiver
        ):
            self._emulated(data[1:])
        else:
            yield from self._answered(packet)

    def _answered(self, packet: Packet) -> Iterator[Packet]:
        port, channel, data = packet
        answer = self._obey(packet)
        if port == CrtpPort.HIGH_LEVEL:
            yield Packet(
                port,
                channel,
                data[:3].ljust(3, b"\0")
                + bytes(
                    [FIRMWARE_RESULTS.unknown_command if answer is None else answer]
                ),
            )
        elif answer is not None and port == CrtpPort.SUPERVISOR:
            yield Packet(port, channel, bytes([0x80 | data[0]]) + answer)
        elif answer is not None and port == CrtpPort.LOCALIZATION:
            yield Packet(port, channel, data[:1] + answer)

    def _obey(self, packet: Packet) -> Any:
        """Return the answer of the model; None if there is none."""
        forms, (port, channel, data) = self._forms, packet
        if port == CrtpPort.SUPERVISOR and channel == 0:
            return self._asked(data)
        form = forms.get((port, channel, data[0] if data else -1)) or forms.get(
            (port, channel, -1)
        )
        if form is None:
            return self._handle_unknown(packet)
        try:
            values = form.values(packet)
        except CodecError as error:
            return self._wrong(form, error)
        if port in (CrtpPort.COMMANDER, CrtpPort.SETPOINT) and channel == 0:
            self.last = form.name
            self.zeros += form.name == "rpyt" and not any(values)
        if (
            port == CrtpPort.HIGH_LEVEL
            and form.name not in ("group_mask", "define_trajectory")
            and not self._meant(values[0])
        ):
            return 0
        if form.name in SPECIAL_FORMS.planned:
            self.planned_at = int(self.onboard.record["tick"])
        if form.name in COMMAND_FUNCTIONS:
            return COMMAND_FUNCTIONS[form.name](self.onboard, *values)
        return FLIGHT_FUNCTIONS[form.name](self, *values)

    def _handle_unknown(self, packet: Packet) -> None:
        """Count an unknown packet, and act on it as the firmware does.

        An unknown set-point acts as a set-point without thrust; an empty one fails an assertion.
        """
        self.unknown += 1
        if packet.port == CrtpPort.SETPOINT and packet.channel == 0:
            if not packet.data:
                raise FirmwareAssertion("CRTP set-point: 0 bytes; allowed: 1 or more.")
            self.last = f"unknown {packet.data[0]}"
            self.onboard.setpoints.stop_setpoint()

    def _wrong(self, form: PacketForm, error: CodecError) -> None:
        self.malformed += 1
        if (
            form.port == CrtpPort.SETPOINT
            and form.channel == 0
            and form.name not in SPECIAL_FORMS.unchecked
        ):
            raise FirmwareAssertion(str(error)) from error

    def _meant(self, group: int) -> bool:
        """Return whether the drone is in a group of this mask; 0 means every drone."""
        return group == 0 or bool(group & int(self.read("hlCommander.groupmask")))

    # The supervisor

    @property
    def info(self) -> int:
        """The supervisor's bits."""
        return self.onboard.info & ~(SUPERVISOR_BITS.can_arm * self.refuses)

    def _asked(self, data: bytes) -> bytes | None:
        """Return the supervisor's answer: all bits for request 12, one bit for requests 1 to 11."""
        if len(data) != 1 or not 1 <= data[0] <= 12:
            self.unknown += 1
            return None
        return (
            self.info.to_bytes(2, "little")
            if data[0] == 12
            else bytes([self.info >> data[0] - 1 & 1])
        )

    def arm(self, wanted: bool) -> bytes:
        """Arm or disarm; return whether this was done, and whether the drone is armed now."""
        done = not (wanted and self.refuses) and self.onboard.arm(wanted)
        return bytes([done, bool(self.onboard.record["armed"] or (done and wanted))])

    def recover(self) -> bytes:
        """Recover from a crash.

        Returns whether this was done, and whether the drone has recovered.
        """
        done = self.onboard.recover()
        return bytes([done, done])

    # The platform

    def _platform(self, packet: Packet) -> Iterator[Packet]:
        port, channel, data = packet
        if channel == 1:
            yield from self._version(data[:1])
        elif channel == 0 and data:
            answer = self._obey(packet) if data[0] in (1, 2) else None
            yield packet if answer is None else Packet(port, channel, data[:1] + answer)
        else:
            # The channel of an application on board; this drone has none.
            self.unknown += 1

    def _version(self, command: bytes) -> Iterator[Packet]:
        match command:
            case b"\x00":
                yield Packet(
                    CrtpPort.PLATFORM,
                    1,
                    command + PROTOCOL_VERSION.to_bytes(4, "little"),
                )
            case b"\x01":
                yield Packet(
                    CrtpPort.PLATFORM, 1, command + self.firmware.encode()[:29]
                )
            case b"\x02":
                yield Packet(CrtpPort.PLATFORM, 1, command + self.device.encode()[:29])

    # Poses from outside

    def pose(self, p: Any, q: Any) -> None:
        """Take a pose from outside: p in m, and a quaternion."""
        self.poses = self.poses + 1
        self.external = (*p, *q)
        self.onboard.external_pose(np.array(p, float), np.array(q, float))

    def position(self, p: Any) -> None:
        """Take a position from outside, m."""
        self.poses = self.poses + 1
        self.external = tuple(p)
        self.onboard.external_position(np.array(p, float))

    def _packed(self, body: bytes, layout: struct.Struct) -> None:
        """Take poses or positions of several drones in one packet.

        The one with the number of this drone corrects its estimate; the others are its peers.
        """
        for number, x, y, z, *q in layout.iter_unpack(
            body[: len(body) // layout.size * layout.size]
        ):
            p = (
                x * PACKET_UNITS.thousandth,
                y * PACKET_UNITS.thousandth,
                z * PACKET_UNITS.thousandth,
            )
            if number != self.number:
                self.onboard.peer_position(number, np.array(p))
            elif q:
                self.pose(p, unpack_quaternion(q[0]))
            else:
                self.position(p)

    # The channels of an emulated receiver

    def _emulated(self, body: bytes) -> None:
        """Apply roll, pitch, yaw and thrust as pulses of 1000 to 2000 us.

        The first further channel selects angles or rates.
        """
        count = body[0] & 0x0F if body else 0
        if len(body) != 9 + 2 * count:
            self.malformed += 1
            allowed = f"allowed for {count} more channels: {9 + 2 * count}"
            raise FirmwareAssertion(
                f"CRTP emulated receiver: {len(body)} bytes; {allowed}."
            )
        roll, pitch, yaw, thrust, *more = struct.unpack(f"<{4 + count}H", body[1:])
        self.last = "receiver"
        rates = bool(more) and more[0] < 1500
        turn = [(1500 - stick) / 500.0 for stick in (roll, pitch, yaw)]
        read = self.read
        names = (
            ("cppm.rateRoll", "cppm.ratePitch")
            if rates
            else ("cppm.angRoll", "cppm.angPitch")
        )
        r = turn[0] * read(names[0])
        p = turn[1] * read(names[1])
        w = turn[2] * read("cppm.rateYaw")
        apply_manual(
            self.onboard,
            r,
            p,
            w,
            max(thrust - 1000, 0) / 1000.0 * FULL_THRUST_COMMAND,
            int(rates),
        )


def _set_group_mask(me: FlightService, group: int) -> int:
    me.write("hlCommander.groupmask", group)
    return 0


def _set_rpyt(
    me: FlightService, roll: float, pitch: float, yaw: float, thrust: float
) -> None:
    """Apply an RPYT packet; a yaw rate in the carefree mode fails an assertion."""
    fw = me.onboard.record
    if (
        fw["yaw_mode"] == YAW_MODES.carefree
        and not fw["rate_yaw_mode"]
        and not fw["sets_position"]
    ):
        raise FirmwareAssertion("RPYT: flightmode.yawMode is 0; allowed: 1 or 2.")
    me.onboard.setpoints.rpyt_raw(roll, pitch, yaw, thrust)


FLIGHT_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "group_mask": _set_group_mask,
    "rpyt": _set_rpyt,
    "external_position": lambda me, *p: me.position(p),
    "external_pose": lambda me, *values: me.pose(values[:3], values[3:]),
    "lighthouse_persist": lambda me, geometries, calibrations: b"\x01",
    "arm": FlightService.arm,
    "platform_arm": FlightService.arm,
    "recover": FlightService.recover,
    "platform_recover": FlightService.recover,
}
"""Functions of the forms that the model does not handle.

The result is the answer if the port answers.
"""
