import json

import numpy as np
import pytest
from scaled_programs import draw as draw_scaled
from scipy.optimize import linprog
from teams import run_team

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.simplex import (
    BasisExchange,
    DistributedSimplex,
    DualDistributedSimplex,
)
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import GraphSequence, complete, erdos_renyi_connected, ring

STATUS = {0: "optimal", 2: "infeasible", 3: "unbounded"}


def draw(seed):
    """Return (c, A, b, parts) of a random program, often a degenerate one.

    parts: by agent, the columns that it has; an agent may have none
    """
    chance = np.random.default_rng(seed)
    agents, m = int(chance.integers(2, 7)), int(chance.integers(1, 6))
    sizes = chance.integers(0, 4, agents)
    n = int(sizes.sum())
    A = (
        chance.integers(-1, 2, (m, n)).astype(float)
        if seed % 2
        else chance.normal(size=(m, n))
    )
    b = (
        A @ (chance.random(n) * (chance.random(n) < 0.5))
        if seed % 5
        else chance.normal(size=m)
    )
    c = (
        chance.integers(-1, 3, n).astype(float)
        if seed % 2
        else chance.normal(size=n) + 0.5
    )
    return c, A, b, np.split(np.arange(n), np.cumsum(sizes)[:-1])


def links(agents, seed):
    """A graph and its diameter: directed, random, or changing."""
    if seed % 3 == 0:
        return (graph := ring(agents, directed=True)), graph.diameter()
    if seed % 3 == 1:
        return (graph := erdos_renyi_connected(agents, 0.4, seed)), graph.diameter()
    return GraphSequence.draw(complete(agents), 0.2, 4, seed), 4 * agents


def outcome_of(agents, graph):
    """What the team ends with: optimal, infeasible or unbounded."""
    try:
        run_team(agents, graph)
    except SolverError as error:
        return error.status.partition(":")[0]
    return "optimal"


@pytest.mark.parametrize("seed", range(60))
def test_the_split_program_is_solved_as_the_whole_one(seed):
    c, A, b, parts = draw(seed)
    graph, diameter = links(len(parts), seed)
    agents = {
        i: DistributedSimplex(i, c[part], A[:, part], b, diameter)
        for i, part in enumerate(parts)
    }
    central = linprog(c, A_eq=A, b_eq=b)
    assert outcome_of(agents, graph) == STATUS[central.status]
    if central.status:
        return
    results = [agent.result for agent in agents.values()]
    x = np.concatenate([result.x for result in results])
    assert (x >= 0).all()
    assert A @ x == pytest.approx(b, abs=1e-8)
    assert c @ x == pytest.approx(central.fun, abs=1e-8)
    prices = results[0].prices
    assert (c - prices @ A >= -1e-7).all()
    assert prices @ b == pytest.approx(central.fun, abs=1e-7)
    assert all(r.ids == results[0].ids and r.cost == results[0].cost for r in results)
    assert all(np.array_equal(r.prices, prices) for r in results)


@pytest.mark.parametrize("seed", range(60))
def test_split_constraints_are_solved_by_the_dual(seed):
    b, transposed, c, parts = draw(seed)
    A = transposed.T
    graph, diameter = links(len(parts), seed)
    agents = {
        i: DualDistributedSimplex(i, c, A[part], b[part], diameter)
        for i, part in enumerate(parts)
    }
    central = linprog(-c, A_ub=A, b_ub=b, bounds=(None, None))
    assert outcome_of(agents, graph) == STATUS[central.status]
    if central.status:
        return
    x = agents[0].result.x
    assert (A @ x <= b + 1e-7).all()
    assert c @ x == pytest.approx(-central.fun, abs=1e-7)
    assert agents[0].result.cost == pytest.approx(-central.fun, abs=1e-7)
    assert all(np.array_equal(agent.result.x, x) for agent in agents.values())
    for owner, row in agents[0].result.active:
        assert A[parts[owner][row]] @ x == pytest.approx(b[parts[owner][row]], abs=1e-7)


def test_each_iterate_of_the_dual_meets_the_own_constraints_where_c_has_zeros():
    chance = np.random.default_rng(2)
    c = np.array([0.7, 0.0, -0.4, 0.0])
    A = chance.normal(size=(20, 4))
    b = A @ chance.normal(size=4) + chance.uniform(0, 2, 20)
    graph = ring(5)
    agents = {
        i: DualDistributedSimplex(i, c, A[4 * i : 4 * i + 4], b[4 * i : 4 * i + 4], 2)
        for i in range(5)
    }
    # A box at agent 0, so that the program is bounded from the first round on.
    own = np.vstack([A[:4], np.eye(4), -np.eye(4)])
    bounds = np.concatenate([b[:4], np.full(8, 20.0)])
    agents[0] = DualDistributedSimplex(0, c, own, bounds, 2)
    x = simulate(agents, graph, record=("x",)).of("x")
    for i in range(5):
        rows = slice(4 * i, 4 * i + 4)
        assert (x[i] @ A[rows].T <= b[rows] + 1e-7).all()
    assert (x[:, -1] @ A.T <= b + 1e-7).all()
    np.testing.assert_array_equal(x[:, -1], [agents[0].result.x] * 5)


def test_the_reference_program_in_no_more_rounds_than_the_search_and_its_end(
    reference_data,
):
    data = json.loads((reference_data("disropt") / "simplex_ring_N5.json").read_text())
    c, A, b = (np.array(data[key]) for key in ("c", "A", "b"))
    graph, per = ring(5), data["cols_per_agent"]
    agents = {
        i: DistributedSimplex(i, c[per * i :][:per], A[:, per * i :][:, :per], b, 2)
        for i in graph.ids
    }
    rounds = run_team(agents, graph)
    assert rounds <= data["iterations"]
    assert [agent.result.cost for agent in agents.values()] == pytest.approx(
        [data["J_opt"]] * 5, abs=1e-12
    )
    assert np.concatenate(
        [agent.result.x for agent in agents.values()]
    ) == pytest.approx(data["x_opt"], abs=1e-12)


def test_rows_that_others_imply_keep_an_artificial_column_and_true_prices():
    A = np.array([[1.0, 1.0], [2.0, 2.0]])
    agents = {
        i: DistributedSimplex(i, [3.0 - i], A[:, i : i + 1], [4.0, 8.0], 1)
        for i in range(2)
    }
    run_team(agents, ring(2))
    assert [agent.result.x.tolist() for agent in agents.values()] == [[0.0], [4.0]]
    assert any(owner == -1 for owner, _ in agents[0].result.ids)
    assert agents[0].result.prices @ A == pytest.approx([2.0, 2.0])


def fail(agents, graph, match):
    with pytest.raises(SolverError, match=match):
        run_team(agents, graph)


def test_what_cannot_be_met_is_named_with_its_row():
    A = np.array([[1.0, 1.0], [1.0, 1.0]])
    agents = {
        i: DistributedSimplex(i, [1.0], A[:, i : i + 1], [1.0, 3.0], 1)
        for i in range(2)
    }
    fail(
        agents, ring(2), r"agent 0: distributed simplex: .*infeasible: row 1 \(2 left\)"
    )


def test_what_may_fall_for_ever_is_named_with_its_column():
    agents = {
        i: DistributedSimplex(i, [-float(i)], [[1.0 - 2.0 * i]], [0.0], 1)
        for i in range(2)
    }
    fail(agents, ring(2), "unbounded: column 0 of agent 1 may grow for ever")


def test_contradicting_constraints_and_free_variables_are_named():
    agents = {
        i: DualDistributedSimplex(i, [1.0], [[1.0 - 2.0 * i]], [-1.0], 1)
        for i in range(2)
    }
    fail(agents, ring(2), "infeasible: constraint 0 of agent 1 contradicts others")
    agents = {
        i: DualDistributedSimplex(i, [1.0, 0.5], [[1.0, 0.0]], [1.0], 1)
        for i in range(2)
    }
    fail(agents, ring(2), r"unbounded: variable 1 \(0.5 left\) without a limit")


@pytest.mark.parametrize(
    ("c", "A", "b", "match"),
    [
        (
            [1.0],
            [[1.0], [float("nan")]],
            [1.0, 1.0],
            r"agent 4: distributed simplex: A\[1, 0\]: found nan",
        ),
        (
            [1.0, float("inf")],
            [[1.0, 1.0]],
            [1.0],
            r"c\[1\]: found inf; allowed: a finite number",
        ),
        ([1.0], [[1.0, 2.0]], [1.0], r"A: found shape \(1, 2\); allowed: \(1, 1\)"),
        ([[1.0]], [[1.0]], [1.0], r"c: found shape \(1, 1\)"),
        (["one"], [[1.0]], [1.0], r"c: found list; allowed: an array of numbers"),
        (
            [1.0],
            [[1e200]],
            [1e200],
            r"A\[0, 0\]: found 1e\+200; allowed: 0, or a size from 1e-60 to 1e\+60",
        ),
        (
            [1.0],
            [[1.0]],
            [1e-320],
            r"b\[0\]: found 9.99989e-321; allowed: 0, or a size from",
        ),
    ],
)
def test_data_that_do_not_fit_are_refused_with_agent_row_and_value(c, A, b, match):
    with pytest.raises(ConfigError, match=match):
        DistributedSimplex(4, c, A, b, 1)


@pytest.mark.parametrize("c", [[], [1.0, 2.0], [-1.0, 2.0], [0.0, 0.0]])
def test_a_linear_program_without_rows_is_refused(c):
    with pytest.raises(
        ConfigError,
        match="agent 4: distributed simplex: b: found no rows; allowed: one row or more",
    ):
        DistributedSimplex(4, c, np.zeros((0, len(c))), [], 1)


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_a_linear_program_without_variables_is_refused(rows):
    with pytest.raises(
        ConfigError,
        match="agent 4: dual distributed simplex: c: found no variables; allowed: one",
    ):
        DualDistributedSimplex(4, [], np.zeros((rows, 0)), np.ones(rows), 1)


def test_an_agent_without_constraints_or_columns_takes_part():
    own = {0: ([[1.0]], [2.0]), 1: (np.zeros((0, 1)), [])}
    run_team(
        team := {i: DualDistributedSimplex(i, [1.0], *own[i], 1) for i in own},
        complete(2),
    )
    assert [agent.result.x.tolist() for agent in team.values()] == [[2.0], [2.0]]
    run_team(
        team := {
            i: DistributedSimplex(i, [1.0] * (1 - i), [[1.0] * (1 - i)], [2.0], 1)
            for i in own
        },
        complete(2),
    )
    assert [agent.result.cost for agent in team.values()] == [2.0, 2.0]


@pytest.mark.parametrize("kind", [DistributedSimplex, DualDistributedSimplex])
@pytest.mark.parametrize("diameter", [None, "a", 1.5, -1])
def test_a_diameter_that_is_no_count_is_refused(kind, diameter):
    with pytest.raises(ConfigError, match=r"diameter: found .*; allowed: 0 or more"):
        kind(4, [1.0], [[1.0]], [1.0], diameter)


@pytest.mark.parametrize(
    "change",
    [
        lambda m: "x",
        lambda m: m[:5],
        lambda m: [1, *m[1:]],
        lambda m: [*m[:2], 1, *m[3:]],
        lambda m: [*m[:3], 1, *m[4:]],
        lambda m: [*m[:5], np.array([np.nan]), *m[6:]],
        lambda m: [*m[:7], np.array([4]), *m[8:]],
        lambda m: [*m[:4], m[4][:1], *m[5:]],
    ],
)
def test_what_is_no_basis_names_the_neighbour(change):
    agents = {i: DistributedSimplex(i, [1.0], [[1.0]], [1.0], 1) for i in range(2)}
    for _ in range(2):
        sent = {i: agent.message() for i, agent in agents.items()}
        if isinstance(sent[1][0], bytes):
            break
        for i, agent in agents.items():
            agent.step({1 - i: sent[1 - i]})
    with pytest.raises(
        ConfigError,
        match=r"agent 0: message of agent 1 = no basis: .*; flags, a ray, and 1 columns",
    ):
        agents[0].step({1: change(sent[1])})


def test_another_right_hand_side_at_a_neighbour_is_refused():
    agents = {i: DistributedSimplex(i, [1.0], [[1.0]], [1.0 + i], 1) for i in range(2)}
    with pytest.raises(
        ConfigError,
        match=r"b of agent 1: found \[2.0\]; allowed: \[1.0\], the same at all agents",
    ):
        run_team(agents, ring(2))


@pytest.mark.parametrize("dual", [False, True])
def test_the_bases_are_the_same_whatever_is_lost(dual):
    c, A, b, parts = draw(6)
    graph, histories = ring(len(parts), directed=True), []
    d = graph.diameter()
    for loss in (0.0, 0.4):
        agents = {
            i: DualDistributedSimplex(i, b, A[:, p].T, c[p], d)
            if dual
            else DistributedSimplex(i, c[p], A[:, p], b, d)
            for i, p in enumerate(parts)
        }
        histories.append(
            simulate(agents, graph, loss=loss, record=("x",) if dual else ("x", "cost"))
        )
        assert agents[0].result.rounds == histories[-1].rounds
    assert histories[1].lost > 10
    for i in graph.ids:
        for name, values in histories[0].values[i].items():
            assert np.array_equal(values, histories[1].values[i][name])


def test_what_fails_at_one_agent_ends_all_of_them():
    agents = {
        i: DistributedSimplex(i, [1.0], [[1.0]], [1.0 + (i == 2)], 2) for i in range(4)
    }
    with pytest.raises(ConfigError, match="b of agent 2: found"):
        simulate(agents, ring(4), record=())


def solve(agents):
    """(status, results) of a team on a ring; all agents end alike, as run_team requires."""
    graph = ring(len(agents))
    try:
        run_team(agents, graph)
    except SolverError as error:
        return error.status.partition(":")[0], []
    return "optimal", [agent.result for agent in agents.values()]


def primal_team(c, A, b, parts):
    diameter = len(parts) // 2
    return {
        i: DistributedSimplex(i, c[part], A[:, part], b, diameter)
        for i, part in enumerate(parts)
    }


def dual_team(c, A, b, parts):
    """max b'y s.t. A'y <= c, the dual of min c'x s.t. A x = b, x >= 0."""
    diameter = len(parts) // 2
    return {
        i: DualDistributedSimplex(i, b, A[:, part].T, c[part], diameter)
        for i, part in enumerate(parts)
    }


def require_agreement_with_the_program_in_units_near_1(seed):
    """Solve a scaled program and its dual; compare with HiGHS on the unscaled one, each row by its own terms."""
    program = draw_scaled(seed)
    c, A, b = program.scaled
    status, results = solve(primal_team(c, A, b, program.parts))
    assert status == program.status
    dual_status, duals = solve(dual_team(c, A, b, program.parts))
    if status == "unbounded":
        assert dual_status == "infeasible"
    if status == "infeasible":
        assert dual_status in ("infeasible", "unbounded")
    if status != "optimal":
        return
    assert dual_status == "optimal"
    x = np.concatenate([result.x for result in results]) * program.s
    assert (x >= 0.0).all()
    terms = np.abs(program.A) @ x + np.abs(program.b)
    assert (np.abs(program.A @ x - program.b) <= 1e-8 * terms).all()
    size = np.abs(program.c) @ x + abs(program.value)
    assert abs(results[0].cost - program.value) <= 1e-7 * size
    y = duals[0].x * program.r
    assert (
        program.A.T @ y - program.c
        <= 1e-8 * (np.abs(program.c) + np.abs(program.A.T) @ np.abs(y))
    ).all()
    assert abs(duals[0].cost - program.value) <= 1e-7 * (
        size + np.abs(y) @ np.abs(program.b)
    )
    prices = results[0].prices * program.r
    assert (
        program.c - prices @ program.A
        >= -1e-8 * (np.abs(program.c) + np.abs(prices) @ np.abs(program.A))
    ).all()
    assert all(r.ids == results[0].ids and r.cost == results[0].cost for r in results)
    assert all(np.array_equal(r.prices, results[0].prices) for r in results)
    assert all(
        np.array_equal(r.x, duals[0].x) and r.active == duals[0].active for r in duals
    )


SCALED = [range(k, k + 40) for k in range(0, 2000, 40)]


@pytest.mark.parametrize(
    "seeds",
    [
        *SCALED[:3],
        *(pytest.param(seeds, marks=pytest.mark.slow) for seeds in SCALED[3:]),
    ],
    ids=lambda seeds: f"{seeds[0]}-",
)
def test_rows_and_columns_in_any_units_change_nothing(seeds):
    for seed in seeds:
        require_agreement_with_the_program_in_units_near_1(seed)


@pytest.mark.parametrize(
    "seeds",
    [range(k, k + 24) for k in range(0, 48, 24)],
    ids=lambda seeds: f"{seeds[0]}-",
)
def test_units_that_are_powers_of_two_give_the_same_basis(seeds):
    for seed in seeds:
        program = draw_scaled(seed, base=2.0)
        status, results = solve(primal_team(*program.scaled, program.parts))
        same_status, plain = solve(
            primal_team(program.c, program.A, program.b, program.parts)
        )
        assert status == same_status == program.status
        for one, other in zip(results, plain, strict=True):
            assert one.ids == other.ids
            s = program.s[program.parts[results.index(one)]]
            assert one.x * s == pytest.approx(other.x, rel=1e-12)


TWO_UNITS = np.array([[1e6, 1e6, 0.0, 0.0], [1e-4, 0.0, 1e-4, 0.0]])


def one_column_each(c, A, b):
    return primal_team(
        np.array(c), A, np.array(b), [np.array([k]) for k in range(len(c))]
    )


def test_a_small_right_hand_side_beside_a_large_one_is_met():
    status, results = solve(
        one_column_each([1.0, 3.0, 1.0, 2.0], TWO_UNITS, [1e6, 5e-5])
    )
    assert status == "optimal"
    assert [result.cost for result in results] == pytest.approx([2.0] * 4)
    assert np.concatenate([result.x for result in results]) == pytest.approx(
        [0.5, 0.5, 0.0, 0.0]
    )


def test_a_small_row_that_cannot_be_met_is_infeasible():
    without = np.delete(TWO_UNITS, 2, axis=1)
    agents = one_column_each([1.0, 3.0, 2.0], without, [1e6, 0.05])
    fail(agents, ring(3), r"infeasible: row 1 \(0.0499 left\)")
    agents = one_column_each([1.0, 3.0, 1.0, 2.0], TWO_UNITS, [1e6, -1e-12])
    fail(agents, ring(4), r"infeasible: row 1 \(1e-12 left\)")


def test_the_dual_calls_no_unbounded_program_optimal():
    A = np.array([[1e6, 0.0], [-1e6, 0.0]])
    agents = {
        i: DualDistributedSimplex(i, [1e6, 1e-4], A[i : i + 1], [1e6], 1)
        for i in range(2)
    }
    fail(agents, ring(2), r"unbounded: variable 1 \(0.0001 left\) without a limit")


def nearly_equal_rows(difference, b):
    A = np.array([[1.0, 1.0], [1.0, 1.0 + difference]])
    return {
        i: DistributedSimplex(i, [1.0 + i], A[:, i : i + 1], b, 1) for i in range(2)
    }


def test_rows_that_differ_in_their_last_digits_alone_count_as_one():
    agents = nearly_equal_rows(2.0**-36, [2.0, 2.0])
    run_team(agents, ring(2))
    assert [agent.result.x.tolist() for agent in agents.values()] == [[2.0], [0.0]]
    agents = nearly_equal_rows(2.0**-36, [2.0, 2.5])
    fail(agents, ring(2), r"infeasible: row 1 \(0.5 left\)")


@pytest.mark.parametrize("b", [[2.0, 2.0 + 1e-8], [2.0, 2.5]])
def test_rows_that_differ_by_more_than_rounded_data_and_less_than_can_be_met_are_refused(
    b,
):
    found = "differs from a sum of other.* by .e-09 of its terms"
    fail(nearly_equal_rows(1e-8, b), ring(2), f"{found}: double precision cannot tell")


def test_levels_that_are_smaller_than_their_rounding_errors_are_refused_by_all_agents():
    n = 12
    hilbert = 1.0 / (np.arange(n)[:, None] + np.arange(n) + 1.0)
    agents = primal_team(
        np.ones(n), hilbert, hilbert @ np.ones(n), np.split(np.arange(n), 3)
    )
    fail(agents, ring(3), "double precision cannot tell")


@pytest.mark.parametrize("agent", [0, 2])
def test_a_failure_at_one_agent_is_raised_by_all_in_one_round(agent, monkeypatch):
    c = np.array([1.0, 2.0, 3.0, 4.0])
    parts = [np.array([k]) for k in range(4)]
    agents = primal_team(c, np.ones((1, 4)), np.array([1.0]), parts)
    exchange = agents[agent]._bases

    def fail_once(*arguments):
        raise SolverError("lexicographic simplex", "a singular basis")

    monkeypatch.setattr(exchange, "_best", fail_once)
    exchange._weighed = set()
    fail(agents, ring(4), "agent 0: .*a singular basis")


def test_bases_that_no_agent_can_tell_apart_end_as_one():
    """Each agent holds its own basis and judges it the best, as rounding may make it."""
    exchanges = {
        i: BasisExchange(i, np.array([1.0]), np.ones((1, 1)), np.array([1.0]), 1)
        for i in range(2)
    }
    for exchange in exchanges.values():
        exchange._weighed = {(0, 0), (1, 0)}
    for _ in range(30):
        sent = {i: exchange.message() for i, exchange in exchanges.items()}
        for i, exchange in exchanges.items():
            exchange.step({1 - i: sent[1 - i]})
        if exchanges[0].settled:
            break
    assert exchanges[0].settled
    assert exchanges[1].settled
    assert exchanges[0].undecided
    assert exchanges[1].undecided
    for exchange in exchanges.values():
        assert exchange.basis.columns.ids.tolist() == [[0, 0]]
        assert exchange.pricing().excess() == 0.0
