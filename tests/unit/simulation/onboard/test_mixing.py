"""Power distribution: tables by hand, the battery's compensation, the cap and the thrust map."""

import numba
import numpy as np
import pytest

from crazychoir.numerics.kernels import kernel
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS, PLATFORM_BY_NAME
from crazychoir.simulation.onboard import mixing
from crazychoir.simulation.onboard.record import OUTPUT_KINDS, make_fleet
from crazychoir.simulation.onboard.units import (
    convert_thrust_to_newtons,
    convert_thrust_to_raw,
)


@kernel(numba.from_dtype(make_fleet(1, CRAZYFLIE_21).dtype)[::1], numba.int64)
def drive(rows, allowed):
    mixing.drive_motors(rows[0], allowed != 0)
    mixing.compute_shares(rows[0])


def driven(platform=CRAZYFLIE_21, allowed=1, **values):
    rows = make_fleet(1, platform)
    for name, value in values.items():
        rows[name] = value
    drive(rows, allowed)
    return rows[0]


def request(platform=CRAZYFLIE_21, **values):
    return driven(platform, **values)["request"].tolist()


def ratios(**values):
    return driven(**values)["ratio"].tolist()


def shares(platform=CRAZYFLIE_21, **values):
    return driven(platform, **values)["motors"]


def volts(platform, f):
    """The voltage at which a motor gives f N."""
    c0, c1, c2, c3 = platform.rotor.voltage
    v = np.roots([c3, c2, c1, c0 - f])
    return float(v[np.isreal(v)].real[0])


@pytest.mark.parametrize(
    ("command", "motors"),
    [
        (dict(thrust=30000), [30000] * 4),
        (dict(thrust=30000, roll_out=2001), [29000, 29000, 31000, 31000]),
        (dict(thrust=30000, roll_out=-2001), [31000, 31000, 29000, 29000]),
        (dict(thrust=30000, pitch_out=2001), [31000, 29000, 29000, 31000]),
        (dict(thrust=30000, yaw_out=700), [30700, 29300, 30700, 29300]),
        (dict(thrust=500.7, yaw_out=700), [1200, -199, 1200, -199]),
        (dict(thrust=60000, roll_out=20000), [50000, 50000, 70000, 70000]),
    ],
)
def test_legacy_table(command, motors):
    assert request(output=OUTPUT_KINDS.legacy, **command) == motors


def test_a_full_request_is_far_from_full_pwm_at_a_full_battery():
    row = driven(output=OUTPUT_KINDS.legacy, thrust=65535, vbat=4.18, vbat_low=4.18)
    assert row["ratio"] == pytest.approx([65535 * 2.9836 / 4.18] * 4, abs=10)
    assert row["motors"] == pytest.approx([1.0] * 4, rel=1e-4)


@pytest.mark.parametrize("vbat", [4.18, 3.3])
def test_the_cap_takes_the_excess_over_full_pwm_from_all_motors(vbat):
    row = driven(
        output=OUTPUT_KINDS.legacy,
        thrust=70000,
        roll_out=60000,
        pitch_out=30000,
        vbat=vbat,
        vbat_low=vbat,
    )
    assert row["request"].tolist() == [55000, 25000, 85000, 115000]
    wanted = [
        65535 * volts(CRAZYFLIE_21, r / 65535 * 0.12) / vbat for r in row["request"]
    ]
    assert row["uncapped_ratio"] == pytest.approx(wanted, abs=1)
    excess = max(0.0, wanted[3] - 65535)
    assert (excess > 0) == (vbat == 3.3)
    assert row["ratio"] == pytest.approx(np.array(wanted) - excess, abs=1)
    given = [curve(CRAZYFLIE_21, r / 65535 * vbat) / 0.12 for r in row["ratio"]]
    assert row["motors"] == pytest.approx(given, rel=1e-9)


def test_idle_is_the_floor_and_nothing_turns_where_motors_are_not_allowed():
    assert ratios(output=OUTPUT_KINDS.legacy, thrust=0, idle=3000) == [3000] * 4
    assert (
        ratios(output=OUTPUT_KINDS.legacy, thrust=40000, idle=3000, allowed=0)
        == [0] * 4
    )


def test_the_power_of_the_parameters_is_the_pwm_of_the_motors():
    command = dict(output=OUTPUT_KINDS.legacy, thrust=40000, power_1=20000, power_3=9)
    assert ratios(power_set=1, **command) == [20000, 0, 9, 0]
    assert ratios(power_set=2, **command, allowed=0) == [20000] * 4


@pytest.mark.parametrize("platform", [CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS])
def test_force_and_torque_are_what_the_motors_make(platform):
    firmware = platform.firmware
    want = np.array([0.4 * platform.max_thrust, 4e-4, -3e-4, 2e-4])
    f = np.array(
        request(
            platform,
            output=OUTPUT_KINDS.force_torque,
            force=want[0],
            torque_x=want[1],
            torque_y=want[2],
            torque_z=want[3],
        )
    )
    f *= firmware.thrust_max / 65535
    a, k = firmware.arm * np.sqrt(0.5), firmware.thrust_to_torque
    torque = [
        a * (-f[0] - f[1] + f[2] + f[3]),
        a * (-f[0] + f[1] + f[2] - f[3]),
        k * (-f[0] + f[1] - f[2] + f[3]),
    ]
    unit = firmware.thrust_max / 65535  # requests are integers
    assert [f.sum(), *torque] == pytest.approx(want, abs=4 * unit)
    assert torque == pytest.approx(want[1:], abs=4 * unit * a)


def test_the_map_is_linear_in_newtons():
    assert convert_thrust_to_raw(1.0, CRAZYFLIE_21.firmware) == pytest.approx(
        136531, abs=1
    )
    assert convert_thrust_to_raw(1.0, CRAZYFLIE_21_BRUSHLESS.firmware) == pytest.approx(
        81919, abs=1
    )
    assert convert_thrust_to_newtons(
        convert_thrust_to_raw(0.3, CRAZYFLIE_21.firmware), CRAZYFLIE_21.firmware
    ) == pytest.approx(0.3)
    assert shares(output=OUTPUT_KINDS.legacy, thrust=32768) == pytest.approx(
        [0.5] * 4, rel=1e-4
    )


def test_below_the_least_thrust_a_motor_stops():
    least = 0.0128 / 0.12 * 65535
    assert np.all(shares(output=OUTPUT_KINDS.legacy, thrust=least + 1) > 0.1)
    assert np.all(shares(output=OUTPUT_KINDS.legacy, thrust=least - 1) == 0.0)


@pytest.mark.parametrize(
    "platform", PLATFORM_BY_NAME.values(), ids=lambda row: row.name
)
def test_motors_stand_without_pwm(platform):
    assert np.all(shares(platform, output=OUTPUT_KINDS.legacy, thrust=0.0) == 0.0)


def curve(platform, v):
    return np.polyval(platform.rotor.voltage[::-1], v)


@pytest.mark.parametrize(
    "platform", PLATFORM_BY_NAME.values(), ids=lambda row: row.name
)
def test_a_battery_off_its_low_pass_gives_what_the_curve_says(platform):
    got = shares(
        platform, output=OUTPUT_KINDS.legacy, thrust=39321, vbat=3.7, vbat_low=3.9
    )
    v = volts(platform, 0.6 * platform.firmware.thrust_max)
    assert got == pytest.approx(
        [curve(platform, v * 3.7 / 3.9) / platform.firmware.thrust_max] * 4, rel=1e-4
    )


def test_a_dead_battery_gives_nothing():
    assert ratios(output=OUTPUT_KINDS.legacy, thrust=65535, vbat_low=1.99) == [0] * 4
    assert np.all(shares(output=OUTPUT_KINDS.legacy, thrust=65535, vbat=0.0) == 0.0)


def test_an_empty_battery_limits_the_thrust():
    got = shares(output=OUTPUT_KINDS.legacy, thrust=65535, vbat=2.8, vbat_low=2.8)
    assert got == pytest.approx([curve(CRAZYFLIE_21, 2.8) / 0.12] * 4)
    assert got[0] < 1.0
    got = shares(output=OUTPUT_KINDS.legacy, thrust=65535, vbat=2.6, vbat_low=2.6)
    assert got == pytest.approx([curve(CRAZYFLIE_21, 2.6) / 0.12] * 4)
    assert got[0] < 0.9


@pytest.mark.parametrize(
    "platform", PLATFORM_BY_NAME.values(), ids=lambda row: row.name
)
def test_the_voltage_is_found_in_one_pass_of_the_controller(platform):
    for r in (10_000, 65_535, 120_000):
        row = driven(platform, output=OUTPUT_KINDS.legacy, thrust=r)
        f = r / 65535 * platform.firmware.thrust_max
        least = platform.firmware.thrust_min
        wanted = volts(platform, f) if f >= least else volts(platform, least)
        assert row["volts"] == pytest.approx([wanted] * 4, abs=1e-6)
