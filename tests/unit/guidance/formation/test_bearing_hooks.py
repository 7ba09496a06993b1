"""What a bearing formation needs beside its law: gains by law and drones, shapes, reports."""

import numpy as np
import pytest

from crazychoir.control.gains import (
    AGILE_GAINS,
    FORMATION_GAINS,
    FORMATION_GAINS_ON_MOTORS,
)
from crazychoir.errors import ConfigError
from crazychoir.guidance.formation.bearing_hooks import BearingHooks, BearingOptions

HOOKS = BearingHooks(BearingOptions)


def swarm(uri="sim://", **options):
    """The square with these options, and with drones of this kind."""
    config = HOOKS.swarm(4)
    drones = [
        {"id": d.id, "home": d.home, "leader": d.leader, "uri": uri}
        for d in config.drones
    ]
    return config.replace(drones=drones, mission_options=options)


@pytest.mark.parametrize(
    ("law", "uri", "gains", "control"),
    [
        ("normalised", "sim://", (8.0, 4.5, 1.0), AGILE_GAINS),
        ("normalised", "sim://motors", (8.0, 4.5, 1.0), AGILE_GAINS),
        ("paper", "sim://", (1.6, 4.6, 1.0), FORMATION_GAINS),
        ("paper", "sim://motors", (4.0, 6.0, 0.5), FORMATION_GAINS_ON_MOTORS),
    ],
)
def test_gains_suit_law_and_drones(law, uri, gains, control):
    config = swarm(uri, law=law)
    found = HOOKS.law(config)
    assert (found.kp, found.kv, found.in_height) == gains
    assert HOOKS.gains(config) == control
    assert HOOKS.rest(config) == (4.0 if law == "paper" else 0.0)


def test_given_gains_are_taken():
    found = HOOKS.law(swarm(kp=2.0, kv=3.0))
    assert (found.kp, found.kv) == (2.0, 3.0)


@pytest.mark.parametrize("drones", [4, 11, 30])
def test_own_swarms_have_their_size_and_may_fly(drones):
    config = HOOKS.swarm(drones)
    assert len(config.ids) == drones
    assert HOOKS.check(config) == []


@pytest.mark.parametrize(
    ("move", "is_warned_of"),
    [
        (lambda i, home: home + np.array([0.4, -0.2, 0.0]), False),
        (lambda i, home: 1.3 * home, False),
        (lambda i, home: home + np.array([0.0, 0.3 * (i == 0), 0.0]), True),
    ],
    ids=["moved", "scaled", "one leader aside"],
)
def test_leaders_that_distort_the_shape_are_warned_of(move, is_warned_of):
    config = HOOKS.swarm(4)
    drones = [
        {"id": d.id, "home": move(d.id, np.array(d.home)).tolist(), "leader": d.leader}
        for d in config.drones
    ]
    warnings = HOOKS.check(config.replace(drones=drones))
    assert any("will not be the shape" in text for text in warnings) is is_warned_of


def test_other_sizes_are_refused():
    with pytest.raises(ConfigError, match=r"4 .a square., 11 .a letter. or 30"):
        HOOKS.swarm(5)


def test_report_names_the_drone_and_the_neighbours_that_it_did_not_hear():
    config = HOOKS.swarm(4)
    ends = {
        i: {"place": p, "unheard_s": {0: 0.5} if i == 2 else {}}
        for i, p in HOOKS.goal(config).items()
    }
    assert HOOKS.report(config, ends) == {"success": True, "reasons": {}}
    ends[2]["place"] = ends[2]["place"] + np.array([0.0, 0.0, 0.02])
    assert HOOKS.report(config, ends)["reasons"] == {
        2: "0.020 m from its place at the end of the law, allowed 0.01 m; did not hear drone 0 for 0.50 s"
    }
