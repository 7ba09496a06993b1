"""What the surveillance mission needs beside its law: its checks, and how it judges defenders."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.defaults.aggregative import (
    STANDING_INTRUDERS,
    DefenceHooks,
    DefenceOptions,
    build_defender_graph,
    compute_lag,
    list_defenders,
    list_intruders,
)

HOOKS = DefenceHooks(DefenceOptions)
INTRUDER_HOMES = ((-1.6, 1.6), (-1.6, -1.6), (1.6, 0.2))


def test_defenders_that_stand_wrong_or_follow_late_are_no_success():
    config = HOOKS.swarm(None)
    t = np.arange(0.0, 12.0, 0.1)
    seen = {
        i: np.column_stack([t, *np.outer([x, y], 1.0 + 0.1 * t), 0 * t])
        for i, (x, y) in enumerate(STANDING_INTRUDERS)
    }

    def judged(late, off):
        """Defenders that are half-way `late` s late, the first one also `off` m aside."""
        results = {}
        for i, rows in seen.items():
            way = rows.copy()
            way[:, 1:3] = (
                0.5
                * rows[:, 1:3]
                * ((1.0 + 0.1 * (t - late)) / (1.0 + 0.1 * t))[:, None]
            )
            way[-1, 1:3] = 0.5 * rows[-1, 1:3] + [off if i == 0 else 0.0, 0.0]
            results[i] = {
                "way": way.tolist(),
                "intruder_way": rows.tolist(),
                "rounds": 1,
            }
        return HOOKS.report(config, results)

    assert judged(1.0, 0.0)["success"] is True
    assert judged(1.0, 0.0)["lag_s"] == pytest.approx(1.0, abs=0.05)
    assert "s late, allowed 1.5 s" in judged(2.5, 0.0)["reasons"][0]
    assert "0.030 m from its place" in judged(0.0, 0.03)["reasons"][0]
    assert judged(0.0, 0.0).keys() >= {"lag_s", "following_rms_m", "final_error_m"}


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.2])
def test_the_lag_is_the_shift_that_fits(delay):
    t = np.arange(0.0, 20.0, 0.1)
    wanted = np.stack([np.sin(0.5 * t), np.cos(0.3 * t)], axis=1)[:, None]
    flown = np.stack([np.sin(0.5 * (t - delay)), np.cos(0.3 * (t - delay))], axis=1)
    assert compute_lag(t, flown[:, None], wanted) == pytest.approx(delay, abs=0.021)


def moving():
    """Three defenders, and three intruders that fly."""
    config = HOOKS.swarm()
    drones = [
        {"id": i, "home": [x, y, 0.0], "role": "intruder"}
        for i, (x, y) in zip((3, 4, 5), INTRUDER_HOMES, strict=True)
    ]
    defenders = [{"id": d.id, "home": d.home} for d in config.drones]
    edges = [[0, 1], [1, 2], [0, 3], [1, 4], [2, 5]]
    return config.replace(graph=None, edges=edges, drones=defenders + drones)


def test_intruders_that_fly_go_from_home_to_home():
    config = moving()
    assert list_defenders(config) == [0, 1, 2]
    assert list_intruders(config) == [3, 4, 5]
    assert HOOKS.intruder(1, config) == 4
    assert build_defender_graph(config).edges() == ((0, 1), (1, 2))
    assert HOOKS.goal(config) == {}
    assert HOOKS.duration(config) == pytest.approx(3 * 15.0 + 4.0 + 1.0)
    path = HOOKS.path(3, config)
    for leg, k in enumerate((0, 1, 2, 0)):
        place = path.sample(15.0 * leg).p[:2]
        assert place == pytest.approx(INTRUDER_HOMES[k], abs=1e-6)


def test_a_defender_that_does_not_hear_its_intruder_is_named():
    config = moving().replace(edges=[[0, 1], [1, 2], [0, 3], [1, 4], [3, 5]])
    with pytest.raises(ConfigError, match=r"no edge 2-5.*Add the edge \[2, 5\]"):
        HOOKS.check(config)


def test_there_is_an_intruder_for_each_defender():
    config = HOOKS.swarm().replace(mission_options={"intruders": [[1.0, 0.0]]})
    with pytest.raises(ConfigError, match=r"1 places in mission_options.intruders"):
        HOOKS.check(config)
