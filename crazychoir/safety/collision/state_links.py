"""The simulated network as records: what becomes of states on their way between drones."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.random_draws import RANDOM_DRAWS, draw_key
from crazychoir.bus.impairment.rules import EdgeEffects, effects_on_edge
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.safety.collision.airspace_rows import LINK_ROW, LinkKind
from crazychoir.types import Records


class PairsOfAll(Sequence[tuple[int, int]]):
    """The pairs (source, destination) of all sources with all destinations, without a list of them.

    sources: ids
    destinations: ids; the pairs of the first destination come first
    """

    def __init__(self, sources: Sequence[int], destinations: Sequence[int]) -> None:
        self._sources = sources
        self._destinations = destinations

    def __len__(self) -> int:
        return len(self._sources) * len(self._destinations)

    def __getitem__(self, at: Any) -> Any:
        i, j = divmod(at, len(self._sources))
        return self._sources[j], self._destinations[i]


class StateLinks:
    """The links between some drones, one record a pair.

    impairment: the simulated network
    pairs: (source, destination) of each link
    """

    def __init__(
        self, impairment: Impairment, pairs: Sequence[tuple[int, int]]
    ) -> None:
        self.rows = np.zeros(0, LINK_ROW)
        """(n,), in the order of the pairs; empty without a simulated network."""
        self.has_by_hand = False
        """Whether a link has the kind BY_HAND."""
        self._impairment = impairment
        self._pairs = pairs
        self._version = 0
        self._cuts: tuple[bool, ...] = ()
        impairment.count_sources.append(self.count)

    def close(self) -> None:
        """Give the last counts to the simulated network."""
        self.count()
        self._impairment.count_sources.remove(self.count)

    def refresh(self, now: float) -> None:
        """Write the links anew if the network has changed, or a partition has begun or ended.

        now: s
        """
        network = self._impairment
        if not network.active and len(self.rows) == 0:
            return
        age = now - network.began
        cuts = tuple(cut.since <= age < cut.until for cut in network.partitions)
        if network.version == self._version and cuts == self._cuts:
            return
        self.count()
        if network.version != self._version:
            self._version = network.version
            self._write()
        self._cuts = cuts
        self._cut()
        self.has_by_hand = bool(np.any(self.rows["kind"] == LinkKind.BY_HAND))

    def _write(self) -> None:
        """Write the kinds, keys and thresholds of all links."""
        network = self._impairment
        self.rows = np.zeros(0, LINK_ROW)
        if not network.active:
            return
        self.rows = np.zeros(len(self._pairs), LINK_ROW)
        common = effects_on_edge(
            [rule for rule in network.rules if rule.rank == 0], -1, -1
        )
        named = {rule.drone for rule in network.rules}
        named |= {j for rule in network.rules for j in rule.edge or ()}
        for at, row in enumerate(self.rows):
            j, i = self._pairs[at]
            if i == j:
                continue
            is_named = i in named or j in named
            effects = effects_on_edge(network.rules, j, i) if is_named else common
            row["kind"] = _find_kind(effects)
            if row["kind"] == LinkKind.DRAW:
                row["key"] = draw_key(network.seed, j, i, DRONE_TOPICS.state.name)
                _write_losses(row, effects)

    def _cut(self) -> None:
        """Cut the links that a partition cuts now, and restore the others."""
        network = self._impairment
        if not network.partitions:
            return
        self._write()
        active = [
            cut
            for cut, is_active in zip(network.partitions, self._cuts, strict=True)
            if is_active
        ]
        for at, row in enumerate(self.rows):
            j, i = self._pairs[at]
            # The verdict of a link by hand knows the partitions itself.
            if row["kind"] != LinkKind.BY_HAND and any(
                cut.cuts(j, i) for cut in active
            ):
                row["kind"] = LinkKind.CUT

    def count(self) -> None:
        """Give the counts since the last call to the simulated network."""
        for at in np.flatnonzero(self.rows["sent"]).tolist():
            row = self.rows[at]
            self._impairment.count(*self._pairs[at], int(row["sent"]), int(row["lost"]))
        self.rows["sent"] = 0
        self.rows["lost"] = 0


def _find_kind(effects: EdgeEffects) -> LinkKind:
    """Return how the effects on an edge lose a message."""
    is_slow = max(effects.delay, effects.jitter, effects.duplicate, effects.reorder) > 0
    if is_slow or effects.bandwidth > 0.0:
        return LinkKind.BY_HAND
    if effects.p_good_bad > 0.0:
        return LinkKind.DRAW
    # A threshold beyond all values does not fit into 64 bits.
    if round(effects.loss * RANDOM_DRAWS.range_size) == RANDOM_DRAWS.range_size:
        return LinkKind.CUT
    return LinkKind.DRAW if effects.loss > 0.0 else LinkKind.CLEAR


def _write_losses(row: Records, effects: EdgeEffects) -> None:
    """Write the thresholds and the burst chain of a link that loses messages by draws.

    row: one row of LINK_ROW
    effects: with a loss below 1, or with a burst chain
    """
    most = RANDOM_DRAWS.range_size - 1
    bad = round(effects.loss_bad * RANDOM_DRAWS.range_size)
    row["threshold"] = min(round(effects.loss * RANDOM_DRAWS.range_size), most)
    row["bad_threshold"] = min(bad, most)
    row["loses_bad"] = bad > most
    row["p_good_bad"] = effects.p_good_bad
    row["p_bad_good"] = effects.p_bad_good
