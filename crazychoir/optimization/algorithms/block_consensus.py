"""Consensus on one block of coordinates at a time."""

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.blocks import Blocks, flat
from crazychoir.optimization.rounds.iteration import vector
from crazychoir.optimization.rounds.messages import INTEGER, like, parts
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, require_heard
from crazychoir.types import Vec


class BlockConsensus(Mixing):
    """Consensus where each agent, if it is awake, averages one block and tells its neighbours that block alone.

        x_i[l] <- sum_j w_ij x_j|i[l],   l = the block that i draws,   x_j|i = what i has heard last of j's x

    In the first round all of x travels, later blocks only; an agent that sleeps sends None.
    blocks: lengths of consecutive blocks of the vector x;  chances: of each, None: equal;  awake: probability a round;
    weights: row i, of sum one;  seed: of the draws. x_i is agreed upon, and lies between the x of the start; it is in
    general not their mean, as an agent may use a block before those that it has given it to do. No step size.
    The graph is static.  Source: Farina & Notarstefano 2020, "Randomized block proximal methods for distributed
    stochastic big-data optimization", IEEE Trans. Autom. Control, without its gradient.
    """

    doubly_stochastic = False

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        blocks: Sequence[int],
        chances: Sequence[float] | None = None,
        awake: float = 1.0,
        rounds: int | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(i, weights, rounds)
        if len(self.weights) > 1:
            raise ConfigError(
                f"agent {i}: weights",
                f"{len(self.weights)} rows",
                "one: the graph must not change",
            )
        self.x = flat(i, vector(f"agent {i}: x", x))
        self.blocks = Blocks(i, len(self.x), blocks, chances, awake, seed)
        self._known: dict[int, Vec] = {}
        self._changed: int | None = None

    def payload(self) -> Any:
        """[l, x_i[l]]: the block that has changed; all in the first round; None if it slept."""
        if self.k == 0:
            return self.x
        return (
            None
            if self._changed is None
            else [self._changed, self.x[self.blocks.part(self._changed)]]
        )

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Remember what was heard; change a block."""
        require_heard(self.i, row, heard)
        for j, message in heard.items():
            self._remember(j, message)
        self._changed = self.blocks.draw()
        if self._changed is not None:
            part = self.blocks.part(self._changed)
            x = self.x.copy()
            x[part] = self.changed(row, part)
            self.x = x

    def changed(self, row: Row, part: slice) -> Vec:
        """The new block of x."""
        return self.mixed(row, part)

    def mixed(self, row: Row, part: slice) -> Vec:
        """sum_j w_ij x_j|i, this part of it."""
        mixed = row[self.i] * self.x[part]
        for j in self._known:
            mixed += row[j] * self._known[j][part]
        return mixed

    def _remember(self, j: int, message: Any) -> None:
        """The neighbour's x, or its block."""
        if message is None:
            return
        if not isinstance(message, list):
            self._known[j] = like(self.i, j, message, self.x).copy()
            return
        parts(self.i, self.k, {j: message}, INTEGER, object)
        block, values = message
        if j not in self._known or not 0 <= block < len(self.blocks):
            allowed = f"all of x, then of blocks 0 to {len(self.blocks) - 1}"
            raise ConfigError(
                f"agent {self.i}: message of agent {j}, round {self.k}",
                f"block {block}",
                allowed,
            )
        part = self.blocks.part(block)
        self._known[j][part] = like(self.i, j, values, self.x[part])
