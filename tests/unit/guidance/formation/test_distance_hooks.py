"""What a formation by distances needs beside its law."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.formation.distance_hooks import DistanceHooks, DistanceOptions
from crazychoir.guidance.mission_options import Gain, given


class MoreOptions(DistanceOptions, frozen=True, kw_only=True):
    pull: Gain = 0.5


HOOKS = DistanceHooks(DistanceOptions)


def test_own_swarm_is_a_regular_polygon_that_may_fly():
    config = HOOKS.swarm(7)
    assert HOOKS.check(config) == []
    near = {j: d for j, d in HOOKS.distances(0, config).items() if j in (1, 6)}
    assert near[1] == pytest.approx(near[6], abs=1e-3)
    assert HOOKS.level(config) == config.flight.ground + config.flight.takeoff_height


def test_four_corners_are_refused():
    with pytest.raises(ConfigError, match="5 or more"):
        HOOKS.swarm(4)


def test_a_shape_in_space_has_no_level():
    config = HOOKS.swarm()
    places = HOOKS.shape(config)
    shape = {str(i): [*p[:2].tolist(), 1.0 + 0.1 * i] for i, p in places.items()}
    assert HOOKS.level(config.replace(mission_options={"shape": shape})) is None


def test_gains_of_an_unstable_mode_are_refused():
    config = HOOKS.swarm()
    options = dict(config.mission_options) | {"k": 100.0}
    with pytest.raises(Refused, match=r"k = 100, kv = 1.2: its stiffest mode"):
        HOOKS.check(config.replace(mission_options=options))


def test_a_copy_of_the_mission_may_have_more_options():
    config = HOOKS.swarm()
    config = config.replace(
        mission_options=dict(config.mission_options) | {"pull": 2.0}
    )
    assert DistanceHooks(MoreOptions).check(config) == []
    assert given(config, MoreOptions).pull == 2.0
    with pytest.raises(ConfigError, match=r"pull = 2\.0: there is no such key"):
        HOOKS.check(config)


def test_report_names_a_wrong_distance():
    config = HOOKS.swarm()
    ends = {i: {"place": np.array(p)} for i, p in HOOKS.shape(config).items()}
    assert HOOKS.report(config, ends)["success"]
    ends[3]["place"] = ends[3]["place"] + [0.1, 0.0, 0.0]
    report = HOOKS.report(config, ends)
    assert not report["success"]
    assert 0.02 < report["distance_error_m"] <= 0.1
    assert "m wanted" in next(iter(report["reasons"].values()))
