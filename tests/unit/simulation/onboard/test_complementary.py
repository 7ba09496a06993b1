"""The complementary estimator against runs of the firmware's, and what it heeds of the outside."""

import json

import numba
import numpy as np
import pytest
from virtual_drones import Hangar

from crazychoir.numerics.kernels import kernel
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard import complementary, loop
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import FLOOR_ALTITUDE, make_fleet

PARAMETERS = [
    "sensfusion6.kp",
    "sensfusion6.ki",
    "posEstAlt.estAlphaAsl",
    "posEstAlt.velFactor",
    "posEstAlt.velZAlpha",
    "posEstAlt.vAccDeadband",
]
SENSORS = ["gx", "gy", "gz", "ax", "ay", "az", "asl"]
ESTIMATES = {
    **{f"sensfusion6.q{axis}": 1e-6 for axis in "xyzw"},
    **{f"stateEstimate.{angle}": 1e-4 for angle in ("roll", "pitch", "yaw")},
    "stateEstimate.az": 1e-5,
    "stateEstimate.z": 1e-3,
    "stateEstimate.vz": 2e-2,
    "posEstAlt.velocityZ": 1e-5,
    "sensfusion6.accZbase": 1e-6,
}
"""Log variables of an answer, and how far they may be from it: height and speed have 32 bits in the firmware."""


@kernel(numba.from_dtype(make_fleet(1, CRAZYFLIE_21).dtype)[::1])
def estimate(rows):
    complementary.estimate(rows[0])


@pytest.fixture(scope="module")
def table(repository):
    path = repository / "tests/data/firmware/complementary.json"
    return json.loads(path.read_text())["runs"]


def estimates_of(run):
    """Return the log variables after each tenth row of a run."""
    board = Onboard(CRAZYFLIE_21)
    for name, value in zip(PARAMETERS, run["parameters"], strict=True):
        board.set(name, value)
    found = []
    for k, row in enumerate(run["rows"]):
        for name, value in zip(SENSORS, row, strict=True):
            board.record[name] = value
        for tick in range(4 * k, 4 * k + 4):
            board.record["tick"] = tick
            estimate(board.rows)
        if k % 10 == 9:
            found.append([board.log(name) for name in ESTIMATES])
    return np.array(found)


def test_estimates_are_the_firmwares(table):
    for run in table:
        found = estimates_of(run)
        wanted = np.array(run["answers"])
        assert np.all(np.abs(found - wanted) <= list(ESTIMATES.values()))
        assert np.max(np.abs(wanted[:, 4:6])) > 1.0


def test_the_quick_inverse_root_is_up_to_two_thousandths_too_small():
    x = np.geomspace(1e-3, 1e3, 500)
    shares = np.array([complementary._invert_root(v) * np.sqrt(v) for v in x])
    assert np.max(shares) <= 1.0 + 1e-6
    assert 0.998 < np.min(shares) < 0.9985


def test_positions_and_poses_from_outside_are_not_heeded():
    board = Onboard(CRAZYFLIE_21)
    board.set("stabilizer.estimator", 1)
    loop.run(board.rows, 20.0, 0, 0, 0, 0, 0, 9.81)
    p = np.array([1.0, 2.0, 3.0])
    board.external_position(p)
    board.external_pose(p, np.array([0.0, 0.0, 0.6, 0.8]))
    board.measured_velocity(p, 0.01)
    loop.run(board.rows, 20.0, 0, 0, 0, 0, 0, 9.81)
    estimate = board.estimate
    assert estimate.p == pytest.approx([0.0, 0.0, FLOOR_ALTITUDE], abs=0.01)
    assert estimate.v[:2] == pytest.approx([0.0, 0.0])
    assert board.log("stateEstimate.yaw") == pytest.approx(0.0)


def test_the_kalman_filter_starts_anew_when_it_is_chosen():
    board = Onboard(CRAZYFLIE_21)
    board.place((1.0, 2.0, 0.0), 0.0)
    board.set("stabilizer.estimator", 1)
    loop.run(board.rows, 20.0, 0, 0, 0, 0, 0, 9.81)
    assert board.estimate.p[0] == 0.0
    board.set("stabilizer.estimator", 0)
    assert board.get("stabilizer.estimator") == 2
    loop.run(board.rows, 20.0, 0, 0, 0, 0, 0, 9.81)
    assert board.estimate.p == pytest.approx([1.0, 2.0, 0.0], abs=0.01)


def test_a_hovering_drone_without_a_position_is_on_the_floor_within_two_seconds():
    hangar = Hangar().hovering(0.5)
    hangar.drone.parameters.set("stabilizer.estimator", 1.0)
    assert hangar.drone.parameters.read("stabilizer.estimator") == 1.0
    hangar.run(2.0)
    assert hangar.state[2] < 0.05
    assert hangar.log("stateEstimate.x") == 0.0
    assert hangar.log("stateEstimate.z") == pytest.approx(FLOOR_ALTITUDE, abs=0.2)
    assert hangar.log("baro.asl") == pytest.approx(FLOOR_ALTITUDE, abs=0.05)


def test_an_unknown_estimator_is_not_taken():
    hangar = Hangar()
    hangar.drone.parameters.set("stabilizer.estimator", 3.0)
    assert hangar.drone.parameters.read("stabilizer.estimator") == 2.0
