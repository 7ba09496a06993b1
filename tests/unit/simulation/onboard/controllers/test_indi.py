"""INDI against runs of the firmware's controller with the same inputs."""

import json

import numba
import numpy as np
import pytest

from crazychoir.numerics.kernels import kernel
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard.controllers import indi
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import (
    INDI_DEFAULTS,
    INDI_POSITION_DEFAULTS,
    OUTPUT_KINDS,
    make_fleet,
)

PARAMETERS = [
    *(f"ctrlINDI.{name}" for name in INDI_DEFAULTS),
    *(f"posCtrlIndi.{name}" for name in INDI_POSITION_DEFAULTS),
]
SETPOINT_FIELDS = [
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "roll",
    "pitch",
    "yaw",
    "roll_rate",
    "pitch_rate",
    "yaw_rate",
]
"""Fields of a set-point in a row of the table of answers."""
STATE_FIELDS = [
    "ax",
    "ay",
    "az",
    "gx",
    "gy",
    "gz",
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "roll",
    "pitch",
    "yaw",
]
"""Fields of readings and estimate in a row of the table of answers."""


@kernel(numba.from_dtype(make_fleet(1, CRAZYFLIE_21).dtype)[::1])
def control(rows):
    indi.control(rows[0], rows[0].wanted)


def chosen(**parameters):
    """Return a drone with this controller, chosen after its parameters were set."""
    board = Onboard(CRAZYFLIE_21)
    for name, value in parameters.items():
        board.set(name.replace("__", "."), value)
    board.set("stabilizer.controller", 3)
    return board


def command_of(board):
    fw = board.record
    control(board.rows)
    assert fw["output"] == OUTPUT_KINDS.legacy
    return [float(fw[k]) for k in ("thrust", "roll_out", "pitch_out", "yaw_out")]


def answers_to(run):
    """Return the commands (passes, 4) for a run of the table."""
    board = chosen(**dict(zip(PARAMETERS, run["parameters"], strict=True)))
    fw = board.record
    sp = fw["wanted"]
    for axis, mode in zip(
        ["x", "y", "z", "roll", "pitch", "yaw"], run["modes"], strict=True
    ):
        sp[f"mode_{axis}"] = mode
    commands = []
    for *row, thrust in run["rows"]:
        for name, value in zip(SETPOINT_FIELDS, row[:12], strict=True):
            sp[name] = value
        for name, value in zip(STATE_FIELDS, row[12:], strict=True):
            fw[name] = value
        sp["thrust"] = thrust
        commands.append(command_of(board))
    return np.array(commands)


@pytest.fixture(scope="module")
def table(repository):
    path = repository / "tests/data/firmware/indi.json"
    return json.loads(path.read_text())["runs"]


def test_commands_are_the_firmwares_within_one_step_of_its_integers(table):
    kinds = {run["kind"] for run in table}
    assert kinds == {"position", "velocity", "angles", "rates", "zdistance"}
    for run in table:
        found = answers_to(run)
        wanted = np.array(run["answers"])
        assert found[:, 0] == pytest.approx(wanted[:, 0], abs=1e-4 * 60000.0)
        assert found[:, 1:] == pytest.approx(wanted[:, 1:], abs=1.0)
        assert np.max(np.abs(wanted[:, 1:])) > 3000.0


def test_there_are_no_commands_below_the_least_thrust():
    board = chosen()
    board.record["wanted"]["thrust"] = 299.0
    board.record["wanted"]["roll"] = 10.0
    assert command_of(board) == [299.0, 0.0, 0.0, 0.0]
    board.record["wanted"]["thrust"] = 301.0
    assert command_of(board)[1] > 1000.0


def test_the_pids_take_the_place_of_the_outer_loop():
    board = chosen(ctrlINDI__outerLoopActive=0)
    board.setpoints.position((0.0, 0.0, 0.2), 0.0)
    assert command_of(board)[0] == pytest.approx(board.record["position_thrust"])
    assert board.record["position_thrust"] > 36000.0
    assert not board.record["indi"]["delays"][indi.FILTER_ROWS.accelerations].any()


def test_a_new_cutoff_acts_when_the_controller_is_chosen():
    board = chosen()
    filters = board.record["indi"]["filters"].copy()
    board.set("ctrlINDI.filt_cutoff", 20.0)
    command_of(board)
    assert np.array_equal(board.record["indi"]["filters"], filters)
    board.set("stabilizer.controller", 3)
    assert board.record["indi"]["filters"][0, 0] > filters[0, 0]
    assert board.record["indi"]["filters"][1, 0] == filters[1, 0]
