"""Ports 3, 6, 7, 8, 9 and 13: the packets that fly a virtual drone.

The firmware's units become the SI units of the model.
"""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import CodecError
from crazychoir.firmware.release import PROTOCOL_VERSION
from crazychoir.firmware.requests import PLATFORM_REQUESTS, SUPERVISOR_REQUESTS
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.protocol.compressed import unpack_quaternion
from crazychoir.radio.protocol.crtp import (
    CRTP_FORMAT,
    PACKET_FORMS,
    CrtpPort,
    Packet,
    PacketForm,
)
from crazychoir.radio.protocol.packed_poses import PACKED_POSES, PACKED_POSITIONS
from crazychoir.radio.protocol.receive_buffer import FirmwareAssertion, ReceivedPacket
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
    packed_pose: int = PACKED_POSES.head[0]
    """Command of LOCALIZATION's channel 1: packed poses."""
    position_channel: int = PACKED_POSITIONS.channel
    """Channel of packed positions."""
    located: tuple[int, ...] = (short_lpp, packed_pose)
    """Commands of LOCALIZATION's channel 1 that have no form."""
    receiver: bytes = b"\x03"
    """Head of the set-point of an emulated receiver; its length depends on its content."""


FORMLESS_PACKETS = FormlessPackets()


@dataclass(frozen=True, slots=True)
class SpecialForms:
    """Names of the forms that are treated in a special way."""

    unchecked: tuple[str, ...] = ("position", "stop")
    """Set-points with a length that the firmware does not check."""
    complete: tuple[str, ...] = ("lighthouse_persist",)
    """Requests that the firmware passes over if they are too short."""
    planned: tuple[str, ...] = (
        "take_off",
        "take_off_with_velocity",
        "go_to",
        "go_to_legacy",
        "spiral",
        "start_trajectory",
    )
    """Commands by which the planner on board flies, unless a set-point has control."""
    started: tuple[str, ...] = ("start_trajectory", "start_trajectory_legacy")
    """Commands that start an uploaded trajectory."""


SPECIAL_FORMS = SpecialForms()


CAREFREE_MODE = 0
"""Value of flightmode.yawMode for which the firmware has no code (crtp_commander_rpyt.c)."""


class VersionService:
    """Tells the protocol, the release and the kind of drone.

    release: release of the firmware
    device: kind of drone
    """

    def __init__(self, release: str, device: str) -> None:
        self._answers = {
            PLATFORM_REQUESTS.protocol: PROTOCOL_VERSION.to_bytes(4, "little"),
            PLATFORM_REQUESTS.release: release.encode(),
            PLATFORM_REQUESTS.device: device.encode(),
        }

    def take(self, request: int) -> Iterator[Packet]:
        """Return the answer to a request; none to an unknown one."""
        if request in self._answers:
            answer = bytes([request]) + self._answers[request]
            yield Packet(
                CrtpPort.PLATFORM,
                PLATFORM_REQUESTS.version_channel,
                answer[: CRTP_FORMAT.payload_size],
            )


class ToldPoses:
    """Counts the poses and positions that a drone is told, and measures the time between them.

    onboard: model of the firmware, for its clock
    """

    def __init__(self, onboard: Onboard) -> None:
        self.count = 0
        """Poses and positions so far."""
        self.last: tuple[float, ...] = ()
        """Last pose (7,) or position (3,)."""
        self.longest_gap = 0.0
        """s: longest time between two of them."""
        self._onboard = onboard
        self._tick: int | None = None

    def note(self, told: tuple[float, ...]) -> None:
        """Count a pose or a position."""
        if self._tick is not None:
            self.longest_gap = max(self.longest_gap, self.age)
        self._tick = int(self._onboard.record["tick"])
        self.count = self.count + 1
        self.last = told

    @property
    def age(self) -> float:
        """s since the last one; infinite before the first."""
        if self._tick is None:
            return math.inf
        return 1e-3 * (int(self._onboard.record["tick"]) - self._tick)


class FlightService:
    """Takes set-points, plans, poses and requests, and counts them.

    onboard: model of the firmware
    number: last byte of the drone's address, which selects its packed pose
    versions: tells what the drone is
    read: returns a parameter by name
    write: sets a parameter by name
    """

    def __init__(
        self,
        onboard: Onboard,
        number: int,
        versions: VersionService,
        read: Callable[[str], float],
        write: Callable[[str, float], None],
    ) -> None:
        self.onboard = onboard
        self.number = number
        self._versions = versions
        self.read = read
        self.write = write
        self._forms: dict[tuple[int, int, int], PacketForm] = {}
        for form in PACKET_FORMS.values():
            self._forms[form.port, form.channel, form.head[0] if form.head else -1] = (
                form
            )
        self.zeros = self.malformed = self.unknown = 0
        """Counts: RPYT packets of zeros, wrong lengths, unknown packets."""
        self.told = ToldPoses(onboard)
        """Poses and positions from outside."""
        self.last = ""
        """Kind of the last set-point."""
        self.refuses = False
        """True while a fault refuses arming."""
        self.planned_at: int | None = None
        """ms of the last plan that waits for the end of set-points; None without one."""
        self.undefined: int | None = None
        """Trajectory that was started and is not defined; None without one."""

    def take(self, packet: ReceivedPacket) -> Iterator[Packet]:
        """Do what a packet asks for; return the answers.

        Raises FirmwareAssertion where the firmware would reset.
        """
        port, channel, data, _ = packet
        match (port, channel):
            case (CrtpPort.PLATFORM, _):
                yield from self._platform(packet)
            case (CrtpPort.SUPERVISOR, 0):
                yield from self._tell_supervision(data)
            case (CrtpPort.LOCALIZATION, FORMLESS_PACKETS.position_channel):
                self._packed(data, PACKED_POSITIONS.entry)
            case (CrtpPort.LOCALIZATION | CrtpPort.SUPERVISOR, 1) if not data:
                self.unknown += 1
            case (CrtpPort.LOCALIZATION, 1) if data[0] in FORMLESS_PACKETS.located:
                yield from self._locate(packet)
            case (CrtpPort.SETPOINT, 0) if data[:1] == FORMLESS_PACKETS.receiver:
                self._emulated(data[1:])
            case _:
                yield from self._answered(packet)

    def _locate(self, packet: ReceivedPacket) -> Iterator[Packet]:
        """Take a packet for anchors, or packed poses."""
        port, channel, data, _ = packet
        if data[0] == FORMLESS_PACKETS.packed_pose:
            self._packed(data[1:], PACKED_POSES.entry)
        elif len(data) > 1:
            # The answer says that the packet was not passed on: there is no anchor.
            yield Packet(port, channel, data[:2] + b"\0")

    def _answered(self, packet: ReceivedPacket) -> Iterator[Packet]:
        port, channel, _, buffer = packet
        answer = self._obey(packet)
        if port == CrtpPort.HIGH_LEVEL:
            result = FIRMWARE_RESULTS.unknown_command if answer is None else answer
            yield Packet(port, channel, buffer[:3] + bytes([result]))
        elif answer is not None and port == CrtpPort.SUPERVISOR:
            yield Packet(
                port, channel, bytes([SUPERVISOR_REQUESTS.answer | buffer[0]]) + answer
            )
        elif answer is not None and port == CrtpPort.LOCALIZATION:
            yield Packet(port, channel, buffer[:1] + answer)

    def _obey(self, packet: ReceivedPacket) -> Any:
        """Return the answer of the model; None if there is none."""
        port, channel, data, buffer = packet
        is_setpoint = port in (CrtpPort.COMMANDER, CrtpPort.SETPOINT)
        if (port, channel) == (CrtpPort.SETPOINT, 0) and not data:
            raise FirmwareAssertion("CRTP set-point: 0 bytes; allowed: 1 or more.")
        form = self._forms.get((port, channel, buffer[0])) or self._forms.get(
            (port, channel, -1)
        )
        if form is None:
            return self._handle_unknown(packet)
        self._check_length(form, packet)
        if form.name in SPECIAL_FORMS.complete and len(data) <= form.layout.size:
            return None
        values = form.read(buffer)
        if is_setpoint and channel == 0:
            self._note_setpoint(form, values)
        if (
            port == CrtpPort.HIGH_LEVEL
            and form.name not in ("group_mask", "define_trajectory")
            and not self._meant(values[0])
        ):
            return 0
        if form.name in SPECIAL_FORMS.started:
            slot = values[form.names.index("id")]
            self.undefined = (
                None if self.onboard.trajectories.is_defined(slot) else slot
            )
        if form.name in SPECIAL_FORMS.planned:
            self.planned_at = int(self.onboard.record["tick"])
        if form.name in COMMAND_FUNCTIONS:
            return COMMAND_FUNCTIONS[form.name](self.onboard, *values)
        return FLIGHT_FUNCTIONS[form.name](self, *values)

    def _note_setpoint(self, form: PacketForm, values: tuple[Any, ...]) -> None:
        """Note the kind of a set-point.

        Raises FirmwareAssertion for roll, pitch and yaw in a mode that the firmware does not have.
        """
        self.last = form.name
        if form.name == "rpyt":
            self.zeros += not any(values)
            if self.read("flightmode.yawMode") == CAREFREE_MODE:
                raise FirmwareAssertion("flightmode.yawMode is 0; allowed: 1, 2.")

    def _handle_unknown(self, packet: ReceivedPacket) -> None:
        """Count an unknown packet, and act on it as the firmware does.

        An unknown set-point acts as a set-point without thrust.
        """
        self.unknown += 1
        if (packet.port, packet.channel) == (CrtpPort.SETPOINT, 0):
            self.last = f"unknown {packet.data[0]}"
            self.onboard.setpoints.stop_setpoint()

    def _check_length(self, form: PacketForm, packet: ReceivedPacket) -> None:
        """Count a packet of a wrong length.

        Raises FirmwareAssertion if the firmware checks the length of this form. It reads the fields
        of other forms at their places, also behind the end of the packet.
        """
        try:
            form.values(Packet(packet.port, packet.channel, packet.data))
        except CodecError as error:
            self.malformed += 1
            if (
                form.port == CrtpPort.SETPOINT
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

    def _tell_supervision(self, data: bytes) -> Iterator[Packet]:
        """Return the supervisor's bits for request 12, and one of them for requests 1 to 11."""
        request = data[0] if data else 0
        if not 1 <= request <= SUPERVISOR_REQUESTS.all_bits:
            self.unknown += 1
            return
        answer = (
            self.info.to_bytes(2, "little")
            if request == SUPERVISOR_REQUESTS.all_bits
            else bytes([self.info >> request - 1 & 1])
        )
        yield Packet(
            CrtpPort.SUPERVISOR,
            0,
            bytes([SUPERVISOR_REQUESTS.answer | request]) + answer,
        )

    def arm(self, wanted: bool) -> bytes:
        """Arm or disarm; return whether this was done, and whether the drone is armed now."""
        done = not (wanted and self.refuses) and self.onboard.arm(wanted)
        return bytes([done, bool(self.onboard.record["armed"])])

    def recover(self) -> bytes:
        """Recover from a crash.

        Returns whether this was done, and whether the drone has recovered.
        """
        done = self.onboard.recover()
        return bytes([done, done])

    # The platform

    def _platform(self, packet: ReceivedPacket) -> Iterator[Packet]:
        match packet.channel:
            case PLATFORM_REQUESTS.command_channel:
                yield self._command_platform(packet)
            case PLATFORM_REQUESTS.version_channel:
                yield from self._versions.take(packet.buffer[0])
            case _:
                # The channel of an application on board; this drone has none.
                self.unknown += 1

    def _command_platform(self, packet: ReceivedPacket) -> Packet:
        """Arm, recover or notify; other commands are sent back."""
        port, channel, data, buffer = packet
        if buffer[0] == PLATFORM_REQUESTS.notification:
            return Packet(port, channel)
        if (port, channel, buffer[0]) not in self._forms:
            return Packet(port, channel, data)
        return Packet(port, channel, buffer[:1] + self._obey(packet))

    # Poses from outside

    def pose(self, p: Any, q: Any) -> None:
        """Take a pose from outside: p in m, and a quaternion."""
        self.told.note((*p, *q))
        self.onboard.external_pose(np.array(p, float), np.array(q, float))

    def position(self, p: Any) -> None:
        """Take a position from outside, m."""
        self.told.note(tuple(p))
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
