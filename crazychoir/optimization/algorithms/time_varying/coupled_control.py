"""Model predictive control of a team with coupled outputs, solved by the team in rounds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.predictive_control import Prediction, PredictiveControl
from crazychoir.optimization.problems.gradient import CheckedFunction
from crazychoir.optimization.rounds.blocks import require_vector
from crazychoir.optimization.rounds.iteration import Iteration, copy_state
from crazychoir.optimization.rounds.messages import check_array, require_heard
from crazychoir.types import Mat, Vec

Plant = Callable[[Vec, Vec], ArrayLike]


@dataclass(frozen=True)
class OutputCoupling:
    """The constraint between neighbours, and how the team meets it; the same at all agents."""

    reach: float
    """Largest |y_i - y_j|, in each entry, above 0, in m or the unit of y."""
    penalty: float
    """rho, penalty of ADMM, above 0: any one converges, the best one is of the size of the cost."""
    iterations: int
    """Rounds for each step of the control, 1 or more."""

    def __post_init__(self) -> None:
        for name in ("reach", "penalty"):
            if not (value := getattr(self, name)) > 0.0:
                raise ConfigError(f"OutputCoupling: {name}", value, "above 0")
        if self.iterations < 1:
            found = self.iterations
            raise ConfigError("OutputCoupling: iterations", found, "1 or more")


class CoupledMPC(Iteration):
    """One robot's part of a team's model predictive control, solved by ADMM in each step.

    In each step of the control the team solves

        min sum_i J_i(U_i; x_i)  s.t.  the limits of each robot,
            |y_i,t - y_j,t| <= reach  for t = 1..T,  i and j neighbours, in each entry

    with J_i the cost of the `Prediction` and y = C x. One round is one iteration:

        l_ij+ = (e - clip(e, -reach, reach)) / 2,   e = y_i - y_j + 2 l_ij
        z_i = mean over j of (y_i + l_ij - 2 l_ij+)
        U_i = argmin J_i(U; x_i) + rho |N_i| / 2 sum_t |y_t - z_i,t|^2

    rho l_ij are the multipliers of the edge. l_ji = -l_ij, so both ends of an edge know them and only
    y_i (T, d) travels. This is ADMM with a copy of both outputs for each edge. After `iterations`
    rounds the robot applies its first input, measures its state, shifts its plan by one step, and
    the next step starts from the shifted plan and multipliers. The first step starts from z_i = the
    outputs of the plan without neighbours, and l_ij = 0.

    With a feasible problem, ADMM converges for any rho to the optimum of the team, and the inputs to
    the inputs of one central controller. With few iterations the plan may exceed the reach a little:
    `violation` says by how much. Lost messages change no iterate: they delay rounds, and all rounds
    of a step must fit into the time that the step lasts.

    agent: id of the robot
    x: (n,) state at the start
    neighbors: N_i, ids of the neighbours, in increasing order
    of: model, limits and cost of this robot; T and C x of one length at all robots
    coupling: reach, rho and the number of rounds a step
    steps: number of steps of the control until done; None for no end
    plant: maps (x, u) to the state at the next step; None for the model
    x: (n,) state at the start of the step
    u: (m,) input of the last step, 0 before the first
    plan: (T, m) inputs from now on
    violation: excess of the reach of the newest plans, 0 if there is none
    Raises SolverError if the limits of the robot allow no plan.
    Source: Boyd, Parikh, Chu, Peleato & Eckstein 2011, Found. Trends Mach. Learn. 3(1) (ADMM);
    Summers & Lygeros 2012, "Distributed model predictive consensus via the alternating direction
    method of multipliers", Allerton Conference.
    """

    connected = True
    undirected = True
    common = False
    same = ("reach", "penalty", "iterations")

    def __init__(
        self,
        agent: int,
        x: ArrayLike,
        neighbors: tuple[int, ...],
        of: Prediction,
        coupling: OutputCoupling,
        steps: int | None = None,
        plant: Plant | None = None,
    ) -> None:
        super().__init__(agent, None if steps is None else steps * coupling.iterations)
        self.x = require_vector(agent, copy_state(f"agent {agent}: x", x))
        self.neighbors = tuple(neighbors)
        self.reach = coupling.reach
        self.penalty = coupling.penalty
        self.iterations = coupling.iterations
        self.control = PredictiveControl(of, pull=self.penalty * len(self.neighbors))
        self.u: Vec = np.zeros(of.B.shape[1])
        self.violation = 0.0
        self._plant = CheckedFunction(agent, "plant", plant or self._model)
        self._nobody = np.zeros((0, of.T, len(of.C)))
        self._l = {j: np.zeros((of.T, len(of.C))) for j in self.neighbors}
        self._z = self._plan(PredictiveControl(of), None)
        self._solve()

    def message(self) -> Mat:
        """Return the outputs y_i (T, d) of the plan at t = 1..T."""
        return self.y

    def update(self, heard: Mapping[int, Any]) -> None:
        """Do an iteration of ADMM; in the last one of a step, move on to the next step."""
        require_heard(self.i, self.neighbors, heard)
        targets = [
            self._meet(j, check_array(self.i, j, y, self.y)) for j, y in heard.items()
        ]
        self.violation = max(
            0.0, *(np.abs(self.y - y).max() - self.reach for y in heard.values()), 0.0
        )
        self._z = np.mean(targets, axis=0) if targets else self._z
        self._solve()
        if (self.k + 1) % self.iterations == 0:
            self._advance()

    def _meet(self, j: int, y: Mat) -> Mat:
        """Update l_ij with the outputs of neighbour j; return the target of this edge."""
        old = self._l[j]
        e = self.y - y + 2.0 * old
        self._l[j] = 0.5 * (e - np.clip(e, -self.reach, self.reach))
        target: Mat = self.y + old - 2.0 * self._l[j]
        return target

    def _solve(self) -> None:
        """Plan from x, near the targets."""
        self.y = self._plan(self.control, self._z)

    def _plan(self, control: PredictiveControl, targets: Mat | None) -> Mat:
        """Plan from x; return the outputs (T, d).

        targets: (T, d), or None for a plan without neighbours
        """
        found = control.solve(self.x, self._nobody, targets)
        if isinstance(found, str):
            raise SolverError(
                f"agent {self.i}: predictive control, round {self.k}", found
            )
        self.plan = found
        of = control.of
        return np.ascontiguousarray(of.states(self.x, found)[1:-1] @ of.C.T)

    def _advance(self) -> None:
        """Apply the first input, and shift targets and multipliers by one step."""
        self.u = self.plan[0]
        self.x = self._plant(self.k, self.x, self.u)
        self._z = _shift(self._z)
        self._l = {j: _shift(dual) for j, dual in self._l.items()}
        self._solve()

    def _model(self, x: Vec, u: Vec) -> Vec:
        """Return A x + B u."""
        following: Vec = self.control.of.A @ x + self.control.of.B @ u
        return following


def _shift(series: Mat) -> Mat:
    """Return the series (T, d) one step later; the last row stays."""
    return np.vstack([series[1:], series[-1:]])
