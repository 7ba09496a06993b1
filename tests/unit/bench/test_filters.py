import math

import numpy as np
import pytest

from crazychoir.bench.filters import (
    FILTER_BENCH,
    OriginalFilter,
    run,
    table,
    true_state,
)
from crazychoir.filters.motion import RATE_LAG, CommandedMotion
from crazychoir.numerics.math3d import (
    quaternion_conjugate,
    quaternion_product,
    rotation_logarithm,
)
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose


@pytest.fixture(scope="module")
def rows():
    return {(row["filter"], row["rate_hz"]): row for row in run(seeds=(1,))["rows"]}


@pytest.mark.parametrize(
    ("rate", "mm_s", "rad_s"), [(50, 12.0, 0.12), (100, 10.0, 0.11), (240, 8.0, 0.09)]
)
def test_the_kalman_filter_reaches_its_accuracy_with_noise_dropouts_and_a_thrust_that_is_off(
    rows, rate, mm_s, rad_s
):
    assert rows["kalman", rate]["velocity_rmse_mm_s"] <= mm_s
    assert rows["kalman", rate]["angular_rmse_rad_s"] <= rad_s


@pytest.mark.parametrize("rate", FILTER_BENCH.pose_rates)
def test_each_filter_is_better_than_the_one_before(rows, rate):
    for figure in ("velocity_rmse_mm_s", "angular_rmse_rad_s"):
        best = [
            rows[name, rate][figure]
            for name in ("kalman", "kalman, no commands", "derivative", "original")
        ]
        assert best == sorted(best)


def test_it_is_shown(rows):
    assert table({"rows": list(rows.values())}).row_count == 12


@pytest.mark.parametrize("t", [0.0, 2.7, 7.1])
def test_the_truth_obeys_the_dynamics_under_what_it_flies(t):
    (x, u), (after, _) = true_state(t), true_state(t + 1e-3)
    u[0] /= FILTER_BENCH.thrust_factor
    flown = CommandedMotion(PAPER_PLATFORM.flat, -math.inf).after(x, u, 1e-3)
    np.testing.assert_allclose(flown[:6], after[:6], atol=1e-5)
    assert (
        np.linalg.norm(
            rotation_logarithm(
                quaternion_product(
                    quaternion_conjugate(tuple(flown[6:10])), tuple(after[6:10])
                )
            )
        )
        < 1e-5
    )
    np.testing.assert_allclose(flown[10:13], after[10:13], atol=1e-3 * RATE_LAG)


def test_the_peer_is_the_original_difference_equation():
    """v_k = 0.6 v_k-1 + 40 (p_k - p_k-1): right at 100 Hz, half of it at 200; a heading that passes pi is a spike."""
    for h, gain in ((0.01, 1.0), (0.005, 0.5)):
        peer = OriginalFilter()
        for k in range(60):
            v, _ = peer.told(
                Pose(np.array([0.7 * h * k, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])),
                h * k,
                np.zeros(4),
            )
        assert v[0] == pytest.approx(0.7 * gain)
    peer.told(
        Pose(np.array([0.0, 0, 0, 0, 0, math.sin(1.57), math.cos(1.57)])),
        0.0,
        np.zeros(4),
    )
    _, w = peer.told(
        Pose(np.array([0.0, 0, 0, 0, 0, math.sin(1.58), math.cos(1.58)])),
        0.01,
        np.zeros(4),
    )
    assert w[2] < -100.0
