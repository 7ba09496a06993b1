"""Predictions agree with the simulator on its own flights, and have the known errors on real ones."""

from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.identification.fitting import (
    fit_parameters,
    predict_left_out,
)
from crazychoir.simulation.identification.flights import RealFlight, read_flight
from crazychoir.simulation.identification.open_loop import (
    TrimSource,
    estimate_trims,
    find_predictable,
    follow_plant,
    predict_constant,
    predict_plant,
)
from crazychoir.simulation.identification.parameters import (
    FITTED_PARAMETERS,
    PHYSICAL_PARAMETERS,
)
from crazychoir.simulation.identification.scores import score
from crazychoir.simulation.identification.windows import find_windows
from crazychoir.simulation.motor_level.motors import MotorConditions, MotorWorld

FOLDER = Path(__file__).resolve().parents[3] / "data" / "realflight"
TRUE_PARAMETERS = replace(PHYSICAL_PARAMETERS, damping=5.0, drag=0.5, lag=0.05)
VOLTS = 3.6
ROWS = 155
SETTLING_ROWS = 50  # until the rotors have forgotten their start


def make_flight(seed, platform):
    """Fly MotorWorld for a second with random duty cycles, which change each 50 ms."""
    draw = np.random.default_rng(seed)
    start = [0.0, 0.0, 3.0]
    world = MotorWorld(
        [0], np.array([start]), platform=platform, conditions=MotorConditions()
    )
    world.states[0, 3:6] = draw.uniform(-1.0, 1.0, 3)
    c0, c1, c2, c3 = platform.rotor.voltage
    common = draw.uniform(0.74, 0.82, (ROWS // 5, 1))
    duty = np.repeat(common + draw.uniform(-0.01, 0.01, (ROWS // 5, 4)), 5, axis=0)
    volts = duty * VOLTS
    thrust = c0 + volts * (c1 + volts * (c2 + volts * c3))
    states = []
    for row in range(ROWS):
        states.append(world.states[0].copy())
        world.command(0, thrust[row] / platform.firmware.thrust_max)
        world.step()
    x = np.array(states)
    return RealFlight(
        name=f"made {seed}",
        t=0.01 * np.arange(ROWS),
        p=x[:, :3],
        v=x[:, 3:6],
        q=x[:, 6:10],
        w=x[:, 10:],
        duty=duty,
        vbat=np.full(ROWS, VOLTS),
        is_known=np.arange(ROWS) >= SETTLING_ROWS,
        airborne=(0, ROWS),
        marker_tilt=(0.0, 0.0),
    )


def make_windows(platform, count=3):
    return find_windows([make_flight(seed, platform) for seed in range(count)])


def late_position_error(windows, states):
    return score("", windows, states).rmse(50)[0]


def test_the_plant_repeats_a_flight_of_the_simulator_to_a_hundredth_of_a_millimetre():
    plant = TRUE_PARAMETERS.apply(CRAZYFLIE_21)
    windows = make_windows(plant)
    states = predict_plant(windows, follow_plant(windows, plant), TrimSource.NONE)
    assert late_position_error(windows, predict_constant(windows)) > 100.0
    assert late_position_error(windows, states) < 0.01
    other = replace(TRUE_PARAMETERS, roll_moment=0.0).apply(CRAZYFLIE_21)
    without = predict_plant(windows, follow_plant(windows, other), TrimSource.NONE)
    assert late_position_error(windows, without) > 10.0


def test_trims_find_the_thrust_and_the_imbalance_of_the_motors():
    plant = TRUE_PARAMETERS.apply(CRAZYFLIE_21)
    factors = (0.93, 0.90, 0.89, 0.88)
    drone = replace(plant, effects=replace(plant.effects, motor_factors=factors))
    windows = make_windows(drone)
    trims = estimate_trims(windows, follow_plant(windows, plant), TrimSource.LAST)
    np.testing.assert_allclose(trims.thrust, np.mean(factors), atol=0.005)
    f = plant.weight / 4
    uneven = np.array(factors) / np.mean(factors) - 1.0
    roll = plant.arm * f * (uneven @ [-1, -1, 1, 1]) / plant.inertia[0]
    pitch = plant.arm * f * (uneven @ [-1, 1, 1, -1]) / plant.inertia[1]
    np.testing.assert_allclose(
        trims.offsets[:, :2].mean(axis=0), [roll, pitch], rtol=0.15, atol=0.5
    )


def test_a_left_out_flight_is_predicted_with_what_the_others_tell():
    windows = make_windows(TRUE_PARAMETERS.apply(CRAZYFLIE_21))
    (states,) = predict_left_out(windows, CRAZYFLIE_21, [TrimSource.LAST])
    assert states.shape == (3, 51, 13)
    assert late_position_error(windows, states) < 3.0


def test_a_fit_finds_the_parameters_of_the_simulator():
    windows = make_windows(TRUE_PARAMETERS.apply(CRAZYFLIE_21), count=4)
    found = fit_parameters(windows, CRAZYFLIE_21)
    assert found.lag + found.delay == pytest.approx(0.062, rel=0.02)
    assert found.torque_gain == pytest.approx(TRUE_PARAMETERS.torque_gain, rel=0.02)
    assert found.roll_moment == pytest.approx(TRUE_PARAMETERS.roll_moment, rel=0.02)
    assert found.pitch_moment == pytest.approx(TRUE_PARAMETERS.pitch_moment, rel=0.02)
    assert found.drag == pytest.approx(TRUE_PARAMETERS.drag, rel=0.02)


@pytest.fixture(scope="module")
def real():
    names = ("B2_circle_fast_rep3", "B7_oval_slow_rep3")
    return find_windows([read_flight(FOLDER / f"{name}.npz") for name in names])


def test_the_simulator_as_it_is_cannot_follow_a_real_flight(real):
    plant = follow_plant(real, CRAZYFLIE_21)
    states = predict_plant(real, plant, TrimSource.NONE)
    assert late_position_error(real, predict_constant(real)) == pytest.approx(
        109, abs=10
    )
    assert late_position_error(real, states) == pytest.approx(696, abs=15)


@pytest.mark.parametrize(
    ("parameters", "source", "position", "attitude"),
    [
        (PHYSICAL_PARAMETERS, TrimSource.LAST, 65.0, 12.5),
        (FITTED_PARAMETERS, TrimSource.LAST, 45.0, 6.2),
        (FITTED_PARAMETERS, TrimSource.FIRST, 60.0, 7.0),
    ],
)
def test_the_calibrated_simulator_follows_real_flights(
    real, parameters, source, position, attitude
):
    plant = follow_plant(real, parameters.apply(CRAZYFLIE_21))
    found = score("", real, predict_plant(real, plant, source))
    assert found.rmse(10)[0] < 1.3
    assert found.rmse(25)[0] < 8.0
    assert found.rmse(50)[0] < position
    assert found.rmse(50)[2] < attitude


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_fitted_set_is_what_a_fit_to_the_ten_flights_gives():
    flights = [read_flight(path) for path in sorted(FOLDER.glob("*.npz"))]
    found = fit_parameters(find_windows(flights), CRAZYFLIE_21)
    assert len(flights) == 10
    np.testing.assert_allclose(
        astuple(found), astuple(FITTED_PARAMETERS), rtol=0.03, atol=0.01
    )


def test_the_moment_of_speed_is_what_a_physical_plant_needs_most(real):
    still = replace(PHYSICAL_PARAMETERS, roll_moment=0.0, pitch_moment=0.0)
    errors = [
        late_position_error(
            real,
            predict_plant(
                real,
                follow_plant(real, parameters.apply(CRAZYFLIE_21)),
                TrimSource.LAST,
            ),
        )
        for parameters in (PHYSICAL_PARAMETERS, still)
    ]
    assert errors[1] > 1.8 * errors[0]


def test_the_error_of_a_sudden_turn_is_no_offset_that_lasts(real):
    """A push of 3 rad/s in the last 50 ms: the mean over 0.36 s would be off by 8 rad/s2."""
    flight = real.flights[0]
    start = real.start[real.flight == 0][20]
    pushed = flight.w.copy()
    pushed[start - 5 :, 1] += 3.0
    plant = FITTED_PARAMETERS.apply(CRAZYFLIE_21)
    offsets = []
    for one in (flight, replace(flight, w=pushed)):
        windows = find_windows([one])
        trims = estimate_trims(windows, follow_plant(windows, plant), TrimSource.LAST)
        offsets.append(trims.offsets[windows.start == start][0])
    before, after = offsets
    np.testing.assert_allclose(after, before, atol=2.0)


def test_flights_without_a_part_outside_gaps_are_refused(real):
    blind = replace(real.flights[0], is_known=np.zeros(len(real.flights[0].t), bool))
    with pytest.raises(ConfigError, match=r"no 0\.86 s in the air"):
        find_windows([blind])


def test_trims_of_the_first_seconds_predict_only_what_comes_later(real):
    predictable = find_predictable(real, TrimSource.FIRST)
    take_off = np.array([flight.airborne[0] for flight in real.flights])
    late = real.start >= take_off[real.flight] + 300
    np.testing.assert_array_equal(predictable, late)
    assert 0 < late.sum() < len(late)
    assert find_predictable(real, TrimSource.LAST).all()
