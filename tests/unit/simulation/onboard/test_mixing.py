"""Power distribution: tables by hand, the cap, the thrust map and the battery."""

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
def distribute(rows, allowed):
    mixing.distribute(rows[0], allowed != 0)
    mixing.compensate(rows[0])


def request(platform=CRAZYFLIE_21, allowed=1, **values):
    rows = make_fleet(1, platform)
    for name, value in values.items():
        rows[name] = value
    distribute(rows, allowed)
    return rows[0]["request"].tolist()


def shares(times=1, platform=CRAZYFLIE_21, **values):
    rows = make_fleet(1, platform)
    for name, value in values.items():
        rows[name] = value
    for _ in range(times):
        distribute(rows, 1)
    return rows[0]["motors"]


@pytest.mark.parametrize(
    ("command", "motors"),
    [
        (dict(thrust=30000), [30000] * 4),
        (dict(thrust=30000, roll_out=2001), [29000, 29000, 31000, 31000]),
        (dict(thrust=30000, roll_out=-2001), [31000, 31000, 29000, 29000]),
        (dict(thrust=30000, pitch_out=2001), [31000, 29000, 29000, 31000]),
        (dict(thrust=30000, yaw_out=700), [30700, 29300, 30700, 29300]),
        (dict(thrust=500, yaw_out=700), [1200, 0, 1200, 0]),
    ],
)
def test_legacy_table(command, motors):
    assert request(output=OUTPUT_KINDS.legacy, **command) == motors


def test_the_cap_takes_the_excess_from_all():
    assert request(output=OUTPUT_KINDS.legacy, thrust=60000, roll_out=20000) == [
        45535,
        45535,
        65535,
        65535,
    ]


def test_idle_is_the_floor_and_nothing_turns_where_motors_are_not_allowed():
    assert request(output=OUTPUT_KINDS.legacy, thrust=0, idle=3000) == [3000] * 4
    assert (
        request(output=OUTPUT_KINDS.legacy, thrust=40000, idle=3000, allowed=0)
        == [0] * 4
    )


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
    assert [f.sum(), *torque] == pytest.approx(want, rel=1e-9)


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
    assert shares(output=OUTPUT_KINDS.legacy, thrust=32767.5) == pytest.approx(
        [0.5] * 4
    )


def test_below_the_least_thrust_a_motor_stops():
    least = 0.0128 / 0.12 * 65535
    assert np.all(shares(output=OUTPUT_KINDS.legacy, thrust=least + 1) > 0.1)
    assert np.all(shares(output=OUTPUT_KINDS.legacy, thrust=least - 1) == 0.0)


def curve(platform, v):
    return np.polyval(platform.rotor.voltage[::-1], v)


@pytest.mark.parametrize(
    "platform", PLATFORM_BY_NAME.values(), ids=lambda row: row.name
)
def test_a_battery_off_its_low_pass_gives_what_the_curve_says(platform):
    f = 0.6 * platform.firmware.thrust_max
    v = np.roots([*platform.rotor.voltage[:0:-1], platform.rotor.voltage[0] - f])
    v = float(v[np.isreal(v)].real[0])
    got = shares(
        8,
        platform,
        output=OUTPUT_KINDS.legacy,
        thrust=0.6 * 65535,
        vbat=3.7,
        vbat_low=3.9,
    )
    assert got == pytest.approx(
        [curve(platform, v * 3.7 / 3.9) / platform.firmware.thrust_max] * 4, rel=1e-9
    )


def test_a_dead_battery_gives_nothing():
    assert np.all(
        shares(output=OUTPUT_KINDS.legacy, thrust=65535, vbat=0.0, vbat_low=0.1) == 0.0
    )


def test_an_empty_battery_limits_the_thrust():
    got = shares(output=OUTPUT_KINDS.legacy, thrust=65535, vbat=2.8, vbat_low=2.8)
    assert got == pytest.approx([curve(CRAZYFLIE_21, 2.8) / 0.12] * 4)
    assert got[0] < 0.9
