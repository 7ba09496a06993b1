"""Edges that come and go at random, the same at both ends without a message."""

from crazychoir.bus.impairment import random_draws as draws
from crazychoir.runtime.clock import NS_PER_SECOND, Clock


class RandomEdges:
    """The edges of a drone to its neighbours: in each tick, both ends choose the edge or not.

    Each draw is a function of (seed, i, j, k), with the tick k of the team's time. Both ends of an
    edge compute the same draw without a message, even if they have missed messages.

    i: id of the drone.
    neighbors: ids that drone i hears.
    share: probability with which an end chooses an edge in a tick; 1: the edges always count.
    seed: seed of the draws.
    """

    def __init__(
        self, i: int, neighbors: tuple[int, ...], share: float, seed: int
    ) -> None:
        self.neighbors = neighbors
        self.share = share
        self._keys = {
            j: (draws.draw_key(seed, i, j), draws.draw_key(seed, j, i))
            for j in neighbors
        }

    def counts(self, j: int, k: int) -> bool:
        """Return whether both ends of the edge to j have chosen it in tick k."""
        return all(
            draws.draw(key, k, 0) < self.share * draws.RANDOM_DRAWS.range_size
            for key in self._keys[j]
        )


def count_ticks(clock: Clock, rate: float) -> int:
    """Return the number of periods of the team's time until now.

    rate: Hz: ticks a second.
    """
    return (clock.epoch_ns + clock.now_ns()) // round(NS_PER_SECOND / rate)
