"""Consensus that trims: extreme values of neighbours do not count, so that few liars cannot steer it."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.types import Bools, Mat, Vec


class _Trimming(Iteration):
    """The part of both algorithms: the values heard, and the mean of what is kept.

    A message that cannot be decoded, a value that is no array of floats of the own shape, and one
    with an entry that is not finite come from a liar. They are left out, and so many fewer values
    are trimmed.
    """

    connected = True
    takes_malformed = True
    same = ("liars",)

    def __init__(
        self, i: int, x: ArrayLike, liars: int, rounds: int | None = None
    ) -> None:
        super().__init__(i, rounds)
        if liars < 0:
            raise ConfigError(f"agent {i}: liars", liars, "0 or more")
        self.x = copy_state(f"agent {i}: x", x)
        self.liars = liars

    @abstractmethod
    def kept(self, heard: Mat, liars: int) -> Bools:
        """Return True (m, n) for the entries that count.

        heard: (m, n) credible values of m neighbours, sorted in each column
        liars: most liars among them
        """

    def message(self) -> Vec:
        """Return x_i."""
        return self.x

    def update(self, heard: Mapping[int, Any]) -> None:
        """Trim, then average.

        Raises ConfigError if the agent hears too few for so many liars.
        """
        least = 2 * self.liars + 1
        if len(heard) < least:
            do = "Take a denser graph, or guard against fewer liars."
            allowed = f"{least} or more for {self.liars} liars"
            found = f"{len(heard)} agents that it hears"
            raise ConfigError(f"agent {self.i}", found, allowed, do)
        credible = [x for x in heard.values() if self._is_credible(x)]
        unmasked = len(heard) - len(credible)
        own = self.x.reshape(-1)
        values = np.array(credible).reshape(len(credible), len(own))
        values = np.sort(values, axis=0)
        kept = self.kept(values, max(0, self.liars - unmasked))
        total = own + np.where(kept, values, 0.0).sum(axis=0)
        mean = total / (1.0 + kept.sum(axis=0))
        counted = np.vstack([own, np.where(kept, values, own)])
        # Rounding must not lead out of the hull of the values that count.
        mean = np.clip(mean, counted.min(axis=0), counted.max(axis=0))
        self.x = mean.reshape(self.x.shape)

    def _is_credible(self, x: Any) -> bool:
        """Return True if an honest neighbour could have sent x."""
        return (
            isinstance(x, np.ndarray)
            and x.dtype == np.float64
            and x.shape == self.x.shape
            and bool(np.isfinite(x).all())
        )


class WMSR(_Trimming):
    """Consensus by W-MSR, the weighted-mean-subsequence-reduced algorithm, among liars.

        x_i <- mean of x_i and of the x_j, j in R_i

    R_i: the neighbours without the F largest of the values above x_i (all of them if there are
    fewer), and without the F smallest of the values below x_i, in the same way.

    All honest agents stay between the smallest and the largest honest start, in each entry, and
    agree, if the graph is (2F+1)-robust and no agent hears more than F liars. A liar may send any
    value, and another one to each neighbour. F+1 liars among the neighbours of an agent can lead it
    anywhere. `robustness(graph)` tells which F a graph allows. The value of the agreement is not the
    mean of the start. A liar that sends nothing, or ends in another round, is not trimmed: it ends
    the algorithm, as any lost neighbour does.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    liars: F, the same at all agents
    rounds: number of rounds until done; None for no end
    Raises ConfigError if the agent hears fewer than 2F+1 agents.
    Source: LeBlanc, Zhang, Koutsoukos & Sundaram 2013, "Resilient asymptotic consensus in robust
    networks", IEEE J. Sel. Areas Commun. 31(4), 766-781.
    """

    def kept(self, heard: Mat, liars: int) -> Bools:
        """Return True for the entries that are not among the F most extreme beside x_i."""
        own = self.x.reshape(-1)
        place = np.arange(len(heard))[:, None]
        below = (heard < own).sum(axis=0)
        above = (heard > own).sum(axis=0)
        first = np.minimum(liars, below)
        last = len(heard) - np.minimum(liars, above)
        middle: Bools = (place >= first) & (place < last)
        return middle


class TrimmedMean(_Trimming):
    """Consensus by the trimmed mean, among liars.

        x_i <- mean of x_i and of the x_j that remain without the F largest and the F smallest

    The guarantee is that of `WMSR`, on the same graphs: the honest agents stay between the smallest
    and the largest honest start, and agree, with at most F liars among the neighbours of each agent.
    F+1 can lead an agent anywhere. It always drops 2F values, even if they agree with x_i, and so
    mixes more slowly than W-MSR.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    liars: F, the same at all agents
    rounds: number of rounds until done; None for no end
    Raises ConfigError if the agent hears fewer than 2F+1 agents.
    Source: Vaidya, Tseng & Liang 2012, "Iterative approximate Byzantine consensus in arbitrary
    directed graphs", ACM PODC, 365-374.
    """

    def kept(self, heard: Mat, liars: int) -> Bools:
        """Return True for all entries but the F smallest and the F largest."""
        place = np.arange(len(heard))[:, None]
        middle = (place >= liars) & (place < len(heard) - liars)
        return np.broadcast_to(middle, heard.shape)
