"""Graphs: shapes, directions, connectivity, names, graphs that change."""

import os
import subprocess
import sys
import time
from itertools import product

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.errors import ConfigError
from crazychoir.team import graph as shapes
from crazychoir.team.graph import Graph, GraphSequence

SIZES = st.integers(1, 9)


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    ids = sorted(draw(st.sets(st.integers(0, 9999), min_size=1, max_size=7)))
    arcs = [(i, j) for i, j in product(ids, ids) if i != j]
    chosen = draw(st.lists(st.sampled_from(arcs), max_size=20)) if arcs else []
    return Graph.from_edges(ids, chosen, directed=draw(st.booleans()))


def reach(graph: Graph) -> dict[tuple[int, int], int]:
    """All pairs' hops by Floyd and Warshall, to check the breadth-first search against."""
    far = len(graph.ids) + 1
    hops = {
        (i, j): 0 if i == j else 1 if (i, j) in graph.arcs else far
        for i in graph.ids
        for j in graph.ids
    }
    for m, i, j in product(graph.ids, repeat=3):
        hops[i, j] = min(hops[i, j], hops[i, m] + hops[m, j])
    return hops


@given(graphs())
def test_neighbors_agree_with_the_arcs(graph: Graph) -> None:
    for i in graph.ids:
        assert graph.in_neighbors(i) == tuple(
            j for j in graph.ids if (j, i) in graph.arcs
        )
        assert graph.out_neighbors(i) == tuple(
            j for j in graph.ids if (i, j) in graph.arcs
        )
        assert graph.neighbors(i) == tuple(
            j for j in graph.ids if (i, j) in graph.arcs or (j, i) in graph.arcs
        )
    assert graph.is_undirected == all((j, i) in graph.arcs for i, j in graph.arcs)
    assert all(i < j for i, j in graph.edges())


@given(graphs())
def test_connectivity_and_diameter_agree_with_all_pairs(graph: Graph) -> None:
    longest = max(reach(graph).values())
    assert graph.is_connected == (longest < len(graph.ids))
    if graph.is_connected:
        assert graph.diameter() == longest
    else:
        with pytest.raises(ConfigError, match="a drone that cannot reach all others"):
            graph.diameter()


@given(graphs())
def test_round_trips(graph: Graph) -> None:
    assert Graph.from_edges(graph.ids, graph.arcs, directed=True) == graph
    assert Graph.from_neighbors({i: graph.in_neighbors(i) for i in graph.ids}) == graph
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(graph), type=Graph) == graph
    if graph.is_undirected:
        assert Graph.from_edges(graph.ids, graph.edges()) == graph


def test_a_directed_edge_goes_one_way() -> None:
    graph = Graph.from_edges(3, [(0, 1), (1, 2)], directed=True)
    assert (graph.out_neighbors(0), graph.in_neighbors(1), graph.in_neighbors(0)) == (
        (1,),
        (0,),
        (),
    )
    assert not graph.is_undirected
    assert not graph.is_connected


@pytest.mark.parametrize(
    ("graph", "edges", "diameter"),
    [
        (shapes.ring(5), ((0, 1), (0, 4), (1, 2), (2, 3), (3, 4)), 2),
        (shapes.ring(2), ((0, 1),), 1),
        (shapes.ring(1), (), 0),
        (shapes.path([2, 9, 4]), ((2, 4), (4, 9)), 2),
        (shapes.star([3, 1, 8]), ((1, 3), (1, 8)), 2),
        (shapes.complete(3), ((0, 1), (0, 2), (1, 2)), 1),
        (shapes.k_regular(4, 3), shapes.complete(4).edges(), 1),
        (
            shapes.k_regular(6, 4),
            tuple((i, j) for i, j in shapes.complete(6).edges() if j - i != 3),
            2,
        ),
        (
            shapes.grid(2, 3),
            ((0, 1), (0, 3), (1, 2), (1, 4), (2, 5), (3, 4), (4, 5)),
            3,
        ),
        (shapes.grid(2, 2, diagonals=True), shapes.complete(4).edges(), 1),
        (
            shapes.grid(2, 3, diagonals=True),
            (
                (0, 1),
                (0, 3),
                (0, 4),
                (1, 2),
                (1, 3),
                (1, 4),
                (1, 5),
                (2, 4),
                (2, 5),
                (3, 4),
                (4, 5),
            ),
            2,
        ),
    ],
)
def test_shapes(
    graph: Graph, edges: tuple[tuple[int, int], ...], diameter: int
) -> None:
    assert (graph.edges(), graph.diameter(), graph.is_undirected) == (
        edges,
        diameter,
        True,
    )


def test_parts_are_what_is_joined_whatever_the_direction() -> None:
    assert shapes.ring(4).parts() == ((0, 1, 2, 3),)
    assert Graph.from_edges(
        (0, 1, 3, 4, 7), [(4, 3), (1, 0)], directed=True
    ).parts() == ((0, 1), (3, 4), (7,))
    assert shapes.empty(2).parts() == ((0,), (1,))


def test_a_directed_ring_sends_to_the_next() -> None:
    ring = shapes.ring(4, directed=True)
    assert [ring.out_neighbors(i) for i in ring.ids] == [(1,), (2,), (3,), (0,)]
    assert ring.is_connected
    assert ring.diameter() == 3


@given(SIZES, st.integers(0, 8))
def test_k_regular_gives_everybody_k_neighbors(n: int, k: int) -> None:
    if k < n and k * n % 2 == 0:
        graph = shapes.k_regular(n, k)
        assert {len(graph.neighbors(i)) for i in graph.ids} == {k}
    else:
        with pytest.raises(ConfigError, match="k-regular graph: found k = "):
            shapes.k_regular(n, k)


@given(SIZES, st.integers(-3, 1000), st.booleans())
def test_erdos_renyi_is_connected_and_repeats(
    n: int, seed: int, directed: bool
) -> None:
    graph = shapes.erdos_renyi_connected(n, 0.7, seed, directed)
    assert graph.is_connected
    assert graph == shapes.erdos_renyi_connected(n, 0.7, seed, directed)


@pytest.mark.parametrize("seed", range(5))
def test_geometric_is_connected_and_grows_with_the_radius(seed: int) -> None:
    few, many = shapes.geometric(20, 0.35, seed), shapes.geometric(20, 0.6, seed)
    assert few.is_connected
    assert few.is_undirected
    assert few == shapes.geometric(20, 0.35, seed)
    assert few != shapes.geometric(20, 0.35, seed + 100)
    assert len(few.edges()) < len(many.edges())


@pytest.mark.parametrize("radius", [0.0, 2.5, float("nan")])
def test_geometric_refuses_other_radii(radius: float) -> None:
    with pytest.raises(ConfigError, match="radius"):
        shapes.geometric(5, radius, 1)


def test_a_radius_that_never_connects_is_named() -> None:
    with pytest.raises(ConfigError, match="none of 1000 draws is connected"):
        shapes.geometric(30, 0.01, 1)


def test_erdos_renyi_has_about_p_of_the_edges_and_depends_on_the_seed() -> None:
    drawn = [shapes.erdos_renyi_connected(20, 0.4, seed) for seed in range(20)]
    assert sum(len(graph.edges()) for graph in drawn) / (20 * 190) == pytest.approx(
        0.4, abs=0.03
    )
    assert len(set(drawn)) == 20
    assert shapes.erdos_renyi_connected(6, 0.4, 1) != shapes.erdos_renyi_connected(
        6, 0.4, -1
    )


def test_a_drawn_graph_does_not_depend_on_the_hash_seed() -> None:
    program = (
        "from crazychoir.team.graph import graph_from_name\n"
        "print(graph_from_name('erdos-renyi:0.4', [5, 900, 17, 3, 44], 7))"
    )
    texts = [
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "PYTHONHASHSEED": h},
            capture_output=True,
            check=True,
        ).stdout
        for h in ("1", "2")
    ]
    assert (
        texts[0]
        == texts[1]
        == f"{shapes.graph_from_name('erdos-renyi:0.4', [5, 900, 17, 3, 44], 7)}\n".encode()
    )


@pytest.mark.parametrize(
    ("name", "graph"),
    [
        ("ring", shapes.ring(6)),
        ("path", shapes.path(6)),
        ("star", shapes.star(6)),
        ("complete", shapes.complete(6)),
        ("empty", shapes.empty(6)),
        ("k-regular:4", shapes.k_regular(6, 4)),
        ("erdos-renyi:0.5", shapes.erdos_renyi_connected(6, 0.5, 3)),
        ("erdos-renyi:1", shapes.complete(6)),
        ("geometric:0.6", shapes.geometric(6, 0.6, 3)),
        ("geometric:1.5", shapes.complete(6)),
        ("grid:2x3", shapes.grid(2, 3)),
    ],
)
def test_names(name: str, graph: Graph) -> None:
    assert shapes.graph_from_name(name, 6, seed=3) == graph


def test_a_wrong_name_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError) as caught:
        shapes.graph_from_name("triangle", 6)
    assert str(caught.value) == (
        "graph: found triangle; allowed: ring, path, star, complete, empty, k-regular:K, erdos-renyi:P, geometric:R, "
        "grid:ROWSxCOLUMNS."
    )


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (
            lambda: shapes.graph_from_name("grid:2x2", 6),
            "grid graph: found 2x2; allowed: rows times columns = 6 drones.",
        ),
        (
            lambda: shapes.graph_from_name("k-regular:3", 5),
            "k-regular graph: found k = 3; allowed: 0 to 4, with k times 5",
        ),
        (
            lambda: shapes.graph_from_name("erdos-renyi:0.01", 9),
            "p = 0.01: none of 1000 draws is connected; allowed: a larger p",
        ),
        (
            lambda: shapes.graph_from_name("erdos-renyi:7", 9),
            "random graph: found p = 7; allowed: a probability, 0 to 1.",
        ),
        (lambda: shapes.ring(3).neighbors(7), "graph: found drone 7; allowed: 0 to 2."),
        (
            lambda: Graph.from_edges([0, 2], [(2, 2)]),
            "found edge [2, 2]; allowed: two different drones of 0, 2.",
        ),
        (
            lambda: Graph.from_edges(2, [(0, 5)]),
            "found edge [0, 5]; allowed: two different drones of 0 to 1.",
        ),
        (
            lambda: Graph.from_edges([1, 1], []),
            r"found [1, 1]; allowed: at least one drone id, each once",
        ),
        (lambda: Graph.from_edges(0, []), "found []; allowed: at least one drone id"),
        (lambda: Graph((0, 1), ((1, 0), (0, 1))), "arcs out of order or twice"),
        (
            lambda: GraphSequence(()),
            "found 0 graph(s); allowed: one or more graphs of the same drones",
        ),
        (lambda: GraphSequence((shapes.ring(3), shapes.ring(4))), "found 2 graph(s)"),
        (
            lambda: shapes.metropolis(shapes.ring(3, directed=True)),
            "found a directed graph; allowed: an undirected",
        ),
    ],
)
def test_errors_say_what_is_allowed(wrong: object, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        wrong()  # type: ignore[operator]
    assert text in str(caught.value)


def test_a_hostile_graph_does_not_decode() -> None:
    with pytest.raises(msgspec.ValidationError, match="two different drones"):
        msgspec.msgpack.decode(msgspec.msgpack.encode([[0, 1], [[0, 7]]]), type=Graph)


def test_a_sequence_repeats_and_is_jointly_connected() -> None:
    sequence = GraphSequence(
        (Graph.from_edges(3, [(0, 1)]), Graph.from_edges(3, [(1, 2)]))
    )
    assert [sequence.at(k).edges() for k in range(3)] == [
        ((0, 1),),
        ((1, 2),),
        ((0, 1),),
    ]
    assert sequence.is_connected
    assert not any(graph.is_connected for graph in sequence.graphs)
    assert sequence.diameter() == 3  # from 0 in round 1: 0-1 in round 2, 1-2 in round 3
    assert GraphSequence((shapes.path(5), shapes.path(5))).diameter() == 4
    with pytest.raises(ConfigError, match="never reaches all"):
        GraphSequence((Graph.from_edges(3, [(0, 1)]),)).diameter()
    assert sequence.union() == shapes.path(3)
    assert not GraphSequence(
        (Graph.from_edges(3, [(0, 1)]), shapes.empty(3))
    ).is_connected
    assert shapes.ring(3).at(12) == shapes.ring(3)


@given(graphs(), st.integers(1, 6), st.integers(0, 99))
def test_drawn_sub_graphs_unite_to_the_whole(
    graph: Graph, length: int, seed: int
) -> None:
    sequence = GraphSequence.draw(graph, 0.2, length, seed)
    assert sequence.union() == graph
    assert len(sequence.graphs) == length
    assert sequence == GraphSequence.draw(graph, 0.2, length, seed)


@pytest.mark.parametrize(
    ("ids", "text"),
    [
        ([3], "3"),
        ([2, 0, 1], "0 to 2"),
        ([0, 2], "0, 2"),
        (range(0, 60, 2), ", 36, 38, ..."),
    ],
)
def test_span(ids: list[int], text: str) -> None:
    assert shapes.describe_ids(ids).endswith(text)


@pytest.mark.parametrize(
    "spelling",
    ["0.5", ".5", "5e-1", "5E-1", "0.50", "0.500000000000", "+0.5", " 0.5 ", "50e-2"],
)
def test_a_number_of_a_shape_is_taken_however_it_is_written(spelling: str) -> None:
    assert shapes.graph_from_name(
        f"erdos-renyi:{spelling}", 6, seed=3
    ) == shapes.erdos_renyi_connected(6, 0.5, 3)
    assert shapes.graph_from_name(
        f"geometric:{spelling}", 6, seed=3
    ) == shapes.geometric(6, 0.5, 3)


@pytest.mark.parametrize(
    "name",
    [
        "grid:2X3",
        "grid:2 x 3",
        "grid:2\N{MULTIPLICATION SIGN}3",
        "grid:02x3",
        " grid:2x3",
    ],
)
def test_the_sides_of_a_grid_are_taken_however_they_are_written(name: str) -> None:
    assert shapes.graph_from_name(name, 6) == shapes.grid(2, 3)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("erdos-renyi", "allowed: erdos-renyi:P, with P a probability of 0 to 1"),
        ("erdos-renyi:", "allowed: erdos-renyi:P, with P a probability of 0 to 1"),
        ("erdos-renyi:x", "allowed: erdos-renyi:P, with P a probability of 0 to 1"),
        ("erdos-renyi:nan", "allowed: erdos-renyi:P"),
        ("erdos-renyi:inf", "allowed: erdos-renyi:P"),
        ("erdos-renyi:0,3", "Write erdos-renyi:0.3."),
        ("erdos-renyi:30%", "Write erdos-renyi:0.3."),
        ("erdos-renyi:30", "30 % is 0.3."),
        ("erdos-renyi:-0.1", "allowed: a probability, 0 to 1"),
        ("erdos_renyi:0.3", "Did you mean erdos-renyi:0.3?"),
        ("Erdos-Renyi:0.3", "Did you mean erdos-renyi:0.3?"),
        ("Ring", "Did you mean ring?"),
        ("compleet", "Did you mean complete?"),
        ("ring:3", "Write ring."),
        ("star:", "Write star."),
        ("k-regular:4.0", "Write k-regular:4."),
        ("k-regular:x", "with K a whole number of neighbours"),
        ("k-regular:-2", "with K a whole number of neighbours"),
        ("k-regular:99999", "k = 99999; allowed: 0 to 5"),
        ("k-regular:" + "9" * 5000, "with K a whole number of neighbours"),
        ("geometric:nan", "with R a radius above 0"),
        ("geometric:0", "radius 0; allowed: above 0, at most 2"),
        ("grid:6", "with ROWS and COLUMNS whole numbers"),
        ("grid:2x3x1", "with ROWS and COLUMNS whole numbers"),
        ("grid:x", "with ROWS and COLUMNS whole numbers"),
        ("", "allowed: ring, path"),
        (":", "allowed: ring, path"),
    ],
    ids=lambda text: text[:20],
)
def test_a_number_that_a_shape_cannot_have_is_refused_with_its_form(
    name: str, text: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        shapes.graph_from_name(name, 6, seed=3)
    assert text in str(refused.value)


@pytest.mark.parametrize("name", ["erdos-renyi:1e-9", "geometric:1e-9"])
def test_a_shape_that_never_connects_a_large_swarm_is_refused_at_once(
    name: str,
) -> None:
    began = time.perf_counter()
    with pytest.raises(ConfigError, match="none of 1000 draws is connected"):
        shapes.graph_from_name(name, 3000)
    assert time.perf_counter() - began < 5.0
