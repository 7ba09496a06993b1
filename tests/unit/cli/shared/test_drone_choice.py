"""Drones that are chosen by ids and by names."""

import pytest

from crazychoir.cli.shared.drone_choice import parse_choice, parse_one_drone
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError

NAMES = {3: "cf231", 5: "north-east", 6: "7", 7: ""}
CONFIG = SwarmConfig.of(
    {
        "name": "named",
        "drones": [
            {"id": i, "name": name, "home": [0.4 * i, 0.0, 0.0]}
            for i, name in NAMES.items()
        ],
    }
)


@pytest.mark.parametrize(
    ("text", "ids"),
    [
        ("3, 5-7,3", [3, 5, 6, 7]),
        ("cf231", [3]),
        ("7, north-east ,3,cf231", [7, 5, 3]),
    ],
)
def test_drones_are_chosen_by_ids_ranges_and_names(text, ids):
    assert parse_choice(text, "--drones").find(CONFIG) == ids


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("cf213", r"--drones.*Did you mean cf231\?"),
        ("zebra", "cf231, north-east, 7, or the ids 3, 5, 6, 7"),
        ("4", "drone 4"),
    ],
)
def test_a_drone_that_is_not_there_is_refused_with_what_may_be_meant(text, said):
    choice = parse_choice(text, "--drones")
    with pytest.raises(ConfigError, match=said):
        choice.find(CONFIG)


@pytest.mark.parametrize("text", ["", "3,", "7-5", "3;5", "a b"])
def test_another_form_is_refused_before_the_swarm_is_known(text):
    with pytest.raises(ConfigError, match=r"--only.*as 3,5-7"):
        parse_choice(text, "--only")


def test_one_drone_is_chosen_by_its_id_or_its_name():
    assert parse_one_drone(None, "--drone") is None
    assert parse_one_drone("5", "--drone").find(CONFIG) == [5]
    assert parse_one_drone("cf231", "--drone").find(CONFIG) == [3]
    with pytest.raises(ConfigError, match=r"--drone.*one drone, by its id or its name"):
        parse_one_drone("3,5", "--drone")
