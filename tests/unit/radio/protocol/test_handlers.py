"""What each command becomes on the air: bytes worked out by hand from the packet descriptions."""

import math
import struct

import numpy as np
import pytest

from crazychoir.errors import CodecError, ConfigError
from crazychoir.platforms import CRAZYFLIE_21, PLATFORM_BY_NAME
from crazychoir.radio.protocol.handlers import (
    RADIO_HANDLERS,
    RadioHandlerFPQR,
    RadioHandlerFRPY,
    RadioHandlerFullState,
    RadioHandlerVel,
    RadioHandlerXYZ,
    emergency_packets,
    is_idle_command,
    pose_packet,
)
from crazychoir.radio.protocol.thrust import thrust_command_per_newton
from crazychoir.types import FPQR, FRPY, XYZ, FullState, Pose, Vel

NEWTON = 65535 / 0.48
STOP = XYZ("stop", np.zeros(5))


def test_body_rates_are_degrees_with_pitch_and_yaw_turned_around() -> None:
    handler = RadioHandlerFPQR(CRAZYFLIE_21, NEWTON)
    (packet,) = handler.packets(FPQR(np.array([0.24, 0.1, 0.2, 0.3])))
    roll, pitch, yaw, thrust = struct.unpack("<fffH", packet.data)
    assert (packet.port, packet.channel) == (3, 0)
    assert np.allclose([roll, pitch, yaw], np.degrees([0.1, -0.2, -0.3]))
    assert thrust == 32768
    assert handler.parameters == {
        "flightmode.stabModeRoll": 0,
        "flightmode.stabModePitch": 0,
        "flightmode.stabModeYaw": 0,
    }


def test_angles_need_other_modes_and_thrust_is_cut_to_what_there_is() -> None:
    handler = RadioHandlerFRPY(CRAZYFLIE_21, NEWTON)
    assert handler.parameters["flightmode.stabModeRoll"] == 1
    assert handler.parameters["flightmode.stabModeYaw"] == 0
    assert (
        struct.unpack("<fffH", handler.packets(FRPY(np.array([9.0, 0, 0, 0])))[0].data)[
            3
        ]
        == 65535
    )
    assert (
        struct.unpack(
            "<fffH", handler.packets(FRPY(np.array([-1.0, 0, 0, 0])))[0].data
        )[3]
        == 0
    )


def test_velocities() -> None:
    (packet,) = RadioHandlerVel(CRAZYFLIE_21).packets(
        Vel(np.array([0.1, -0.2, 0.3, math.pi]))
    )
    assert (packet.port, packet.channel, packet.data[0]) == (7, 0, 8)
    assert np.allclose(struct.unpack("<ffff", packet.data[1:]), [0.1, -0.2, 0.3, 180.0])


def test_plans() -> None:
    handler = RadioHandlerXYZ(CRAZYFLIE_21)
    line, relax = handler.packets(XYZ("line", np.array([1.0, 2.0, 3.0, 0.5, 0.2])))
    assert (relax.port, relax.channel) == (7, 1), (
        "it ends the set-points of an earlier program"
    )
    assert (line.port, line.channel, line.data[:4]) == (8, 0, bytes([12, 0, 0, 1]))
    assert np.allclose(
        struct.unpack("<fffff", line.data[4:]), [1.0, 2.0, 3.0, 0.5, 0.2]
    )
    (land,) = handler.packets(XYZ("land", np.array([0.0, 0.0, 0.04, 1.0, 2.0])))
    assert struct.unpack("<BBff?f", land.data) == (
        8,
        0,
        np.float32(0.04),
        1.0,
        False,
        2.0,
    )
    assert handler.packets(STOP)[0].data == bytes([3, 0])


def test_a_plan_after_set_points_tells_then_that_they_have_ended() -> None:
    handler = RadioHandlerFPQR(CRAZYFLIE_21, NEWTON)
    handler.packets(FPQR(np.zeros(4)))
    (land,) = handler.planned(XYZ("land", np.array([0.0, 0.0, 0.0, 0.0, 2.0])))
    assert (land.port, land.data[0]) == (8, 8), (
        "it flies: no word but this before its answer"
    )
    assert [(relax.port, relax.channel) for relax in handler.relax] == [(7, 1)]
    for _ in range(2):
        stop, planner, relax = handler.planned(STOP)
        assert (
            (stop.port, stop.data),
            (planner.port, planner.data[0]),
            (relax.port, relax.channel),
        ) == ((7, b"\x00"), (8, 3), (7, 1))
    assert (
        len(handler.planned(XYZ("take_off", np.array([0.0, 0.0, 1.0, 0.0, 2.0])))) == 2
    )
    assert len(handler.planned(STOP)) == 1, "nothing was streamed since"


@pytest.mark.parametrize("kind", RADIO_HANDLERS)
def test_an_owner_does_not_know_whether_one_before_it_has_sent_set_points(
    kind: str,
) -> None:
    assert len(RADIO_HANDLERS[kind](CRAZYFLIE_21, NEWTON).relax) == 1


@pytest.mark.parametrize("verb", ["land", "take_off"])
def test_plans_of_no_time_are_refused(verb: str) -> None:
    with pytest.raises(CodecError, match=f"no plan '{verb}' of 0 s"):
        RadioHandlerXYZ(CRAZYFLIE_21).packets(XYZ(verb, np.zeros(5)))


def test_full_states_are_thousandths_with_rates_in_radians() -> None:
    handler = RadioHandlerFullState(CRAZYFLIE_21)
    reference = FullState.at(
        (1.0, -2.0, 0.5), (0.1, 0, 0), (0, 0, 0), yaw=0.0, yaw_rate=0.7
    )
    (packet,) = handler.packets(reference)
    values = struct.unpack("<hhhhhhhhhIhhh", packet.data[1:])
    assert (packet.data[0], values[:4]) == (6, (1000, -2000, 500, 100))
    assert values[10:] == (0, 0, 700)
    assert values[9] >> 30 == 3, "level: w is the largest"
    with pytest.raises(CodecError, match=r"full state \[99.0, .* 32.767 m"):
        handler.packets(FullState.at((99.0, 0, 0)))


@pytest.mark.parametrize("kind", ["fpqr", "frpy", "vel", "xyz", "fullstate"])
def test_what_is_no_number_never_leaves(kind: str) -> None:
    broken = {
        "fpqr": FPQR,
        "frpy": FRPY,
        "vel": Vel,
        "fullstate": lambda flat: FullState(np.append(flat, [0.0] * 10)),
    }
    broken.setdefault("xyz", lambda flat: XYZ("line", np.append(flat, 1.0)))
    with pytest.raises(CodecError, match="finite numbers"):
        RADIO_HANDLERS[kind](CRAZYFLIE_21, NEWTON).packets(
            broken[kind](np.array([np.nan, 0.0, 0.0, 0.0]))
        )


def test_poses_and_the_emergency_stop() -> None:
    packet = pose_packet(Pose(np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])))
    assert (packet.port, packet.channel, packet.data[0], len(packet.data)) == (
        6,
        1,
        8,
        29,
    )
    assert [tuple(packet) for packet in emergency_packets()] == [
        (6, 1, b"\x03"),
        (9, 1, b"\x03"),
    ]


def test_what_asks_for_motors_that_are_off() -> None:
    assert is_idle_command(STOP)
    assert is_idle_command(FPQR(np.zeros(4)))
    assert not is_idle_command(Vel(np.zeros(4))), "to hover is to fly"
    assert not is_idle_command(FPQR(np.array([0.1, 0, 0, 0])))


@pytest.mark.parametrize(
    ("release", "given", "value"),
    [
        ("2025.12", None, 136531.25),
        ("2026.8.1 +3", None, 136531.25),
        ("2025.02", None, 42000 / 0.39),
        ("2023.11", None, 42000 / 0.39),
        ("virtual", 120000.0, 120000.0),
    ],
)
def test_thrust_by_release(release: str, given: float | None, value: float) -> None:
    assert thrust_command_per_newton(
        release, CRAZYFLIE_21, given, "drone 3"
    ) == pytest.approx(value)


def test_thrust_by_platform() -> None:
    newest = {
        name: round(thrust_command_per_newton("2025.12", row, None, ""))
        for name, row in PLATFORM_BY_NAME.items()
    }
    assert newest == {
        "paper": 136531,
        "cf21": 136531,
        "cf21plus": 136531,
        "cf21thrust": 91021,
        "cf21bl": 81919,
    }


@pytest.mark.parametrize("name", ["cf21plus", "cf21thrust", "cf21bl"])
def test_an_unmeasured_thrust_needs_newer_firmware_or_a_thrust_map(name: str) -> None:
    row = PLATFORM_BY_NAME[name]
    with pytest.raises(
        ConfigError,
        match=f"found 2023.11; allowed: 2025.10 or newer, .* {name} is known.* set thrust_map",
    ):
        thrust_command_per_newton("2023.11", row, None, "drone 3")
    assert thrust_command_per_newton("2023.11", row, 9e4, "drone 3") == 9e4


@pytest.mark.parametrize(
    "release", ["2025.09", "2025.9", "2025.09 +41", "2025.02 +300", "2023.11.1 +2"]
)
def test_a_build_that_may_be_linear_already_has_no_thrust(release: str) -> None:
    with pytest.raises(
        ConfigError,
        match=r"newer, or a release until 2025.02, .* of this one it is 136531 since",
    ):
        thrust_command_per_newton(release, CRAZYFLIE_21, None, "drone 3")


@pytest.mark.parametrize("release", ["", "master", "1.0", "2025.13", "20255.1"])
def test_an_unknown_release_has_no_thrust(release: str) -> None:
    with pytest.raises(ConfigError, match=r"drone 3: firmware: .* set thrust_map"):
        thrust_command_per_newton(release, CRAZYFLIE_21, None, "drone 3")
