"""Brescianini's controller against a table of the firmware's answers, and in flight."""

import json

import numba
import numpy as np
import pytest

from crazychoir.numerics.kernels import kernel
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard.controllers import brescianini
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import OUTPUT_KINDS, make_fleet

PARAMETERS = [
    "tau_xy",
    "zeta_xy",
    "tau_z",
    "zeta_z",
    "tau_rp",
    "mixing_factor",
    "coll_fairness",
]


@kernel(numba.from_dtype(make_fleet(1, CRAZYFLIE_21).dtype)[::1])
def control(rows):
    brescianini.control(rows[0], rows[0].wanted)


def put(record, names, values):
    for name, value in zip(names.split(), values, strict=True):
        record[name] = value


def answer_to(case):
    """Return force N and torque N m, (4,), for a case of the table."""
    board = Onboard(CRAZYFLIE_21)
    fw = board.record
    for name, value in zip(PARAMETERS, case["parameters"], strict=True):
        board.set(f"ctrlAtt.{name}", value)
    put(fw, "gx gy gz", case["gyro"])
    put(fw, "qx qy qz qw", case["q"])
    put(fw, "x y z", case["p"])
    put(fw, "vx vy vz", case["v"])
    sp = fw["wanted"]
    sp["mode_z"] = case["mode_z"]
    put(sp, "x y z", case["place"])
    put(sp, "vx vy vz", case["velocity"])
    put(sp, "ax ay az", case["acceleration"])
    put(sp, "yaw yaw_rate", (case["yaw"], case["yaw_rate"]))
    control(board.rows)
    assert fw["output"] == OUTPUT_KINDS.force_torque
    return np.array([fw[k] for k in ("force", "torque_x", "torque_y", "torque_z")])


@pytest.fixture(scope="module")
def table(repository):
    path = repository / "tests/data/firmware/brescianini.json"
    return json.loads(path.read_text())["cases"]


def test_answers_are_the_firmwares_within_a_ten_thousandth(table):
    assert len(table) >= 100
    for case in table:
        wanted = np.array(case["answer"])
        found = answer_to(case)
        assert found[0] == pytest.approx(wanted[0], rel=1e-4)
        largest = np.max(np.abs(wanted[1:]))
        assert found[1:] == pytest.approx(wanted[1:], abs=1e-4 * largest)


def test_the_table_has_reduced_thrusts_stopped_motors_and_mixed_errors(table):
    mass = CRAZYFLIE_21.firmware.mass
    full = [c for c in table if c["answer"][0] == pytest.approx(18.0 * mass)]
    stopped = [c for c in table if c["mode_z"] == 0]
    mixed = [c for c in table if 0.0 < c["parameters"][5] < 1.0]
    assert min(len(full), len(stopped), len(mixed)) >= 5


def test_the_yaw_of_a_quaternion_is_not_heeded(table):
    case = next(c for c in table if c["mode_z"] != 0)
    board = Onboard(CRAZYFLIE_21)
    answers = []
    for mode, yaw in ((1, 90.0), (1, 0.0), (0, 0.0)):
        sp = board.record["wanted"]
        sp["mode_z"] = 1
        sp["mode_quat"] = mode
        sp["yaw"] = yaw
        put(board.record, "qx qy qz qw", case["q"])
        control(board.rows)
        answers.append(float(board.record["torque_z"]))
    assert answers[0] == answers[1] == answers[2]
