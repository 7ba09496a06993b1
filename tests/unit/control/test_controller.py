import numpy as np
import pytest

from crazychoir.control.attitude import GeometryAttitudeCtrl
from crazychoir.control.controller import HierarchicalController
from crazychoir.control.gains import STANDARD_GAINS, Gains
from crazychoir.control.handlers import AccelerationTraj, FullStateTraj
from crazychoir.control.position import FlatnessAccelerationCtrl, FlatnessPositionCtrl
from crazychoir.control.senders import FPQRSender
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.mocap.simulated import CameraErrors, SimulatedMocap
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.planning.point_to_point import PointToPoint, compute_flight_time
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.simulation.lightweight.integrator import CFIntegrator, InputLags
from crazychoir.types import Acceleration, FullState, State

HERE = State.at((0.0, 0.0, 1.0))
HOVER = [PAPER_PLATFORM.weight, 0.0, 0.0, 0.0]


def tracking(gains=STANDARD_GAINS):
    return HierarchicalController(
        FlatnessPositionCtrl(gains),
        GeometryAttitudeCtrl(gains),
        FPQRSender(),
        FullStateTraj(),
    )


def accelerating():
    return HierarchicalController(
        FlatnessAccelerationCtrl(),
        GeometryAttitudeCtrl(),
        FPQRSender(),
        AccelerationTraj(),
    )


def test_hovering_in_place_takes_the_weight_and_no_rates():
    np.testing.assert_allclose(
        tracking().command(HERE, FullState.at((0, 0, 1)), 0.0).flat, HOVER, atol=1e-12
    )
    np.testing.assert_allclose(
        accelerating().command(HERE, Acceleration(np.zeros(3)), 0.0).flat,
        HOVER,
        atol=1e-12,
    )


def test_a_wish_to_go_forward_pitches_forward():
    assert tracking().command(HERE, FullState.at((1, 0, 1)), 0.0).flat[2] > 0.1
    assert (
        accelerating()
        .command(HERE, Acceleration(np.array([0.0, 1.0, 0.0])), 0.0)
        .flat[1]
        < -0.1
    )


def test_without_a_reference_it_holds_the_place():
    law = tracking()
    np.testing.assert_allclose(law.command(HERE, None, 0.0).flat, HOVER, atol=1e-12)
    assert law.command(State.at((-1.0, 0.0, 1.0)), None, 0.1).flat[2] > 0.1
    assert law.refused == 0


def test_a_reference_that_is_not_finite_is_refused_counted_and_the_last_one_held():
    law = tracking()
    law.command(HERE, FullState.at((0, 0, 1), (0.5, 0, 0), (1, 0, 0)), 0.0)
    bad = law.command(HERE, FullState.at((np.nan, 0, 1)), 0.01)
    np.testing.assert_allclose(bad.flat, HOVER, atol=1e-12)
    assert law.refused == 1


@pytest.mark.parametrize(
    "bad",
    [Acceleration(np.array([0.0, np.inf, 0.0])), Acceleration(np.zeros(3), np.nan)],
)
def test_an_acceleration_that_is_not_finite_is_refused(bad):
    law = accelerating()
    assert np.all(np.isfinite(law.command(HERE, bad, 0.0).flat))
    np.testing.assert_allclose(
        law.command(HERE, Acceleration(np.zeros(3)), 0.01).flat, HOVER, atol=1e-12
    )
    assert law.refused == 1


def test_a_reference_of_another_kind_is_refused():
    law = tracking()
    np.testing.assert_allclose(
        law.command(HERE, Acceleration(np.ones(3)), 0.0).flat, HOVER, atol=1e-12
    )
    assert law.refused == 1


@pytest.mark.parametrize("flat", [np.zeros(13), np.zeros(14, dtype=np.float32)])
def test_a_reference_of_another_shape_or_precision_is_refused(flat):
    law = tracking()
    np.testing.assert_allclose(
        law.command(HERE, FullState(flat), 0.0).flat, HOVER, atol=1e-12
    )
    np.testing.assert_allclose(
        accelerating().command(HERE, Acceleration(flat), 0.0).flat, HOVER, atol=1e-12
    )
    assert law.refused == 1


def test_with_a_broken_state_it_keeps_the_thrust_and_does_not_turn():
    law = tracking()
    law.command(HERE, FullState.at((0, 0, 1.01)), 0.0)
    thrust = law.command(HERE, FullState.at((0, 0, 1.01)), 0.0).thrust
    u = law.command(State.at((np.nan, 0.0, 1.0)), FullState.at((0, 0, 1.01)), 0.01)
    np.testing.assert_array_equal(u.flat, [thrust, 0.0, 0.0, 0.0])


def test_strategies_are_exchanged_at_run_time():
    law = tracking()
    law.pos_strategy, law.traj_handler = FlatnessAccelerationCtrl(), AccelerationTraj()
    assert (
        law.command(HERE, Acceleration(np.array([0.0, 0.0, 1.0])), 0.0).thrust
        > PAPER_PLATFORM.weight
    )
    assert law.refused == 0


@pytest.mark.parametrize(
    "far", [(100, 0, 1), (0, -100, 1), (0, 0, 100), (0, 0, -100), (50, 50, -50)]
)
def test_tilt_thrust_and_rates_stay_within_their_limits(far):
    position = FlatnessPositionCtrl()
    out = position.desired(HERE, FullState.at(far).flat, 0.0)
    assert out[9] >= np.cos(STANDARD_GAINS.max_tilt) - 1e-9
    assert 0.0 < out[0] <= PAPER_PLATFORM.max_thrust
    assert np.all(np.isfinite(out))
    u = tracking().command(State.at((0, 0, 1)), FullState.at(far), 0.0).flat
    assert np.all(np.abs(u[1:]) <= PAPER_PLATFORM.max_rate)


def test_a_falling_reference_meets_no_singularity():
    out = FlatnessPositionCtrl().desired(
        HERE, FullState.at((0, 0, 1), a=(0, 0, -STANDARD_GRAVITY)).flat, 0.0
    )
    np.testing.assert_allclose(out[7:10], [0.0, 0.0, 1.0], atol=1e-12)
    assert out[0] == pytest.approx(0.2 * PAPER_PLATFORM.weight)


def fly(gains=STANDARD_GAINS, noise=0.0, seconds=6.0, **world):
    """Take off and go to (1, 1, 1): largest tracking error and the error at the end, m."""
    start, goal = FullState.at((0, 0, 0)), np.array([1.0, 1.0, 1.0])
    engine, plan = (
        CFIntegrator([0], np.zeros((1, 3)), **world),
        PointToPoint(start, goal, 1.0, compute_flight_time(start, goal, 1.0)),
    )
    mocap, velocity, law = (
        SimulatedMocap([0], 1, CameraErrors(noise, 2.0 * noise)),
        VelocityFilter(),
        tracking(gains),
    )
    errors = []
    for k in range(round(seconds / engine.dt)):
        pose = mocap.sample(engine.states, k).pose(0)
        state = velocity.update(pose, engine.time)
        engine.command(
            0, law.command(state, plan.sample(engine.time), engine.time).flat
        )
        engine.step()
        errors.append(np.linalg.norm(engine.states[0, :3] - plan.sample(engine.time).p))
    return max(errors), errors[-1]


def test_one_drone_takes_off_and_goes_to():
    largest, last = fly()
    assert largest < 0.011
    assert last < 2e-4


def test_it_does_so_with_noise():
    largest, last = fly(noise=0.0005)
    assert largest < 0.015
    assert last < 0.003


def test_the_shipped_gains_fly_behind_86_ms_of_lag_and_40_ms_of_delay():
    largest, last = fly(seconds=20.0, lags=InputLags(rates=0.086, delay=0.04))
    assert largest < 0.02
    assert last < 1e-4


def test_a_faster_attitude_loop_does_not():
    stiff = Gains(STANDARD_GAINS.kp, STANDARD_GAINS.kv, (16.0, 16.0, 4.0))
    assert fly(stiff, seconds=20.0, lags=InputLags(rates=0.086, delay=0.04))[0] > 0.1
