"""Consensus on one block of coordinates at a time."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.blocks import Blocks, RandomBlocks, require_vector
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.messages import (
    INTEGER_TYPES,
    check_array,
    check_parts,
)
from crazychoir.optimization.rounds.mixing import Mixing, Row, Rows, require_heard
from crazychoir.types import Vec


class BlockConsensus(Mixing):
    """Consensus on one block at a time.

    In each round an agent that is awake averages one block and sends its neighbours that block
    alone:

        x_i[l] <- sum_j w_ij x_j|i[l]
        l = the block that i draws,   x_j|i = the last x_j known to i

    All of x travels in the first round, and only blocks in later rounds. An agent that sleeps sends
    None. The graph is static. There is no step size.
    All agents agree on a value between those of the start. In general it is not their mean, because
    an agent may use a block before its neighbours have used the one it sent.

    i: id of the agent
    x: start, a vector
    weights: row i, of sum one
    blocks: the blocks of x, and how the agent draws them
    rounds: number of rounds until done; None for no end
    Source: Farina & Notarstefano 2020, "Randomized block proximal methods for distributed
    stochastic big-data optimization", IEEE Trans. Autom. Control, without its gradient.
    """

    doubly_stochastic = False

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        blocks: RandomBlocks,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, weights, rounds)
        if len(self.weights) > 1:
            raise ConfigError(
                f"agent {i}: weights",
                f"{len(self.weights)} rows",
                "one: the graph must not change",
            )
        self.x = require_vector(i, copy_state(f"agent {i}: x", x))
        self.blocks = Blocks(i, len(self.x), blocks)
        self._known: dict[int, Vec] = {}
        self._changed: int | None = None

    def payload(self) -> Any:
        """Return [l, x_i[l]], the block that has changed; None if the agent slept.

        In the first round, return all of x.
        """
        if self.k == 0:
            return self.x
        return (
            None
            if self._changed is None
            else [self._changed, self.x[self.blocks.part(self._changed)]]
        )

    def mix_in(self, row: Row, heard: Mapping[int, Any]) -> None:
        """Store the messages, then change a block."""
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
        """Return the new block of x.

        row: the weights w_ij of this round
        part: slice of x that is the block
        """
        return self.mixed(row, part)

    def mixed(self, row: Row, part: slice) -> Vec:
        """Return the entries `part` of sum_j w_ij x_j|i."""
        mixed = row[self.i] * self.x[part]
        for j in self._known:
            mixed += row[j] * self._known[j][part]
        return mixed

    def _remember(self, j: int, message: Any) -> None:
        """Store the x of a neighbour, or its block."""
        if message is None:
            return
        if not isinstance(message, list):
            self._known[j] = check_array(self.i, j, message, self.x).copy()
            return
        check_parts(self.i, self.k, {j: message}, INTEGER_TYPES, object)
        block, values = message
        if j not in self._known or not 0 <= block < len(self.blocks):
            allowed = f"all of x, then of blocks 0 to {len(self.blocks) - 1}"
            raise ConfigError(
                f"agent {self.i}: message of agent {j}, round {self.k}",
                f"block {block}",
                allowed,
            )
        part = self.blocks.part(block)
        self._known[j][part] = check_array(self.i, j, values, self.x[part])
