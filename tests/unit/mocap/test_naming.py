import numpy as np
import pytest

from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.naming import match_bodies, measure_bodies


def seen(**places):
    return [
        PoseFrame(
            k, 0.01 * k, {n: np.array([*p, 0, 0, 0, 1.0]) for n, p in places.items()}
        )
        for k in range(200)
    ]


def test_bodies_are_listed_with_place_rate_and_how_far_they_moved():
    frames = seen(a=(1, 2, 0), b=(0, 0, 1))
    for k, frame in enumerate(frames):
        frame.bodies["b"][0] = 0.1 * (-1) ** k
        if k % 2:
            del frame.bodies["a"]
    one, other = measure_bodies(frames, 2.0)
    assert (one.name, one.rate, one.spread) == ("a", 50.0, 0.0)
    assert (other.name, other.rate) == ("b", 100.0)
    assert other.spread == pytest.approx(0.1)
    np.testing.assert_allclose(one.p, [1, 2, 0])


def test_the_sum_of_the_distances_is_least_not_each_of_them():
    """The body nearest to drone 0 goes to drone 1: the other body is far from drone 1."""
    found = match_bodies(
        measure_bodies(seen(p=(0.1, 0, 0), q=(-0.25, 0, 0)), 2.0),
        {0: (0, 0, 0), 1: (0.2, 0, 0)},
    )
    assert [(m.drone, m.name, m.sure) for m in found] == [
        (0, "q", True),
        (1, "p", True),
    ]


def test_more_bodies_than_drones_and_fewer():
    homes = {0: (0, 0, 0), 1: (1, 0, 0)}
    found = match_bodies(
        measure_bodies(seen(wand=(3, 3, 1), a=(1.01, 0, 0), b=(0, 0.02, 0)), 2.0), homes
    )
    assert {m.drone: m.name for m in found} == {0: "b", 1: "a"}
    assert [
        (m.drone, m.sure)
        for m in match_bodies(measure_bodies(seen(a=(0.9, 0, 0)), 2.0), homes)
    ] == [(1, True)]
    assert match_bodies([], homes) == []


def test_a_body_far_from_every_home_is_not_sure():
    (found,) = match_bodies(measure_bodies(seen(a=(0.5, 0, 0)), 2.0), {0: (0, 0, 0)})
    assert not found.sure
