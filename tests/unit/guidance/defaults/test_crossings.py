"""Random places of a crossing: clear of each other, and those of the seed."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.defaults.crossings import (
    SMALLEST_SPACING,
    SPACING_SCALE,
    CrossingHooks,
    CrossingOptions,
)

HOOKS = CrossingHooks(CrossingOptions)


@pytest.mark.parametrize("pattern", ["antipodal", "permutation"])
def test_places_are_clear_of_each_other(pattern):
    config = HOOKS.swarm(8).replace(seed=3, mission_options={"pattern": pattern})
    for places in HOOKS.places(config):
        at = np.array(list(places.values())) * SPACING_SCALE
        gaps = np.linalg.norm(at[:, None] - at[None], axis=2) + 9.0 * np.eye(len(at))
        assert gaps.min() >= SMALLEST_SPACING


def test_a_permutation_moves_every_drone_to_the_start_of_another():
    config = HOOKS.swarm(8).replace(mission_options={"pattern": "permutation"})
    starts, goals = HOOKS.places(config)
    at = {tuple(p): i for i, p in starts.items()}
    assert sorted(at[tuple(p)] for p in goals.values()) == list(config.ids)
    assert all(at[tuple(p)] != i for i, p in goals.items())


def test_homes_are_below_the_starts():
    config = HOOKS.scatter(HOOKS.swarm(5).replace(seed=7))
    starts, _ = HOOKS.places(config)
    for drone in config.drones:
        assert drone.home == pytest.approx((*starts[drone.id][:2], 0.0))


def test_a_circle_that_is_too_small_is_refused():
    config = HOOKS.swarm(8)
    with pytest.raises(ConfigError, match="room for 8 drones"):
        HOOKS.places(config.replace(mission_options={"radius": 0.1}))
