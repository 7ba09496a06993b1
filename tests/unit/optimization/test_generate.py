"""Random problems have the solutions that they say."""

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, linprog, milp

from crazychoir.errors import ConfigError
from crazychoir.optimization.generate import (
    random_lp,
    random_milp,
    random_quadratics,
    random_standard_lp,
)


@pytest.mark.parametrize("seed", range(8))
def test_a_random_lp_has_its_solution(seed):
    lp = random_lp(4, 3, 12, seed)
    found = linprog(lp.c, lp.a, lp.b, bounds=(None, None))
    assert found.x == pytest.approx(lp.x, abs=1e-7)
    assert found.fun == pytest.approx(lp.cost)
    assert lp.c + lp.a.T @ lp.dual == pytest.approx(np.zeros(3), abs=1e-12)
    assert sorted(r for rows in lp.parts.values() for r in rows) == list(range(12))
    assert sorted(lp.parts) == [0, 1, 2, 3]


@pytest.mark.parametrize("seed", range(8))
def test_a_random_lp_in_standard_form_has_its_solution(seed):
    lp = random_standard_lp(5, 15, 4, seed)
    found = linprog(lp.c, A_eq=lp.a, b_eq=lp.b)
    assert found.x == pytest.approx(lp.x, abs=1e-7)
    assert found.fun == pytest.approx(lp.cost)
    assert (lp.a.T @ lp.dual <= lp.c + 1e-12).all()
    assert sum(map(len, lp.parts.values())) == 15


def test_a_random_milp_is_scarce_and_feasible():
    p = random_milp(4, seed=2)
    whole = np.hstack(list(p.a))
    integrality = np.tile(np.arange(5) < p.integers, 4).astype(int)
    bounds = (np.zeros(20), np.tile(p.upper, 4))
    solved = milp(
        p.c.ravel(),
        constraints=LinearConstraint(whole, ub=p.b),
        integrality=integrality,
        bounds=bounds,
    )
    assert solved.success
    assert p.c.ravel() @ bounds[1] < solved.fun < -1.0
    assert (whole @ bounds[1] > p.b).all()


def test_random_quadratics_have_their_optimum():
    q = random_quadratics(5, 3, seed=7)
    for d in np.eye(3) * 1e-3:
        assert q.cost(q.optimum) < min(q.cost(q.optimum + d), q.cost(q.optimum - d))
    slope = sum(q.gradient(i)(q.optimum) for i in range(5))
    assert slope == pytest.approx(np.zeros(3), abs=1e-10)
    x, y = np.ones(3), np.zeros(3)
    assert all(
        np.linalg.norm(q.gradient(i)(x) - q.gradient(i)(y)) <= q.smoothness * np.sqrt(3)
        for i in range(5)
    )


def test_equal_seeds_give_equal_problems():
    assert (
        random_lp(3, 2, 6, 5).a.tobytes()
        == random_lp(3, 2, 6, 5).a.tobytes()
        != random_lp(3, 2, 6, 6).a.tobytes()
    )


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (
            lambda: random_lp(2, 5, 4),
            "random LP: constraints: found 4; allowed: 5 or more",
        ),
        (
            lambda: random_standard_lp(2, 3, 4),
            "random LP: columns: found 3; allowed: 4 or more",
        ),
        (lambda: random_milp(2, tightness=1.0), "random MILP: found tightness 1.0"),
        (lambda: random_quadratics(0, 2), "random problem: agents: found 0"),
    ],
)
def test_sizes_that_cannot_be(make, error):
    with pytest.raises(ConfigError, match=error):
        make()
