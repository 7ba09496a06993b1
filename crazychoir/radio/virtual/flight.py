"""Ports 3, 6, 7, 8, 9 and 13: what flies a virtual drone, from the firmware's units to the model's SI."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from crazychoir.errors import CodecError
from crazychoir.radio.compressed import quaternion
from crazychoir.radio.crtp import (
    FORMS,
    HIGH_LEVEL,
    LOCALIZATION,
    PLATFORM,
    PROTOCOL,
    SUPERVISOR,
    Form,
    Packet,
)
from crazychoir.simulation.onboard.onboard import Onboard

UNKNOWN = 8
"""The answer ENOEXEC of the planner's port to a command that there is not."""
PACKED_POSE, PACKED = 9, 9
"""Command of LOCALIZATION's channel 1, and bytes of a packed pose after its number: 3 times mm, a quaternion."""
MILLI = 1e-3


class Flight:
    """Takes set-points, plans, poses and requests; number: the last byte of its address, by which poses are packed."""

    def __init__(self, onboard: Onboard, number: int, firmware: str = "virtual", device: str = "CF21") -> None:
        self.onboard, self.number, self.firmware, self.device = onboard, number, firmware, device
        self._forms: dict[tuple[int, int, int], Form] = {}
        for form in FORMS.values():
            self._forms[form.port, form.channel, form.head[0] if form.head else -1] = form
        self.malformed = 0

    def take(self, packet: Packet) -> Iterator[Packet]:
        """Do what a packet asks for; the answers to it."""
        port, channel, data = packet
        if port == PLATFORM and channel == 1:
            yield from self._about(packet)
        elif port == LOCALIZATION and channel == 1 and data[:1] == bytes([PACKED_POSE]):
            self._packed_poses(data[1:])
        else:
            answer = self._obey(packet)
            if port == HIGH_LEVEL:
                yield Packet(port, channel, data[:3].ljust(3, b"\0") + bytes([UNKNOWN if answer is None else answer]))
            elif answer is not None and port in (SUPERVISOR, PLATFORM):
                yield Packet(port, channel, bytes([0x80 | data[0]]) + answer)

    def _obey(self, packet: Packet) -> Any:
        """The answer of the model, None where there is none."""
        forms, (port, channel, data) = self._forms, packet
        form = forms.get((port, channel, data[0] if data else -1)) or forms.get((port, channel, -1))
        if form is None:
            return None
        try:
            values = form.values(packet)
        except CodecError:
            self.malformed += 1
            return None
        return OBEY[form.name](self.onboard, *values)

    def _about(self, packet: Packet) -> Iterator[Packet]:
        match packet.data[:1]:
            case b"\x00":
                yield Packet(PLATFORM, 1, b"\x00" + PROTOCOL.to_bytes(4, "little"))
            case b"\x01":
                yield Packet(PLATFORM, 1, b"\x01" + self.firmware.encode()[:28] + b"\0")
            case b"\x02":
                yield Packet(PLATFORM, 1, b"\x02" + self.device.encode()[:28] + b"\0")

    def _packed_poses(self, body: bytes) -> None:
        """Of up to two drones in one packet: number, mm, quaternion; its own counts."""
        for k in range(0, len(body) - 10, 11):
            if body[k] == self.number:
                p = np.frombuffer(body, "<i2", 3, k + 1) * MILLI
                self.onboard.external_pose(p, quaternion(int.from_bytes(body[k + 7 : k + 11], "little")))


def _full_state(on: Onboard, *values: float) -> None:
    """mm, mm/s, mm/s2, and milli-rad/s of the body."""
    milli = np.array([*values[:9], *values[10:]]) * MILLI
    on.full_state(np.array([*milli[:9], *quaternion(int(values[9])), *milli[9:]]))


def _spiral(on: Onboard, group: int, sideways: int, clockwise: int, *arc: float) -> int:
    angle, r0, r1, climb, duration = arc
    return on.spiral(angle, r0, r1, climb, duration, bool(sideways), bool(clockwise))


def _take_off(on: Onboard, group: int, height: float, yaw: float, keep: bool, duration: float) -> int:
    return on.take_off(height, duration, None if keep else yaw)


def _land(on: Onboard, group: int, height: float, yaw: float, keep: bool, duration: float) -> int:
    return on.land(height, duration, None if keep else yaw)


def _rise(on: Onboard, group: int, height: float, relative: bool, yaw: float, keep: bool, speed: float) -> int:
    away = abs(height) if relative else abs(height - on.estimate.p[2])
    goal = on.estimate.p[2] + height if relative else height
    return on.take_off(goal, away / _speed(on, speed, "hlCommander.vtoff"), None if keep else yaw)


def _sink(on: Onboard, group: int, height: float, relative: bool, yaw: float, keep: bool, speed: float) -> int:
    away = abs(height) if relative else abs(height - on.estimate.p[2])
    goal = on.estimate.p[2] - height if relative else height
    return on.land(goal, away / _speed(on, speed, "hlCommander.vland"), None if keep else yaw)


def _speed(on: Onboard, speed: float, default: str) -> float:
    return speed if speed > 0.0 else on.get(default)


def _go_to(on: Onboard, group: int, relative: int, linear: int, *goal: float) -> int:
    x, y, z, yaw, duration = goal
    return on.go_to((x, y, z), yaw, duration, bool(relative), bool(linear))


def _start(on: Onboard, group: int, relative: int, rel_yaw: int, reverse: int, slot: int, timescale: float) -> int:
    return on.start_trajectory(slot, timescale, bool(relative), bool(rel_yaw), bool(reverse))


def _define(on: Onboard, slot: int, location: int, kind: int, offset: int, pieces: int) -> int:
    return on.define_trajectory(slot, offset, pieces) if (location, kind) == (1, 0) else UNKNOWN


def _stop_planner(on: Onboard, group: int) -> int:
    on.stop()
    return 0


def _arm(on: Onboard, wanted: bool) -> bytes:
    done = on.arm(wanted)
    return bytes([done, bool(on.record["armed"])])


def _recover(on: Onboard) -> bytes:
    done = on.recover()
    return bytes([done, done])


def _info(on: Onboard) -> bytes:
    return on.info.to_bytes(2, "little")


RADIANS = math.pi / 180.0
OBEY: dict[str, Callable[..., Any]] = {
    "rpyt": lambda on, roll, pitch, yaw, thrust: on.rpyt_raw(roll, pitch, yaw, thrust),
    "stop": lambda on: on.stop_setpoint(),
    "full_state": _full_state,
    "velocity_world": lambda on, vx, vy, vz, rate: on.velocity((vx, vy, vz), RADIANS * rate),
    "z_distance": lambda on, roll, pitch, rate, z: on.z_distance(RADIANS * roll, -RADIANS * pitch, RADIANS * rate, z),
    "hover": lambda on, vx, vy, rate, z: on.hover(vx, vy, RADIANS * rate, z),
    "position": lambda on, x, y, z, yaw: on.position((x, y, z), RADIANS * yaw),
    "notify_setpoint_stop": lambda on, remain: on.notify_setpoint_stop(),
    "group_mask": lambda on, group: 0,
    "planner_stop": _stop_planner,
    "define_trajectory": _define,
    "take_off": _take_off,
    "land": _land,
    "take_off_with_velocity": _rise,
    "land_with_velocity": _sink,
    "spiral": _spiral,
    "go_to": _go_to,
    "start_trajectory": _start,
    "external_position": lambda on, *p: on.external_position(np.array(p)),
    "external_pose": lambda on, *values: on.external_pose(np.array(values[:3]), np.array(values[3:])),
    "emergency_stop": lambda on: on.emergency_stop(),
    "emergency_stop_watchdog": lambda on: on.emergency_stop_watchdog(),
    "supervisor_stop": lambda on: on.emergency_stop(),
    "supervisor_watchdog": lambda on: on.emergency_stop_watchdog(),
    "supervisor_info": _info,
    "arm": _arm,
    "platform_arm": _arm,
    "recover": _recover,
    "platform_recover": _recover,
}
