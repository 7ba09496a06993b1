import pytest

from crazychoir.cli.shared.chosen_swarm import (
    check_options,
    drones_to_start,
)
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError

PAIRS = default_swarm(4).replace(processes=[[0, 1], [2], [3]])


def test_all_drones_start_unless_some_are_named():
    assert drones_to_start(None, PAIRS) == (0, 1, 2, 3)


@pytest.mark.parametrize(
    ("only", "here"),
    [("2", (2,)), ("3,2", (2, 3)), ("1, 0,1", (0, 1)), ("3,1,0", (0, 1, 3))],
)
def test_the_named_drones_start(only, here):
    assert drones_to_start(only, PAIRS) == here


@pytest.mark.parametrize("only", ["x", "", "2,", "17", "2;3"])
def test_drones_that_there_are_not_are_refused(only):
    with pytest.raises(ConfigError, match="--only"):
        drones_to_start(only, PAIRS)


def test_a_process_starts_whole_or_not():
    with pytest.raises(
        ConfigError, match=r"drones 0, 1 share a process.*Name all of them or none"
    ):
        drones_to_start("1,2", PAIRS)


NOTHING = {"--fast": False, "--processes": None, "--picture": None, "--drones": None}


def test_only_wants_a_swarm_file():
    with pytest.raises(ConfigError, match=r"--only.*2 without a swarm file.*--swarm"):
        check_options("bearing_formation", None, "2", NOTHING)
    check_options("bearing_formation", "swarm.toml", "2", NOTHING)
    check_options("swarm.toml", None, "2", NOTHING)


@pytest.mark.parametrize("option", ["--fast", "--processes", "--picture"])
def test_only_goes_with_nothing_of_a_whole_swarm(option):
    with pytest.raises(ConfigError, match=f"--only: found {option}"):
        check_options("swarm.toml", None, "2", NOTHING | {option: 2})


@pytest.mark.parametrize(
    ("what", "swarm", "given", "said"),
    [
        ("swarm.toml", None, {"--drones": 6}, "--drones: found 6 beside a swarm file"),
        (
            "bearing_formation",
            "swarm.toml",
            {"--drones": 6},
            "--drones: found 6 beside a swarm file",
        ),
        ("a.toml", "b.toml", {}, "--swarm: found b.toml beside a.toml"),
        (
            "bearing_formation",
            None,
            {"--fast": True, "--processes": 2},
            "--processes: found --fast beside it",
        ),
    ],
)
def test_an_option_that_would_say_nothing_is_refused(what, swarm, given, said):
    with pytest.raises(ConfigError, match=said):
        check_options(what, swarm, None, NOTHING | given)
    check_options(
        "bearing_formation", None, None, NOTHING | {"--drones": 6, "--processes": 2}
    )
    check_options(
        "bearing_formation", None, None, NOTHING | {"--drones": 6, "--fast": True}
    )
