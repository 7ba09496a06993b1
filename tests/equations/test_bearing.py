import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crazychoir.control.margin import REQUIRED_DELAY_MARGIN
from crazychoir.guidance.formation.bearing import (
    BEARING_GAINS,
    BearingLaw,
    build_bearing_laplacian,
    check_formation,
)
from crazychoir.guidance.formation.modes import compute_slowest_mode

SQUARE = {0: (0, 0, 1), 1: (1, 0, 1), 2: (1, 1, 1), 3: (0, 1, 1)}
PAPER_GRAPH = {0: {1, 3}, 1: {0, 2, 3}, 2: {1, 3}, 3: {0, 1, 2}}


def test_the_formation_is_where_the_law_is_at_rest():
    b_ff, b_fl, followers = build_bearing_laplacian(SQUARE, PAPER_GRAPH, [0, 1])
    assert followers == [2, 3]
    leaders, goal = (
        np.array([SQUARE[0], SQUARE[1]], float),
        np.array([SQUARE[2], SQUARE[3]], float),
    )
    np.testing.assert_allclose(
        -np.linalg.solve(b_ff.toarray(), b_fl @ leaders.ravel()),
        goal.ravel(),
        atol=1e-12,
    )


@given(st.floats(0.5, 3.0), arrays(float, 3, elements=st.floats(-2.0, 2.0)))
def test_it_scales_and_moves_with_the_leaders(scale, offset):
    b_ff, b_fl, _ = build_bearing_laplacian(SQUARE, PAPER_GRAPH, [0, 1])
    at = {i: scale * np.array(p) + offset for i, p in SQUARE.items()}
    found = -np.linalg.solve(b_ff.toarray(), b_fl @ np.concatenate([at[0], at[1]]))
    np.testing.assert_allclose(found, np.concatenate([at[2], at[3]]), atol=1e-9)


@given(
    arrays(float, 12, elements=st.floats(-1.0, 1.0)),
    arrays(float, 12, elements=st.floats(-1.0, 1.0)),
)
def test_the_matrix_is_the_papers_sum_over_neighbours(p, v):
    p, v = p.reshape(4, 3), v.reshape(4, 3)
    b_ff, b_fl, _ = build_bearing_laplacian(SQUARE, PAPER_GRAPH, [0, 1])
    whole = -(
        b_ff @ (BEARING_GAINS.kp * p[2:] + BEARING_GAINS.kv * v[2:]).ravel()
        + b_fl @ (BEARING_GAINS.kp * p[:2] + BEARING_GAINS.kv * v[:2]).ravel()
    ).reshape(2, 3)
    for row, i in enumerate((2, 3)):
        u = np.zeros(3)
        for j in PAPER_GRAPH[i]:
            g = np.array(SQUARE[j], float) - SQUARE[i]
            g /= np.linalg.norm(g)
            u -= (np.eye(3) - np.outer(g, g)) @ (
                BEARING_GAINS.kp * (p[i] - p[j]) + BEARING_GAINS.kv * (v[i] - v[j])
            )
        np.testing.assert_allclose(whole[row], u, atol=1e-12)


def test_the_slowest_mode_is_the_slowest_of_the_coupled_system():
    b_ff, _, _ = build_bearing_laplacian(SQUARE, PAPER_GRAPH, [0, 1])
    b_ff = b_ff.toarray()
    n = len(b_ff)
    whole = np.block(
        [
            [np.zeros((n, n)), np.eye(n)],
            [-BEARING_GAINS.kp * b_ff, -BEARING_GAINS.kv * b_ff],
        ]
    )
    slowest = compute_slowest_mode(
        np.linalg.eigvalsh(b_ff), BEARING_GAINS.kp, BEARING_GAINS.kv
    )
    assert slowest == pytest.approx(-np.linalg.eigvals(whole).real.max(), abs=1e-9)


def test_the_papers_example_is_flown_with_the_required_margin():
    report = check_formation(
        SQUARE,
        PAPER_GRAPH,
        [0, 1],
        BearingLaw("paper", BEARING_GAINS.kp, BEARING_GAINS.kv),
    )
    assert report.lambda_min == pytest.approx(0.1454, abs=1e-4)
    assert report.lambda_max == pytest.approx(3.618, abs=1e-3)
    assert report.slowest == pytest.approx(0.334, abs=1e-3)
    assert report.margin >= REQUIRED_DELAY_MARGIN
    assert report.warnings == ()
