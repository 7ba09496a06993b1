"""Communication graphs over drone ids: shapes, weights, and graphs that change with the round."""

import random
import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from functools import cached_property, lru_cache
from itertools import combinations, pairwise, permutations, product
from math import dist, isfinite, nan, pi
from typing import Self

from crazychoir.errors import ConfigError
from crazychoir.types import Wire

Ids = int | Iterable[int]
"""Number of drones, or their ids."""
Arc = tuple[int, int]
"""(sender, receiver)."""
Weights = dict[int, dict[int, float]]
"""w[i][j]: weight of j at i."""

SHAPE_NAMES = "ring, path, star, complete, empty, k-regular:K, erdos-renyi:P, geometric:R, grid:ROWSxCOLUMNS"
"""Shapes that a swarm file can name."""
DIRECTED_SHAPES = "ring, erdos-renyi:P"
"""Shapes of SHAPE_NAMES that can be directed."""
LEAST_LIKENESS = 0.75
"""Least likeness of a name to the shape that was meant, 0 to 1."""
SHAPE_FORMS = {
    "k-regular": ("k-regular:K", "K a whole number of neighbours, as k-regular:4"),
    "erdos-renyi": ("erdos-renyi:P", "P a probability of 0 to 1, as erdos-renyi:0.3"),
    "geometric": (
        "geometric:R",
        "R a radius above 0, at most 2, in sides of the square, as geometric:0.4",
    ),
    "grid": ("grid:ROWSxCOLUMNS", "ROWS and COLUMNS whole numbers, as grid:3x4"),
}
"""Shapes that take numbers: how each is written, and the meaning of its numbers."""
SHAPE_DIGITS = 9
"""Largest number of digits of a whole number in a shape."""
_PLAIN_NUMBER = re.compile(r"[0-9]{1,9}\.?[0-9]{0,9}|\.[0-9]{1,9}")
"""A number in plain decimal digits, without a sign or an exponent."""
HOPELESS_ISOLATION = 40.0
"""Mean number of isolated drones above which a random graph is not even
drawn: the probability of a connected draw is below exp(-40).
"""
CONNECTED_DRAWS = 1000
"""Most attempts to draw a connected random graph."""


class Graph(Wire, frozen=True, array_like=True, gc=True, dict=True):
    """A directed graph; the arc (i, j) says that drone i sends to drone j.

    All answers are sorted tuples.
    Raises ConfigError if the fields do not describe such a graph, and for a drone that is not in
    it.
    """

    ids: tuple[int, ...]
    """Drone ids, increasing."""
    arcs: tuple[Arc, ...]
    """Ordered pairs of drones, increasing, without loops."""

    def __post_init__(self) -> None:
        if not self.ids or any(i >= j for i, j in pairwise(self.ids)):
            raise ConfigError(
                "graph", list(self.ids), "at least one drone id, each once, increasing"
            )
        if any(a >= b for a, b in pairwise(self.arcs)):
            raise ConfigError(
                "graph",
                "arcs out of order or twice",
                "each once, increasing",
                "Use Graph.from_edges.",
            )
        members = self.members
        for i, j in self.arcs:
            if i == j or i not in members or j not in members:
                raise ConfigError(
                    "graph",
                    f"edge [{i}, {j}]",
                    f"two different drones of {describe_ids(self.ids)}",
                )

    @classmethod
    def from_edges(
        cls, ids: Ids, pairs: Iterable[Iterable[int]], directed: bool = False
    ) -> Self:
        """Return the graph with the edges [i, j].

        directed: True if i only sends to j; False if both also send back
        """
        arcs = [_arc(pair) for pair in pairs]
        both = arcs if directed else arcs + [(j, i) for i, j in arcs]
        return cls(_ids(ids), tuple(sorted(dict.fromkeys(both))))

    @classmethod
    def from_neighbors(cls, neighbors: Mapping[int, Iterable[int]]) -> Self:
        """Return the graph in which drone i receives from the drones neighbors[i].

        It is undirected if the two drones of every pair name each other.
        """
        return cls.from_edges(
            neighbors,
            ((j, i) for i, heard in neighbors.items() for j in heard),
            directed=True,
        )

    @cached_property
    def _in(self) -> dict[int, tuple[int, ...]]:
        return _adjacency(self.ids, ((j, i) for i, j in self.arcs))

    @cached_property
    def _out(self) -> dict[int, tuple[int, ...]]:
        return _adjacency(self.ids, self.arcs)

    @cached_property
    def _both(self) -> dict[int, tuple[int, ...]]:
        return {
            i: tuple(sorted(dict.fromkeys(self._in[i] + self._out[i])))
            for i in self.ids
        }

    @cached_property
    def members(self) -> frozenset[int]:
        """The drones as a set, for quick questions."""
        return frozenset(self.ids)

    def in_neighbors(self, i: int) -> tuple[int, ...]:
        """Return the drones that drone i receives from."""
        return self._in[self._member(i)]

    def out_neighbors(self, i: int) -> tuple[int, ...]:
        """Return the drones that receive from drone i."""
        return self._out[self._member(i)]

    def neighbors(self, i: int) -> tuple[int, ...]:
        """Return the drones that send to drone i or receive from it."""
        return self._both[self._member(i)]

    def _member(self, i: int) -> int:
        if i not in self._in:
            raise ConfigError("graph", f"drone {i}", describe_ids(self.ids))
        return i

    def edges(self) -> tuple[Arc, ...]:
        """Return each pair (i, j), i < j, with an arc in at least one direction.

        `arcs` holds the directions.
        """
        return tuple(sorted(dict.fromkeys((min(arc), max(arc)) for arc in self.arcs)))

    @cached_property
    def is_undirected(self) -> bool:
        """True if each arc has its opposite."""
        return self._in == self._out

    @cached_property
    def is_connected(self) -> bool:
        """True if a message of each drone reaches every other drone (strongly connected)."""
        first = self.ids[0]
        return all(
            len(_distances(first, step)) == len(self.ids)
            for step in (self._in, self._out)
        )

    def parts(self) -> tuple[tuple[int, ...], ...]:
        """Return the groups of drones that edges join in either
        direction, ordered by their lowest id.

        A graph without isolated drones or groups has one part.
        """
        return self._parts

    @cached_property
    def _parts(self) -> tuple[tuple[int, ...], ...]:
        found: list[tuple[int, ...]] = []
        seen: dict[int, int] = {}
        for i in self.ids:
            if i not in seen:
                part = _distances(i, self._both)
                seen.update(part)
                found.append(tuple(sorted(part)))
        return tuple(found)

    def diameter(self) -> int:
        """Return the largest number of hops that a message needs
        between two drones: the rounds of a flood.

        Raises ConfigError if the graph is not connected.
        """
        if not self.is_connected:
            do = "Add an edge; in flight: those in between have gone, and the others cannot go on as a team."
            raise ConfigError(
                "graph", "a drone that cannot reach all others", "a connected graph", do
            )
        return _diameter(self.ids, self.arcs)

    def at(self, k: int) -> Self:
        """Return the graph of round k, which is always this one."""
        return self


class GraphSequence(Wire, frozen=True, array_like=True, gc=False):
    """A graph that changes periodically: round k uses graphs[k mod len(graphs)].

    Raises ConfigError without a graph, or if the graphs have different drones.
    """

    graphs: tuple[Graph, ...]
    """The graphs of one period."""

    def __post_init__(self) -> None:
        if not self.graphs or any(
            graph.ids != self.graphs[0].ids for graph in self.graphs
        ):
            raise ConfigError(
                "graph sequence",
                f"{len(self.graphs)} graph(s)",
                "one or more graphs of the same drones",
            )

    @classmethod
    def draw(cls, graph: Graph, p: float, length: int, seed: int) -> Self:
        """Return `length` sub-graphs of `graph`; each keeps each edge with probability p.

        Edge number e is always in graph e mod `length`, therefore the union of all is `graph`.
        """
        chance = _random_stream(p, seed, length, *graph.ids)
        directed = not graph.is_undirected
        kept: list[list[Arc]] = [[] for _ in range(length)]
        for (e, edge), k in product(
            enumerate(graph.arcs if directed else graph.edges()), range(length)
        ):
            if chance.random() < p or e % length == k:
                kept[k].append(edge)
        return cls(
            tuple(Graph.from_edges(graph.ids, pairs, directed) for pairs in kept)
        )

    @property
    def ids(self) -> tuple[int, ...]:
        """Drone ids, increasing."""
        return self.graphs[0].ids

    @property
    def members(self) -> frozenset[int]:
        """The drones as a set, for quick questions."""
        return self.graphs[0].members

    def at(self, k: int) -> Graph:
        """Return the graph of round k."""
        return self.graphs[k % len(self.graphs)]

    def union(self) -> Graph:
        """Return the graph with all arcs of one period."""
        return Graph.from_edges(
            self.ids,
            (arc for graph in self.graphs for arc in graph.arcs),
            directed=True,
        )

    @property
    def is_connected(self) -> bool:
        """True if the graphs of one period are jointly (strongly) connected."""
        return self.union().is_connected

    def diameter(self) -> int:
        """Return the most rounds that a flood needs, over all
        drones and all first rounds of the period.

        Raises ConfigError if the graphs are not jointly connected.
        """
        if not self.is_connected:
            found = "a drone that never reaches all others"
            raise ConfigError(
                "graph sequence",
                found,
                "jointly connected graphs",
                "Add an edge to one of them.",
            )
        return max(
            _flooding_rounds(self, i, k)
            for i in self.ids
            for k in range(len(self.graphs))
        )


def empty(n: Ids) -> Graph:
    """Return the graph without edges.

    n: number of drones, or their ids; every shape takes both
    """
    return Graph.from_edges(n, ())


def ring(n: Ids, directed: bool = False) -> Graph:
    """Return the ring: each drone and the next, and the last and the first.

    directed: True if each drone sends to the next only
    """
    ids = _ids(n)
    return Graph.from_edges(
        ids, zip(ids, ids[1:] + ids[:1], strict=True) if len(ids) > 1 else (), directed
    )


def path(n: Ids) -> Graph:
    """Return the path: each drone and the next."""
    return Graph.from_edges(ids := _ids(n), pairwise(ids))


def star(n: Ids) -> Graph:
    """Return the star: the first drone and each other drone."""
    ids = _ids(n)
    return Graph.from_edges(ids, ((ids[0], j) for j in ids[1:]))


def complete(n: Ids) -> Graph:
    """Return the graph in which every drone receives from every other."""
    return Graph.from_edges(ids := _ids(n), combinations(ids, 2))


def k_regular(n: Ids, k: int) -> Graph:
    """Return the circulant graph of a ring: each drone and its k/2 next drones on both sides.

    If k is odd, each drone is also joined with the opposite one.
    Raises ConfigError if no such graph exists.
    """
    ids = _ids(n)
    size = len(ids)
    if not 0 <= k < size or k * size % 2:
        raise ConfigError(
            "k-regular graph",
            f"k = {k}",
            f"0 to {size - 1}, with k times {size} drones even",
        )
    offsets = [*range(1, k // 2 + 1), *([size // 2] if k % 2 else [])]
    return Graph.from_edges(
        ids, ((ids[i], ids[(i + d) % size]) for i in range(size) for d in offsets)
    )


def erdos_renyi_connected(n: Ids, p: float, seed: int, directed: bool = False) -> Graph:
    """Return a binomial graph, in which each edge exists with probability p.

    The graph is drawn again until it is (strongly) connected.
    Raises ConfigError if no draw is connected.
    """
    ids = _ids(n)
    chance = _random_stream(p, seed, *ids)
    if len(ids) * (1.0 - p) ** (len(ids) - 1) > HOPELESS_ISOLATION:
        raise _connection_error("erdos-renyi", f"p = {p:g}", "a larger p", len(ids))
    pairs = list(permutations(ids, 2) if directed else combinations(ids, 2))
    for _ in range(CONNECTED_DRAWS):
        graph = Graph.from_edges(
            ids, (pair for pair in pairs if chance.random() < p), directed
        )
        if graph.is_connected:
            return graph
    raise _connection_error("erdos-renyi", f"p = {p:g}", "a larger p", len(ids))


def geometric(n: Ids, radius: float, seed: int) -> Graph:
    """Return a graph of random points in the unit square, joined where they are within `radius`.

    This is the network of a randomly spread swarm with short-range radios. The graph is drawn again
    until it is connected.
    Raises ConfigError if no draw is connected.
    """
    ids = _ids(n)
    if not 0.0 < radius <= 2.0:
        raise ConfigError(
            "geometric graph",
            f"radius {radius:g}",
            "above 0, at most 2; 1 is the side of the square",
        )
    chance = _random_stream(0.0, seed, *ids)
    if len(ids) * max(0.0, 1.0 - pi * radius**2) ** (len(ids) - 1) > HOPELESS_ISOLATION:
        raise _connection_error(
            "geometric", f"radius {radius:g}", "a larger one", len(ids)
        )
    for _ in range(CONNECTED_DRAWS):
        points = {i: (chance.random(), chance.random()) for i in ids}
        graph = Graph.from_edges(
            ids,
            (
                e
                for e in combinations(ids, 2)
                if dist(points[e[0]], points[e[1]]) <= radius
            ),
        )
        if graph.is_connected:
            return graph
    raise _connection_error("geometric", f"radius {radius:g}", "a larger one", len(ids))


def _connection_error(shape: str, given: str, larger: str, size: int) -> ConfigError:
    return ConfigError(
        f"{shape} graph",
        f"{given}: none of {CONNECTED_DRAWS} draws is connected",
        f"{larger} for {size} drones",
    )


def grid(
    rows: int, columns: int, diagonals: bool = False, ids: Ids | None = None
) -> Graph:
    """Return the grid of rows and columns, numbered row by row.

    Each drone is joined with those to the left, right, above and below.
    diagonals: True to join the diagonal ones too
    Raises ConfigError if rows times columns is not the number of drones.
    """
    members = _ids(rows * columns if ids is None else ids)
    if rows < 1 or columns < 1 or rows * columns != len(members):
        raise ConfigError(
            "grid graph",
            f"{rows}x{columns}",
            f"rows times columns = {len(members)} drones",
        )
    steps = [(0, 1), (1, 0), *([(1, 1), (1, -1)] if diagonals else [])]
    pairs = [
        (members[r * columns + c], members[(r + dr) * columns + c + dc])
        for r, c, (dr, dc) in product(range(rows), range(columns), steps)
        if r + dr < rows and 0 <= c + dc < columns
    ]
    return Graph.from_edges(members, pairs)


def graph_from_name(name: str, n: Ids, seed: int = 0, directed: bool = False) -> Graph:
    """Return the graph that a swarm file names; SHAPE_NAMES lists the shapes.

    seed: seed of the random shapes
    directed: only for the shapes in DIRECTED_SHAPES
    Raises ConfigError for an unknown shape or a wrong number.
    """
    plain = {"path": path, "star": star, "complete": complete, "empty": empty}
    shape, colon, given = name.strip().partition(":")
    if colon and shape not in SHAPE_FORMS:
        takes_none = shape == "ring" or shape in plain
        raise ConfigError(
            "graph",
            name,
            SHAPE_NAMES,
            f"Write {shape}." if takes_none else _hint_at_shape(shape, given),
        )
    if shape == "ring":
        return ring(n, directed)
    if shape == "erdos-renyi":
        return erdos_renyi_connected(n, _read_number(name, given), seed, directed)
    if directed and (shape in plain or shape in SHAPE_FORMS):
        do = "Name one of these, list `edges` or the drones' `neighbors`, or leave directed out."
        raise ConfigError("graph", f"{name} with directed = true", DIRECTED_SHAPES, do)
    if shape in plain:
        return plain[shape](n)
    if shape == "geometric":
        return geometric(n, _read_number(name, given), seed)
    if shape == "k-regular":
        return k_regular(n, _read_whole_number(name, given))
    if shape == "grid":
        rows, columns = _read_sides(name, given)
        return grid(rows, columns, ids=n)
    raise ConfigError("graph", name, SHAPE_NAMES, _hint_at_shape(shape, given))


def _read_number(name: str, given: str) -> float:
    """Return the number of "erdos-renyi:0.3", in any notation that Python reads.

    Raises ConfigError if it is not a finite number.
    """
    try:
        number = float(given)
    except ValueError:
        number = nan
    if not isfinite(number):
        bare = given.strip().removesuffix("%").strip().replace(",", ".")
        share = (
            f"{float(bare) / 100.0:g}"
            if given.strip().endswith("%") and _PLAIN_NUMBER.fullmatch(bare)
            else bare
        )
        raise _shape_error(name, share if _PLAIN_NUMBER.fullmatch(share) else "")
    return number


def _read_whole_number(name: str, given: str) -> int:
    """Return the number of "k-regular:4"; raise ConfigError if it is not a whole number."""
    text = given.strip()
    if text.isascii() and text.isdecimal() and len(text) <= SHAPE_DIGITS:
        return int(text)
    whole = (
        _PLAIN_NUMBER.fullmatch(text)
        and float(text).is_integer()
        and len(text) <= SHAPE_DIGITS
    )
    raise _shape_error(name, f"{float(text):.0f}" if whole else "")


def _read_sides(name: str, given: str) -> tuple[int, int]:
    """Return the two numbers of "grid:3x4"; raise ConfigError if there are not two."""
    rows, cross, columns = (
        given.lower().replace("\N{MULTIPLICATION SIGN}", "x").partition("x")
    )
    if not cross:
        raise _shape_error(name, "")
    return _read_whole_number(name, rows), _read_whole_number(name, columns)


def _shape_error(name: str, meant: str) -> ConfigError:
    """Return the error for a shape with an invalid number.

    meant: the number that was probably meant, or an empty text
    """
    shape = name.strip().partition(":")[0]
    form, what = SHAPE_FORMS[shape]
    do = f"Write {shape}:{meant}." if meant and shape != "grid" else ""
    return ConfigError(
        "graph",
        name if len(name) <= 60 else f"{name[:60]}...",
        f"{form}, with {what}",
        do,
    )


def _hint_at_shape(shape: str, given: str) -> str:
    """Return a hint with the shape that was probably meant, or an empty text.

    Other capitals, hyphens or blanks do not count.
    """
    names = ("ring", "path", "star", "complete", "empty", *SHAPE_FORMS)
    known_by_letters = {name.replace("-", ""): name for name in names}
    letters = re.sub(r"[^a-z]", "", shape.lower())
    near = get_close_matches(letters, known_by_letters, n=1, cutoff=LEAST_LIKENESS)
    if not near:
        return ""
    known = known_by_letters[near[0]]
    return (
        f"Did you mean {known}{':' + given if given and known in SHAPE_FORMS else ''}?"
    )


def metropolis(graph: Graph) -> Weights:
    """Return the Metropolis-Hastings weights: symmetric, doubly
    stochastic, from the neighbours' degrees only.

        w_ij = 1 / (1 + max(d_i, d_j)) for neighbours,   w_ii = 1 - sum_j w_ij

    d_i: number of neighbours of i
    Returns w[i][j], where j is i or a neighbour of i, increasing.
    Raises ConfigError if the graph is directed.
    Source: Xiao, Boyd & Lall 2005, IPSN, "A scheme for robust distributed sensor fusion based on
        average consensus".
    """
    if not graph.is_undirected:
        raise ConfigError(
            "metropolis weights",
            "a directed graph",
            "an undirected one",
            "Use row_stochastic.",
        )
    degree = {i: len(graph.in_neighbors(i)) for i in graph.ids}
    weights = {
        i: {j: 1.0 / (1 + max(degree[i], degree[j])) for j in graph.in_neighbors(i)}
        for i in graph.ids
    }
    return {
        i: dict(sorted({**w, i: 1.0 - sum(w.values())}.items()))
        for i, w in weights.items()
    }


def row_stochastic(graph: Graph) -> Weights:
    """Return equal weights for drone i and its in-neighbours.

        w_ij = 1 / (1 + |N_in(i)|)

    Each row sums to one.
    """
    heard = {i: graph.in_neighbors(i) for i in graph.ids}
    return {
        i: {j: 1.0 / (1 + len(heard[i])) for j in sorted((i, *heard[i]))}
        for i in graph.ids
    }


def column_stochastic(graph: Graph) -> Weights:
    """Return equal shares of the value of j for itself and its out-neighbours (push-sum).

        w_ij = 1 / (1 + |N_out(j)|)

    Each column sums to one.
    """
    heard = {i: graph.in_neighbors(i) for i in graph.ids}
    return {
        i: {j: 1.0 / (1 + len(graph.out_neighbors(j))) for j in sorted((i, *heard[i]))}
        for i in graph.ids
    }


def describe_ids(ids: Iterable[int]) -> str:
    """Return ids as text for an error: "0 to 7" without gaps, else "0, 2, 5"."""
    known = sorted(ids)
    if len(known) > 1 and known[-1] - known[0] == len(known) - 1:
        return f"{known[0]} to {known[-1]}"
    return ", ".join(str(i) for i in known[:20]) + (", ..." if len(known) > 20 else "")


def _ids(n: Ids) -> tuple[int, ...]:
    return tuple(range(n)) if isinstance(n, int) else tuple(sorted(n))


def _arc(pair: Iterable[int]) -> Arc:
    i, j = pair
    return i, j


def _adjacency(ids: tuple[int, ...], arcs: Iterable[Arc]) -> dict[int, tuple[int, ...]]:
    found: dict[int, list[int]] = {i: [] for i in ids}
    for i, j in arcs:
        found[i].append(j)
    return {i: tuple(sorted(others)) for i, others in found.items()}


@lru_cache(maxsize=16)  # each drone of a large swarm computes it for the same graph
def _diameter(ids: tuple[int, ...], arcs: tuple[Arc, ...]) -> int:
    step = _adjacency(ids, arcs)
    return max(max(_distances(i, step).values()) for i in ids)


def _distances(start: int, step: Mapping[int, tuple[int, ...]]) -> dict[int, int]:
    """Return the hops from start to each drone that can be reached, breadth first."""
    hops = {start: 0}
    queue = [start]
    for i in queue:
        for j in step[i]:
            if j not in hops:
                hops[j] = hops[i] + 1
                queue.append(j)
    return hops


def _flooding_rounds(graphs: GraphSequence, start: int, first: int) -> int:
    """Return the rounds until a flood from `start`, which
    begins in round `first`, reaches all drones.
    """
    reached = {start: None}  # a dict, because a set has no fixed order
    k = first
    while len(reached) < len(graphs.ids):
        graph = graphs.at(k)
        for i in list(reached):
            reached.update(dict.fromkeys(graph.out_neighbors(i)))
        k += 1
    return k - first


def _random_stream(p: float, seed: int, *salt: int) -> random.Random:
    """Return a random stream that is the same on every host and every Python.

    Raises ConfigError if p is not a probability.
    """
    if not 0.0 <= p <= 1.0:
        do = f"{p:g} % is {p / 100.0:g}." if 1.0 < p <= 100.0 else ""
        raise ConfigError("random graph", f"p = {p:g}", "a probability, 0 to 1", do)
    return random.Random(" ".join(map(str, (seed, *salt))))  # noqa: S311 - shapes, not secrets
