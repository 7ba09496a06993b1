"""The weights of graph.py: their sums, and what consensus does with them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.team.graph import (
    Graph,
    Weights,
    column_stochastic,
    erdos_renyi_connected,
    metropolis,
    path,
    row_stochastic,
)

CONNECTED = st.builds(
    erdos_renyi_connected,
    st.integers(2, 8),
    st.just(0.5),
    st.integers(0, 99),
    st.booleans(),
)
UNDIRECTED = st.builds(
    erdos_renyi_connected, st.integers(2, 8), st.just(0.5), st.integers(0, 99)
)


def matrix(weights: Weights) -> np.ndarray:
    return np.array([[weights[i].get(j, 0.0) for j in weights] for i in weights])


def test_metropolis_on_a_path() -> None:
    third = pytest.approx(1 / 3)
    assert metropolis(path(3)) == {
        0: {0: pytest.approx(2 / 3), 1: third},
        1: {0: third, 1: third, 2: third},
        2: {1: third, 2: pytest.approx(2 / 3)},
    }


@given(UNDIRECTED)
def test_metropolis_is_symmetric_and_doubly_stochastic(graph: Graph) -> None:
    w = matrix(metropolis(graph))
    assert np.array_equal(w, w.T)
    assert w.min() >= 0.0
    assert w.diagonal().min() > 0.0
    np.testing.assert_allclose(w.sum(axis=1), 1.0)
    for i in graph.ids:
        for j in graph.neighbors(i):
            assert w[i, j] == 1 / (
                1 + max(len(graph.neighbors(i)), len(graph.neighbors(j)))
            )


@given(UNDIRECTED)
def test_consensus_with_metropolis_reaches_the_mean(graph: Graph) -> None:
    x = np.arange(len(graph.ids)) ** 2.0
    reached = np.linalg.matrix_power(matrix(metropolis(graph)), 2000) @ x
    np.testing.assert_allclose(reached, x.mean(), rtol=1e-9)


@given(CONNECTED)
def test_rows_and_columns_sum_to_one_on_the_arcs(graph: Graph) -> None:
    rows, columns = matrix(row_stochastic(graph)), matrix(column_stochastic(graph))
    np.testing.assert_allclose(rows.sum(axis=1), 1.0)
    np.testing.assert_allclose(columns.sum(axis=0), 1.0)
    arcs = {(i, j) for j, i in graph.arcs} | {(i, i) for i in graph.ids}
    assert (
        set(zip(*np.nonzero(rows), strict=True))
        == set(zip(*np.nonzero(columns), strict=True))
        == arcs
    )
    for i, j in arcs:
        assert rows[i, j] == 1 / (1 + len(graph.in_neighbors(i)))
        assert columns[i, j] == 1 / (1 + len(graph.out_neighbors(j)))


@given(CONNECTED)
def test_push_sum_with_column_weights_reaches_the_mean(graph: Graph) -> None:
    x = np.arange(len(graph.ids)) ** 2.0
    power = np.linalg.matrix_power(matrix(column_stochastic(graph)), 2000)
    np.testing.assert_allclose(
        (power @ x) / (power @ np.ones_like(x)), x.mean(), rtol=1e-9
    )


def test_weights_are_listed_by_increasing_id() -> None:
    graph = Graph.from_edges([4, 1, 7], [(7, 1), (1, 4)])
    for weights in (metropolis(graph), row_stochastic(graph), column_stochastic(graph)):
        assert [list(row) for row in weights.values()] == [[1, 4, 7], [1, 4], [1, 7]]
