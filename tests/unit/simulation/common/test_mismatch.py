"""Simulated drones that are not what their controllers believe."""

from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.config.calibrated import find_known_platform
from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import (
    CRAZYFLIE_21,
    CRAZYFLIE_21_BRUSHLESS,
    PAPER_PLATFORM,
    rotor_speed,
)
from crazychoir.simulation import engines
from crazychoir.simulation.common.mismatch import (
    apply_model_errors,
    find_lightweight_platform,
)
from crazychoir.simulation.engines import make_worlds
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.simulation.motor_level.motors import MotorConditions, MotorWorld
from crazychoir.types import FPQR

MASS, THRUST = 0.03, -0.05


def swarm(uri, platform, **plant):
    drones = [{"id": 0, "home": [0.0, 0.0, 0.0], "uri": uri, "platform": platform}]
    config = SwarmConfig.of({"name": "a", "drones": drones, "plant": plant})
    (world,) = make_worlds(config, (0,))
    return world


def test_a_lightweight_drone_accelerates_by_its_own_mass_and_thrust():
    world = swarm(
        "sim://",
        "paper",
        mass_error=MASS,
        thrust_error=THRUST,
        command_delay=0.0,
        rate_lag=0.0,
    )
    u = 1.5 * PAPER_PLATFORM.weight
    world.states[0, 2] = 1.0
    world._resting[:] = 0.0
    world.link(0).send(FPQR(np.array([u, 0.0, 0.0, 0.0])))
    world.step()
    wanted = (1.0 + THRUST) * u / (
        (1.0 + MASS) * PAPER_PLATFORM.mass
    ) - STANDARD_GRAVITY
    assert world.states[0, 5] / world.dt == pytest.approx(
        wanted, rel=2e-3
    )  # the rest is drag


def falls(platform):
    world = CFIntegrator([0], np.array([[0.0, 0.0, 100.0]]), platform=platform)
    world.commands[:] = 0.0
    for _ in range(400):
        world.step()
    return world.states[0, 5]


def test_a_lightweight_drone_without_thrust_falls_by_its_mass_and_drag_alone():
    assert falls(
        find_lightweight_platform(PAPER_PLATFORM, MASS, THRUST)
    ) == pytest.approx(
        falls(find_lightweight_platform(PAPER_PLATFORM, MASS, 0.0)), rel=1e-12
    )
    assert falls(find_lightweight_platform(PAPER_PLATFORM, MASS, 0.0)) != pytest.approx(
        falls(PAPER_PLATFORM), rel=1e-3
    )


@pytest.mark.parametrize(
    "platform", [CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS], ids=lambda row: row.name
)
def test_an_equal_motor_command_turns_the_rotors_as_fast_and_they_pull_by_the_error_harder(
    platform,
):
    share = platform.weight / (4.0 * platform.firmware.thrust_max)
    lifts, torques, volts = [], [], []
    for body in (platform, apply_model_errors(platform, 0.0, 0.05)):
        world = MotorWorld(
            [0],
            np.array([[0.0, 0.0, 5.0]]),
            platform=body,
            conditions=MotorConditions(has_ground_effect=False),
        )
        world.commands[:] = share * np.array([1.1, 0.9, 1.1, 0.9])
        for _ in range(200):
            before = world.states[0, 12]
            world.step()
        lifts.append(world._lift[0])
        torques.append(world.states[0, 12] - before)
        volts.append(world.vbat(0))
    assert lifts[1] == pytest.approx(1.05 * lifts[0], rel=1e-6)
    assert torques[1] == pytest.approx(
        torques[0], rel=1e-6
    )  # the drag of the rotors goes by their speeds
    assert volts[1] == pytest.approx(volts[0], rel=1e-5)  # and so does what they draw


def test_rotors_that_pull_harder_turn_as_fast_as_the_others_do_for_less():
    rotor, other = CRAZYFLIE_21.rotor, apply_model_errors(CRAZYFLIE_21, 0.0, 0.1).rotor
    assert rotor_speed(other, 1.1 * 0.07) == pytest.approx(
        rotor_speed(rotor, 0.07), rel=1e-12
    )


def test_the_firmware_of_a_body_is_made_for_its_platform():
    world = swarm(WORLD_URIS.motor_level, "cf21", mass_error=MASS, thrust_error=THRUST)
    row = world.onboard[0].record
    plain = swarm(WORLD_URIS.motor_level, "cf21").onboard[0].record
    for name in ("thrust_max", "thrust_min", "c0", "c1", "c2", "c3"):
        assert row[name] == plain[name]
    assert world.onboard[0].platform is CRAZYFLIE_21
    assert world.platforms[0].mass == pytest.approx((1.0 + MASS) * CRAZYFLIE_21.mass)


@pytest.mark.parametrize(
    ("mass", "thrust"), [(0.0, 0.0), (0.03, 0.0), (0.0, 0.05), (-0.03, -0.05)]
)
def test_a_drone_hovers_at_the_command_that_its_errors_ask_for(mass, thrust):
    """At m (1 + e_m) g / (1 + e_f) N by the firmware's scale it neither climbs nor sinks."""
    body = apply_model_errors(CRAZYFLIE_21, mass, thrust)
    world = MotorWorld(
        [0],
        np.array([[0.0, 0.0, 5.0]]),
        platform=body,
        conditions=MotorConditions(has_ground_effect=False),
    )
    share = CRAZYFLIE_21.weight / (4.0 * CRAZYFLIE_21.firmware.thrust_max)
    world.commands[:] = (1.0 + mass) / (1.0 + thrust) * share
    for _ in range(100):
        world.step()
    assert abs(world.states[0, 5]) < 1e-6


def test_an_engine_of_others_is_told_the_errors(monkeypatch):
    told = []

    def engine(setup):
        told.append((setup.mass_error, setup.thrust_error))
        return CFIntegrator(setup.ids, np.array(setup.homes), dt=setup.dt)

    entry = SimpleNamespace(name="toy", value="toys:toy", load=lambda: engine)
    monkeypatch.setattr(engines, "_entry_point", lambda uri: entry)
    swarm("sim://", "paper", mass_error=MASS, thrust_error=THRUST)
    assert told == [(MASS, THRUST)]


@pytest.mark.parametrize("uri", [WORLD_URIS.lightweight, WORLD_URIS.motor_level])
def test_a_calibrated_drone_hovers_at_what_its_controller_commands(uri):
    """The controller knows m/k: its thrust m g/k makes the true thrust m g."""
    found = {"thrust_factor": 0.85, "drag": [0.01, 0.01, 0.02], "rotor_lag": 0.05}
    drone = {
        "id": 0,
        "home": [0.0, 0.0, 0.0],
        "uri": uri,
        "platform": "cf21",
        "calibration": found,
    }
    config = SwarmConfig.of({"name": "a", "drones": [drone]})
    (world,) = make_worlds(config, (0,))
    known = find_known_platform(config.drone(0))
    assert known.weight == pytest.approx(CRAZYFLIE_21.weight / 0.85)
    if uri == WORLD_URIS.lightweight:
        assert world.platforms[0].weight == pytest.approx(known.weight)
        np.testing.assert_allclose(world.platforms[0].drag, known.drag)
        return
    body = world.platforms[0]
    assert body.rotor.lag == 0.05
    assert body.drag == (0.01, 0.01, 0.02)
    share = known.weight / (4.0 * CRAZYFLIE_21.firmware.thrust_max)
    lift = 4.0 * share * body.firmware.thrust_max
    assert lift == pytest.approx(body.weight)
    assert world.onboard[0].platform is CRAZYFLIE_21
