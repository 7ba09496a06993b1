import numpy as np
import pytest
from scipy.optimize import linprog

from crazychoir.optimization.problems.quadratic import (
    AffineHull,
    InequalityRows,
    MovingProgram,
    Polyhedron,
    QuadraticProgram,
)

NONE = np.zeros((0, 2)), np.zeros(0)


def box(n, low, high):
    return Polyhedron.of(
        np.vstack([np.eye(n), -np.eye(n)]),
        np.r_[np.full(n, high), np.full(n, -low)],
        *none(n),
    )


def none(n):
    return np.zeros((0, n)), np.zeros(0)


def programs(count, seed, degenerate=False):
    """Feasible ones: P, q, the polyhedron."""
    draw = np.random.default_rng(seed)
    for _ in range(count):
        n, m = int(draw.integers(1, 12)), int(draw.integers(1, 30))
        equal = int(draw.integers(0, n))
        L, A, E, x = (
            draw.normal(size=shape) for shape in ((n, n), (m, n), (equal, n), n)
        )
        if degenerate:
            A, x = np.round(A), np.round(x)
        slack = draw.integers(0, 2, m) * float(not degenerate)
        over = Polyhedron.of(A, A @ x + slack, E, E @ x)
        yield QuadraticProgram(
            L @ L.T + 0.1 * np.eye(n),
            draw.normal(size=n) * 10.0 ** draw.integers(-1, 3),
            over,
        )


def require_optimal(program, x, p):
    """The conditions of Karush, Kuhn and Tucker, relative to the size of the data."""
    over, u = program.over, program.u
    scale = 1.0 + np.abs(program.q + p).max()
    gradient = program.P @ x + program.q + p + over.A.T @ u
    null = np.eye(over.n) - np.linalg.pinv(over.E) @ over.E
    assert np.abs(null @ gradient).max() < 1e-8 * scale
    assert np.abs(over.E @ x - over.e).max(initial=0.0) < 1e-9
    assert (over.A @ x - over.b).max(initial=0.0) < 1e-8 * scale
    assert u.min(initial=0.0) >= 0.0
    assert np.abs(u * (over.A @ x - over.b)).max(initial=0.0) < 1e-6 * scale**2


@pytest.mark.parametrize("degenerate", [False, True])
def test_what_it_finds_is_optimal_also_from_the_last_solution(degenerate):
    for program in programs(150, 3, degenerate):
        for p in np.random.default_rng(1).normal(size=(3, program.over.n)):
            require_optimal(program, program.solve(p), p)


def test_a_warm_start_does_not_change_the_solution():
    draw = np.random.default_rng(0)
    L, A = draw.normal(size=(5, 5)), draw.normal(size=(12, 5))

    def make():
        return QuadraticProgram(
            L @ L.T + np.eye(5), np.zeros(5), Polyhedron.of(A, np.ones(12), *none(5))
        )

    warm = make()
    for p in draw.normal(size=(50, 5)) * 10:
        np.testing.assert_allclose(warm.solve(p), make().solve(p), atol=1e-11)


def test_without_inequalities_it_is_a_closed_form():
    line = Polyhedron.of(*NONE, np.ones((1, 2)), np.ones(1))
    program = QuadraticProgram(np.diag([2.0, 4.0]), np.array([-2.0, 0.0]), line)
    assert program.name == "closed form"
    np.testing.assert_allclose(program.solve(np.zeros(2)), [1.0, 0.0], atol=1e-15)
    assert program.solve(np.array([np.nan, 0.0])) == "not finite"


def test_dependent_equalities_count_once():
    over = Polyhedron.of(
        *NONE, np.array([[1.0, 1.0], [2.0, 2.0]]), np.array([1.0, 2.0])
    )
    np.testing.assert_allclose(
        QuadraticProgram(np.eye(2), np.zeros(2), over).solve(np.zeros(2)), 0.5
    )


@pytest.mark.parametrize("p", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(p):
    assert (
        QuadraticProgram(np.eye(2), np.zeros(2), box(2, -1.0, 1.0)).solve(
            np.array([0.0, p])
        )
        == "not finite"
    )


def test_an_empty_polyhedron_is_infeasible_and_the_next_question_is_answered_alike():
    program = QuadraticProgram(np.eye(2), np.zeros(2), box(2, 1.0, -1.0))
    assert program.solve(np.zeros(2)) == "infeasible"
    assert program.solve(np.ones(2)) == "infeasible"


def test_rows_of_small_integers_are_met_or_exclude_each_other():
    """Many are parallel, or sums of others: what is left of them when others are held is zero, but for its rounding."""
    said = {True: 0, False: 0}
    for seed in range(1000):
        draw = np.random.default_rng(seed)
        n, m = int(draw.integers(1, 4)), int(draw.integers(2, 7))
        A, b = (
            draw.integers(-1, 2, (m, n)).astype(float),
            draw.integers(-1, 2, m).astype(float),
        )
        L = draw.normal(size=(n, n))
        P = 2.0 * np.eye(n) if seed % 2 else L @ L.T + 0.1 * np.eye(n)
        over = Polyhedron.of(A, b, np.zeros((0, n)), np.zeros(0))
        x = QuadraticProgram(P, draw.normal(size=n), over).solve(np.zeros(n))
        solved = not isinstance(x, str)
        said[solved] += 1
        if solved:
            assert (over.A @ x <= over.b + 1e-9).all(), seed
        else:
            assert x == "infeasible"
            assert (
                seed % 5
                or linprog(np.zeros(n), A_ub=A, b_ub=b, bounds=(None, None)).status == 2
            ), seed
    assert min(said.values()) > 200


def test_a_row_of_zeros_is_left_out_if_it_always_holds():
    A = np.array([[0.0, 0.0], [1.0, 0.0]])
    assert len(Polyhedron.of(A, np.array([0.0, 1.0]), *NONE).b) == 1
    never = Polyhedron.of(A, -np.ones(2), *NONE)
    assert (
        QuadraticProgram(np.eye(2), np.zeros(2), never).solve(np.zeros(2))
        == "infeasible"
    )


def test_a_hessian_that_is_flat_somewhere_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), box(2, -1.0, 1.0))


def test_a_hessian_that_is_flat_where_the_equalities_forbid_to_go_is_not():
    over = Polyhedron.of(*NONE, np.array([[0.0, 1.0]]), np.array([3.0]))
    program = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), over)
    np.testing.assert_allclose(program.solve(np.array([-2.0, 7.0])), [2, 3])


def test_a_program_with_moved_bounds_equals_a_new_one_with_those_bounds():
    draw, n, m = np.random.default_rng(4), 6, 9
    L, A, E = (
        draw.normal(size=(n, n)),
        draw.normal(size=(m, n)),
        draw.normal(size=(2, n)),
    )
    A /= np.linalg.norm(A, axis=1)[:, None]
    P, q = L @ L.T + np.eye(n), draw.normal(size=n)
    moving = MovingProgram(P, q, Polyhedron(A, np.zeros(m), E, np.zeros(2)))
    for _ in range(10):
        x, p = draw.normal(size=(2, n))
        b, e = A @ x + draw.uniform(0.0, 0.5, m), E @ x
        moving.move(b, e)
        found = moving.solve(p)
        np.testing.assert_allclose(
            found, QuadraticProgram(P, q, Polyhedron(A, b, E, e)).solve(p), atol=1e-10
        )
        np.testing.assert_allclose(E @ found, e, atol=1e-10)


CONFLICTS = {
    "two values": ([[1.0, 0.0], [1.0, 0.0]], [1.0, 2.0]),
    "zero is one": ([[0.0, 0.0]], [1.0]),
    "rows of other lengths": ([[1e6, 0.0], [1e-6, 0.0]], [1e6, 2e-6]),
    "small ones beside large ones": (
        [[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]],
        [1e9, 1e-5, -1e-5],
    ),
    "tiny ones": ([[1.0, 0.0], [1.0, 0.0]], [1e-9, 2e-9]),
    "a sum": ([[1.0, 1.0], [1.0, -1.0], [1.0, 0.0]], [2.0, 0.0, 1.5]),
    "more than entries": ([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [1.0, 1.0, 2.1]),
}


@pytest.mark.parametrize("name", CONFLICTS)
@pytest.mark.parametrize("beside", [False, True])
def test_equalities_that_exclude_each_other_are_infeasible(name, beside):
    E, e = (np.array(part) for part in CONFLICTS[name])
    upper = (np.eye(2), np.full(2, 1e10)) if beside else NONE
    program = QuadraticProgram(np.eye(2), np.zeros(2), Polyhedron.of(*upper, E, e))
    assert program.name == ("active set" if beside else "closed form")
    assert program.solve(np.zeros(2)) == "infeasible"
    assert program.solve(np.ones(2)) == "infeasible"


AGREEING = {
    "the rounding of their terms": (
        [[1.0, 1.0], [3.0, 3.0]],
        [1.0, 3.0 * (1.0 + 1e-12)],
    ),
    "the rounding of their entries": (
        [[1.0, 1.0], [1.0, 1.0 + 1e-12]],
        [1.0, 1.0 + 1e-12],
    ),
    "the rounding of a sum": ([[1.0, 0.0], [1.0, 0.0]], [0.0, 0.1 + 0.2 - 0.3]),
    "a zero row": ([[1.0, 0.0], [0.0, 0.0]], [1.0, 0.0]),
    "a rounded zero row": ([[1.0, 0.0], [0.0, 0.0]], [1.0, 5e-17]),
    "other lengths": ([[1e6, 2e6], [1e-6, 2e-6]], [1e6, 1e-6]),
}


@pytest.mark.parametrize("name", AGREEING)
def test_equalities_that_differ_by_rounding_have_a_solution(name):
    E, e = (np.array(part) for part in AGREEING[name])
    x = QuadraticProgram(np.eye(2), np.zeros(2), Polyhedron.of(*NONE, E, e)).solve(
        np.zeros(2)
    )
    np.testing.assert_allclose(E @ x, e, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    "row", [[1.0, np.pi], [1e-6, np.pi * 1e-6], [-3.0, -3.0 * np.pi]]
)
def test_an_inequality_that_the_equalities_decide_is_met_or_not(row):
    """Its multiplier is of no use: what is left of it where x may go is zero, but for rounding."""
    E, e, row = np.array([[1.0, np.pi]]), np.array([1.0]), np.array([row])
    value = row @ np.linalg.lstsq(E, e)[0]
    for more, is_met in ((1.0, True), (0.0, True), (-1e-6, False), (-1.0, False)):
        over = Polyhedron.of(row, value + more * np.abs(row[:, 0]), E, e)
        x = QuadraticProgram(np.eye(2), np.zeros(2), over).solve(np.array([0.3, -5.0]))
        assert isinstance(x, str) != is_met
        if is_met:
            np.testing.assert_allclose(
                x,
                QuadraticProgram(
                    np.eye(2), np.zeros(2), Polyhedron.of(*NONE, E, e)
                ).solve(np.array([0.3, -5.0])),
                atol=1e-12,
            )


def test_a_point_that_the_equalities_fix_meets_the_inequalities_or_not():
    E, e = np.array([[1.0, 2.0], [3.0, 4.1]]), np.array([1.0, 2.0])
    point = np.linalg.solve(E, e)
    for more, is_met in ((1e-3, True), (0.0, True), (-1e-3, False)):
        over = Polyhedron.of(np.eye(2), point + more, E, e)
        x = QuadraticProgram(np.eye(2), np.zeros(2), over).solve(np.ones(2))
        assert isinstance(x, str) != is_met
        if is_met:
            np.testing.assert_allclose(x, point, atol=1e-12)


@pytest.mark.parametrize("large", [1.0, 1e6, 1e9])
@pytest.mark.parametrize("gap", [1e-2, 1e-5])
def test_inequalities_are_judged_by_their_own_size(large, gap):
    A = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    apart = Polyhedron.of(A, np.array([large, -gap, -gap]), *NONE)
    assert (
        QuadraticProgram(np.eye(2), np.zeros(2), apart).solve(np.zeros(2))
        == "infeasible"
    )
    together = Polyhedron.of(A, np.array([large, -gap, 2.0 * gap]), *NONE)
    x = QuadraticProgram(np.eye(2), np.zeros(2), together).solve(np.zeros(2))
    np.testing.assert_allclose(x, [0.0, -gap], atol=1e-12)


@pytest.mark.parametrize("size", [1e-300, 1e-200, 1e200, 1e300])
def test_rows_of_any_length_count(size):
    over = Polyhedron.of(
        np.array([[0.0, size]]),
        np.array([-size]),
        np.array([[size, 0.0]]),
        np.array([size]),
    )
    np.testing.assert_allclose(
        QuadraticProgram(np.eye(2), np.zeros(2), over).solve(np.zeros(2)), [1.0, -1.0]
    )


def test_right_hand_sides_that_move_may_exclude_each_other_and_agree_again():
    E = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    A = np.array([[0.0, 1.0], [1.0, 0.0]])
    moving = MovingProgram(
        np.eye(2), np.zeros(2), Polyhedron(A, np.full(2, 9.0), E, np.zeros(3))
    )
    agree, differ, never = (
        np.array([1.0, 1.0, 0.0]),
        np.array([1.0, 2.0, 0.0]),
        np.array([1.0, 1.0, 1.0]),
    )
    for _ in range(2):
        moving.move(np.array([-3.0, 9.0]), agree)
        np.testing.assert_allclose(moving.solve(np.zeros(2)), [1.0, -3.0], atol=1e-12)
        for b, e in (([-3.0, 9.0], differ), ([-3.0, 9.0], never), ([-3.0, 0.5], agree)):
            moving.move(np.array(b), e)
            assert moving.solve(np.zeros(2)) == "infeasible"


def test_the_affine_hull_gives_a_point_all_directions_and_the_shares_of_dependent_rows():
    draw = np.random.default_rng(2)
    for _ in range(50):
        n = int(draw.integers(1, 6))
        E = draw.integers(-2, 3, (int(draw.integers(0, 7)), n)).astype(float)
        E /= np.maximum(np.linalg.norm(E, axis=1), 1.0)[:, None]
        e = E @ draw.normal(size=n)
        hull = AffineHull(E)
        rank = np.linalg.matrix_rank(E) if E.size else 0
        assert hull.null.shape[1] == n - rank
        np.testing.assert_allclose(
            hull.null.T @ hull.null, np.eye(hull.null.shape[1]), atol=1e-12
        )
        np.testing.assert_allclose(E @ hull.null, 0.0, atol=1e-12)
        np.testing.assert_allclose(E @ hull.point(e), e, atol=1e-12)
        np.testing.assert_allclose(
            hull.shares @ E[hull.basis], E[hull.others], atol=1e-12
        )
        assert not hull.gaps(hull.point(e), e).any()
        assert hull.verdict(hull.point(e), e) == ""


def test_inequality_rows_know_what_the_affine_set_leaves_of_them():
    hull = AffineHull(np.array([[1.0, 0.0]]))
    rows = InequalityRows.of(np.array([[0.0, -1.0], [-1.0, 0.0], [0.6, 0.8]]), hull)
    np.testing.assert_allclose(np.abs(rows.free[:, 0]), [1.0, 0.0, 0.8], atol=1e-15)
    assert rows.is_fixed.tolist() == [False, True, False]
    np.testing.assert_allclose(rows.sizes, [[0.0, 1.0], [1.0, 0.0], [0.6, 0.8]])
    np.testing.assert_allclose(rows.shares, [[0.0], [1.0], [0.6]])


@pytest.mark.parametrize(
    ("slack", "size", "is_missed"),
    [(-1e-3, 1.0, True), (-1e-3, 1e7, False), (0.0, 1.0, False)],
)
def test_a_fixed_row_is_missed_by_more_than_its_rounding(slack, size, is_missed):
    hull = AffineHull(np.array([[1.0, 0.0]]))
    rows = InequalityRows.of(np.eye(2), hull)
    found = rows.misses_fixed_row(np.array([slack, -9.0]), np.full(2, size), np.ones(1))
    assert found is is_missed


@pytest.mark.parametrize(
    ("A", "slack", "is_certain"),
    [
        ([[1.0, 0.0], [-1.0, 0.0]], [-1.0, 0.5], True),
        ([[1.0, 0.0], [-1.0, 0.0]], [-1.0, 1.5], False),
        ([[1.0, 0.0], [0.0, -1.0]], [-1.0, 0.5], False),
        ([[1.0, 0.0], [-1.0, 1e-5]], [-1.0, 0.5], False),
    ],
    ids=["apart", "together", "crossing", "nearly parallel"],
)
def test_rows_exclude_each_other_for_certain_only_where_they_are_dependent(
    A, slack, is_certain
):
    rows = InequalityRows.of(np.array(A), AffineHull(np.zeros((0, 2))))
    found = rows.exclude_each_other(np.arange(2), np.array(slack), np.ones(2))
    assert found is is_certain
