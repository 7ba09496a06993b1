"""The log variables, poses and references of a recording become the columns of a calibration."""

import numpy as np
import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.recording.flight_columns import read_flight_columns
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.simulation.identification.calibration.columns import FIRMWARE_LOGS
from crazychoir.types import FullState, Pose

STEP_NS = 10_000_000
ROWS = 600


def record(path, *, drones=(3,), logs=FIRMWARE_LOGS, swarm="{}"):
    """Write poses, references and log variables; in row k the place is 0.001 k m, 5 ms after the logs."""
    file = RecordingFile(path, {"version": "1"}, swarm, False)
    kinds = {"pose": Pose, "reference": FullState, "telemetry": dict}
    entries = []
    for drone in drones:
        series = {n: Series(drone, n, FORM_BY_VALUE_TYPE[k]) for n, k in kinds.items()}
        for k in range(ROWS):
            born = k * STEP_NS
            place = 0.001 * k
            values = {
                "pose": Pose(np.array([place, 0.0, 1.0, 0.0, 0.0, 0.0, (-1.0) ** k])),
                "reference": FullState.at((place + 0.5, 0.0, 1.0)),
                "telemetry": {name: [1.0 + 0.01 * k, 0.005] for name in logs},
            }
            for name, value in values.items():
                if name == "telemetry" and not logs:
                    continue
                pack = make_packer(series[name].message, drone)
                entries.append(
                    RecordingEntry(series[name], born, born, pack(value, born))
                )
    file.write(entries)
    file.close({})
    return path


def test_all_columns_lie_at_the_times_of_the_log_variables_in_si_units(tmp_path):
    columns = read_flight_columns(record(tmp_path / "a.mcap"))
    row = 100
    said = 1.0 + 0.01 * row
    assert columns["vbat"][row] == pytest.approx(said)
    assert columns["gyro"][row] == pytest.approx(np.radians(said))
    assert columns["duty"][row] == pytest.approx(said / 65535.0)
    assert columns["acc"][row] == pytest.approx(said * STANDARD_GRAVITY)
    assert columns["p"][row, 0] == pytest.approx(0.001 * (row - 0.5), abs=1e-9)
    assert columns["sp"][row, 0] == pytest.approx(0.5 + 0.001 * (row - 0.5), abs=1e-9)
    np.testing.assert_allclose(np.abs(columns["q"][row]), [0.0, 0.0, 0.0, 1.0])


def test_without_log_variables_the_error_says_how_to_record_them(tmp_path):
    path = record(tmp_path / "a.mcap", logs=())
    with pytest.raises(ConfigError, match=r"self\.log\('gyro\.x'"):
        read_flight_columns(path)


def test_a_missing_variable_is_named(tmp_path):
    path = record(tmp_path / "a.mcap", logs=FIRMWARE_LOGS[:-1])
    with pytest.raises(ConfigError, match="no vbat"):
        read_flight_columns(path)


def test_one_of_several_drones_must_be_chosen(tmp_path):
    path = record(tmp_path / "a.mcap", drones=(3, 4))
    with pytest.raises(ConfigError, match="--drone"):
        read_flight_columns(path)
    assert len(read_flight_columns(path, 4)["t"]) == ROWS


def test_a_drone_is_chosen_by_its_name_in_the_recorded_swarm(tmp_path):
    drones = [{"id": i, "name": f"cf{i}", "home": [0, i - 3, 0]} for i in (3, 4)]
    swarm = SwarmConfig.of({"name": "lab", "drones": drones}).dumps()
    path = record(tmp_path / "a.mcap", drones=(4,), swarm=swarm)
    assert len(read_flight_columns(path, "cf4")["t"]) == ROWS
    with pytest.raises(ConfigError, match=r"found cf5.*cf3, cf4"):
        read_flight_columns(path, "cf5")
