"""Edges of a simulated network that only lose messages, as records: one call draws for all."""

from collections.abc import Sequence

import numpy as np

from crazychoir.bus.impairment.compiled_draws import (
    draw_first_attempt,
    is_bad_state,
    split_threshold,
)
from crazychoir.bus.impairment.model import Impairment
from crazychoir.numerics.kernels import Records, kernel, rows_of, whole, wholes
from crazychoir.types import Ints

LOSSY_EDGE_ROW = np.dtype(
    [
        ("key", np.uint64),  # of the draws of its channel
        ("threshold", np.uint64),  # draws below it lose a message
        ("loses_all", np.int64),  # 1: every message is lost
        ("is_bursty", np.int64),  # 1: it has a burst chain
        ("p_good_bad", np.float64),  # probability that good turns bad
        ("p_bad_good", np.float64),  # probability that bad turns good
        ("bad_threshold", np.uint64),  # in the bad state, draws below it lose a message
        ("loses_all_bad", np.int64),  # 1: every message in the bad state is lost
        ("sent", np.int64),  # messages since the last count
        ("lost", np.int64),  # messages that were lost since the last count
        ("is_lost", np.int64),  # 1: the newest message is lost
    ]
)
"""One channel of a directed edge."""


@kernel(rows_of(LOSSY_EDGE_ROW), wholes, whole)
def draw_losses(rows: Records, chosen: Ints, number: int) -> None:
    """Draw which edges lose the message with this number, at its first attempt.

    rows: (n,)
    chosen: (m,): places of the edges on which it is sent
    """
    for place in chosen:
        row = rows[place]
        threshold = row.threshold
        is_lost = row.loses_all
        if row.is_bursty and is_bad_state(
            row.key, number, row.p_good_bad, row.p_bad_good
        ):
            threshold = row.bad_threshold
            is_lost = row.loses_all_bad
        if draw_first_attempt(row.key, number) < threshold:
            is_lost = 1
        row.is_lost = is_lost
        row.sent += 1
        row.lost += is_lost


class LossyEdges:
    """The edges from one drone to others that do nothing but lose messages.

    impairment: the simulated network, with `only_loses` for each of these edges
    source: id of the drone
    destinations: ids of the others
    channel: channel of the messages
    """

    def __init__(
        self,
        impairment: Impairment,
        source: int,
        destinations: Sequence[int],
        channel: str,
    ) -> None:
        self._impairment = impairment
        self._source = source
        self._place = {j: place for place, j in enumerate(destinations)}
        self.destinations = self._place.keys()
        self._rows = np.zeros(len(self._place), LOSSY_EDGE_ROW)
        for row, j in zip(self._rows, self._place, strict=True):
            row["key"] = impairment.draw_key(source, j, channel)
            effects = impairment.effects(source, j)
            row["threshold"], row["loses_all"] = split_threshold(effects.loss)
            row["is_bursty"] = effects.p_good_bad > 0.0
            row["p_good_bad"] = effects.p_good_bad
            row["p_bad_good"] = effects.p_bad_good
            row["bad_threshold"], row["loses_all_bad"] = split_threshold(
                effects.loss_bad
            )
        impairment.count_sources.append(self.count)

    def send(self, number: int, destinations: Sequence[int]) -> list[int]:
        """Send a message to some destinations; return the destinations that it reaches."""
        chosen = np.array([self._place[j] for j in destinations], np.int64)
        draw_losses(self._rows, chosen, number)
        is_lost = self._rows["is_lost"][chosen].tolist()
        return [j for j, lost in zip(destinations, is_lost, strict=True) if not lost]

    def count(self) -> None:
        """Give the counts since the last call to the simulated network."""
        for row, j in zip(self._rows, self._place, strict=True):
            if row["sent"]:
                sent = int(row["sent"])
                self._impairment.count(self._source, j, sent, int(row["lost"]))
        self._rows["sent"] = 0
        self._rows["lost"] = 0

    def close(self) -> None:
        """Give the last counts to the simulated network."""
        self.count()
        self._impairment.count_sources.remove(self.count)
