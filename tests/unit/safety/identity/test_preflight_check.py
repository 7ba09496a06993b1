import math

import numpy as np
import pytest

from crazychoir.numerics.math3d import (
    quaternion_of_yaw,
    quaternion_product,
    rotation_exponential,
)
from crazychoir.safety.identity.preflight_check import (
    GroundedDrone,
    find_arming_problems,
)
from crazychoir.types import Pose

HOMES = {
    0: np.array([0.0, 0.0, 0.0]),
    1: np.array([1.0, 0.0, 0.0]),
    2: np.array([0.0, 1.0, 0.0]),
}


def at(p, yaw=0.0, tilt=0.0):
    q = quaternion_product(
        tuple(quaternion_of_yaw(yaw)), rotation_exponential(tilt, 0.0, 0.0)
    )
    return Pose(np.array([*p, *q]))


def standing(**changes):
    """Three drones at home, each as it says; changes: `own1`, `seen2`."""
    return {
        i: GroundedDrone(
            home,
            changes.get(f"own{i}", at(home)),
            changes.get(f"seen{i}", at(home + 0.004)),
        )
        for i, home in HOMES.items()
    }


def said(drones, i=1):
    found = find_arming_problems(i, drones)
    assert all(find_arming_problems(j, drones) == [] for j in drones if j != i)
    return found


def test_nothing_is_said_where_all_agrees():
    assert said(standing()) == []
    assert said(standing(own1=at((1.03, 0.03, 0.0), yaw=math.radians(4.5)))) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"own1": None}, "it does not say where it is"),
        ({"seen1": None}, "the cameras do not see it"),
        (
            {"own1": at((1.06, 0, 0))},
            "it takes itself to be 0.06 m from where it is seen, limit 0.05 m",
        ),
        ({"own1": at((math.nan, 0, 0))}, "it takes itself to be nan m"),
        (
            {"own1": at((1, 0, 0), yaw=math.pi)},
            "it looks 180 deg away from how it is seen, limit 5 deg",
        ),
        (
            {"own1": at((1, 0, 0), yaw=-3.1), "seen1": at((1, 0, 0), yaw=3.05)},
            "it looks 8 deg away",
        ),
        (
            {"seen1": at((1, 0, 0), tilt=0.12)},
            "it is seen tilted by 7 deg from what it says, limit 5 deg",
        ),
    ],
)
def test_what_does_not_agree_keeps_it_on_the_ground(changes, words):
    (text,) = said(standing(**changes))
    assert text.startswith(words)


def test_exchanged_bodies_are_seen_by_where_they_stand_although_each_drone_believes_the_cameras():
    drones = standing(
        seen0=at(HOMES[1]), own0=at(HOMES[1]), seen1=at(HOMES[0]), own1=at(HOMES[0])
    )
    assert find_arming_problems(0, drones) == [
        "its body is 0.00 m from the home of drone 1, 1.00 m from its own: exchanged with that of drone 1"
    ]
    assert "exchanged with that of drone 0" in find_arming_problems(1, drones)[0]
    assert find_arming_problems(2, drones) == []


def test_a_body_at_an_occupied_home_is_not_called_exchanged():
    (text,) = said(standing(seen1=at((0.1, 0.9, 0.0)), own1=at((0.1, 0.9, 0.0))))
    assert text == "its body is 0.14 m from the home of drone 2, 1.27 m from its own"


def test_a_drone_that_need_not_stand_at_home_may_stand_anywhere():
    drones = {i: GroundedDrone(None, at(HOMES[1]), at(HOMES[1])) for i in HOMES}
    assert find_arming_problems(0, drones) == []
