import math
from dataclasses import replace

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY, rotation
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS, Battery
from crazychoir.simulation.common.world import World
from crazychoir.simulation.motor_level.air import Wind
from crazychoir.simulation.motor_level.imu import Imu
from crazychoir.simulation.motor_level.motors import MotorConditions, MotorWorld

P = CRAZYFLIE_21
HOVER = P.weight / P.max_thrust


def one(z=0.0, platform=P, dt=0.01, seed=0, **conditions):
    return MotorWorld(
        [7],
        np.array([[0.1, 0.2, z]]),
        np.array([0.5]),
        platform,
        dt,
        seed=seed,
        conditions=MotorConditions(**conditions),
    )


def run(world, ticks):
    for _ in range(ticks):
        world.step()
    return world.state(world.ids[0])


def fly(world, u, ticks):
    for i in world.ids:
        world.command(i, np.full(4, u))
    return run(world, ticks)


def test_it_is_a_world():
    world: World = one()
    assert world.ids == (7,)
    assert fly(world, 0.0, 5).p[2] == 0.0
    assert world.time == pytest.approx(0.05)


def test_a_drone_on_the_floor_rests_and_does_not_slip():
    world = one(has_ground_effect=False)
    before = world.state(7).flat
    np.testing.assert_array_equal(fly(world, 0.99 * HOVER, 100).flat, before)
    assert world.resting(7)
    np.testing.assert_allclose(
        world.accelerometer(7), [0, 0, STANDARD_GRAVITY], atol=0.4
    )


def test_lift_off_waits_for_the_rotors():
    world, u = one(has_ground_effect=False), 1.2 * HOVER
    for i in world.ids:
        world.command(i, np.full(4, u))
    ticks = 0
    while world.resting(7):
        world.step()
        ticks += 1
    assert ticks * world.dt == pytest.approx(P.rotor.lag * math.log(6.0), abs=0.011)
    assert run(world, 50).p[2] > 0.05


def test_near_the_floor_it_floats_on_less_than_its_weight():
    fly(on := one(), 0.97 * HOVER, 100)
    fly(off := one(has_ground_effect=False), 0.97 * HOVER, 100)
    assert not on.resting(7)
    assert 0.0 < on.states[0, 2] < 0.05
    assert off.resting(7)


def test_motors_turn_the_body_as_they_are_placed():
    for u, axis, sign in [
        ([0, 0, 1, 1], 0, 1),
        ([1, 1, 0, 0], 0, -1),
        ([0, 1, 1, 0], 1, 1),
        ([1, 0, 0, 1], 1, -1),
        ([0, 1, 0, 1], 2, 1),
        ([1, 0, 1, 0], 2, -1),
    ]:
        world = one(3.0)
        world.command(7, HOVER + 0.02 * np.array(u))
        w = run(world, 8).w
        assert sign * w[axis] > 0.05
        np.testing.assert_allclose(np.delete(w, axis), 0.0, atol=0.01)


def test_a_cut_drone_falls_does_not_bounce_and_is_recorded_as_crashed():
    world = one(1.0)
    world.cut(7)
    state = fly(world, 1.0, 150)
    assert state.p[2] == 0.0
    np.testing.assert_array_equal(state.v, 0.0)
    assert 2.0 < world.impact[0] < math.sqrt(2 * STANDARD_GRAVITY)
    assert world.crashed == [7]
    assert world.resting(7)


def test_a_soft_landing_is_no_crash_and_keeps_the_heading():
    world = one(0.03, has_ground_effect=False)
    world.command(7, 0.95 * HOVER + np.array([-0.001, -0.001, 0.001, 0.001]))
    state = run(world, 300)
    assert world.crashed == []
    assert world.resting(7)
    np.testing.assert_allclose(
        state.q, [0, 0, math.sin(0.25), math.cos(0.25)], atol=0.01
    )
    np.testing.assert_allclose(rotation(state.q)[:, 2], [0, 0, 1], atol=1e-6)


def test_on_its_back_it_stays_there():
    world = one(0.05)
    world.states[0, 6:10] = [math.cos(0.1), 0.0, 0.0, math.sin(0.1)]
    state = fly(world, 1.0, 300)
    assert state.p[2] == 0.0
    np.testing.assert_allclose(rotation(state.q)[:, 2], [0, 0, -1], atol=1e-6)
    np.testing.assert_allclose(state.w, 0.0, atol=1e-6)


def test_from_a_tilted_floor_it_starts_tilted_and_drifts_downhill():
    tilt = math.radians(3.0)
    world = one(floor_normal=(math.sin(tilt), 0.0, math.cos(tilt)), imu=Imu(0, 0, 0, 0))
    state = fly(world, 0.0, 20)
    assert world.resting(7)
    np.testing.assert_allclose(
        rotation(state.q)[:, 2], [math.sin(tilt), 0, math.cos(tilt)], atol=1e-12
    )
    np.testing.assert_allclose(state.p, [0.1, 0.2, 0.0], atol=0)
    np.testing.assert_allclose(
        world.accelerometer(7), STANDARD_GRAVITY * rotation(state.q)[2], atol=1e-9
    )
    state = fly(world, 1.2 * HOVER, 60)
    assert state.p[2] > 0.1
    assert state.p[0] > 0.103
    assert abs(state.p[1] - 0.2) < 1e-6
    state = fly(world, 0.9 * HOVER, 300)
    assert world.resting(7)
    np.testing.assert_allclose(
        rotation(state.q)[:, 2], [math.sin(tilt), 0, math.cos(tilt)], atol=1e-6
    )


@pytest.mark.parametrize("normal", [(0, 0, -1), (1, 0, 0), (0, 0, 0), (math.nan, 0, 1)])
def test_a_floor_that_nothing_could_stand_on_is_refused(normal):
    with pytest.raises(ConfigError, match="floor_normal"):
        one(floor_normal=normal)


def test_commands_beyond_the_motors_are_limited_and_counted_and_what_is_no_number_is_ignored():
    world = one(1.0)
    fly(world, 1.5, 3)
    assert world.limited[0] == 3
    same = one(1.0)
    fly(same, 1.0, 3)
    np.testing.assert_array_equal(world.states, same.states)
    fly(world, math.nan, 2)
    fly(same, 1.0, 2)
    np.testing.assert_array_equal(world.states, same.states)
    assert world.limited[0] == 5
    assert same.limited[0] == 0


def test_below_the_least_thrust_a_motor_stops():
    u = 0.99 * P.firmware.thrust_min / P.firmware.thrust_max
    falls, cut = one(5.0), one(5.0)
    cut.cut(7)
    np.testing.assert_array_equal(fly(falls, u, 30).flat, fly(cut, u, 30).flat)


def test_two_runs_are_the_same_and_another_seed_is_not():
    def sensed(seed):
        world = one(1.0, seed=seed, wind=Wind((1.0, 0, 0), 0.5))
        state = fly(world, HOVER, 50)
        return [*state.flat, *world.gyro(7), *world.accelerometer(7), *world.wind(7)]

    assert sensed(3) == sensed(3)
    assert not set(sensed(3)[-6:]) & set(sensed(4)[-6:])


def test_every_drone_flies_as_if_alone():
    rng, ids = np.random.default_rng(1), [4, 9, 2, 11, 30, 31, 5, 6, 77, 12, 13]
    n = len(ids)
    p0, u = rng.uniform(0.0, 3.0, (n, 3)), rng.uniform(0.5, 0.8, (n, 4))
    p0[::3, 2] = 0.0
    platforms = [P if i % 2 else CRAZYFLIE_21_BRUSHLESS for i in ids]
    options = {
        "conditions": MotorConditions(
            wind=Wind((0.5, 0.2, 0.0), 0.3), has_downwash=False
        ),
        "seed": 5,
    }
    together = MotorWorld(ids, p0, platform=platforms, **options)
    for i, row in together.row.items():
        together.command(i, u[row])
    for _ in range(30):
        together.step()
    for i, row in together.row.items():
        alone = MotorWorld([i], p0[row : row + 1], platform=platforms[row], **options)
        alone.command(i, u[row])
        for _ in range(30):
            alone.step()
        np.testing.assert_array_equal(alone.states[0], together.states[row])
        np.testing.assert_array_equal(alone.gyro(i), together.gyro(i))
        assert alone.vbat(i) == together.vbat(i)


def test_a_drone_below_another_is_pushed_down():
    p0 = np.array([[0.0, 0.0, 1.0], [0.05, 0.0, 1.4], [3.0, 0.0, 1.0]])
    world = MotorWorld([0, 1, 2], p0)
    for _ in range(30):
        world.step()
    assert 0.03 < world.below(0) < 0.06  # about 6 g at 0.4 m, and they part
    assert world.below(1) == world.below(2) == 0.0
    assert world.states[0, 2] < 0.97
    assert world.states[2, 2] == pytest.approx(1.0, abs=1e-3)


def test_wind_carries_a_drone_away():
    state = fly(one(5.0, wind=Wind((2.0, -1.0, 0.0))), HOVER, 100)
    expected = 2.0 * (1.0 - math.exp(-P.drag[0] / P.mass))
    assert state.v[0] == pytest.approx(expected, rel=1e-3)
    assert state.v[1] == pytest.approx(-0.5 * expected, rel=1e-3)


def test_forces_from_outside_push():
    world = one(5.0, has_ground_effect=False)
    world.force[0] = [0.01, 0.0, -0.02]
    world.torque[0] = [0.0, 0.0, 1e-5]
    state = fly(world, HOVER, 10)
    np.testing.assert_allclose(
        state.v, [0.1 * 0.01 / P.mass, 0.0, -0.1 * 0.02 / P.mass], rtol=0.03, atol=1e-6
    )
    assert state.w[2] == pytest.approx(0.1 * 1e-5 / P.inertia[2], rel=1e-3)


def test_the_battery_sags_under_load_and_takes_the_top_thrust_with_it():
    idle, loaded = one(), one(50.0)
    fly(idle, 0.0, 100)
    fly(loaded, HOVER, 100)
    current = P.battery.hover_power / loaded.vbat(7) + P.battery.idle
    assert idle.vbat(7) == pytest.approx(
        P.battery.full - P.battery.resistance * P.battery.idle, abs=2e-3
    )
    assert idle.vbat(7) - loaded.vbat(7) == pytest.approx(
        P.battery.resistance * (current - P.battery.idle), abs=5e-3
    )
    assert 1.0 - loaded.charge(7) == pytest.approx(
        current / P.battery.capacity, rel=0.01
    )
    weak = replace(P, battery=Battery(resistance=0.3))
    full, low = one(50.0, platform=weak), one(50.0, platform=weak, charge=0.05)
    assert fly(low, 1.0, 100).v[2] < fly(full, 1.0, 100).v[2] - 0.5


def test_an_empty_battery_stops_the_motors():
    world = one(200.0, charge=1e-4)
    state = fly(world, HOVER, 200)
    assert world.vbat(7) == 0.0
    assert state.v[2] < -5.0


def test_the_sensors_err_as_their_data_sheet_says():
    world = one()
    seen = []
    for _ in range(400):
        world.step()
        seen.append([*world.gyro(7), *world.accelerometer(7)])
    noise, bias = (
        np.std(seen, axis=0),
        np.mean(seen, axis=0) - [0, 0, 0, 0, 0, STANDARD_GRAVITY],
    )
    np.testing.assert_allclose(
        noise[:3], math.radians(0.014) * math.sqrt(500), rtol=0.15
    )
    np.testing.assert_allclose(
        noise[3:], 190e-6 * STANDARD_GRAVITY * math.sqrt(500), rtol=0.15
    )
    assert np.all(np.abs(bias[:3]) < math.radians(0.075) + 4 * noise[:3] / 20)
    assert np.all(np.abs(bias[3:]) < 0.020 * STANDARD_GRAVITY + 4 * noise[3:] / 20)
    assert len(set(np.round(bias, 6))) == 6


def test_a_step_is_a_multiple_of_the_firmwares_tick():
    with pytest.raises(ConfigError, match=r"0\.001"):
        one(dt=0.0015)


def test_each_drone_has_a_platform():
    with pytest.raises(ConfigError, match="one platform, or 1"):
        MotorWorld([1], np.zeros((1, 3)), platform=[P, P])


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_drone_is_put_back_where_it_began_and_no_other_notices(wrong):
    places = np.array([[0.5 * i, 0.0, 1.0 - 0.125 * i] for i in range(9)])
    began, alone, mended = (
        MotorWorld(range(9), places, conditions=MotorConditions(has_downwash=False))
        for _ in range(3)
    )
    for world in (alone, mended):
        fly(world, 0.6, 20)
    mended.states[3, 5] = wrong
    mended.step()
    alone.step()
    assert not np.all(np.isfinite(mended.states[3]))
    mended.restore(3)
    assert np.array_equal(mended.states[3], began.states[3])
    assert (mended.vbat(3), mended.resting(3), mended.harm(3)) == (
        began.vbat(3),
        began.resting(3),
        "",
    )
    others = [i for i in range(9) if i != 3]
    run(alone, 10)
    run(mended, 10)
    assert np.array_equal(mended.states[others], alone.states[others])
    assert np.allclose(mended.commands[3], began.commands[3])
    assert mended.state(3).p[2] == pytest.approx(places[3, 2], abs=0.05), (
        "it hovers there"
    )
