import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.simulation.common.world import World
from crazychoir.simulation.lightweight.integrator import CFIntegrator, InputLags

W = PAPER_PLATFORM.weight


def one(z=0.0, **options):
    return CFIntegrator([7], np.array([[0.1, 0.2, z]]), np.array([0.5]), **options)


def run(world, ticks):
    for _ in range(ticks):
        world.step()
    return world.state(7)


def test_it_is_a_world():
    world: World = one()
    assert world.ids == (7,)
    assert world.time == 0.0


def test_a_drone_on_the_floor_rests_and_does_not_slip():
    world = one()
    world.command(7, [0.99 * W, 3.0, -2.0, 1.0])
    before = world.state(7).flat
    np.testing.assert_array_equal(run(world, 100).flat, before)
    assert world.resting(7)


def test_it_takes_off_when_thrust_exceeds_weight():
    world = one()
    world.command(7, [1.2 * W, 0.0, 0.0, 0.0])
    assert run(world, 50).p[2] > 0.1
    assert not world.resting(7)


def test_a_drone_in_the_air_hovers_until_its_first_command():
    np.testing.assert_allclose(run(one(1.0), 100).p, [0.1, 0.2, 1.0], atol=1e-12)


def test_a_cut_drone_falls_does_not_sink_and_is_recorded_as_crashed():
    world = one(1.0)
    world.cut(7)
    world.command(7, [1.5 * W, 0.0, 0.0, 0.0])
    state = run(world, 100)
    assert state.p[2] == 0.0
    np.testing.assert_array_equal(state.v, 0.0)
    assert world.impact[0] == pytest.approx(np.sqrt(2 * 9.80665), rel=0.1)
    assert world.crashed == [7]


def test_a_soft_landing_is_no_crash_and_leaves_the_drone_level_with_its_heading():
    world = one(0.05)
    world.command(7, [0.95 * W, 0.3, 0.0, 0.0])
    state = run(world, 100)
    assert world.crashed == []
    np.testing.assert_allclose(
        state.q, [0.0, 0.0, np.sin(0.25), np.cos(0.25)], atol=0.02
    )
    assert state.q[0] == state.q[1] == 0.0


def test_on_its_back_it_cannot_take_off():
    world = one(0.05)
    world.states[0, 6:10] = [1.0, 0.0, 0.0, 0.0]
    world.command(7, [1.5 * W, 0.0, 0.0, 0.0])
    assert run(world, 200).p[2] == 0.0


def test_inputs_are_limited_and_counted():
    world = one(1.0)
    world.command(7, [2.0 * PAPER_PLATFORM.max_thrust, 99.0, 0.0, 0.0])
    state = run(world, 3)
    assert world.limited[0] == 3
    assert state.w[0] == PAPER_PLATFORM.max_rate[0]
    world.command(7, [PAPER_PLATFORM.max_thrust, -PAPER_PLATFORM.max_rate[0], 0.0, 0.0])
    run(world, 3)
    assert world.limited[0] == 3


def test_a_command_that_is_not_a_number_repeats_the_last():
    world = one(1.0)
    world.command(7, [W, 0.0, 0.0, 0.5])
    run(world, 2)
    world.command(7, [np.nan, 0.0, 0.0, 0.0])
    state = run(world, 2)
    assert state.w[2] == 0.5
    assert world.limited[0] == 2


@pytest.mark.parametrize(("delay", "ticks"), [(0.0, 1), (0.03, 4), (0.035, 4)])
def test_a_command_acts_after_its_delay(delay, ticks):
    world = one(1.0, lags=InputLags(delay=delay))
    world.command(7, [W, 1.0, 0.0, 0.0])
    run(world, ticks - 1)
    assert world.states[0, 6] == 0.0
    run(world, 1)
    assert world.states[0, 6] != 0.0


def test_the_rate_lag_is_of_first_order():
    world = one(1.0, lags=InputLags(rates=0.086))
    world.command(7, [W, 0.0, 0.0, 1.0])
    assert run(world, 10).w[2] == pytest.approx(1.0 - np.exp(-0.1 / 0.086), abs=1e-12)


def test_every_drone_flies_as_if_alone():
    rng = np.random.default_rng(1)
    p0, u = (
        rng.uniform(1.0, 3.0, (5, 3)),
        rng.uniform([0.2, -3, -3, -3], [0.4, 3, 3, 3], (5, 4)),
    )
    together = CFIntegrator(range(5), p0, lags=InputLags(rates=0.05, delay=0.013))
    for i in range(5):
        together.command(i, u[i])
    for _ in range(50):
        together.step()
    for i in range(5):
        alone = CFIntegrator(
            [i], p0[i : i + 1], lags=InputLags(rates=0.05, delay=0.013)
        )
        alone.command(i, u[i])
        for _ in range(50):
            alone.step()
        np.testing.assert_array_equal(alone.states[0], together.states[i])


def test_the_closest_pair_is_found():
    world = CFIntegrator([4, 9, 2], np.array([[0, 0, 1], [3, 0, 1], [0, 0.4, 1.3]]))
    assert world.closest() == (4, 2, pytest.approx(0.5))
    assert one().min_separation() == np.inf


def test_a_wrong_start_is_refused():
    with pytest.raises(ConfigError, match="one row a drone"):
        CFIntegrator([1, 2], np.zeros((1, 3)))
