"""The simulated network as records: what becomes of states on their way between drones."""

from collections.abc import Sequence

import numpy as np

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.random_draws import RANDOM_DRAWS, draw_edge_keys
from crazychoir.bus.impairment.rules import EdgeEffects, effects_on_edge
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.safety.airspace.airspace_rows import LINK_ROW, LOSS_ROW, LinkKind
from crazychoir.types import Records

MOST_LOSS_ROWS = LinkKind.LATE - LinkKind.DRAW
"""Most rows of LOSS_ROW: the kinds are numbers of 16 bits."""
LINK_COUNTS = ("sent", "lost", "delayed", "duplicated")
"""Fields of LINK_ROW that are counts, in the order of Impairment.count."""


class StateLinks:
    """The links between some drones, one record a pair.

    impairment: the simulated network
    sources: each drone that hears others, with the ids of these in the order of the links
    """

    def __init__(
        self,
        impairment: Impairment,
        sources: Sequence[tuple[int, Sequence[int]]],
    ) -> None:
        self.rows = np.zeros(0, LINK_ROW)
        """(n,), in the order of `sources`; empty without a simulated network."""
        self.kinds = np.zeros(0, np.uint16)
        """(n,): LinkKind of each link; empty without a simulated network."""
        self.losses = np.zeros(0, LOSS_ROW)
        """(m,): what the links of the kinds from LinkKind.DRAW on do with messages."""
        self.has_late = False
        """Whether a link may delay messages."""
        self._impairment = impairment
        self._sources = sources
        self._ends = np.cumsum([len(ids) for _, ids in sources])
        self._version = 0
        self._cuts: list[bool] = []
        self._kind_of_effects: dict[EdgeEffects, int] = {}
        impairment.count_sources.append(self.count)

    def close(self) -> None:
        """Give the last counts to the simulated network."""
        self.count()
        self._impairment.count_sources.remove(self.count)

    def refresh(self, now: float) -> bool:
        """Write the links anew if the network has changed, or a partition has begun or ended.

        now: s
        Returns whether they were written.
        """
        network = self._impairment
        if not network.active and len(self.rows) == 0:
            return False
        age = now - network.began
        cuts = [cut.since <= age < cut.until for cut in network.partitions]
        if network.version == self._version and cuts == self._cuts:
            return False
        self.count()
        self._version = network.version
        self._cuts = cuts
        self._write()
        return True

    def _write(self) -> None:
        """Write the kinds, keys and thresholds of all links."""
        self._kind_of_effects = {}
        self.losses = np.zeros(0, LOSS_ROW)
        if self._impairment.active:
            self._write_keys()
            self.kinds = np.zeros(len(self.rows), np.uint16)
            self._write_kinds()
            self._cut()
        else:
            self.rows = np.zeros(0, LINK_ROW)
            self.kinds = np.zeros(0, np.uint16)
        self.has_late = bool(
            np.any((self.kinds == LinkKind.BY_HAND) | (self.kinds >= LinkKind.LATE))
        )

    def _write_keys(self) -> None:
        """Write the keys of all links, unless they are known: the seed does not change."""
        if len(self.rows) > 0:
            return
        count = sum(len(ids) for _, ids in self._sources)
        self.rows = np.zeros(count, LINK_ROW)
        topic = DRONE_TOPICS.state.name
        for (i, ids), end in zip(self._sources, self._ends.tolist(), strict=True):
            keys = draw_edge_keys(self._impairment.seed, ids, i, topic)
            self.rows["key"][end - len(ids) : end] = keys

    def _write_kinds(self) -> None:
        """Write the kinds of all links, without the partitions."""
        rules = self._impairment.rules
        common = self._find_kind(
            effects_on_edge([rule for rule in rules if rule.rank == 0], -1, -1)
        )
        named = {rule.drone for rule in rules}
        named |= {j for rule in rules for j in rule.edge or ()}
        for (i, ids), end in zip(self._sources, self._ends.tolist(), strict=True):
            kinds = self.kinds[end - len(ids) : end]
            kinds[:] = common
            for k, j in enumerate(ids):
                if i == j:
                    kinds[k] = LinkKind.CLEAR
                elif i in named or j in named:
                    kinds[k] = self._find_kind(effects_on_edge(rules, j, i))

    def _cut(self) -> None:
        """Cut the links that a partition cuts now."""
        active = [
            cut
            for cut, is_active in zip(
                self._impairment.partitions, self._cuts, strict=True
            )
            if is_active
        ]
        if not active:
            return
        for (i, ids), end in zip(self._sources, self._ends.tolist(), strict=True):
            kinds = self.kinds[end - len(ids) : end]
            for k, j in enumerate(ids):
                # The verdict of a link by hand knows the partitions itself.
                if kinds[k] != LinkKind.BY_HAND and any(
                    cut.cuts(j, i) for cut in active
                ):
                    kinds[k] = LinkKind.CUT

    def _find_kind(self, effects: EdgeEffects) -> int:
        """Return the kind of a link with these effects; add a row of losses if it is new."""
        kind = self._kind_of_effects.get(effects)
        if kind is None:
            kind = int(_find_kind(effects))
            if kind >= LinkKind.DRAW and len(self.losses) == MOST_LOSS_ROWS:
                kind = int(LinkKind.BY_HAND)
            if kind >= LinkKind.DRAW:
                kind += len(self.losses)
                self.losses = np.append(self.losses, _compute_losses(effects))
            self._kind_of_effects[effects] = kind
        return kind

    def count(self) -> None:
        """Give the counts since the last call to the simulated network."""
        for (i, ids), end in zip(self._sources, self._ends.tolist(), strict=True):
            rows = self.rows[end - len(ids) : end]
            for k in np.flatnonzero(rows["sent"]).tolist():
                counts = [int(rows[name][k]) for name in LINK_COUNTS]
                self._impairment.count(ids[k], i, *counts)
        for name in LINK_COUNTS:
            self.rows[name] = 0


def _find_kind(effects: EdgeEffects) -> LinkKind:
    """Return how the effects on an edge lose a message."""
    if effects.bandwidth > 0.0:
        return LinkKind.BY_HAND
    # A threshold beyond all values does not fit into 64 bits.
    loses_all = round(effects.loss * RANDOM_DRAWS.range_size) == RANDOM_DRAWS.range_size
    if loses_all and effects.p_good_bad == 0.0:
        return LinkKind.CUT
    if max(effects.delay, effects.jitter, effects.duplicate, effects.reorder) > 0.0:
        return LinkKind.LATE
    has_draws = effects.p_good_bad > 0.0 or effects.loss > 0.0
    return LinkKind.DRAW if has_draws else LinkKind.CLEAR


def _compute_losses(effects: EdgeEffects) -> Records:
    """Return the thresholds, the burst chain and the delays of links that draw for each message.

    effects: with a loss below 1, or with a burst chain
    Returns (1,) LOSS_ROW.
    """
    most = RANDOM_DRAWS.range_size - 1
    bad = round(effects.loss_bad * RANDOM_DRAWS.range_size)
    row = np.zeros(1, LOSS_ROW)
    row["threshold"] = min(round(effects.loss * RANDOM_DRAWS.range_size), most)
    row["bad_threshold"] = min(bad, most)
    row["loses_bad"] = bad > most
    row["p_good_bad"] = effects.p_good_bad
    row["p_bad_good"] = effects.p_bad_good
    for name in ("delay", "jitter", "reorder", "reorder_delay", "duplicate"):
        row[name] = getattr(effects, name)
    return row
