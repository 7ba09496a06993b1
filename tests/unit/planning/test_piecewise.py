import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.piecewise import Piecewise, join_pieces
from crazychoir.planning.spline import fit_spline

RNG = np.random.default_rng(0)
FLIGHT = Piecewise(RNG.normal(size=(5, 4, 8)), [0.5, 1.0, 0.25, 2.0, 1.0])


def test_each_time_is_in_its_piece():
    for i, knot in enumerate(FLIGHT.knots[:-1]):
        np.testing.assert_array_equal(
            FLIGHT.sample(knot).p, FLIGHT.coefficients[i, 0:3, 0]
        )
        assert FLIGHT.sample(knot).yaw == FLIGHT.coefficients[i, 3, 0]
    inside = FLIGHT.knots[2] + 0.1
    wanted = [np.polynomial.Polynomial(c)(0.1) for c in FLIGHT.coefficients[2]]
    np.testing.assert_allclose(
        [*FLIGHT.sample(inside).p, FLIGHT.sample(inside).yaw], wanted
    )


def test_before_the_start_it_holds_and_after_the_end_it_stands():
    np.testing.assert_array_equal(FLIGHT.sample(-1.0).flat, FLIGHT.sample(0.0).flat)
    at_end, after = (
        FLIGHT.sample(FLIGHT.duration).flat,
        FLIGHT.sample(FLIGHT.duration + 1e-6).flat,
    )
    assert np.abs(at_end[3:6]).min() > 0.0
    np.testing.assert_array_equal(after[[0, 1, 2, 12]], at_end[[0, 1, 2, 12]])
    np.testing.assert_array_equal(after[3:12], 0.0)
    assert after[13] == 0.0
    assert FLIGHT.done(FLIGHT.duration)
    assert not FLIGHT.done(FLIGHT.duration - 1e-9)


def test_many_samples_are_the_same_as_one_by_one():
    t = np.linspace(0.0, FLIGHT.duration, 50)
    np.testing.assert_allclose(
        FLIGHT.samples(t), [FLIGHT.sample(k).flat for k in t], atol=1e-9
    )


def test_a_sample_is_its_own():
    for t in (0.3, FLIGHT.duration, FLIGHT.duration + 1.0):
        FLIGHT.sample(t).flat[:] = 7.0
        assert FLIGHT.sample(t).flat[0] != 7.0


def test_peaks_are_those_of_all_pieces():
    flight = fit_spline([0, 1, 1.5, 4], RNG.normal(size=(4, 3)), [0, 1, 2, 1])
    x = np.array(
        [flight.sample(t).flat for t in np.linspace(0.0, flight.duration, 5000)]
    )
    wanted = [
        np.linalg.norm(x[:, 3:6], axis=1).max(),
        np.linalg.norm(x[:, 6:9], axis=1).max(),
        np.abs(x[:, 13]).max(),
    ]
    np.testing.assert_allclose(flight.peaks, wanted, rtol=0.01)


def test_one_piece_has_no_jumps():
    assert not Piecewise(FLIGHT.coefficients[0:1], [1.0]).jumps.any()


@pytest.mark.parametrize(
    ("coefficients", "durations", "complaint"),
    [
        (np.zeros((2, 4, 7)), [1, 1], "shapes"),
        (np.zeros((2, 4, 8)), [1], "shapes"),
        (np.zeros((0, 4, 8)), [], "shapes"),
        (np.full((1, 4, 8), np.nan), [1], "piece: found 0"),
        (np.zeros((2, 4, 8)), [1, 0], "piece 1"),
        (np.zeros((2, 4, 8)), [-1, 1], "piece 0"),
        (np.zeros((2, 4, 8)), [1, np.inf], "piece 1"),
    ],
)
def test_what_is_no_trajectory_is_refused(coefficients, durations, complaint):
    with pytest.raises(ConfigError, match=complaint):
        Piecewise(coefficients, durations)


def test_yaw_goes_on_where_flights_are_joined():
    turning = np.zeros((1, 4, 8))
    turning[0, 3, 0:2] = 0.0, 3.0
    other = np.zeros((1, 4, 8))
    other[0, 3, 0:2] = 3.0, 3.0
    both = join_pieces(
        [Piecewise(turning, [1.0]), Piecewise(other, [1.0]), Piecewise(turning, [0.5])]
    )
    assert both.sample(2.0).yaw == pytest.approx(2.0 * np.pi)
    assert both.sample(2.5).yaw == pytest.approx(2.0 * np.pi + 1.5)
    assert both.jumps[3, 1] == pytest.approx(0.0)


def test_reversed_path_is_the_path_backwards_with_all_derivatives():
    path = minimum_snap(
        [[0, 0, 1], [1, 0.5, 1.2], [2, 0, 1]], [0.0, 1.5, 4.0], yaws=[0.0, 0.5, 1.0]
    )
    back = path.reversed()
    t = np.linspace(0.0, path.duration, 101)
    signs = np.array([1.0] * 3 + [-1.0] * 3 + [1.0] * 3 + [-1.0] * 3 + [1.0, -1.0])
    there = path.samples(path.duration - t)
    assert np.allclose(back.samples(t), signs * there, atol=1e-8)
    assert np.allclose(back.durations, path.durations[::-1])
    assert np.allclose(back.reversed().coefficients, path.coefficients, atol=1e-9)
