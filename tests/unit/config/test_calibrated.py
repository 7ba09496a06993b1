"""A calibration gives a drone its true body, and its controller what it knows of it."""

import msgspec
import numpy as np
import pytest

from crazychoir.config.calibrated import (
    build_body,
    compute_least_voltage,
    find_controlled_platform,
    find_known_platform,
    find_thrust_factor,
)
from crazychoir.config.reader import read_table
from crazychoir.config.tables import CalibrationTable, DroneTable, MotorsTable
from crazychoir.errors import ConfigError
from crazychoir.platforms import CRAZYFLIE_21


def make_drone(**keys):
    found = read_table(keys, CalibrationTable, "swarm.toml")
    return DroneTable(id=0, home=(0.0, 0.0, 0.0), platform="cf21", calibration=found)


def test_a_drone_without_a_calibration_is_its_platform():
    drone = make_drone()
    assert build_body(drone) == CRAZYFLIE_21
    assert find_known_platform(drone) == CRAZYFLIE_21
    assert find_thrust_factor(drone) == 1.0


def test_the_body_has_what_was_found_and_the_platform_what_was_not():
    drone = make_drone(
        rotor_lag=0.05,
        rotor_delay=0.01,
        speed_moment=[5e-4, 6e-4],
        motor_factors=[1.02, 0.98, 1.01, 0.99],
        battery_capacity=500.0,
    )
    body = build_body(drone)
    assert body.rotor.lag == 0.05
    assert body.effects.delay == 0.01
    assert body.effects.speed_moment == (5e-4, 6e-4)
    assert body.effects.motor_factors == (1.02, 0.98, 1.01, 0.99)
    assert body.effects.rate_damping is None
    assert body.battery.capacity == 500.0
    assert body.battery.resistance == CRAZYFLIE_21.battery.resistance
    assert body.drag == CRAZYFLIE_21.drag


def test_the_controller_commands_the_thrust_that_makes_the_true_one():
    """m v' = -m g + k u: with u = m/k (g + a), v' = a."""
    k = 0.8
    known = find_known_platform(make_drone(thrust_factor=k, drag=[0.01, 0.02, 0.03]))
    assert k * known.weight == pytest.approx(CRAZYFLIE_21.weight)
    np.testing.assert_allclose(np.array(known.drag) * k, [0.01, 0.02, 0.03])


def test_a_worn_battery_raises_the_voltage_of_take_off():
    fresh = find_known_platform(make_drone(battery_resistance=0.05))
    worn = find_known_platform(make_drone(battery_resistance=0.25, thrust_factor=0.75))
    assert fresh.battery.begin == CRAZYFLIE_21.battery.begin
    assert worn.battery.begin > CRAZYFLIE_21.battery.begin
    assert worn.battery.begin == pytest.approx(compute_least_voltage(worn))
    assert worn.battery.begin < CRAZYFLIE_21.battery.full


@pytest.mark.parametrize(
    "keys",
    [{"battery_resistance": 0.35, "thrust_factor": 0.75}, {"thrust_factor": 0.3}],
)
def test_a_drone_that_could_not_take_off_with_a_full_battery_is_refused(keys):
    with pytest.raises(ConfigError, match=r"drone 0: calibration.*at most 4.15 V"):
        find_known_platform(make_drone(**keys))


def test_the_controller_takes_two_lags_for_one_of_their_sum():
    known = find_known_platform(make_drone(rotor_lag=0.06, rotor_delay=0.012))
    assert known.rotor.lag == pytest.approx(0.072)


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        ({"thrust_factor": 5.0}, "thrust_factor"),
        ({"motor_factors": [1.0, 1.0, 1.0]}, "motor_factors"),
        ({"lag": 0.05}, "there is no such key"),
    ],
)
def test_wrong_keys_and_values_are_refused(keys, found):
    with pytest.raises(ConfigError, match=found):
        make_drone(**keys)


def test_a_thrust_factor_weakens_the_torques_about_roll_and_pitch_too():
    """J w' = k l S u + M v - D w: with J/k, M/k and D/k it turns by u alone; rotors turn as fast, so yaw stays."""
    k = 0.8
    damping = [5e-5, 6e-5, 7e-5]
    known = find_known_platform(
        make_drone(thrust_factor=k, speed_moment=[5e-4, 6e-4], rate_damping=damping)
    )
    jx, jy, jz = CRAZYFLIE_21.inertia
    np.testing.assert_allclose(known.inertia, (jx / k, jy / k, jz))
    np.testing.assert_allclose(known.effects.speed_moment, (5e-4 / k, 6e-4 / k))
    np.testing.assert_allclose(known.effects.rate_damping, (5e-5 / k, 6e-5 / k, 7e-5))


@pytest.mark.parametrize(
    ("uri", "motors", "moment"),
    [
        ("sim://motors", {}, 34.0),
        ("sim://motors", {"imperfections": 0.5, "speed_moment": 20.0}, 10.0),
        ("sim://motors", {"imperfections": 0.0}, 0.0),
        ("mujoco://", {"speed_moment": 0.0}, 0.0),
        ("radio://0/80/2M/E7E7E7E703", {}, 34.0),
        ("sim://", {}, None),
        ("marbles://", {}, None),
    ],
)
def test_controllers_are_made_for_the_moment_of_a_typical_drone(uri, motors, moment):
    drone = msgspec.structs.replace(make_drone(thrust_factor=0.9), uri=uri)
    platform = find_controlled_platform(drone, MotorsTable(**motors))
    about_x, about_y = platform.effects.speed_moment or (None, None)
    if moment is None:
        assert (about_x, about_y) == (None, None)
        return
    x, y, _ = platform.inertia
    assert (about_x / x, about_y / y) == pytest.approx((moment, moment))


def test_controllers_are_made_for_the_moment_that_was_found():
    drone = msgspec.structs.replace(
        make_drone(speed_moment=[5e-4, 6e-4]), uri="sim://motors"
    )
    platform = find_controlled_platform(drone, MotorsTable())
    assert platform.effects.speed_moment == (5e-4, 6e-4)


def test_a_calibrated_battery_is_not_worn_twice():
    drone = make_drone(battery_resistance=0.2)
    worn = build_body(drone, has_worn_battery=True).battery
    assert worn.resistance == 0.2
    assert worn.capacity == CRAZYFLIE_21.battery.worn.capacity
    assert worn.hover_power == CRAZYFLIE_21.battery.worn.hover_power
    assert build_body(drone).battery.capacity == CRAZYFLIE_21.battery.capacity
