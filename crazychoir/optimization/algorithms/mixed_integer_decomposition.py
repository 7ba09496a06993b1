"""Primal decomposition for mixed-integer linear programs.

It finds prices first, then a feasible solution in finite time.
"""

from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.algorithms.convexified import Convexified
from crazychoir.optimization.algorithms.primal_decomposition import PrimalDecomposition
from crazychoir.optimization.problems.mixed_integer import (
    MILP_TOLERANCE,
    MixedIntegerBlock,
    find_scale,
    require_block,
)
from crazychoir.optimization.problems.options_lp import (
    AgentOptions,
    OptionsPool,
    sum_columns,
)
from crazychoir.optimization.problems.options_search import OptionsSearch
from crazychoir.optimization.rounds.agreement import find_greatest, flood_values
from crazychoir.optimization.rounds.mixing import Rows, check_rows
from crazychoir.optimization.rounds.program import Exchange, Program
from crazychoir.optimization.rounds.step_size import StepSize
from crazychoir.types import Vec


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

    It is negative by no more than MILP_TOLERANCE times the largest number of a resource, in all.
    """
    lower_bound: float
    """Lower bound of the cost of all solutions.

    It is sum_i min over X_i of (c_i + A_i'pi)'x - pi'b, or the least such bound of all open nodes of
    branch and price. It is -inf if the agents' pi differed, and the cost if the solution is proven to
    be the best. If a resource is exceeded within the tolerance, the bound may be above the cost by the
    value of the excess.
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
       options, and agree on the best mixture of options with the same integers for each agent.
    3. OptionsSearch improves this choice: the best parts that are no integers for the integers of the
       choice; options that use what is left, or somewhat more or less than now; then branch and
       price, up to a limit of nodes. A small problem is solved to its end.
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
    which has stages 1 and 4, and 2 with one option an agent. Stage 3: see OptionsSearch.
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
        self._scale = np.ones(block.S)
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
            s = int(np.argmax(self._excess * self._scale))
            found_none = f"infeasible, as far as was found: resource {s} exceeded by {self._excess[s]:.6g}"
            raise SolverError(
                self._where, f"{found_none}; more rounds or a larger penalty may help"
            )
        return found

    def _hello(self) -> Exchange[None]:
        """Exchange all shares, which add up to the common capacity, and the size of each resource.

        Raises ConfigError unless all agents have the same number of resources, and their number is
        N.
        """
        block = self._block
        sizes = np.maximum(np.abs(block.A).max(axis=1), np.abs(block.share))
        known = yield from flood_values(
            self._i, [block.share.tolist(), sizes.tolist()], self.diameter
        )
        for j, (share, _) in known.items():
            if len(share) != block.S:
                raise ConfigError(
                    f"{self._where}: share of agent {j}",
                    f"{len(share)} resources",
                    f"{block.S}",
                )
        if len(known) != self._agents:
            allowed = f"{len(known)}, those within {self.diameter} hops"
            raise ConfigError(f"{self._where}: agents", self._agents, allowed)
        self._capacity = sum_columns(share for share, _ in known.values())
        self._scale = find_scale(np.max([sizes for _, sizes in known.values()], axis=0))
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
        pool = OptionsPool(self._capacity, self._scale, self._members)
        search = OptionsSearch(self._where, options, pool, self.diameter)
        choice, bound = yield from search.run()
        self._excess = -choice.left
        if choice.excess > MILP_TOLERANCE:
            return None
        return MixedIntegerSolution(
            options.mix(choice.mixtures[self._members.index(self._i)]),
            choice.cost,
            choice.left,
            bound,
            restricted,
            self.k,
        )
