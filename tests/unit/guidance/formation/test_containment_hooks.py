"""What containment needs beside its law."""

import numpy as np
import pytest

from crazychoir.guidance.formation.containment_hooks import (
    ContainmentHooks,
    ContainmentOptions,
)

HOOKS = ContainmentHooks(ContainmentOptions)


def test_each_follower_ends_at_the_mean_of_its_neighbours():
    config = HOOKS.swarm()
    goals = HOOKS.goal(config)
    for i in (4, 5, 6, 7):
        heard = [goals[j] for j in config.graph().in_neighbors(i)]
        np.testing.assert_allclose(goals[i], np.mean(heard, axis=0), atol=1e-12)


def test_random_edges_have_their_share_and_static_edges_all():
    config = HOOKS.swarm()
    assert HOOKS.edges(4, config).share == 1.0
    assert HOOKS.edges(4, config).neighbors == config.graph().in_neighbors(4)
    options = {"edges": "random", "share": 0.7}
    assert HOOKS.share(config.replace(mission_options=options)) == 0.7


def test_a_follower_outside_of_the_hull_is_named():
    config = HOOKS.swarm()
    ends = {i: {"place": p} for i, p in HOOKS.goal(config).items()}
    assert HOOKS.report(config, ends)["success"]
    ends[5]["place"] = np.array([-1.5, 0.0, 1.0])
    report = HOOKS.report(config, ends)
    assert report["reasons"] == {5: "0.300 m outside of the leaders' hull"}
    assert report["outside_m"] == pytest.approx(0.3, abs=1e-3)
