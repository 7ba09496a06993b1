"""Which way it flies: signs and units of each set-point, by flying, at headings that hide nothing."""

import math

import numpy as np
import pytest
from virtual_drones import Hangar

from crazychoir.numerics.math3d import yaw_of
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.radio.protocol.compressed import pack_quaternion
from crazychoir.radio.virtual.setup import platform_of_release

HOVER = round(0.0319 * 9.81 * 136531)
QUARTER = math.pi / 2.0


def _yaw(hangar):
    return float(yaw_of(hangar.state[6:10]))


def _ahead(hangar, home):
    """m, by the body's heading: ahead, to the left."""
    d, yaw = hangar.state[:2] - home, _yaw(hangar)
    return np.array(
        [
            d[0] * math.cos(yaw) + d[1] * math.sin(yaw),
            d[1] * math.cos(yaw) - d[0] * math.sin(yaw),
        ]
    )


def _flown(name, *values, yaw=QUARTER, seconds=0.6):
    """Where it goes by a set-point, from hover at a heading: m ahead, m to the left, m up, rad of heading."""
    hangar = Hangar(yaw=yaw, height=0.0).hovering(0.8)
    if name == "rpyt":
        hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    home, before = hangar.state.copy(), _yaw(hangar)
    hangar.run(seconds, name, *values, every=0.02)
    ahead, left = (
        _ahead(hangar, home[:2])
        if abs(_yaw(hangar) - before) < 0.2
        else (math.nan, math.nan)
    )
    return (
        ahead,
        left,
        hangar.state[2] - home[2],
        math.remainder(_yaw(hangar) - before, 2.0 * math.pi),
    )


FULL_THRUST = round(1.05 * HOVER)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        (
            "rpyt",
            (0.0, -6.0, 0.0, FULL_THRUST),
        ),  # cflib writes -pitch: nose down is negative on the wire
        ("manual", (0.0, -6.0, 0.0, FULL_THRUST, 0)),
        ("z_distance", (0.0, -6.0, 0.0, 0.8)),
        ("z_distance_legacy", (0.0, -6.0, 0.0, 0.8)),
        ("altitude_hold", (0.0, -6.0, 0.0, 0.0)),
        ("hover", (0.4, 0.0, 0.0, 0.8)),
        ("hover_legacy", (0.4, 0.0, 0.0, 0.8)),
        ("velocity_world", (0.0, 0.4, 0.0, 0.0)),
        ("velocity_world_legacy", (0.0, 0.4, 0.0, 0.0)),
        ("position", (0.0, 0.4, 0.8, 90.0)),
        (
            "full_state",
            (
                0,
                400,
                800,
                0,
                0,
                0,
                0,
                0,
                0,
                pack_quaternion(np.array([0.0, 0.0, 0.5**0.5, 0.5**0.5])),
                0,
                0,
                0,
            ),
        ),
    ],
)
def test_ahead_at_a_heading_of_90_degrees_is_along_y(name, values):
    ahead, left, _, turned = _flown(name, *values)
    assert ahead > 0.05
    assert abs(left) < 0.4 * ahead
    assert abs(turned) < 0.1


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("rpyt", (-6.0, 0.0, 0.0, FULL_THRUST)),
        ("manual", (-6.0, 0.0, 0.0, FULL_THRUST, 0)),
        ("z_distance", (-6.0, 0.0, 0.0, 0.8)),
        ("altitude_hold", (-6.0, 0.0, 0.0, 0.0)),
        ("hover", (0.0, 0.4, 0.0, 0.8)),
        ("velocity_world", (-0.4, 0.0, 0.0, 0.0)),
        ("position", (-0.4, 0.0, 0.8, 90.0)),
    ],
)
def test_to_the_left_at_a_heading_of_90_degrees_is_against_x(name, values):
    ahead, left, _, _ = _flown(name, *values)
    assert left > 0.05
    assert abs(ahead) < 0.4 * left


@pytest.mark.parametrize(
    ("name", "values", "turns"),
    [
        (
            "rpyt",
            (0.0, 0.0, 60.0, HOVER),
            -1,
        ),  # turned around, in this packet and in the legacy ones
        ("velocity_world_legacy", (0.0, 0.0, 0.0, 60.0), -1),
        ("z_distance_legacy", (0.0, 0.0, 60.0, 0.8), -1),
        ("hover_legacy", (0.0, 0.0, 60.0, 0.8), -1),
        ("manual", (0.0, 0.0, 60.0, HOVER, 0), 1),
        ("altitude_hold", (0.0, 0.0, 60.0, 0.0), 1),
        ("z_distance", (0.0, 0.0, 60.0, 0.8), 1),
        ("hover", (0.0, 0.0, 60.0, 0.8), 1),
        ("velocity_world", (0.0, 0.0, 0.0, 60.0), 1),
    ],
)
def test_which_way_a_yaw_rate_turns(name, values, turns):
    *_, turned = _flown(name, *values, seconds=0.5)
    assert turns * turned == pytest.approx(math.radians(30.0), abs=math.radians(14.0))


def test_rates_are_in_deg_s_and_of_the_body_when_the_flight_mode_says_so():
    hangar = Hangar().hovering(1.5)
    for axis in ("Roll", "Pitch"):
        hangar.drone.parameters.set(f"flightmode.stabMode{axis}", 0.0)
    hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    hangar.run(0.2, "rpyt", 0.0, -40.0, 0.0, HOVER, every=0.01)
    assert hangar.state[11] == pytest.approx(
        math.radians(40.0), rel=0.3
    )  # about y: nose down
    assert hangar.log("stabilizer.pitch") < -3.0  # and the log has the nose up


def test_a_full_states_rates_are_in_milli_radians_a_second():
    hangar = Hangar().hovering()
    hangar.send(
        "full_state",
        0,
        0,
        500,
        0,
        0,
        0,
        0,
        0,
        0,
        pack_quaternion(np.array([0.0, 0.0, 0.0, 1.0])),
        0,
        0,
        1000,
    )
    assert float(hangar.onboard.record["wanted"]["yaw_rate"]) == pytest.approx(
        math.degrees(1.0)
    )


def test_altitude_hold_climbs_by_its_last_number():
    hangar = Hangar().hovering()
    hangar.run(2.0, "altitude_hold", 0.0, 0.0, 0.0, 0.4)
    assert hangar.state[5] == pytest.approx(
        0.35, abs=0.06
    )  # its integral takes its time


def test_thrust_is_locked_until_a_packet_without_thrust_comes():
    hangar = Hangar().run(0.5)
    hangar.run(0.5, "rpyt", 0.0, 0.0, 0.0, 50000)
    assert hangar.state[2] == 0.0
    hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    hangar.run(0.5, "rpyt", 0.0, 0.0, 0.0, 50000)
    assert hangar.state[2] > 0.05


def test_a_receivers_sticks_forward_and_right_fly_forward_and_right():
    from crazychoir.radio.protocol.crtp import CrtpPort, Packet

    hangar = Hangar(yaw=QUARTER).hovering(0.8)
    home = hangar.state[:2].copy()
    thrust = 1000 + round(1000 * FULL_THRUST / 65535)
    sticks = np.array([1440, 1440, 1500, thrust], "<u2").tobytes()
    for _ in range(30):
        list(hangar.drone.take(Packet(CrtpPort.SETPOINT, 0, b"\x03\x00" + sticks)))
        hangar.run(0.02)
    ahead, left = _ahead(hangar, home)
    assert (ahead, left) == (
        pytest.approx(-0.12, abs=0.08),
        pytest.approx(-0.12, abs=0.08),
    )


def test_packed_poses_are_for_the_number_that_they_name():
    from crazychoir.radio.protocol.crtp import CrtpPort, Packet

    hangar = Hangar(told=False, number=0xE9).run(0.1)
    level = pack_quaternion(np.array([0.0, 0.0, 0.0, 1.0])).to_bytes(4, "little")

    def item(number, x):
        return bytes([number]) + np.array([x, 0, 0], "<i2").tobytes() + level

    list(
        hangar.drone.take(
            Packet(
                CrtpPort.LOCALIZATION, 1, b"\x09" + item(0xE8, 5000) + item(0xE9, -250)
            )
        )
    )
    assert hangar.onboard.estimate.p[0] == pytest.approx(-0.25, abs=0.01)
    assert hangar.drone.flight.told.count == 1


def test_an_old_release_has_another_thrust_map():
    """42000 were 0.39 N; the same command is 21 % less force now."""
    old, new = (
        platform_of_release(CRAZYFLIE_21, release).firmware.thrust_max
        for release in ("2023.11", "2025.12")
    )
    assert old / new == pytest.approx(136531 / 107692, rel=1e-3)
    assert 4.0 * old * 42000 / 65535 == pytest.approx(0.39, rel=1e-3)
    assert (
        platform_of_release(CRAZYFLIE_21_BRUSHLESS, "2023.11") is CRAZYFLIE_21_BRUSHLESS
    )
    rising = []
    for release in ("2023.11", "2025.12"):
        hangar = Hangar(release=release).hovering()
        hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
        hangar.run(0.3, "rpyt", 0.0, 0.0, 0.0, HOVER, every=0.02)
        rising.append(hangar.state[5])
    assert rising[0] > rising[1] + 0.4


def test_a_take_off_to_another_heading_turns_the_drone_on_its_feet_and_rises():
    """Take-offs of cflib do this: their heading is 0 unless the caller gives another."""
    hangar = Hangar(yaw=1.6).run(2.0)
    hangar.send("take_off", 0, 0.4, 0.0, False, 0.8)
    hangar.run(6.0)
    assert hangar.state[2] == pytest.approx(0.4, abs=0.1)
    assert yaw_of(hangar.state[6:10]) == pytest.approx(0.0, abs=0.1)
    hangar.send("stop")
    hangar.run(2.0)
    assert hangar.state[2] == 0.0
    assert hangar.state[12] == pytest.approx(0.0, abs=1e-9)
