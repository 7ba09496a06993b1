"""Communication graphs over drone ids: shapes, weights, and graphs that change from round to round."""

import random
import re
from collections.abc import Iterable, Mapping
from functools import cached_property, lru_cache
from itertools import combinations, pairwise, permutations, product
from math import dist, isfinite, nan, pi
from typing import Self

from crazychoir.errors import ConfigError
from crazychoir.types import Wire

Ids = int | Iterable[int]
Arc = tuple[int, int]
Weights = dict[int, dict[int, float]]

NAMES = "ring, path, star, complete, empty, k-regular:K, erdos-renyi:P, geometric:R, grid:ROWSxCOLUMNS"
DIRECTED = "ring, erdos-renyi:P"
"""Of these, those that there are directed, too."""
FORMS = {
    "k-regular": ("k-regular:K", "K a whole number of neighbours, as k-regular:4"),
    "erdos-renyi": ("erdos-renyi:P", "P a probability of 0 to 1, as erdos-renyi:0.3"),
    "geometric": (
        "geometric:R",
        "R a radius above 0, at most 2, in sides of the square, as geometric:0.4",
    ),
    "grid": ("grid:ROWSxCOLUMNS", "ROWS and COLUMNS whole numbers, as grid:3x4"),
}
"""The shapes that take numbers: how they are written, and with which."""
DIGITS = 9
"""Of a whole number."""
_PLAIN = re.compile(r"[0-9]{1,9}\.?[0-9]{0,9}|\.[0-9]{1,9}")
HOPELESS = 40.0
"""Drones without any neighbour, on average, from which on no draw is connected: the probability is below exp(-40)."""
DRAWS = 1000


class Graph(Wire, frozen=True, array_like=True, gc=True, dict=True):
    """Directed graph; the arc (i, j) says that drone i sends to drone j.

    ids: the drones, increasing;  arcs: ordered pairs of them, increasing, no loops.
    All answers are sorted tuples. Raises ConfigError for what is not such a graph, and for a drone that is not in it.
    """

    ids: tuple[int, ...]
    arcs: tuple[Arc, ...]

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
        members = frozenset(self.ids)
        for i, j in self.arcs:
            if i == j or i not in members or j not in members:
                raise ConfigError(
                    "graph",
                    f"edge [{i}, {j}]",
                    f"two different drones of {span(self.ids)}",
                )

    @classmethod
    def from_edges(
        cls, ids: Ids, pairs: Iterable[Iterable[int]], directed: bool = False
    ) -> Self:
        """The graph with these edges [i, j]: both ways, or, if directed, only from i to j."""
        arcs = [_arc(pair) for pair in pairs]
        both = arcs if directed else arcs + [(j, i) for i, j in arcs]
        return cls(_ids(ids), tuple(sorted(dict.fromkeys(both))))

    @classmethod
    def from_neighbors(cls, neighbors: Mapping[int, Iterable[int]]) -> Self:
        """The graph where drone i hears the drones neighbors[i]; undirected if every pair names each other."""
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

    def in_neighbors(self, i: int) -> tuple[int, ...]:
        """Whom drone i hears."""
        return self._in[self._member(i)]

    def out_neighbors(self, i: int) -> tuple[int, ...]:
        """Who hears drone i."""
        return self._out[self._member(i)]

    def neighbors(self, i: int) -> tuple[int, ...]:
        """Whom drone i hears, or who hears it."""
        return self._both[self._member(i)]

    def _member(self, i: int) -> int:
        if i not in self._in:
            raise ConfigError("graph", f"drone {i}", span(self.ids))
        return i

    def edges(self) -> tuple[Arc, ...]:
        """The joined pairs (i, j), i < j, whatever the direction; the directed ones are `arcs`."""
        return tuple(sorted(dict.fromkeys((min(arc), max(arc)) for arc in self.arcs)))

    @property
    def is_undirected(self) -> bool:
        """Whether each arc has its opposite."""
        return self._in == self._out

    @property
    def is_connected(self) -> bool:
        """Whether a message of each drone reaches every other drone (strongly connected)."""
        first = self.ids[0]
        return all(
            len(_distances(first, step)) == len(self.ids)
            for step in (self._in, self._out)
        )

    def parts(self) -> tuple[tuple[int, ...], ...]:
        """Drones that are joined, whatever the direction, by their lowest one: one part, if nobody is by itself."""
        found: dict[int, tuple[int, ...]] = {}
        for i in self.ids:
            if not any(i in part for part in found.values()):
                found[i] = tuple(sorted(_distances(i, self._both)))
        return tuple(found.values())

    def diameter(self) -> int:
        """The most hops that a message needs from one drone to another: rounds of a flood."""
        if not self.is_connected:
            do = "Add an edge; in flight: those in between have gone, and the others cannot go on as a team."
            raise ConfigError(
                "graph", "a drone that cannot reach all others", "a connected graph", do
            )
        return _diameter(self.ids, self.arcs)

    def at(self, k: int) -> Self:
        """The graph of round k: always this one."""
        return self


class GraphSequence(Wire, frozen=True, array_like=True, gc=False):
    """A graph that changes with the round, periodically: round k uses graphs[k mod len(graphs)]."""

    graphs: tuple[Graph, ...]

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
        """`length` sub-graphs of `graph`, each keeping each edge with probability p.

        Edge number e is always in graph e mod `length`, so their union is `graph`.
        """
        chance = _chance(p, seed, length, *graph.ids)
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
        """The drones."""
        return self.graphs[0].ids

    def at(self, k: int) -> Graph:
        """The graph of round k."""
        return self.graphs[k % len(self.graphs)]

    def union(self) -> Graph:
        """All arcs of one period together."""
        return Graph.from_edges(
            self.ids,
            (arc for graph in self.graphs for arc in graph.arcs),
            directed=True,
        )

    @property
    def is_connected(self) -> bool:
        """Whether the graphs of one period are jointly (strongly) connected."""
        return self.union().is_connected

    def diameter(self) -> int:
        """The most rounds that a flood needs, whoever starts it and in whichever round of the period."""
        if not self.is_connected:
            found = "a drone that never reaches all others"
            raise ConfigError(
                "graph sequence",
                found,
                "jointly connected graphs",
                "Add an edge to one of them.",
            )
        return max(
            _flooded(self, i, k) for i in self.ids for k in range(len(self.graphs))
        )


def empty(n: Ids) -> Graph:
    """Nobody hears anybody. n: how many drones, or their ids; so in all shapes."""
    return Graph.from_edges(n, ())


def ring(n: Ids, directed: bool = False) -> Graph:
    """Each drone and the next, the last and the first; directed: each sends to the next only."""
    ids = _ids(n)
    return Graph.from_edges(
        ids, zip(ids, ids[1:] + ids[:1], strict=True) if len(ids) > 1 else (), directed
    )


def path(n: Ids) -> Graph:
    """Each drone and the next."""
    return Graph.from_edges(ids := _ids(n), pairwise(ids))


def star(n: Ids) -> Graph:
    """The first drone and each other."""
    ids = _ids(n)
    return Graph.from_edges(ids, ((ids[0], j) for j in ids[1:]))


def complete(n: Ids) -> Graph:
    """Everybody hears everybody."""
    return Graph.from_edges(ids := _ids(n), combinations(ids, 2))


def k_regular(n: Ids, k: int) -> Graph:
    """Circulant graph: each drone and the k/2 next on both sides of a ring; k odd: and the one opposite."""
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
    """Binomial graph: each edge is there with probability p; drawn again until it is (strongly) connected."""
    ids = _ids(n)
    chance = _chance(p, seed, *ids)
    if len(ids) * (1.0 - p) ** (len(ids) - 1) > HOPELESS:
        raise _never_connected("erdos-renyi", f"p = {p:g}", "a larger p", len(ids))
    pairs = list(permutations(ids, 2) if directed else combinations(ids, 2))
    for _ in range(DRAWS):
        graph = Graph.from_edges(
            ids, (pair for pair in pairs if chance.random() < p), directed
        )
        if graph.is_connected:
            return graph
    raise _never_connected("erdos-renyi", f"p = {p:g}", "a larger p", len(ids))


def geometric(n: Ids, radius: float, seed: int) -> Graph:
    """Random points in the unit square, those within `radius` of each other joined; drawn again until it is connected.

    What short-range radios make of a swarm that is spread at random.
    """
    ids = _ids(n)
    if not 0.0 < radius <= 2.0:
        raise ConfigError(
            "geometric graph",
            f"radius {radius:g}",
            "above 0, at most 2; 1 is the side of the square",
        )
    chance = _chance(0.0, seed, *ids)
    if len(ids) * max(0.0, 1.0 - pi * radius**2) ** (len(ids) - 1) > HOPELESS:
        raise _never_connected(
            "geometric", f"radius {radius:g}", "a larger one", len(ids)
        )
    for _ in range(DRAWS):
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
    raise _never_connected("geometric", f"radius {radius:g}", "a larger one", len(ids))


def _never_connected(shape: str, given: str, larger: str, size: int) -> ConfigError:
    return ConfigError(
        f"{shape} graph",
        f"{given}: none of {DRAWS} draws is connected",
        f"{larger} for {size} drones",
    )


def grid(
    rows: int, columns: int, diagonals: bool = False, ids: Ids | None = None
) -> Graph:
    """Rows and columns, numbered row by row: each drone and those beside, above, below; and diagonally."""
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


def named(name: str, n: Ids, seed: int = 0, directed: bool = False) -> Graph:
    """The graph that a swarm file names, see NAMES; `seed` draws the random ones; directed: one of DIRECTED."""
    plain = {"path": path, "star": star, "complete": complete, "empty": empty}
    shape, colon, given = name.strip().partition(":")
    if colon and shape not in FORMS:
        takes_none = shape == "ring" or shape in plain
        raise ConfigError(
            "graph",
            name,
            NAMES,
            f"Write {shape}." if takes_none else _meant(shape, given),
        )
    if shape == "ring":
        return ring(n, directed)
    if shape == "erdos-renyi":
        return erdos_renyi_connected(n, _number(name, given), seed, directed)
    if directed and (shape in plain or shape in FORMS):
        do = "Name one of these, list `edges` or the drones' `neighbors`, or leave directed out."
        raise ConfigError("graph", f"{name} with directed = true", DIRECTED, do)
    if shape in plain:
        return plain[shape](n)
    if shape == "geometric":
        return geometric(n, _number(name, given), seed)
    if shape == "k-regular":
        return k_regular(n, _whole(name, given))
    if shape == "grid":
        rows, columns = _sides(name, given)
        return grid(rows, columns, ids=n)
    raise ConfigError("graph", name, NAMES, _meant(shape, given))


def _number(name: str, given: str) -> float:
    """Return the number of "erdos-renyi:0.3", however it is written; raise ConfigError for none that is finite."""
    try:
        number = float(given)
    except ValueError:
        number = nan
    if not isfinite(number):
        bare = given.strip().removesuffix("%").strip().replace(",", ".")
        share = (
            f"{float(bare) / 100.0:g}"
            if given.strip().endswith("%") and _PLAIN.fullmatch(bare)
            else bare
        )
        raise _wrong(name, share if _PLAIN.fullmatch(share) else "")
    return number


def _whole(name: str, given: str) -> int:
    """Return the number of "k-regular:4"; raise ConfigError for none that is whole."""
    text = given.strip()
    if text.isascii() and text.isdecimal() and len(text) <= DIGITS:
        return int(text)
    whole = _PLAIN.fullmatch(text) and float(text).is_integer() and len(text) <= DIGITS
    raise _wrong(name, f"{float(text):.0f}" if whole else "")


def _sides(name: str, given: str) -> tuple[int, int]:
    """Return the numbers of "grid:3x4"; raise ConfigError for what has no two."""
    rows, cross, columns = (
        given.lower().replace("\N{MULTIPLICATION SIGN}", "x").partition("x")
    )
    if not cross:
        raise _wrong(name, "")
    return _whole(name, rows), _whole(name, columns)


def _wrong(name: str, meant: str) -> ConfigError:
    """The error of a shape whose number is none."""
    shape = name.strip().partition(":")[0]
    form, what = FORMS[shape]
    do = f"Write {shape}:{meant}." if meant and shape != "grid" else ""
    return ConfigError(
        "graph",
        name if len(name) <= 60 else f"{name[:60]}...",
        f"{form}, with {what}",
        do,
    )


def _meant(shape: str, given: str) -> str:
    """Return which shape was probably meant: the same letters, with other capitals, hyphens or blanks."""
    letters = re.sub(r"[^a-z]", "", shape.lower())
    for known in ("ring", "path", "star", "complete", "empty", *FORMS):
        if known.replace("-", "") == letters:
            return f"Did you mean {known}{':' + given if given and known in FORMS else ''}?"
    return ""


def metropolis(graph: Graph) -> Weights:
    """Metropolis-Hastings weights: symmetric and doubly stochastic, from the degrees of neighbours only.

        w_ij = 1 / (1 + max(d_i, d_j)) for neighbours,   w_ii = 1 - sum_j w_ij

    d_i: number of neighbours of i.  Returns w[i][j], j over i and its neighbours, increasing. The graph is undirected.
    Source: Xiao, Boyd & Lall 2005, IPSN, "A scheme for robust distributed sensor fusion based on average consensus".
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
    """Equal weights of what i hears and itself, w_ij = 1 / (1 + |N_in(i)|): each row sums to one."""
    heard = {i: graph.in_neighbors(i) for i in graph.ids}
    return {
        i: {j: 1.0 / (1 + len(heard[i])) for j in sorted((i, *heard[i]))}
        for i in graph.ids
    }


def column_stochastic(graph: Graph) -> Weights:
    """Equal shares of what j sends and keeps, w_ij = 1 / (1 + |N_out(j)|): each column sums to one (push-sum)."""
    heard = {i: graph.in_neighbors(i) for i in graph.ids}
    return {
        i: {j: 1.0 / (1 + len(graph.out_neighbors(j))) for j in sorted((i, *heard[i]))}
        for i in graph.ids
    }


def span(ids: Iterable[int]) -> str:
    """Ids for an error text: "0 to 7" without gaps, else "0, 2, 5"."""
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


@lru_cache(maxsize=16)  # each drone of a large swarm asks it of the same graph
def _diameter(ids: tuple[int, ...], arcs: tuple[Arc, ...]) -> int:
    step = _adjacency(ids, arcs)
    return max(max(_distances(i, step).values()) for i in ids)


def _distances(start: int, step: Mapping[int, tuple[int, ...]]) -> dict[int, int]:
    """Hops from start to each drone that can be reached, breadth first."""
    hops = {start: 0}
    queue = [start]
    for i in queue:
        for j in step[i]:
            if j not in hops:
                hops[j] = hops[i] + 1
                queue.append(j)
    return hops


def _flooded(graphs: GraphSequence, start: int, first: int) -> int:
    """Rounds until all have heard of `start`, which begins in round `first`."""
    reached = {start: None}  # in order, as a set would not be
    k = first
    while len(reached) < len(graphs.ids):
        graph = graphs.at(k)
        for i in list(reached):
            reached.update(dict.fromkeys(graph.out_neighbors(i)))
        k += 1
    return k - first


def _chance(p: float, seed: int, *salt: int) -> random.Random:
    """A stream of draws that is the same on every host and Python."""
    if not 0.0 <= p <= 1.0:
        do = f"{p:g} % is {p / 100.0:g}." if 1.0 < p <= 100.0 else ""
        raise ConfigError("random graph", f"p = {p:g}", "a probability, 0 to 1", do)
    return random.Random(" ".join(map(str, (seed, *salt))))  # noqa: S311 - shapes, not secrets
