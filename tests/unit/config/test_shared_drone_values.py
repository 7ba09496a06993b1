"""[defaults] and drones that are left out of the run."""

import pytest

from crazychoir.config.calibrated import find_firmware, find_known_platform
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError

DRONES = """
[[drones]]
id = 0
home = [0, 0, 0]
[[drones]]
id = 1
name = "cf231"
home = [1, 0, 0]
platform = "cf21plus"
parameters = { "posCtlPid.xKp" = 3.0 }
[[drones]]
id = 2
home = [2, 0, 0]
enabled = false
"""
DEFAULTS = """
[defaults]
platform = "cf21bl"
leader = true
parameters = { "posCtlPid.xKp" = 2.0, "ring.effect" = 7 }
battery_warning = 3.6
battery_critical = 3.1
"""


def load(head="", tables=DEFAULTS):
    return SwarmConfig.loads(f'name = "a"\n{head}\n{tables}{DRONES}', "a.toml")


def test_drones_have_the_defaults_unless_they_say_otherwise():
    config = load()
    assert [drone.platform for drone in config.drones] == ["cf21bl", "cf21plus"]
    assert all(drone.leader for drone in config.drones)
    assert config.drone(0).parameters == {"posCtlPid.xKp": 2.0, "ring.effect": 7}
    assert config.drone(1).parameters == {"posCtlPid.xKp": 3.0, "ring.effect": 7}
    assert SwarmConfig.loads(config.dumps()) == config


def test_all_drones_may_fly_in_one_world_but_not_share_an_address():
    config = load(tables='[defaults]\nuri = "sim://motors"\n')
    assert {drone.uri for drone in config.drones} == {"sim://motors"}
    with pytest.raises(ConfigError, match=r"drones\[0\] has this address"):
        load(tables='[defaults]\nuri = "udp://127.0.0.1:19850"\n')
    with pytest.raises(ConfigError, match=r"drones\[0\].uri.* sim://motor"):
        load(tables='[defaults]\nuri = "sim://motor"\n')


def test_a_key_that_belongs_to_one_drone_is_no_default():
    with pytest.raises(ConfigError, match=r"defaults.name = .*: there is no such key"):
        load(tables='[defaults]\nname = "cf2"\n')
    with pytest.raises(ConfigError, match=r"a.toml: defaults.platform: found 3"):
        load(tables="[defaults]\nplatform = 3\n")


def test_drones_that_are_not_enabled_are_left_out_with_all_that_names_them():
    head = "edges = [[0, 1], [1, 2]]\nprocesses = [[0, 1], [2]]\n"
    logs = '[[logs]]\nvariables = ["pm.vbat"]\ndrones = [2]\n'
    config = load(head, DEFAULTS + logs)
    assert config.ids == (0, 1)
    assert config.left_out == (2,)
    assert config.edges == ((0, 1),)
    assert config.processes == ((0, 1),)
    assert config.logs == ()


def test_a_list_leaves_out_drones_too_and_one_must_remain():
    assert load("left_out = [0]").ids == (1,)
    with pytest.raises(ConfigError, match="no drone; allowed: one or more"):
        load("left_out = [0, 1]")


def test_neighbours_forget_a_drone_that_is_left_out():
    rows = [
        {
            "id": i,
            "home": [float(i), 0.0, 0.0],
            "neighbors": [j for j in range(3) if j != i],
        }
        for i in range(3)
    ]
    config = SwarmConfig.of({"name": "a", "drones": rows, "left_out": [1]})
    assert config.drone(0).neighbors == (2,)


def test_names_are_there_once_and_name_the_body_in_motion_capture():
    config = load()
    assert config.body_name(1) == "cf231"
    assert config.body_name(0) == "cf0"
    twice = DRONES.replace("id = 0", 'id = 0\nname = "cf231"')
    with pytest.raises(ConfigError, match=r"drones\[1\].name.*drones\[0\] has this"):
        SwarmConfig.loads(f'name = "a"\n{twice}', "a.toml")


def test_batteries_have_the_limits_of_the_file():
    config = load()
    assert find_known_platform(config.drone(0)).battery.begin == 3.6
    assert find_firmware(config.drone(0)).low == 3.1
    plain = load(tables="")
    assert find_known_platform(plain.drone(0)).battery.begin == 3.7
    assert find_firmware(plain.drone(0)).low == 3.2
    with pytest.raises(
        ConfigError, match=r"battery_critical: found 3\.9; allowed: below"
    ):
        load(tables="[defaults]\nbattery_warning = 3.8\nbattery_critical = 3.9\n")


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ('variables = ["pm.vbat"]\nrate = 30', r"logs\[0\].rate: found 30.*33.33"),
        ('variables = ["pm.vbat"]\ndrones = [7]', r"logs\[0\].drones = .*no drone 7"),
        ("variables = []", r"logs\[0\].variables: found \[\]"),
        ('variables = ["vbat"]', r"logs\[0\].variables"),
    ],
)
def test_wrong_logs_are_refused_with_their_key(row, words):
    with pytest.raises(ConfigError, match=words):
        load(tables=f"[[logs]]\n{row}\n")
