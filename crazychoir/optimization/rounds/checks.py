"""Checks that no agent can make alone.

They test whether the agents of a team fit each other and their graph, and send numbers.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.team.graph import Graph, GraphSequence, describe_ids

NUMBERLESS_TYPES = frozenset({type(None), bool, int, str, bytes})
"""Types of values that contain no float."""

COMPARED_ROUNDS = (0, 1, 10, 1000)
"""Rounds in which functions of the round, such as step sizes, are compared."""


def require_team(agents: Mapping[int, Any], graph: Graph | GraphSequence) -> None:
    """Raise ConfigError unless the agents fit the graph and each other.

    There must be one agent for each node. These attributes of an agent are checked, where it has them:

    - `weights`: rows for exactly the agents that it hears
    - `shares`: rows for exactly the agents that hear it
    - `x`: one shape for all agents, if it is an array and `common` is not False
    - `same`: names of attributes that are equal at all agents: numbers, or functions of the round
    - the attributes that `require_graph` checks
    """
    if sorted(agents) != list(graph.ids):
        allowed = f"one for each node of the graph, {describe_ids(graph.ids)}"
        raise ConfigError("team", f"agents {describe_ids(agents) or 'none'}", allowed)
    for i in graph.ids:
        if getattr(agents[i], "i", i) != i:
            raise ConfigError(
                f"team: agent {i}", f"made as agent {agents[i].i}", f"agent {i}"
            )
        _require_fitting(i, agents[i], graph)
        require_graph(agents[i], graph)
    common = {
        i: agents[i].x
        for i in graph.ids
        if getattr(agents[i], "connected", False)
        and getattr(agents[i], "common", hasattr(agents[i], "x"))
    }
    _require_one_shape({i: x for i, x in common.items() if isinstance(x, np.ndarray)})
    for i in graph.ids:
        _require_same(i, agents[i], graph.ids[0], agents[graph.ids[0]])


def require_graph(agent: Any, graph: Graph | GraphSequence) -> None:
    """Raise ConfigError unless the graph suits this algorithm; every agent gets the same answer.

    These attributes of the agent are checked, where it has them:

    - `connected = True`: the graph must be (jointly, strongly) connected
    - `undirected = True`: two neighbours must hear each other
    - `diameter`: must not be below the rounds in which a value floods the graph
    """
    where = f"graph of {type(agent).__name__}"
    if getattr(agent, "undirected", False):
        for each in graph.graphs if isinstance(graph, GraphSequence) else (graph,):
            one_way = next(
                ((i, j) for i, j in each.arcs if i not in each.out_neighbors(j)), None
            )
            if one_way is not None:
                found = "agent {1} hears agent {0}, but not the other way round".format(
                    *one_way
                )
                raise ConfigError(where, found, "an undirected graph")
    diameter = getattr(agent, "diameter", None)
    if (
        getattr(agent, "connected", False) or isinstance(diameter, int)
    ) and not graph.is_connected:
        raise ConfigError(
            where,
            _describe_missing_path(graph),
            "a connected graph",
            "Add edges, or draw with another probability.",
        )
    if isinstance(diameter, int) and diameter < (least := graph.diameter()):
        do = "Take graph.diameter(), or any bound on it, the same at all agents."
        raise ConfigError(
            f"{where}: diameter",
            f"{diameter}",
            f"at least {least}: rounds in which all hear of all",
            do,
        )


def find_nan(value: Any) -> str | None:
    """Return the place of the first nan in a message, or None if there is none.

    The place is an index text: "", "[2]", "['x'][0, 1]".
    Looks at floats and at arrays of floats, in lists, tuples and dictionaries at any depth.
    """
    if type(value) is float:
        return None if value == value else ""
    if type(value) is np.ndarray and value.size and value.dtype.kind == "f":
        greatest = value.item(value.argmax())  # of numpy, nan is the greatest
        return None if greatest == greatest else _find_array_nan(value)
    if isinstance(value, np.ndarray | np.generic):
        return _find_array_nan(np.asarray(value))
    if isinstance(value, dict):
        return _find_first_nan(value.items(), value.values())
    if isinstance(value, list | tuple):
        return _find_first_nan(enumerate(value), value)
    return None


def _find_first_nan(
    items: Iterable[tuple[Any, Any]], values: Iterable[Any]
) -> str | None:
    if NUMBERLESS_TYPES.issuperset(map(type, values)):
        return None
    for key, item in items:
        if type(item) not in NUMBERLESS_TYPES and (place := find_nan(item)) is not None:
            return f"[{key!r}]{place}"
    return None


def _find_array_nan(array: Any) -> str | None:
    if array.dtype.kind not in "fc" or not np.isnan(array).any():
        return None
    at = np.argwhere(np.isnan(array))[0].tolist()
    return str(at) if at else ""


def _require_fitting(i: int, agent: Any, graph: Graph | GraphSequence) -> None:
    graphs = graph.graphs if isinstance(graph, GraphSequence) else (graph,)
    for name, others in (
        ("weights", Graph.in_neighbors),
        ("shares", Graph.out_neighbors),
    ):
        rows = getattr(agent, name, None)
        if not isinstance(rows, tuple) or not rows or not isinstance(rows[0], Mapping):
            continue
        if len(rows) not in (1, len(graphs)):
            allowed = f"one, or one for each of {len(graphs)} graphs"
            raise ConfigError(f"agent {i}: {name}", f"{len(rows)} rows", allowed)
        for k, each in enumerate(graphs):
            found = sorted(j for j in rows[k % len(rows)] if j != i)
            wanted = sorted(others(each, i))
            if found != wanted:
                relation = "hears" if name == "weights" else "is heard by"
                raise ConfigError(
                    f"agent {i}: {name}, round {k}",
                    f"of {found}",
                    f"of the agents it {relation}, {wanted}",
                )


def _describe_missing_path(graph: Graph | GraphSequence) -> str:
    """Describe a missing path of the graph, for an error text."""
    whole = graph.union() if isinstance(graph, GraphSequence) else graph
    first = whole.ids[0]
    for start, step, said in (
        (first, whole.out_neighbors, "no path from agent {0} to {1}"),
        (first, whole.in_neighbors, "no path from {1} to agent {0}"),
    ):
        reached = [start]
        for i in reached:
            reached += [j for j in step(i) if j not in reached]
        missing = [j for j in whole.ids if j not in reached]
        if missing:
            return said.format(first, missing)
    return "connected"


def _require_one_shape(arrays: Mapping[int, Any]) -> None:
    for i, x in arrays.items():
        first = next(iter(arrays))
        if x.shape != arrays[first].shape:
            raise ConfigError(
                f"agent {i}: x",
                f"shape {x.shape}",
                f"shape {arrays[first].shape}, as agent {first}'s",
            )


def _require_same(i: int, agent: Any, first: int, other: Any) -> None:
    """Raise ConfigError unless the values named in `same` equal the first agent's."""
    for name in getattr(agent, "same", ()):
        found = _sample_values(getattr(agent, name))
        wanted = _sample_values(getattr(other, name, None))
        for at, value in found.items():
            if value != wanted.get(at):
                do = "With different ones the team would solve another problem."
                raise ConfigError(
                    f"agent {i}: {name}{at}",
                    f"{value}",
                    f"{wanted.get(at)}, as agent {first}'s",
                    do,
                )


def _sample_values(x: Any) -> dict[str, Any]:
    """Return a number, or the values of a function of the round in COMPARED_ROUNDS, by their place."""
    return {f", round {k}": x(k) for k in COMPARED_ROUNDS} if callable(x) else {"": x}
