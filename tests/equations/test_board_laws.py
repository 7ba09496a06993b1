"""Equations of the firmware's collision avoidance, INDI, Brescianini's and the complementary laws."""

import numba
import numpy as np
import pytest
from scipy import signal
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from crazychoir.numerics.kernels import kernel, vector
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard import complementary, voronoi
from crazychoir.simulation.onboard.controllers import brescianini, indi
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import rows
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY

numbers = numba.float64[::1]
RADII = np.array([0.3, 0.3, 0.9])


@kernel(rows, vector, numbers)
def project(fleet, p, out):
    voronoi._write_cell(fleet[0])
    out[0], out[1], out[2] = voronoi._project(fleet[0].avoidance, (p[0], p[1], p[2]))


@kernel(rows, vector, numbers)
def low_pass(fleet, values, out):
    indi.reset(fleet[0])
    for k in range(len(values)):
        out[k] = indi._filter(fleet[0].indi, 0, 0, values[k])


@kernel(vector, vector, numbers)
def invert_thrust(angles, e, out):
    a = (angles[0], angles[1], angles[2])
    axes = indi._compute_columns(a)
    out[0], out[1], out[2] = indi._invert_thrust(a, axes, (e[0], e[1], e[2]))


@kernel(vector, numba.float64, numbers)
def limit_acceleration(a, fairness, out):
    out[0], out[1], out[2] = brescianini._limit_acceleration(
        (a[0], a[1], a[2]), fairness
    )


@kernel(vector, vector, numbers)
def turn_to(a, b, out):
    out[0], out[1], out[2], out[3] = brescianini._turn_to(
        (a[0], a[1], a[2]), (b[0], b[1], b[2])
    )


@kernel(rows)
def estimate_attitude(fleet):
    complementary._estimate_attitude(fleet[0])


def answer(law, *arguments, size=3):
    out = np.zeros(size)
    law(*arguments, out)
    return out


def drone_among(*peers):
    board = Onboard(CRAZYFLIE_21)
    for k, peer in enumerate(peers):
        board.peer_position(k + 1, np.array(peer))
    return board


def test_a_face_is_half_the_way_to_a_peer_less_one_radius_in_scaled_axes():
    d = np.array([0.9, -0.4, 0.7])
    board = drone_among(d)
    project(board.rows, np.zeros(3), np.zeros(3))
    av = board.record["avoidance"]
    scaled = d / RADII
    normal = d / RADII**2 / np.linalg.norm(d / RADII**2)
    assert av["normals"][0] == pytest.approx(normal)
    on_face = av["bounds"][0] * av["normals"][0]
    along = (on_face / RADII) @ scaled / np.linalg.norm(scaled)
    assert along == pytest.approx(0.5 * np.linalg.norm(scaled) - 1.0)


def test_a_place_is_projected_onto_the_nearest_place_of_the_cell():
    board = drone_among((0.9, 0.2, 0.1), (0.3, 0.8, -0.2))
    wish = np.array([1.0, 0.9, 0.3])
    found = answer(project, board.rows, wish)
    av = board.record["avoidance"]
    n = int(av["faces"])
    a = av["normals"][:n]
    b = av["bounds"][:n]
    best = minimize(
        lambda x: np.sum((x - wish) ** 2),
        np.zeros(3),
        constraints={"type": "ineq", "fun": lambda x: b - a @ x},
        method="SLSQP",
        tol=1e-12,
    )
    assert found == pytest.approx(best.x, abs=1e-4)
    assert np.sum(a @ found > b - 1e-4) >= 2


def test_the_filter_of_indi_is_butterworths_with_a_quality_of_0_7071():
    board = Onboard(CRAZYFLIE_21)
    x = np.sin(0.1 * np.arange(200)) + 0.2
    b, a = signal.butter(2, 8.0, fs=500.0)
    found = answer(low_pass, board.rows, x, size=200)
    assert found == pytest.approx(signal.lfilter(b, a, x), abs=1e-4)


def test_the_thrust_of_indi_is_inverted_for_a_small_change_of_acceleration():
    angles = np.array([0.2, -0.15, 0.8])
    change = np.array([1e-4, -2e-4, 3e-4])

    def acceleration(roll, pitch, thrust):
        axes = Rotation.from_euler("ZYX", [angles[2], pitch, roll]).as_matrix()
        return (thrust - FIRMWARE_GRAVITY) * axes[:, 2]

    e = acceleration(
        angles[0] + change[0], angles[1] + change[1], change[2]
    ) - acceleration(*angles[:2], 0.0)
    assert answer(invert_thrust, angles, e) == pytest.approx(change, abs=1e-6)


@pytest.mark.parametrize("fairness", [0.0, 0.25, 1.0])
def test_a_limited_acceleration_needs_the_greatest_lift(fairness):
    a = np.array([14.0, -9.0, 15.0])
    found = answer(limit_acceleration, a, fairness)
    assert np.linalg.norm(found) == pytest.approx(18.0)
    r = found[0] / a[0]
    assert found[1] == pytest.approx(r * a[1])
    z = a[2] - FIRMWARE_GRAVITY
    kept = (r * fairness + 1.0 - fairness) * z + FIRMWARE_GRAVITY
    assert found[2] == pytest.approx(kept)


def test_the_shortest_turn_moves_one_direction_onto_the_other():
    a, b = np.array([[0.6, 0.0, 0.8], [-0.36, 0.48, 0.8]])
    q = answer(turn_to, a, b, size=4)
    assert Rotation.from_quat(q).apply(a) == pytest.approx(b)
    assert q[:3] @ a == pytest.approx(0.0)


def test_the_complementary_filter_turns_with_the_gyroscope_and_towards_the_vertical():
    board = Onboard(CRAZYFLIE_21)
    fw = board.record
    fw["ax"] = fw["ay"] = fw["az"] = 0.0
    fw["gx"] = 50.0
    for _ in range(100):
        estimate_attitude(board.rows)
    assert fw["roll"] == pytest.approx(50.0 * 0.4, abs=0.05)
    fw["gx"] = 0.0
    fw["az"] = 1.0
    estimate_attitude(board.rows)
    tilt = np.radians(20.0)
    rate = np.radians(fw["roll"]) - tilt
    assert rate / 0.004 == pytest.approx(-0.4 * np.sin(tilt), rel=0.02)
