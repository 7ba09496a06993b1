"""How exactly drones fly, as `crazychoir bench tracking` measures it: accuracy is asserted, time is not."""

import pytest

from crazychoir.bench import tracking as bench_tracking
from crazychoir.bench.tracking import (
    MODEL_CORNERS,
    NOMINAL_CORNER,
    fly_controllers,
    fly_whole_stack,
    original_controller,
    standard_controllers,
    tracking_row,
)
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.launch.recording import open_recording_file
from crazychoir.recording.analysis.figures import FLIGHT_TOPICS, recorded_flight
from crazychoir.recording.mcap.reading import read

pytestmark = pytest.mark.system
LIMITS_MM = {
    "lightweight": {"circle": 0.1, "eight-1": 0.2, "eight-2": 1.5},
    "motors": {"circle": 1.0, "eight-1": 3.0, "eight-2": 13.0},
}


def rmse_mm(errors):
    return tracking_row("", "", "", NOMINAL_CORNER, errors).rmse_mm


@pytest.mark.parametrize("plant", LIMITS_MM)
@pytest.mark.parametrize("name", ["circle", "eight-1", "eight-2"])
def test_the_controllers_alone(plant, name):
    assert (
        rmse_mm(fly_controllers(plant, name, standard_controllers(plant)))
        <= LIMITS_MM[plant][name]
    )


def test_the_gains_of_the_original_are_lost_behind_rotors_that_lag():
    assert fly_controllers("motors", "eight-1", original_controller("motors")) is None


def test_the_whole_stack_at_1_m_s():
    assert rmse_mm(fly_whole_stack("eight-1")) <= 8.0


@pytest.mark.parametrize(("name", "limit"), [("eight-1", 16.0), ("eight-2", 19.0)])
def test_a_typical_drone_flies_as_if_its_speed_made_no_moment(name, limit):
    """Its slow forces alone make 14 and 15 mm; without the feed-forward 31 and 68 mm are left."""
    assert rmse_mm(fly_whole_stack(name, imperfections=1.0)) <= limit


def test_a_part_of_a_flight_is_no_flight(monkeypatch):
    monkeypatch.setattr(bench_tracking, "is_counted", lambda t: 8.0 <= t <= 18.0)
    assert fly_whole_stack("eight-1") is None


@pytest.mark.parametrize("corner", MODEL_CORNERS[1::5], ids=lambda corner: corner.name)
def test_the_whole_stack_with_a_drone_that_is_not_what_its_controllers_believe(corner):
    assert rmse_mm(fly_whole_stack("eight-1", corner)) <= 20.0


@pytest.mark.parametrize(
    ("mission", "options", "says"),
    [
        ("figure", {"period": 1.0}, "drone 0: trajectory at .* s: acceleration"),
        (
            "figure",
            {"figure": "eight", "size": 1.5, "period": 40.0},
            "drone 1: trajectory: set-point.*fence",
        ),
        ("figure", {"size": "wide"}, "mission_options.size.*a length"),
        ("drawn_path", {}, "drone 1: .*fence"),
    ],
)
def test_what_one_of_the_drones_cannot_fly_is_refused_before_the_flight(
    mission, options, says
):
    drones = [{"id": 0, "home": [0.0, 0.0, 0.0]}, {"id": 1, "home": [1.5, 3.5, 0.0]}]
    config = SwarmConfig.of(
        {
            "name": "wide",
            "mission": mission,
            "mission_options": options,
            "graph": "path",
            "drones": drones,
            "fence": {"min": [-2.5, -2.5, 0.0], "max": [2.5, 4.0, 3.0]},
        }
    )
    with pytest.raises(ConfigError, match=says):
        load_mission(mission).check(config, False)


def test_a_drawn_word_is_flown_within_its_limits(tmp_path):
    config = SwarmConfig.load("deploy/casy.toml")
    path = tmp_path / "casy.mcap"
    with open_recording_file(
        path, config, load_mission("drawn_path"), virtual=True
    ) as file:
        result = fly_fast(config, load_mission("drawn_path"), file=file)
    assert result["success"], result["reasons"]
    assert result["speed_m_s"] <= config.flight.speed_limit
    assert result["acceleration_m_s2"] <= config.flight.acceleration_limit
    assert result["deviation_mm"] < 15.0
    flown = recorded_flight(read(path, FLIGHT_TOPICS)).figures()["drones"][0]
    assert flown["tracking_rmse_m"] < 0.020, "15 mm; without imperfections 3 mm"
    assert flown["fastest_m_s"] < 1.06 * config.flight.speed_limit
    assert result["drawing_s"] > 20.0
