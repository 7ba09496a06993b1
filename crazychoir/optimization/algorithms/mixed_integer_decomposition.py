"""Primal decomposition for mixed-integer linear programs.

It finds prices first, then a feasible solution in finite time.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.convexified import Convexified
from crazychoir.optimization.algorithms.primal_decomposition import PrimalDecomposition
from crazychoir.optimization.problems.mixed_integer import (
    MILP_TOLERANCE,
    MixedIntegerBlock,
    require_block,
)
from crazychoir.optimization.problems.options_lp import (
    AgentOptions,
    OptionsPool,
    sum_columns,
    sum_excess,
)
from crazychoir.optimization.rounds.agreement import (
    find_best_offer,
    find_greatest,
    flood_values,
)
from crazychoir.optimization.rounds.mixing import Rows, check_rows
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.optimization.rounds.step_size import StepSize
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class ImprovementSearch:
    """How agents look for better mixed-integer solutions."""

    passes: int = 20
    """Largest number of times that agents ask for options at new prices, or vary their choice.
    """
    variations: tuple[float, ...] = (-1.0, -0.5, -0.25, 0.25, 0.5, 1.0)
    """Changes of the resources that are tried, in parts of an agent's equal share."""
    least_saving: float = 1e-9
    """Least saving of an improvement, relative to 1 + |cost|."""


IMPROVEMENT_SEARCH = ImprovementSearch()


@dataclass(frozen=True, slots=True)
class PriceStage:
    """How stage 1 of the decomposition finds prices and allocations, the same at all agents."""

    rounds: int = 200
    """Rounds of PrimalDecomposition."""
    penalty: float = 1000.0
    """M of Convexified: larger than the sum of the prices on which the team will agree."""
    options: int = 10
    """Number of last allocations that give options."""


STANDARD_PRICE_STAGE = PriceStage()


@dataclass(frozen=True)
class MixedIntegerSolution:
    """The solution of the team, as one agent knows it."""

    x: Vec
    """(n_i,) the agent's own part."""
    cost: float
    """Cost of all agents."""
    left: Vec
    """(S,) what is left of the resources.

    It is negative by no more than the tolerance of a solver, MILP_TOLERANCE (1 + |b|).
    """
    lower_bound: float
    """Lower bound of the cost of all solutions.

    It is sum_i min over X_i of (c_i + A_i'pi)'x - pi'b, or -inf if the agents' pi differed. Except
    for rounding it is at most cost - pi'left. If a resource is exceeded within the tolerance, the bound
    may be above the cost by the value of the excess.
    """
    restricted: bool
    """True if the resources had to be tightened."""
    rounds: int
    """Number of rounds in all."""


class PrimalDecompositionMILP(Program[MixedIntegerSolution]):
    """Agent i's part of a mixed-integer linear program with common resources.

        min sum_i c_i'x_i  s.t.  sum_i A_i x_i <= sum_i b_i,  x_i in X_i,  some x_i integer

    The method has four stages:

    1. `prices.rounds` rounds of PrimalDecomposition over conv(X_i) give allocations y_i.
    2. Each agent computes options. For each of the last `prices.options` allocations, an option is
       x_i = argmin c_i'x over X_i with A_i x <= y_i + v, with the least possible sum of v. More
       options are the corners of conv(X_i) that gave p_i, and the best points at the prices pi of
       the cheapest mixture of all options. All agents receive the cost and the use A_i x of all
       options, and agree on the best choice of one option an agent.
    3. While an agent can save cost with the remaining resources, or can reduce an excess, the agent
       with the largest gain changes its x_i. Then each agent adds options that use somewhat more or
       less of the resources, and all agree on a choice again, until that gains nothing.
    4. If a resource is still exceeded, start again from 1, tightened by the paper's restriction.
       With it, 2 is feasible after finitely many rounds:

           b_i <- b_i - sigma / N,   sigma = S max_i (MixedIntegerBlock.tightening of i)

    block: the agent's own part
    weights: row i, doubly stochastic, of a graph that does not change
    agents: N, the number of agents
    diameter: D of the graph
    step: a_k
    prices: rounds, penalty and options of stage 1
    Raises SolverError, at every agent in the same round, that names a resource which is exceeded in
    the end.
    Source: Camisa, Notarnicola & Notarstefano 2022, IEEE TAC 67(1), 413-420 (arXiv 2010.14446),
    which has stages 1 and 4, and 2 with one option an agent.
    """

    heavy = True
    connected = True

    def __init__(
        self,
        block: MixedIntegerBlock,
        weights: Rows,
        agents: int,
        diameter: int,
        step: float | StepSize,
        prices: PriceStage = STANDARD_PRICE_STAGE,
    ) -> None:
        require_block(block, "PrimalDecompositionMILP")
        self._where = f"agent {block.agent}: primal decomposition"
        for name, value, least in (
            ("agents", agents, 1),
            ("rounds", prices.rounds, 1),
            ("options", prices.options, 1),
        ):
            if value < least:
                raise ConfigError(f"{self._where}: {name}", value, f"at least {least}")
        self._block = block
        self._i = block.agent
        self.weights = check_rows(block.agent, weights)
        self._agents = agents
        self.diameter = diameter
        self._step = step
        self._rounds = prices.rounds
        self._options = prices.options
        self._local = Convexified(block, prices.penalty)
        self._capacity = np.zeros(block.S)
        self._left = np.zeros(block.S)
        self._x = np.zeros(block.n)
        self._cost = 0.0
        super().__init__()

    def run(self) -> Exchange[MixedIntegerSolution]:
        """Run the stages, first without and then with the restriction."""
        yield from self._hello()
        found = yield from self._attempt(np.zeros(self._block.S), restricted=False)
        if found is None:
            sigma = self._block.S * (
                yield from find_greatest(self._block.tightening(), self.diameter)
            )
            found = yield from self._attempt(sigma, restricted=True)
        if found is None:
            s = int(np.argmax(self._excess))
            found_none = f"infeasible, as far as was found: resource {s} exceeded by {self._excess[s]:.6g}"
            raise SolverError(
                self._where, f"{found_none}; more rounds or a larger penalty may help"
            )
        return found

    def _hello(self) -> Exchange[None]:
        """Exchange all shares, which add up to the common capacity.

        Raises ConfigError unless all agents have the same number of resources, and their number is
        N.
        """
        known = yield from flood_values(
            self._i, self._block.share.tolist(), self.diameter
        )
        for j, share in known.items():
            if len(share) != self._block.S:
                raise ConfigError(
                    f"{self._where}: share of agent {j}",
                    f"{len(share)} resources",
                    f"{self._block.S}",
                )
        if len(known) != self._agents:
            allowed = f"{len(known)}, those within {self.diameter} hops"
            raise ConfigError(f"{self._where}: agents", self._agents, allowed)
        self._capacity = sum_columns(known.values())
        self._members = list(known)

    def _attempt(
        self, sigma: Vec, restricted: bool
    ) -> Exchange[MixedIntegerSolution | None]:
        """Run stages 1 to 3; return None if a resource is exceeded."""
        block = self._block
        share = block.share - sigma / self._agents
        prices = PrimalDecomposition(
            self._i, self.weights, self._local, share, self._step, self._rounds
        )
        options = AgentOptions(block)
        while not prices.done:
            prices.step((yield prices.message()))
            if prices.k > self._rounds - self._options:
                options.add(block.within(prices.y)[0])
                for corner in self._local.active:
                    options.add(corner)
        pool = OptionsPool(self._capacity, self._members)
        bound = yield from self._share(options, pool)
        yield from self._choose(options, pool)
        yield from self._improve()
        for _ in range(IMPROVEMENT_SEARCH.passes):
            before = self._x, self._cost, self._left
            yield from self._vary(options, pool)
            yield from self._choose(options, pool)
            yield from self._improve()
            less = sum_excess(before[2]) - sum_excess(self._left)
            if less <= MILP_TOLERANCE and (
                less < -MILP_TOLERANCE
                or self._cost
                >= before[1] - IMPROVEMENT_SEARCH.least_saving * (1.0 + abs(before[1]))
            ):
                self._x, self._cost, self._left = before
                break
        self._excess = -self._left
        if (self._excess > MILP_TOLERANCE * (1.0 + np.abs(self._capacity))).any():
            return None
        self._require_dual(*bound)
        return MixedIntegerSolution(
            self._x, self._cost, self._left, bound[0], restricted, self.k
        )

    def _require_dual(self, bound: float, pi: Vec) -> None:
        """Raise SolverError unless weak duality holds. All agents check it.

        sum_i min_x (c_i + A_i'pi)'x - pi'b <= cost - pi'left  holds for any x_i in X_i.
        """
        most = self._cost - float(pi @ self._left)
        if bound > most + MILP_TOLERANCE * (
            1.0 + abs(most) + float(pi @ np.abs(self._capacity))
        ):
            found = f"bound {bound:.9g} above cost - pi'left = {most:.9g}: a local problem was not solved to its end"
            raise SolverError(self._where, found)

    def _share(
        self, options: AgentOptions, pool: OptionsPool
    ) -> Exchange[tuple[float, Vec]]:
        """Exchange the options of all agents: the first half of stage 2.

        In each pass agents add the options that are best at the prices of the cheapest mixture.
        Returns the best lower bound that was found, and its pi.
        """
        block = self._block
        fresh = 0
        asked: list[Any] = [None, 0.0]
        bound = -np.inf
        at = np.zeros(block.S)
        for _ in range(IMPROVEMENT_SEARCH.passes):
            known = yield from flood_values(
                self._i, [options.table[fresh:], *asked], self.diameter
            )
            fresh = len(options.table)
            prices = asked[0]
            if prices is not None and all(
                theirs == prices for _, theirs, _ in known.values()
            ):
                least = math.fsum(
                    [
                        *(value for *_, value in known.values()),
                        *(-np.array(prices) * self._capacity),
                    ]
                )
                if least > bound:
                    bound = least
                    at = np.array(prices)
            if not pool.add({j: rows for j, (rows, _, _) in known.items()}):
                break
            pi = pool.prices()
            corner, proven = block.least(block.c + pi @ block.A)
            options.add(corner)
            asked = [pi.tolist(), proven]
        return bound, at

    def _vary(self, options: AgentOptions, pool: OptionsPool) -> Exchange[None]:
        """Exchange options that use the present resources, or more or less of them."""
        fresh = len(options.table)
        for part in (0.0, *IMPROVEMENT_SEARCH.variations):
            options.add(
                self._block.within(
                    self._block.A @ self._x + part * self._capacity / self._agents
                )[0]
            )
        known = yield from flood_values(self._i, options.table[fresh:], self.diameter)
        pool.add(known)

    def _choose(self, options: AgentOptions, pool: OptionsPool) -> Exchange[None]:
        """Agree on one option an agent: the second half of stage 2."""
        # The search of one agent is enough.
        offer = pool.best(self._i) if self._i == pool.agents[0] else None
        agreed = yield from find_best_offer(offer, self.diameter)
        if agreed is None:
            raise SolverError(
                self._where, "no choice of options within the nodes of a search"
            )
        chosen = [int(o) for o in agreed[2]]
        self._x = options.x[chosen[pool.agents.index(self._i)]]
        self._cost, self._left = pool.value(chosen)

    def _improve(self) -> Exchange[None]:
        """Let the agent with the largest gain change its x, until no agent gains: stage 3.

        A smaller excess counts first, then a lower cost.
        """
        block = self._block
        for _ in range(10 * self._agents):
            used = block.A @ self._x
            x, _ = block.within(used + self._left)
            left = self._left + used - block.A @ x
            excess = sum_excess(self._left) - sum_excess(left)
            saved = float(block.c @ (self._x - x))
            gains = excess > MILP_TOLERANCE or (
                excess > -MILP_TOLERANCE
                and saved > IMPROVEMENT_SEARCH.least_saving * (1.0 + abs(self._cost))
            )
            offer = None
            if gains:
                less = -excess if excess > MILP_TOLERANCE else 0.0
                offer = [[less, -saved], self._i, left.tolist()]
            agreed = yield from find_best_offer(offer, self.diameter)
            if agreed is None:
                return
            (_, change), winner, after = agreed
            self._cost = self._cost + change
            self._left = np.array(after)
            if winner == self._i:
                self._x = x
