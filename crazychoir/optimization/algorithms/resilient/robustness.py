"""How robust a graph is: the number of liars that trimming stands."""

from typing import Final

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.team.graph import Graph
from crazychoir.types import Ints

MOST_AGENTS: Final = 20
"""Most agents of a graph, because all 2^N sets of agents are looked at."""


def robustness(graph: Graph) -> int:
    """Return the largest r for which the graph is r-robust.

    A graph is r-robust if of any two sets of agents, not empty and without a common agent, at least
    one has an agent that hears r or more agents outside its set. `WMSR` and `TrimmedMean` stand F
    liars if the graph is (2F+1)-robust. A complete graph of N agents is ceil(N/2)-robust, and no
    graph is more.

        r = min over sets S of max(reach(S), min over T in the complement of S of reach(T))
        reach(S) = the largest number of agents outside S that an agent of S hears

    Raises ConfigError for more than 20 agents: no fast way to compute it is known.
    Source: LeBlanc, Zhang, Koutsoukos & Sundaram 2013, IEEE J. Sel. Areas Commun. 31(4), 766-781.
    """
    ids = graph.ids
    if not 2 <= len(ids) <= MOST_AGENTS:
        raise ConfigError("robustness", f"{len(ids)} agents", f"2 to {MOST_AGENTS}")
    place = {i: n for n, i in enumerate(ids)}
    sets = np.arange(2 ** len(ids))
    reach = np.zeros(len(sets), dtype=np.int64)
    for i in ids:
        hears = sum(1 << place[j] for j in graph.in_neighbors(i))
        outside = np.bitwise_count(hears & ~sets).astype(np.int64)
        reach = np.where(sets >> place[i] & 1, np.maximum(reach, outside), reach)
    reach[0] = len(ids)  # the empty set does not count
    least = _least_of_subsets(reach, len(ids))
    return int(np.maximum(reach, least[sets[-1] - sets]).min())


def _least_of_subsets(values: Ints, agents: int) -> Ints:
    """Return for each set the least of the values (2^N,) of its subsets."""
    least = values.copy()
    sets = np.arange(len(values))
    for n in range(agents):
        without = sets & ~(1 << n)
        least = np.minimum(least, least[without])
    return least
