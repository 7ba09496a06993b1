"""Consensus of agents that wake at different times and lose messages."""

from collections.abc import Mapping

from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.optimization.rounds.mixing import Row, check_rows, describe_shape
from crazychoir.types import Vec


class AsynchronousConsensus(Iteration):
    """Consensus with the latest message of each neighbour, however old it is.

        x_i <- w_ii x_i + sum_{j heard} w_ij x_j(latest) + (sum_{j not heard yet} w_ij) x_i

    All agents agree on a value between those of the start. It is the mean only if all agents are in
    step. There is no step size.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i, of sum one, no entry negative, the agent's own entry above 0
    rounds: number of rounds until done; None for no end
    Source: Bertsekas & Tsitsiklis 1989, Parallel and Distributed Computation, section 7.3
    (agreement); Tsitsiklis 1984.
    """

    asynchronous = True
    connected = True

    def __init__(
        self, i: int, x: ArrayLike, weights: Row, rounds: int | None = None
    ) -> None:
        super().__init__(i, rounds)
        self.x = copy_state(f"agent {i}: x", x)
        self.weights = check_rows(i, weights)
        if min(weights.values()) < 0.0 or weights[i] <= 0.0:
            raise ConfigError(
                f"agent {i}: weights",
                dict(weights),
                f"0 or more, that of agent {i} itself above 0",
            )

    def message(self) -> Vec:
        """Return x_i."""
        return self.x

    def update(self, heard: Mapping[int, Vec]) -> None:
        """Average with the neighbours that have been heard."""
        row = self.weights[0]
        x = self.x
        moved = 0.0 * x
        for j, other in heard.items():
            if j not in row or getattr(other, "shape", None) != x.shape:
                allowed = (
                    f"shape {x.shape}, of agents {[j for j in row if j != self.i]}"
                )
                raise ConfigError(
                    f"agent {self.i}: message of agent {j}",
                    describe_shape(other),
                    allowed,
                )
            moved += row[j] * (other - x)
        self.x = x + moved
