import math

import numpy as np
import pytest

from crazychoir.simulation.common.draws import (
    derive_stream_key,
    draw_normals,
    draw_uniform,
)
from crazychoir.simulation.motor_level import air


@pytest.mark.parametrize(
    ("down", "grams"), [(0.2, 10.0), (0.3, 8.0), (0.4, 6.0), (0.5, 4.0)]
)
def test_the_wash_is_what_was_measured_between_crazyflies(down, grams):
    assert 34.0 * air.compute_wash_share(down, 0.0, 0.0685) == pytest.approx(
        grams, abs=0.2
    )


def test_the_wash_is_smooth_falls_to_the_side_and_begins_below():
    down = np.linspace(-0.05, 1.5, 400)
    force = np.array([air.compute_wash_share(z, 0.0, 0.0685) for z in down])
    assert np.all(force[down <= 0.0] == 0.0)
    assert np.abs(np.diff(force)).max() < 0.02
    assert air.compute_wash_share(0.4, 0.2**2, 0.0685) < 0.2 * air.compute_wash_share(
        0.4, 0.0, 0.0685
    )


def pushed(x, lift, radius):
    n = len(x)
    out = np.full(n, np.nan)
    air.compute_downwash(
        x, lift, radius, np.zeros(64, np.int64), np.zeros((n, 3), np.int64), out
    )
    return out


def test_the_search_finds_what_comparing_all_pairs_finds():
    rng = np.random.default_rng(0)
    x = np.zeros((150, 13))
    x[:, :3] = rng.uniform([-2, -2, 0], [2, 2, 3], (150, 3))
    lift, radius = rng.uniform(0.2, 0.5, 150), rng.choice([0.0685, 0.078], 150)
    expected = np.zeros(150)
    for lower in range(150):
        for upper in range(150):
            down = x[upper, 2] - x[lower, 2]
            aside2 = np.sum((x[upper, :2] - x[lower, :2]) ** 2)
            expected[lower] += lift[upper] * air.compute_wash_share(
                down, aside2, radius[upper]
            )
    found = pushed(x, lift, radius)
    assert np.count_nonzero(found) > 50
    np.testing.assert_allclose(found, expected, atol=0.02 * 0.3)


def test_the_wash_grows_with_the_upper_drones_thrust():
    x = np.zeros((2, 13))
    x[1, 2] = 0.3
    once, twice = (
        pushed(x, np.array([9.0, f]), np.full(2, 0.0685)) for f in (0.3, 0.6)
    )
    assert once[1] == 0.0
    assert twice[0] == 2.0 * once[0] > 0.0


def gusts(n, decay):
    m, seen = np.zeros(8 * 400), []
    keys = np.array([derive_stream_key(1, 2, i) for i in range(8)], np.uint64)
    for k in range(n):
        air.advance_block_wind(m, keys, k, (1.0, 0.0, -0.5), 0.4, decay if k else 0.0)
        seen.append(m[air.WIND_X : air.WIND_X + 24].copy())
    return np.array(seen)


def test_gusts_have_the_deviation_the_mean_and_the_memory_of_drydens_filter():
    decay = math.exp(-0.1)
    u = gusts(4000, decay) - np.repeat([1.0, 0.0, -0.5], 8)
    assert np.abs(u.mean(axis=0)).max() < 4 * 0.4 * math.sqrt(2 / 0.1 / 4000)
    assert u.std() == pytest.approx(0.4, rel=0.05)
    assert np.mean(u[10:] * u[:-10]) / np.mean(u * u) == pytest.approx(
        math.exp(-1.0), abs=0.05
    )
    assert np.abs(np.corrcoef(u.T) - np.eye(24)).max() < 0.35


def test_draws_are_nearly_normal_independent_and_functions_of_their_number():
    key = derive_stream_key(1, 0, 7)
    a = np.array([draw_normals(np.uint64(key), np.uint64(k)) for k in range(20000)])
    assert np.abs(a.mean(axis=0)).max() < 0.03
    np.testing.assert_allclose(a.std(axis=0), 1.0, atol=0.02)
    assert np.abs(a).max() < 3.46
    assert np.mean(np.abs(a) < 1.0) == pytest.approx(0.68, abs=0.015)
    assert abs(np.corrcoef(a[:, 0], a[:, 1])[0, 1]) < 0.03
    assert abs(np.corrcoef(a[1:, 0], a[:-1, 0])[0, 1]) < 0.03
    assert draw_normals(np.uint64(key), np.uint64(5)) == tuple(a[5])
    assert (
        len(
            {
                derive_stream_key(seed, use, i)
                for seed in range(5)
                for use in range(3)
                for i in range(50)
            }
        )
        == 750
    )
    drawn = [draw_uniform(key, k) for k in range(1000)]
    assert -1.0 <= min(drawn) < -0.97 < 0.97 < max(drawn) < 1.0
