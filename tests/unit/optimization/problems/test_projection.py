import cvxpy as cp
import numpy as np
import pytest

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.optimization.algorithms.set_membership import SetMembership
from crazychoir.optimization.algorithms.subgradient import SubgradientMethod
from crazychoir.optimization.problems.projection import (
    Box,
    Convex,
    Disc,
    Intersection,
    Strip,
)

SETS = {
    "box": Box(np.zeros(3), np.ones(3)),
    "strip": Strip([1.0, 0.0, 0.0], 1.0, 0.0),
    "disc": Disc([1.0, 0.0, 0.0], 1.0),
    "convex": Convex(cp.Variable(3), []),
}
SIZES = r"shape \(3,\).*shape \(2,\)|shape \(2,\).*shape \(3,\)"


@pytest.mark.parametrize("name", SETS)
def test_a_set_of_another_size_is_refused(name):
    for sets in (
        [SETS[name]],
        [SETS[name], Box(0.0, 1.0)],
        [Box(0.0, 1.0), SETS[name]],
        [SETS[name], SETS[name]],
    ):
        with pytest.raises(ConfigError, match=SIZES):
            Intersection(2, sets)
    known = Intersection(2, [])
    with pytest.raises(
        ConfigError,
        match=rf"set\[0\]: found a {type(SETS[name]).__name__} of points of shape \(3,\)",
    ):
        known.add(SETS[name])
    with pytest.raises(ConfigError, match=SIZES):
        SetMembership(0, np.zeros(2), {0: 1.0}, (SETS[name],))
    with pytest.raises(ConfigError, match=SIZES):
        SetMembership(0, np.zeros(2), {0: 1.0}, (), lambda: SETS[name]).step({})


@pytest.mark.parametrize("name", SETS)
def test_a_point_of_another_size_is_refused(name):
    for point in (np.zeros(2), np.zeros((3, 1)), np.float64(0.0)):
        with pytest.raises(
            ConfigError, match=r"point: found shape .*; allowed: shape \(3,\)"
        ):
            SETS[name].project(point)
    agent = SubgradientMethod(
        0, np.zeros(2), {0: 1.0}, lambda x: x, 0.1, SETS[name].project
    )
    agent.message()
    with pytest.raises(ConfigError, match=SIZES):
        agent.step({})


@pytest.mark.parametrize(
    "one", [Disc([1.0], 1.0), Strip([1.0], 1.0, 0.0), Box([0.0], [1.0])]
)
def test_a_set_of_one_entry_is_not_one_of_two_equal_ones(one):
    np.testing.assert_allclose(one.project(np.array([1.0])), 1.0)
    with pytest.raises(
        ConfigError, match=r"point: found shape \(2,\); allowed: shape \(1,\)"
    ):
        one.project(np.zeros(2))


def test_a_box_of_numbers_is_one_of_any_size():
    for shape in ((), (2,), (3, 2)):
        assert (
            Box(-1.0, 1.0).project(np.full(shape, 5.0)).tolist()
            == np.full(shape, 1.0).tolist()
        )
    assert Intersection(2, Box(-1.0, [1.0, 2.0])).project(np.full(2, 5.0)).tolist() == [
        1.0,
        2.0,
    ]


BAD_SETS = {
    "words in a box": (lambda: Box("a", 1.0), "box: low: found 'a'; allowed: a number"),
    "a box of two sizes": (
        lambda: Box([1.0, 2.0], [3.0, 4.0, 5.0]),
        "box: found .* of one shape",
    ),
    "a strip at a vector": (
        lambda: Strip([1.0, 0.0], [1.0, 2.0], 0.0),
        r"strip: b: found \[1.0, 2.0\]",
    ),
    "a strip as wide as a word": (
        lambda: Strip([1.0, 0.0], 1.0, "x"),
        "strip: width: found 'x'",
    ),
    "a strip of a matrix": (
        lambda: Strip(np.eye(2), 1.0, 0.0),
        r"strip: a: found shape \(2, 2\)",
    ),
    "a disc as large as a word": (lambda: Disc([1.0], "x"), "disc: radius: found 'x'"),
    "a disc about a matrix": (
        lambda: Disc(np.eye(2), 1.0),
        r"disc: c: found shape \(2, 2\)",
    ),
    "a number": (lambda: Intersection(2, [3]), r"set\[0\]: found 3; allowed: a set"),
    "no list": (lambda: Intersection(2, 3), "set: found 3; allowed: a list of sets"),
    "a comparison": (
        lambda: Intersection(2, [cp.Variable(2) >= 0]),
        r"set\[0\]: found .*; allowed: a set",
    ),
    "the set, not its projection": (
        lambda: SubgradientMethod(
            0, np.zeros(2), {0: 1.0}, lambda x: x, 0.1, Box(0.0, 1.0)
        ),
        "agent 0: project: found Box; .* Give its method `project`",
    ),
}


@pytest.mark.parametrize("name", BAD_SETS)
def test_what_is_no_set_is_refused(name):
    make, text = BAD_SETS[name]
    with pytest.raises(ConfigError, match=text) as error:
        make()
    assert isinstance(error.value, CrazyChoirError)
