"""What a user asks to fly: missions, swarms, and the values that replace those of the swarm."""

from types import SimpleNamespace

import pytest

from crazychoir import CFGuidance
from crazychoir.api.flight_request import (
    FlightRequest,
    replace_options,
    replace_swarm_values,
)
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import ConfigError

PAIRS = default_swarm(4).replace(processes=[[0, 1], [2], [3]])


class RisingHigh(CFGuidance):
    async def mission(self):
        await self.take_off()


def test_a_request_changes_what_it_names_and_nothing_else():
    config = PAIRS.replace(network={"loss": 0.1, "delay": 0.02})
    assert replace_swarm_values(config, None, None, None) is config
    other = replace_swarm_values(config, 0.5, 7, "bearing_formation")
    assert (other.network.loss, other.network.delay) == (0.5, 0.02)
    assert (other.seed, other.mission) == (7, "bearing_formation")
    assert other.ids == config.ids


def test_a_swarm_file_keeps_its_name_and_ports(tmp_path):
    path = tmp_path / "swarm.json"
    path.write_text(PAIRS.replace(mission="bearing_formation", base_port=7999).dumps())
    assert FlightRequest(str(path)).choose()[0] == SwarmConfig.load(path)
    config, mission = FlightRequest(
        "bearing_formation", swarm=str(path), seed=3
    ).choose()
    assert (config.name, config.base_port, config.seed) == (PAIRS.name, 7999, 3)
    assert callable(mission.guidance)


def test_a_mission_without_a_swarm_of_its_own_gets_one(tmp_path):
    path = tmp_path / "mission.py"
    path.write_text("def guidance(i, config): ...\n")
    assert FlightRequest(str(path)).choose()[0].ids == (
        0,
        1,
        2,
        3,
    )
    assert FlightRequest(str(path), drones=6).choose()[0].ids == tuple(range(6))


@pytest.mark.parametrize(
    "what",
    [
        RisingHigh,
        SimpleNamespace(guidance=lambda i, config: RisingHigh()),
        lambda i, config: RisingHigh(),
    ],
    ids=["class", "object", "function"],
)
def test_a_mission_need_not_be_a_file(what):
    config, mission = FlightRequest(what, drones=2).choose()
    assert isinstance(mission.guidance(1, config), RisingHigh)
    assert config.ids == (0, 1)


def test_a_class_names_its_mission_as_a_file_would():
    assert FlightRequest(RisingHigh).choose()[0].mission == "rising_high"


@pytest.mark.parametrize("name", ["nothere.py", "nothere"])
def test_a_mission_that_does_not_exist_is_refused_with_the_file_that_names_it(
    tmp_path, name
):
    file = tmp_path / "lab.toml"
    drone = "[[drones]]\nid = 0\nhome = [0, 0, 0]\n"
    file.write_text(f'name = "a"\nmission = "{name}"\n{drone}')
    with pytest.raises(ConfigError, match=r"lab.toml: mission: found .*nothere"):
        FlightRequest(str(file)).choose()


def test_what_is_no_mission_is_refused():
    with pytest.raises(ConfigError, match=r"mission: found int 3.*a class of guidance"):
        FlightRequest(3).choose()


def test_options_replace_values_of_the_mission_and_of_tables():
    config = PAIRS.replace(mission_options={"gain": 1.0, "laps": 2})
    other = replace_options(config, {"gain": 3.0, "network.delay": 0.01})
    assert other.mission_options == {"gain": 3.0, "laps": 2}
    assert other.network.delay == 0.01
    assert replace_options(config, {}) is config


@pytest.mark.parametrize("name", ["networks.loss", "name.x"])
def test_an_option_of_no_table_is_refused(name):
    with pytest.raises(ConfigError, match=f"options: {name}.*no such table"):
        replace_options(PAIRS, {name: 1})


def test_a_key_that_a_table_has_not_is_refused():
    with pytest.raises(ConfigError, match=r"network\.los.*loss"):
        replace_options(PAIRS, {"network.los": 0.1})


@pytest.mark.parametrize(
    ("request_values", "said"),
    [
        ({"swarm": PAIRS, "drones": 6}, "drones: found 6 beside a swarm file"),
        ({"drones": 5}, "drones: found 5; allowed: .*4"),
    ],
)
def test_values_that_contradict_each_other_are_refused(request_values, said):
    with pytest.raises(ConfigError, match=said):
        FlightRequest("bearing_formation", **request_values).choose()
