"""Blocks of coordinates, of which an agent works on one at a time, drawn at random."""

import random
from collections.abc import Sequence
from itertools import accumulate, pairwise

from crazychoir.errors import ConfigError
from crazychoir.types import Vec


class Blocks:
    """Which block an agent works on in a round: drawn from (seed, agent), or none, if it sleeps.

    sizes: of consecutive blocks of x, which add up to its length;  chances: of each block, of sum one, None: equal;
    awake: probability that the agent does anything in a round.
    """

    def __init__(
        self,
        i: int,
        n: int,
        sizes: Sequence[int],
        chances: Sequence[float] | None,
        awake: float,
        seed: int,
    ) -> None:
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
        self._chance = random.Random(f"{seed} {i}")  # noqa: S311 - which block, not secrets

    def __len__(self) -> int:
        return len(self._parts)

    def draw(self) -> int | None:
        """The number of this round's block, None if the agent sleeps."""
        if self._chance.random() >= self._awake:
            return None
        return self._chance.choices(range(len(self._parts)), self._weights)[0]

    def part(self, block: int) -> slice:
        """Where a block is in x."""
        return self._parts[block]


def flat(i: int, x: Vec) -> Vec:
    """x, if it is a vector."""
    if x.ndim != 1:
        raise ConfigError(
            f"agent {i}: x", f"shape {x.shape}", "a vector, for blocks of it"
        )
    return x
