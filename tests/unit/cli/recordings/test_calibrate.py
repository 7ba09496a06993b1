"""`crazychoir calibrate` on a real flight: table, JSON, swarm file and errors."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import find_swarm

FOLDER = Path(__file__).resolve().parents[3] / "data" / "realflight"
FLIGHT = FOLDER / "B2_circle_fast_rep3.npz"
SWARM = """name = "lab"  # ours

[[drones]]
id = 3
name = "cf3"
home = [0.0, 0.0, 0.0]
platform = "cf21"
"""


@pytest.fixture
def calibrate():
    def run(*arguments):
        return CliRunner().invoke(app, ["calibrate", *map(str, arguments)])

    return run


@pytest.fixture
def swarm(tmp_path):
    path = tmp_path / "swarm.toml"
    path.write_text(SWARM)
    return path


def test_the_table_shows_values_errors_and_what_stays_at_its_default(calibrate):
    done = calibrate(FLIGHT)
    assert done.exit_code == 0
    for words in ("thrust_factor", "± 2 s.e.", "rotor_lag", "calibration = {"):
        assert words in done.stdout
    assert "stay at" in done.stdout


def test_the_printed_key_can_be_pasted_into_a_swarm_file(calibrate):
    printed = calibrate(FLIGHT).stdout.splitlines()[-1]
    assert tomllib.loads(printed)["calibration"]["thrust_factor"] < 0.75


def test_a_second_calibration_keeps_what_it_does_not_find(calibrate, tmp_path):
    path = tmp_path / "swarm.toml"
    path.write_text(
        'name = "a"\n\n[[drones]]\nid = 3\nhome = [0.0, 0.0, 0.0]\nplatform = "cf21"\n'
        "calibration = { rotor_lag = 0.06, thrust_factor = 0.9 }\n"
    )
    assert (
        calibrate(FLIGHT, "--swarm", str(path), "--id", "3", "--write").exit_code == 0
    )
    (drone,) = tomllib.loads(path.read_text())["drones"]
    assert drone["calibration"]["rotor_lag"] == 0.06
    assert drone["calibration"]["thrust_factor"] < 0.75


def test_the_answer_has_each_parameter_with_its_error_and_source(calibrate):
    answer = json.loads(calibrate(FLIGHT, "--json").stdout)
    assert answer["success"]
    assert not answer["written"]
    thrust = answer["parameters"]["thrust_factor"]
    assert thrust["identified"]
    assert thrust["value"] == pytest.approx(0.68, abs=0.02)
    assert thrust["standard_error"] < 0.01
    lag = answer["parameters"]["rotor_lag"]
    assert not lag["identified"]
    assert lag["value"] == lag["default"]
    assert "rotor_lag" not in answer["calibration"]
    assert answer["flights"][0]["seconds"] > 30.0


def test_what_was_found_is_written_into_the_swarm_file_and_read_again(calibrate, swarm):
    done = calibrate(FLIGHT, "--swarm", swarm, "--id", "cf3", "--write", "--json")
    answer = json.loads(done.stdout)
    assert answer["written"]
    assert swarm.read_text().startswith(SWARM)
    found = find_swarm(str(swarm))[0].drone(3).calibration
    assert found.thrust_factor == answer["calibration"]["thrust_factor"]
    assert list(found.speed_moment) == answer["calibration"]["speed_moment"]


def test_a_table_with_names_is_read_as_the_arrays_are(calibrate, tmp_path):
    with np.load(FLIGHT) as file:
        arrays = dict(file)
    names = {
        "t": ["t"],
        "p": ["x", "y", "z"],
        "q": ["qx", "qy", "qz", "qw"],
        "gyro": ["gyro.x", "gyro.y", "gyro.z"],
        "duty": [f"motor.m{n}" for n in (1, 2, 3, 4)],
        "vbat": ["pm.vbat"],
        "sp": ["sp_x", "sp_y", "sp_z"],
        "delay": ["delay"],
    }
    units = {"gyro": np.degrees(1.0), "duty": 65535.0}
    columns = [
        units.get(k, 1.0) * arrays[k].reshape(len(arrays["t"]), -1) for k in names
    ]
    header = ",".join(name for group in names.values() for name in group)
    path = tmp_path / "flight.csv"
    np.savetxt(path, np.hstack(columns), delimiter=",", header=header, comments="")
    plain = json.loads(calibrate(FLIGHT, "--json").stdout)["parameters"]
    table = json.loads(calibrate(path, "--json").stdout)
    assert any("no accelerometer" in note for note in table["flights"][0]["notes"])
    for name in ("thrust_factor", "moment_roll", "drag_x"):
        value = plain[name]["value"]
        assert table["parameters"][name]["value"] == pytest.approx(value, rel=0.02)


def test_a_recording_without_log_variables_is_refused_with_what_to_record(
    calibrate, tmp_path
):
    with np.load(FLIGHT) as file:
        arrays = {k: v for k, v in file.items() if k not in ("duty", "gyro")}
    np.savez(tmp_path / "a.npz", **arrays)
    done = calibrate(tmp_path / "a.npz", "--json")
    assert done.exit_code == 2
    error = json.loads(done.stdout)["error"]
    assert "no gyro, duty" in error
    assert "motor.m1" in error


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["none.npz"], "none.npz"),
        ([FLIGHT, "--write"], "--swarm FILE and --id N"),
        ([FLIGHT, "--id", "cf3"], "--swarm, --id"),
        ([FLIGHT, "--drone", "3-4"], "one drone, by its id or its name"),
        ([FLIGHT, "--platform", "cf99"], "--platform"),
    ],
)
def test_what_cannot_be_calibrated_is_refused(calibrate, arguments, reason):
    done = calibrate(*arguments, "--json")
    assert done.exit_code == 2
    assert reason in json.loads(done.stdout)["error"]
