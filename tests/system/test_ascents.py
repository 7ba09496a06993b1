"""Take-offs with exchanged or turned bodies: agents, the owner of the dongles, firmware and motors, in virtual time."""

import math

import numpy as np
import pytest
from system.ascents import ascend, swarm

pytestmark = pytest.mark.system
WINDY = {
    "motors": {"gusts": 0.3, "wind": [0.5, 0.3, 0.0]},
    "mocap": {"latency": 0.01, "dropout": 0.05},
}
NAMED = "it does not tilt as its body does, but as "
WRONG = {
    "exchanged": ({"reaches": {0: 1, 1: 0}}, (0, 1)),
    "turned": ({"turned": {0: math.pi}}, (0,)),
    "turned by a quarter": ({"turned": {0: -math.pi / 2}}, (0,)),
}


def check(tracks, wrong) -> None:
    """Check that the wrong drones, and no others, are named and come down near where they stood."""
    for i, track in tracks.items():
        assert track.result["success"] is (i not in wrong), (i, track.result)
        if i in wrong:
            assert NAMED in track.result["reason"], track.result
            rows = np.array(track.rows)
            on = rows[rows[:, 5] > 0.01]
            assert not len(on) or np.abs(on[:, 1:3] - rows[0, 1:3]).max() < 0.5
            assert rows[-1, 3] < 0.05
            assert np.degrees(track.found[2]) < 15.0, "tilted, when it is named"


@pytest.mark.parametrize(
    ("kind", "case"),
    [("fpqr", "exchanged"), ("frpy", "turned by a quarter"), ("xyz", "turned")],
)
def test_wrong_bodies_are_named_in_the_ascent(kind, case):
    options, wrong = WRONG[case]
    check(ascend(swarm(kind), 2, **options, hover=1.0), wrong)


def test_bodies_that_are_their_drones_are_let_fly():
    check(ascend(swarm("frpy", **WINDY), 1, hover=1.0), ())


def test_a_drone_that_takes_off_alone_with_another_drones_body_fails():
    tracks = ascend(swarm("xyz"), 3, reaches={0: 1, 1: 0}, flying=(0,))
    assert not tracks[0].result["success"]
    assert tracks[0].found[1] < 0.6


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("kind", ["fpqr", "frpy", "xyz"])
def test_take_offs_in_wind_are_stopped_only_for_a_fault(
    kind,
):
    for seed in range(20):
        check(ascend(swarm(kind, **WINDY), seed), ())
        for options, wrong in WRONG.values():
            check(ascend(swarm(kind, **WINDY), seed, **options, hover=1.0), wrong)
