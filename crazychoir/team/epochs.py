"""Epochs of a team: its members and its graph, and the round from which each holds."""

import sys
from collections.abc import Iterable, Mapping
from functools import lru_cache
from math import inf
from typing import Final

from crazychoir.team.graph import Graph, GraphSequence

AnyGraph = Graph | GraphSequence
KEPT_GRAPHS: Final = 16
"""Graphs of earlier epochs that are kept for channels that are still behind."""


class Epochs:
    """The compositions of one team, as one member knows them.

    epoch: number of the present composition
    members: {drone id: incarnation}; empty before the first roster
    gone: ids that have left
    known: ids from which messages are accepted
    born: {drone id: (newest incarnation, its first round)} of the drones that have another
        incarnation than in the first roster
    gaps: True if any drone is or was `silent`
    since: first round of this drone's joinable channels
    held: first round that may not be sent before the next epoch
    graph: the present graph, or a periodic sequence of graphs
    ids: all drones of the mission
    """

    def __init__(self, graph: AnyGraph) -> None:
        self.epoch = 0
        self.members: Mapping[int, int] = {}
        self.gone: dict[int, None] = {}
        self.born: dict[int, tuple[int, float]] = {}
        self.gaps = False
        self.since = 0
        self.held: float = inf
        self._first_members: Mapping[int, int] = {}
        self.replace(graph)

    def replace(self, graph: AnyGraph) -> None:
        """Use another graph, for all rounds."""
        self.graph = self._whole = graph
        self.ids = graph.ids
        self.known = graph.members
        self._graphs: list[tuple[int, AnyGraph]] = [(0, graph)]

    @property
    def first(self) -> int:
        """First round of the present graph."""
        return self._graphs[-1][0]

    def at(self, joinable: bool, k: int) -> Graph:
        """Return the graph of round k of a channel.

        joinable: whether the channel continues across epochs; else the present graph holds
        """
        if not joinable:
            return self.graph.at(k)
        return next(
            (graph for first, graph in reversed(self._graphs) if first <= k),
            self._graphs[0][1],
        ).at(k)

    def until(self, joinable: bool, k: int) -> int:
        """Return the first round after k that may have another graph.

        Returns sys.maxsize if there is none yet.

        joinable: whether the channel continues across epochs
        """
        if any(isinstance(graph, GraphSequence) for _, graph in self._graphs):
            return k + 1
        if not joinable:
            return sys.maxsize
        return next((first for first, _ in self._graphs if first > k), sys.maxsize)

    def hold(self, rounds: list[int]) -> int:
        """Hold the rounds from the highest of these on, and return that round.

        A repeated call returns the same round until the next epoch.
        """
        if self.held == inf:
            self.held = max(rounds, default=0)
        return int(self.held)

    def renew(self, members: Mapping[int, int], first_round: int) -> None:
        """Take the members of an epoch and find restarted drones by their incarnation.

        A drone that was restarted since the last epoch begins with the first round of this one.

        members: {drone id: incarnation}; the drones of a process share it, so it is not copied
        """
        self.members = members
        if not self._first_members:
            self._first_members = members
            return
        for j, incarnation in members.items():
            known = self._find_incarnation(j)
            if known is None:
                self.born[j] = incarnation, -inf
            elif known != incarnation:
                self.born[j] = incarnation, first_round
                self.gaps = True

    def _find_incarnation(self, j: int) -> int | None:
        """Return the newest known incarnation of drone j; None if it was never a member."""
        if j in self.born:
            return self.born[j][0]
        return self._first_members.get(j)

    def silent(self, j: int, k: float) -> bool:
        """Return True if j will send nothing in round k: it has
        left, or was restarted and begins later.
        """
        return j in self.gone or (j in self.born and k < self.born[j][1])

    def begin(
        self,
        epoch: int,
        gone: Iterable[int],
        joined: Iterable[int],
        graph: Graph | None,
        first_round: int,
    ) -> None:
        """Begin a new epoch; its graph holds from `first_round` on."""
        self.epoch = epoch
        self.held = inf
        self.gone.update(dict.fromkeys(gone))
        self.gaps = self.gaps or bool(self.gone)
        for j in joined:
            self.gone.pop(j, None)
        if graph is not None:
            if not graph.members <= self.known:
                self.known |= graph.members
            self.graph = (
                graph
                if isinstance(self._whole, Graph)
                else restrict_to(self._whole, graph.ids)
            )
            earlier = [
                (first, old) for first, old in self._graphs if first < first_round
            ]
            self._graphs = [*earlier[-KEPT_GRAPHS:], (first_round, self.graph)]


@lru_cache(maxsize=8)  # all drones of a process restrict the same sequence
def restrict_to(sequence: GraphSequence, ids: tuple[int, ...]) -> GraphSequence:
    """Return the same sequence of graphs, restricted to these drones."""
    inside = dict.fromkeys(ids)
    return GraphSequence(
        tuple(
            Graph.from_edges(
                ids,
                [arc for arc in graph.arcs if arc[0] in inside and arc[1] in inside],
                directed=True,
            )
            for graph in sequence.graphs
        )
    )
