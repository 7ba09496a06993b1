"""The missions that ship reach their goals."""

import os
import subprocess
import sys
from dataclasses import dataclass

import pytest
from system.commands import fly, run
from system.flights import scattered

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import has_hook, load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.launch.flight_observer import FlightScore
from crazychoir.types import Status

pytestmark = pytest.mark.system
KEYS = {
    "mission",
    "success",
    "drones",
    "simulated_s",
    "wall_s",
    "real_time_factor",
    "min_separation_m",
    "messages",
    "rounds",
    "digest",
}


def formed(seed, loss=0.0):
    """A formation of four in this process, in virtual time."""
    mission = load_mission("bearing_formation")
    return fly_fast(
        mission.scatter(mission.swarm(None).replace(seed=seed, network={"loss": loss})),
        mission,
    )


def flown(seed, loss):
    """The pickups and deliveries in this process, in virtual time."""
    mission = load_mission("pickup_delivery")
    return fly_fast(
        mission.swarm(None).replace(seed=seed, network={"loss": loss}), mission
    )


def settled(result, within=4.0):
    assert result["success"], result["reasons"]
    assert result["formation_error_m"] <= 0.01
    assert 0.5 < result["settling_s"] <= within
    assert result["min_separation_m"] > 0.15


def test_the_result_of_a_run_has_its_keys(here):
    result = here(
        "crazychoir", "run", "bearing_formation", "--fast", "--seed", 1, "--json"
    ).json
    assert set(result) >= KEYS | {"formation_error_m", "settling_s"}
    assert set(result["messages"]) >= {"sent", "lost", "resent"}
    settled(result)


def few(seeds, most):
    """The first `most` of these seeds; the rest is a campaign."""
    return [
        seed if k < most else pytest.param(seed, marks=pytest.mark.slow)
        for k, seed in enumerate(seeds)
    ]


@pytest.mark.parametrize("seed", few(range(20), 3))
def test_four_take_their_places_within_4_s(seed):
    settled(formed(seed))


@pytest.mark.parametrize("loss", [0.2, 0.3])
@pytest.mark.parametrize("seed", few(range(1, 7), 2))
def test_four_take_their_places_though_messages_are_lost(seed, loss):
    result = formed(seed, loss)
    assert result["success"], result["reasons"]
    assert result["formation_error_m"] <= 0.01
    assert 0.5 < result["settling_s"] <= 5.0


def test_the_settling_time_is_the_last_time_that_any_drone_is_far():
    @dataclass
    class Seen(FlightScore):
        def __post_init__(self):
            """No bus."""

    score = Seen(bus=None, ids=(0,))
    score.errors = [(0.0, 0.5), (1.0, 0.009), (2.0, 0.011), (3.0, 0.009)]
    assert score.formation() == {"formation_error_m": 0.009, "settling_s": 2.0}
    score.errors.append((4.0, 0.02))
    assert score.formation()["settling_s"] is None


@pytest.mark.real_time
def test_the_formation_in_real_time(formation):
    settled(formation[0], within=8.0)


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize("seed", range(20))
def test_the_formation_in_real_time_over_all_seeds(seed, tmp_path, compiled):
    settled(fly(scattered(seed), tmp_path), within=8.0)


def test_a_grid_without_diagonals_is_refused_with_the_reason(here, repository):
    said = here(
        "crazychoir",
        "run",
        repository / "tests/data/grid30_without_diagonals.toml",
        "--fast",
        "--json",
    )
    said.refuses("not bearing-rigid", "drones [2, 8, 14, 20, 26]", "Add a diagonal")
    assert said.json["success"] is False


@pytest.mark.timeout(180)
def test_a_grid_with_adjacent_leaders_starts_only_when_forced(here, repository):
    path = repository / "tests/data/grid30_adjacent_leaders.toml"
    here("crazychoir", "run", path, "--fast", "--json").refuses(
        "0.0018", "952 s", "force"
    )
    forced = here("crazychoir", "run", path, "--fast", "--json", "--force")
    assert (forced.code, forced.json["success"]) == (1, False), forced.err
    assert len(forced.json["reasons"]) == 28, (
        "all but the leaders are out of their places"
    )
    assert "0.0018" in forced.err
    assert forced.json["drones"] == 30
    assert forced.json["settling_s"] is None, "2 s of the law are not enough"


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_thirty_drones_take_their_places(repository):
    result = run(repository / "deploy" / "grid30.toml", "--fast", seconds=150.0)
    assert result["success"]
    assert result["formation_error_m"] <= 0.01
    assert result["settling_s"] <= 6.0


@pytest.mark.parametrize(
    ("seed", "loss"),
    [
        (3, 0.5),
        *(pytest.param(*both, marks=pytest.mark.slow) for both in ((1, 0.0), (2, 0.3))),
    ],
)
def test_pickups_and_deliveries_keep_their_distance(seed, loss):
    served(flown(seed, loss))


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("seed", range(10, 20))
def test_pickups_and_deliveries_keep_their_distance_over_many_seeds(seed, loss):
    served(flown(seed, loss))


def served(result):
    assert result["success"], result["reasons"]
    assert result["tasks"] == {"total": 10, "served": 10}
    assert result["violations"] == []
    assert result["min_separation_m"] > 0.24, "two semi-axes"
    assert result["simulated_s"] < 45.0, (
        "with flights that wait for each other it was 49 s"
    )
    for robot, planned in result["planned_m"].items():
        assert 0.95 * planned < result["flown_m"][robot] < 2.0 * planned + 1.0, (
            "the route, and round each other"
        )


def test_a_drone_that_is_stopped_on_its_way_still_gets_there():
    mission = load_mission("pickup_delivery")
    config = mission.swarm(None).replace(seed=2, mocap={"dropout": 0.6})
    notes = set()

    def watch(score):
        notes.update(
            status.note
            for status in score.statuses.values()
            if isinstance(status, Status)
        )

    result = fly_fast(config, mission, watch)
    assert any("pose" in note for note in notes), (
        "poses were missed often enough to matter"
    )
    assert result["success"], result["reasons"]
    assert result["tasks"] == {"total": 10, "served": 10}


def test_every_swarm_file_that_ships_is_valid(repository):
    for path in sorted((repository / "deploy").glob("*.toml")):
        config = SwarmConfig.load(path)
        mission = load_mission(str(config.mission))
        original = path.stem.startswith(
            "original_"
        )  # one of them is as slow as it is known to be
        notes = mission.check(config, original) if has_hook(mission, "check") else []
        assert original or not any(
            "slow" in note or "margin" in note for note in notes
        ), path.name


CORE_TYPES = ("Prescott", "Haswell")
"""Types of processors with kernels of their own in OpenBLAS."""
PRODUCT = """
import numpy as np
values = np.random.default_rng(0).normal(size=(50, 50))
print((values @ values).tobytes().hex())
"""


@pytest.fixture(scope="module")
def roundings():
    """Skip if the BLAS of this machine rounds products in the same way for both core types."""
    products = [
        subprocess.run(
            [sys.executable, "-c", PRODUCT],
            env={**os.environ, "OPENBLAS_CORETYPE": core},
            capture_output=True,
            check=True,
        ).stdout
        for core in CORE_TYPES
    ]
    if products[0] == products[1]:
        pytest.skip("this BLAS has one way to round only")


@pytest.mark.parametrize(
    "words",
    [
        ["crossing", "--drones", "6"],
        ["aggregative"],
        ["pickup_delivery"],
    ],
    ids=lambda words: words[0],
)
@pytest.mark.usefixtures("roundings")
def test_a_flight_does_not_depend_on_how_the_machine_multiplies_matrices(words):
    """Each core type of OpenBLAS rounds products in another way."""
    digests = [
        run(*words, "--fast", OPENBLAS_CORETYPE=core)["digest"] for core in CORE_TYPES
    ]
    assert digests[0] == digests[1]
