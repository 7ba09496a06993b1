"""Log variables of the swarm file, recorded and drawn."""

import csv
from itertools import pairwise

import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.launch.recording import open_recording_file
from crazychoir.recording.analysis.log_plots import log_pictures, read_logged_variables
from crazychoir.recording.analysis.plots import draw

HEIGHT = "stateEstimate.z"


def swarm(*variables):
    return SwarmConfig.of(
        {
            "name": "two",
            "mission": "goto",
            "graph": "complete",
            "drones": [{"id": i, "home": [float(i), 0.0, 0.0]} for i in range(2)],
            "mission_options": {
                "goals": {str(i): [[5.0, float(i), 0.0, 1.0]] for i in range(2)}
            },
            "logs": [{"variables": list(variables), "rate": 5, "drones": [1]}],
        }
    )


def fly(config, path=None):
    mission = load_mission(config.mission)
    with open_recording_file(path, config, mission, virtual=True) as file:
        return fly_fast(config, mission, file=file)


def test_the_variables_of_the_swarm_file_are_recorded_and_drawn(tmp_path):
    file = tmp_path / "flight.mcap"
    assert fly(swarm(HEIGHT), file)["success"]
    logged = read_logged_variables(file, 0.0)
    assert list(logged.rows) == [HEIGHT]
    assert list(logged.rows[HEIGHT]) == [1]
    t, heights = zip(*logged.rows[HEIGHT][1], strict=True)
    steps = [b - a for a, b in pairwise(t)]
    assert min(steps) == pytest.approx(0.2, abs=0.02)
    assert max(heights) == pytest.approx(1.0, abs=0.1)
    assert [path.name for path in draw(log_pictures(logged), tmp_path)] == [
        "logs.png",
        "logs.pdf",
    ]
    logged.write(tmp_path / "logs.csv")
    rows = list(csv.DictReader((tmp_path / "logs.csv").read_text().splitlines()))
    assert len(rows) == len(t)
    assert rows[0]["variable"] == HEIGHT


def test_a_variable_that_a_drone_does_not_have_is_refused_before_the_flight():
    with pytest.raises(ConfigError, match=r"drone 1: log.*stateEstimate\.w"):
        fly(swarm("stateEstimate.w"))
