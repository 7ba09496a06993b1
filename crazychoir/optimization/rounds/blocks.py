"""Blocks of coordinates: an agent works on one block at a time, drawn at random."""

import random
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

from crazychoir.errors import ConfigError
from crazychoir.types import Vec


@dataclass(frozen=True)
class RandomBlocks:
    """The blocks of x, and how an agent draws one of them in each round."""

    sizes: Sequence[int]
    """Lengths of the consecutive blocks of x."""
    chances: Sequence[float] | None = None
    """Probability of each block, with sum one; None for equal ones."""
    awake: float = 1.0
    """Probability that the agent does anything in a round."""
    seed: int = 0
    """Seed of the draws."""


class Blocks:
    """The random choice of an agent's block in each round.

    The draws depend on (seed, agent). An agent that sleeps draws no block.

    i: id of the agent
    n: length of x
    drawn: the blocks and how they are drawn; their lengths add up to n
    Raises ConfigError for lengths or probabilities that do not fit.
    """

    def __init__(self, i: int, n: int, drawn: RandomBlocks) -> None:
        sizes = drawn.sizes
        chances = drawn.chances
        awake = drawn.awake
        if sum(sizes) != n or min(sizes, default=0) < 1:
            raise ConfigError(
                f"agent {i}: blocks",
                list(sizes),
                f"lengths of 1 or more, {n} together, as x has",
            )
        weights = [1.0 / len(sizes)] * len(sizes) if chances is None else list(chances)
        if (
            len(weights) != len(sizes)
            or min(weights) <= 0.0
            or abs(sum(weights) - 1.0) > 1e-9
        ):
            allowed = f"{len(sizes)} probabilities above 0, of sum one: a block never drawn is never optimised"
            raise ConfigError(f"agent {i}: chances of blocks", weights, allowed)
        if not 0.0 < awake <= 1.0:
            raise ConfigError(
                f"agent {i}: awake", awake, "a probability above 0, at most 1"
            )
        self._parts = [slice(a, b) for a, b in pairwise(accumulate(sizes, initial=0))]
        self._weights = weights
        self._awake = awake
        self._chance = random.Random(f"{drawn.seed} {i}")  # noqa: S311 - which block, not secrets

    def __len__(self) -> int:
        return len(self._parts)

    def draw(self) -> int | None:
        """Return the index of the block of this round, or None if the agent sleeps."""
        if self._chance.random() >= self._awake:
            return None
        return self._chance.choices(range(len(self._parts)), self._weights)[0]

    def part(self, block: int) -> slice:
        """Return the place of a block in x."""
        return self._parts[block]


def require_vector(i: int, x: Vec) -> Vec:
    """Return x; raise ConfigError unless it is a vector."""
    if x.ndim != 1:
        raise ConfigError(
            f"agent {i}: x", f"shape {x.shape}", "a vector, for blocks of it"
        )
    return x
