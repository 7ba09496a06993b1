"""How the agents of a team look together for the best mixed-integer solution.

They exchange options, and agree on a mixture of options of each agent.
"""

import heapq
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.mixed_integer import (
    MILP_TOLERANCE,
    BoxBounds,
    MixedIntegerBlock,
)
from crazychoir.optimization.problems.options_lp import (
    AgentOptions,
    OptionsPool,
    TeamChoice,
)
from crazychoir.optimization.rounds.agreement import find_best_offer, flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """How far agents look for better mixed-integer solutions."""

    passes: int = 20
    """Largest number of times that agents ask for options at new prices, or vary their choice.
    """
    nodes: int = 60
    """Largest number of nodes of branch and price."""
    variations: tuple[float, ...] = (-1.0, -0.5, -0.25, 0.25, 0.5, 1.0)
    """Changes of the resources that are tried, in parts of an agent's equal share."""
    least_saving: float = 1e-9
    """Least saving of an improvement, relative to 1 + |cost|."""
    least_fraction: float = 1e-9
    """An entry that is nearer than this to an integer is one."""


SEARCH_LIMITS = SearchLimits()


@dataclass(frozen=True)
class PricedMixture:
    """The cheapest mixture of the options that a node allows, whatever their integers."""

    bound: float
    """Lower bound of the cost of all solutions of the node, or -inf."""
    prices: Vec
    """(S,) prices pi >= 0 at which the bound holds."""
    mixture: TeamChoice
    """The mixture, as far as the agents looked."""


class OptionsSearch:
    """One agent's part in the search of a team for

        min sum_i c_i'x_i  s.t.  sum_i A_i x_i <= b,  x_i in X_i

    where: the start of an error message
    options: the agent's own options; one or more
    pool: the options of all agents, still empty
    diameter: D of the graph
    Source: Dantzig & Wolfe 1960, Operations Research 8(1), 101-111 (prices and options); Barnhart et
    al. 1998, Operations Research 46(3), 316-329 (branch and price).
    """

    def __init__(
        self, where: str, options: AgentOptions, pool: OptionsPool, diameter: int
    ) -> None:
        self._where = where
        self._options = options
        self._block: MixedIntegerBlock = options.block
        self._pool = pool
        self._diameter = diameter
        self._i = self._block.agent
        self._position = pool.agents.index(self._i)
        self._sent = 0
        self._is_any_fresh = False

    def run(self) -> Exchange[tuple[TeamChoice, float]]:
        """Return the best choice that was found, and a lower bound of the cost of all solutions.

        Raises SolverError, at every agent in the same round, if the bound contradicts the choice.
        """
        root = yield from self._price(self._block.bounds)
        if root is None:
            raise SolverError(self._where, "infeasible: an agent has no option")
        choice = yield from self._choose(None)
        choice = yield from self._improve(choice)
        choice, bound = yield from self._branch(choice, root)
        self._require_dual(choice, root)
        return choice, bound

    def _improve(self, choice: TeamChoice) -> Exchange[TeamChoice]:
        """Return a better choice: agents refine and vary their parts until that gains nothing."""
        for _ in range(SEARCH_LIMITS.passes):
            before = choice
            choice = yield from self._refine(choice)
            yield from self._vary(choice)
            choice = yield from self._choose(choice)
            if not _is_better(choice, before):
                break
        return choice

    def _require_dual(self, choice: TeamChoice, root: PricedMixture) -> None:
        """Raise SolverError unless weak duality holds. All agents check it.

        sum_i min_x (c_i + A_i'pi)'x - pi'b <= cost - pi'left  holds for any x_i in X_i.
        """
        pi = root.prices
        most = choice.cost - float(pi @ choice.left)
        if root.bound > most + MILP_TOLERANCE * (
            1.0 + abs(most) + float(pi @ np.abs(self._pool.capacity))
        ):
            found = f"bound {root.bound:.9g} above cost - pi'left = {most:.9g}"
            raise SolverError(
                self._where, f"{found}: a local problem was not solved to its end"
            )

    def _exchange(self, word: Any = None) -> Exchange[dict[int, Any]]:
        """Send the new options of this agent and a word to all agents, and receive theirs."""
        fresh = self._options.table[self._sent :]
        self._sent = len(self._options.table)
        known = yield from flood_values(self._i, [fresh, word], self._diameter)
        self._is_any_fresh = self._pool.add({j: rows for j, (rows, _) in known.items()})
        return {j: theirs for j, (_, theirs) in known.items()}

    def _price(self, box: BoxBounds) -> Exchange[PricedMixture | None]:
        """Add the options that are best at the prices of the cheapest mixture, until there is none.

        box: bounds (low, high) of this agent's x at a node; only options within them are used
        Returns None if an agent has no solution in its box.
        """
        block = self._block
        if box is not block.bounds:
            corner, _ = block.least(block.c, box)
            if corner is not None:
                self._options.add(corner)
        allowed = yield from self._exchange(self._options.within(box))
        if any(usable == [] for usable in allowed.values()):
            return None
        bound = -math.inf
        at = np.zeros(block.S)
        for _ in range(SEARCH_LIMITS.passes):
            pi, mixture = self._pool.relaxed(allowed)
            corner, proven = block.least(block.c + pi @ block.A, box)
            if corner is not None:
                self._options.add(corner)
            # All agents take the mixture of one: at other processors a tie may be broken otherwise.
            word = mixture.mixtures if self._position == 0 else None
            told = yield from self._exchange(
                [pi.tolist(), proven, self._options.within(box), word]
            )
            mixture = self._pool.value(told[self._pool.agents[0]][3])
            if all(theirs == pi.tolist() for theirs, *_ in told.values()):
                terms = [value for _, value, _, _ in told.values()]
                least = math.fsum([*terms, *(-pi * self._pool.capacity)])
                if least > bound:
                    bound = least
                    at = pi
            if not self._is_any_fresh:
                break
            allowed = {j: usable for j, (_, _, usable, _) in told.items()}
        return PricedMixture(bound, at, mixture)

    def _choose(self, start: TeamChoice | None) -> Exchange[TeamChoice]:
        """Agree on a mixture of options with the same integers for each agent.

        start: the choice of the team so far; a worse one is not taken
        """
        # The search of one agent is enough.
        offer = self._pool.best(self._i, start) if self._position == 0 else None
        agreed = yield from find_best_offer(offer, self._diameter)
        if agreed is None:
            if start is None:
                raise SolverError(
                    self._where, "no choice of options within the nodes of a search"
                )
            return start
        choice = self._pool.value(agreed[2])
        return choice if start is None or _is_better(choice, start) else start

    def _refine(self, choice: TeamChoice) -> Exchange[TeamChoice]:
        """Return the best choice with the integers of a choice."""
        own = self._options.mix(choice.mixtures[self._position])
        priced = yield from self._price(self._block.box_of(own))
        if priced is None or not _is_better(priced.mixture, choice):
            return choice
        return priced.mixture

    def _vary(self, choice: TeamChoice) -> Exchange[None]:
        """Exchange options that use what is left, or somewhat more or less than is used now."""
        block = self._block
        used = block.A @ self._options.mix(choice.mixtures[self._position])
        share = self._pool.capacity / len(self._pool.agents)
        self._options.add(block.within(used + choice.left)[0])
        for part in (0.0, *SEARCH_LIMITS.variations):
            self._options.add(block.within(used + part * share)[0])
        yield from self._exchange()

    def _branch(
        self, choice: TeamChoice, root: PricedMixture
    ) -> Exchange[tuple[TeamChoice, float]]:
        """Search the whole tree by branch and price, as far as the limit of nodes allows.

        A node bounds the integers of all agents; each agent knows only its own bounds. If the cheapest
        mixture of a node has integers, it is a solution. Otherwise the agent that is farthest from an
        integer cuts its box into two.
        Returns the best choice, and the least bound of all nodes that remain.
        """
        queue = [(root.bound, 0, self._block.bounds)]
        count = 0
        least = math.inf
        for _ in range(SEARCH_LIMITS.nodes):
            if not queue or self._is_closed(queue[0][0], choice):
                break
            bound, _, box = heapq.heappop(queue)
            priced = yield from self._price(box)
            if priced is None:
                continue
            bound = max(bound, priced.bound)
            if self._is_closed(bound, choice):
                continue
            own = self._options.mean(priced.mixture.mixtures[self._position])
            k, fraction = self._block.find_fraction(own)
            offer = None
            if fraction > SEARCH_LIMITS.least_fraction:
                offer = [-fraction, self._i]
            agreed = yield from find_best_offer(offer, self._diameter)
            if agreed is None:
                least = min(least, bound)
                if _is_better(priced.mixture, choice):
                    choice = priced.mixture
                continue
            boxes = (box, box)
            if agreed[1] == self._i:
                boxes = self._block.cut(box, k, own[k])
            for child in boxes:
                count += 1
                heapq.heappush(queue, (bound, count, child))
        if choice.excess > MILP_TOLERANCE:
            return choice, root.bound
        least = min([least, choice.cost, *(node[0] for node in queue)])
        return choice, max(root.bound, least)

    def _is_closed(self, bound: float, choice: TeamChoice) -> bool:
        """Return True if no solution of a node with this bound is better than a choice."""
        least = SEARCH_LIMITS.least_saving * (1.0 + abs(choice.cost))
        return choice.excess <= MILP_TOLERANCE and bound >= choice.cost - least


def _is_better(choice: TeamChoice, other: TeamChoice) -> bool:
    """Return True if a choice has less excess, or the same excess and a lower cost."""
    less = other.excess - choice.excess
    saved = other.cost - choice.cost
    least = SEARCH_LIMITS.least_saving * (1.0 + abs(other.cost))
    return less > MILP_TOLERANCE or (less > -MILP_TOLERANCE and saved > least)
