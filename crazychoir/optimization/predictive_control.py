"""Model predictive control by quadratic programs, for one robot and for a team in turn."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.quadratic import MovingProgram, Polyhedron
from crazychoir.optimization.rounds.messages import (
    INTEGER_TYPES,
    build_malformed_error,
    check_parts,
)
from crazychoir.types import Mat, Vec

REACH_EXCESS_COST = 1e4
"""Cost of an excess of the reach by 1: larger than any gain from it."""
ZERO_ROW_LENGTH = 1e-12
"""A constraint row shorter than this does not depend on the inputs: it holds or does not."""


@dataclass(frozen=True)
class Prediction:
    """The model, the limits and the costs of a robot over the next T steps.

    The robot solves this quadratic program, from its state x_0:

        min  sum_t=0..T-1 (x_t' Q x_t + u_t' R u_t) + x_T' P x_T
        s.t. x_t+1 = A x_t + B u_t,   G u_t <= h,   E x_t <= f for t = 1..T,   Z x_T = 0

    After T steps it continues with u = K x.
    """

    A: Mat
    """(n, n) dynamics of the state."""
    B: Mat
    """(n, m) effect of the inputs."""
    C: Mat
    """(d, n) outputs y = C x, which other robots receive."""
    Q: Mat
    """(n, n) >= 0, cost of the state."""
    R: Mat
    """(m, m) > 0, cost of the inputs."""
    E: Mat
    """Rows of the limits of the state, E x <= f."""
    f: Vec
    """Limits of the state."""
    G: Mat
    """Rows of the limits of the inputs, G u <= h."""
    h: Vec
    """Limits of the inputs."""
    T: int
    """Number of steps."""
    P: Mat | None = None
    """(n, n) cost of the last state; None means 0."""
    K: Mat | None = None
    """(m, n) gain after the last step; None means 0."""
    Z: Mat | None = None
    """(l, n) condition on the last state, Z x_T = 0; None means that it is free."""

    @property
    def gain(self) -> Mat:
        """The gain K (m, n)."""
        return np.zeros((self.B.shape[1], len(self.A))) if self.K is None else self.K

    def states(self, x: Vec, u: Mat) -> Mat:
        """Return the states (T + 2, n): x_0 = x, the states by u (T, m), and one more by K."""
        found = [x]
        for k in range(self.T + 1):
            found.append(
                self.A @ found[-1]
                + self.B @ (u[k] if k < self.T else self.gain @ found[-1])
            )
        return np.array(found)


class _MovingQuadraticProgram:
    """A quadratic program over z with moving bounds and slopes; its rows are scaled once.

    P: (n, n), symmetrised: the Hessian of the cost
    rows: (m, n), of rows z <= bounds
    ends: (l, n), of ends z = e
    """

    def __init__(self, P: Mat, rows: Mat, ends: Mat) -> None:
        self._lengths, scaled = _scale_rows_to_one(rows)
        self._end_lengths, scaled_ends = _scale_rows_to_one(ends)
        over = Polyhedron(
            scaled, np.zeros(len(scaled)), scaled_ends, np.zeros(len(ends))
        )
        self.program = MovingProgram(0.5 * (P + P.T), np.zeros(len(P)), over)

    def solve(self, slope: Vec, bounds: Vec, e: Vec) -> Vec | str:
        """Return z (n,), or the reason why there is none.

        slope: (n,) linear cost
        bounds: (m,)
        e: (l,)
        """
        self.program.move(bounds / self._lengths, e / self._end_lengths)
        return self.program.solve(slope)


class PredictiveControl:
    """The quadratic program of a Prediction, over its inputs alone.

    It is compiled once for all states and neighbours:

        x_t = F_t x_0 + H_t U,   U = (u_0, ..., u_T-1)
        min 1/2 U' 2 (H' Q_ H + R_) U + (2 H' Q_ F x_0)' U
        Q_ = diag(Q, ..., Q, P), R_ = diag(R, ..., R)

    The reach adds the constraints |y_t - y_j,t| <= reach, in each entry, for t = 1..T and all other
    robots j. They are written as max_j y_j,t - reach <= C x_t <= min_j y_j,t + reach: two rows an
    entry and step, for any number of other robots.

    With a pull, the cost has another term  pull / 2 sum_t=1..T |y_t - z_t|^2  with moving targets z.

    of: the Prediction
    reach: largest distance to the others, in m or the unit of y; None for no such constraint
    pull: cost of the distance to the targets, 0 or more; 0 for no targets
    Raises ConfigError if R is not positive definite.
    """

    def __init__(
        self, of: Prediction, reach: float | None = None, pull: float = 0.0
    ) -> None:
        self.of = of
        self.reach = reach
        self.pull = pull
        self.F, self.H = _condense_model(of.A, of.B, of.T)
        weights = np.kron(np.eye(of.T), of.Q)
        weights[-len(of.A) :, -len(of.A) :] = 0.0 if of.P is None else of.P
        self._hessian = 2.0 * (
            self.H.T @ weights @ self.H + np.kron(np.eye(of.T), of.R)
        )
        self._slope = 2.0 * self.H.T @ weights @ self.F
        y = np.kron(np.eye(of.T), of.C)
        self._drag = pull * (y @ self.H).T
        self._hessian += self._drag @ y @ self.H
        self._slope += self._drag @ y @ self.F
        end = np.zeros((0, len(of.A))) if of.Z is None else of.Z
        self._end = end @ self.F[-len(of.A) :]
        self._ends = end @ self.H[-len(of.A) :]
        self._rows, self._moved, self._fixed = self._constraints()
        try:
            self.program = _MovingQuadraticProgram(
                self._hessian, self._rows, self._ends
            )
        except np.linalg.LinAlgError as error:
            raise ConfigError(
                "Prediction: R", f"{error}", "a positive definite matrix"
            ) from error

    def _constraints(self) -> tuple[Mat, Mat, Vec]:
        """Return the rows over U, the part of x_0 in their bounds, and the fixed bounds.

        The rows are those of the states, of the inputs, and of the reach. The bounds of the reach
        depend on the other robots and are not part of the fixed bounds.
        """
        of = self.of
        steps = np.eye(self.of.T)
        state = np.kron(steps, of.E)
        y = np.kron(steps, of.C)
        none = np.zeros((of.T * len(of.h), len(of.A)))
        near = [] if self.reach is None else [y, -y]
        rows = np.vstack(
            [state @ self.H, np.kron(steps, of.G), *(part @ self.H for part in near)]
        )
        moved = np.vstack([state @ self.F, none, *(part @ self.F for part in near)])
        return rows, moved, np.concatenate([np.tile(of.f, of.T), np.tile(of.h, of.T)])

    @cached_property
    def _soft(self) -> _MovingQuadraticProgram:
        """The program with one more variable s, the excess of the reach."""
        size = len(self._hessian)
        near = np.arange(len(self._rows)) >= len(self._fixed)
        P = np.zeros((size + 1, size + 1))
        P[:size, :size] = self._hessian
        P[size, size] = 1.0
        rows = np.vstack(
            [np.column_stack([self._rows, -1.0 * near]), -np.eye(1, size + 1, size)]
        )
        return _MovingQuadraticProgram(
            P, rows, np.column_stack([self._ends, np.zeros(len(self._ends))])
        )

    def solve(self, x: Vec, others: Mat, targets: Mat | None = None) -> Mat | str:
        """Return the inputs (T, m) from x (n,), or the reason why there are none.

        others: (J, T, d), the y of the J other robots at t = 1..T
        targets: (T, d), z at t = 1..T; None for 0
        The reason is "infeasible", "too many steps", or "not finite".
        """
        slope = self._slope @ x
        if targets is not None:
            slope = slope - self._drag @ targets.reshape(-1)
        found = self.program.solve(slope, self._bounds(x, others), -self._end @ x)
        return found if isinstance(found, str) else found.reshape(self.of.T, -1)

    def approach(self, x: Vec, others: Mat) -> Mat | str:
        """Return the inputs with the least excess of the reach, for an x that is out of reach.

            |y_t - y_j,t| <= reach + s,  s >= 0,  with REACH_EXCESS_COST s + s^2 / 2 more to minimise

        Arguments and results are those of `solve`.
        """
        slope = np.append(self._slope @ x, REACH_EXCESS_COST)
        bounds = np.append(self._bounds(x, others), 0.0)
        found = self._soft.solve(slope, bounds, -self._end @ x)
        return found if isinstance(found, str) else found[:-1].reshape(self.of.T, -1)

    def _bounds(self, x: Vec, others: Mat) -> Vec:
        bounds = [self._fixed]
        if self.reach is not None:
            bounds += [
                self.reach + others.min(axis=0).reshape(-1),
                self.reach - others.max(axis=0).reshape(-1),
            ]
        left: Vec = np.concatenate(bounds) - self._moved @ x
        return left


def _scale_rows_to_one(rows: Mat) -> tuple[Vec, Mat]:
    """Return the lengths (m,) of the rows, and the rows (m, n) divided by them.

    The length of a row of zeros counts as 1.
    """
    lengths = np.linalg.norm(rows, axis=1)
    is_zero = lengths <= ZERO_ROW_LENGTH
    lengths[is_zero] = 1.0
    scaled = np.ascontiguousarray(rows / lengths[:, None])
    scaled[is_zero] = 0.0
    return lengths, scaled


def _condense_model(A: Mat, B: Mat, T: int) -> tuple[Mat, Mat]:
    """Return F (T n, n) and H (T n, T m) for the states of T steps.

    x_t = A^t x_0 + sum_s<t A^(t-1-s) B u_s,  t = 1..T
    """
    n, m = B.shape
    powers = [np.eye(n)]
    for _ in range(T):
        powers.append(A @ powers[-1])
    H = np.zeros((T * n, T * m))
    for t in range(T):
        for s in range(t + 1):
            H[t * n : (t + 1) * n, s * m : (s + 1) * m] = powers[t - s] @ B
    return np.vstack(powers[1:]), H


@dataclass
class StepTally:
    """Counts of the steps of a robot."""

    solved: int = 0
    """Steps with a new plan."""
    loosened: int = 0
    """Steps with a loosened reach, because the robot was out of reach of a neighbour."""
    kept: int = 0
    """Steps that kept the last plan, because news of a neighbour came too late."""
    infeasible: int = 0
    """Steps that kept the last plan, because the problem was infeasible."""
    why: str = ""
    """Reason of the last infeasible step."""


@dataclass
class SequentialMPC:
    """One robot's part of a team's model predictive control.

    In each step the robots solve one after the other, by increasing id:

        |y_i - y_j| <= reach  at all steps of all plans, i and j neighbours

    In step k a robot solves once it knows the plans of its neighbours: for those with lower ids the
    plans of step k, and for those with higher ids the plans of step k - 1, which they keep until
    they decide themselves. Therefore only one of two neighbours changes its plan at a time.
    If a message comes too late, or the problem is infeasible, the robot continues with its last
    plan, which all neighbours know. This stays feasible, whatever messages are lost, if each plan
    ends in a set that the feedback K does not leave (for example Z x = 0 with K = 0). A robot never
    waits. Messages may come late, twice or never.
    If no plan is feasible, because a robot was pushed away, the plan exceeds the reach as little
    as possible.
    Source: Richards & How 2007, "Robust distributed model predictive control", Int. Journal of
    Control 80(9).
    """

    i: int
    """Id of this robot."""
    neighbors: tuple[int, ...]
    """Ids of the neighbours."""
    control: PredictiveControl
    """The compiled quadratic program."""
    x: Vec
    """(n,) state at the start of step k."""
    k: int = 0
    """The step that is being decided."""
    tally: StepTally = field(default_factory=StepTally)
    """Counts of the steps."""
    asynchronous = True
    done = False

    def __post_init__(self) -> None:
        of = self.control.of
        self.inputs: Mat = np.zeros((of.T, of.B.shape[1]))
        """(T, m) the plan from step k on."""
        self.decided = False
        self._k, self._y = -1, self._outputs()
        self._told_of: dict[int, tuple[int, Mat]] = {}

    @property
    def u(self) -> Vec:
        """(m,) the input of step k by the current plan, which may still change."""
        first: Vec = self.inputs[0]
        return first

    def message(self) -> list[Any]:
        """Return [k, y (T + 2, d)]: the newest decided step, and the outputs from then on."""
        return [self._k, self._y]

    def step(self, heard: Mapping[int, Any]) -> None:
        """Store the messages of the neighbours, and solve step k if it needs no more of them."""
        check_parts(self.i, self.k, heard, INTEGER_TYPES, np.ndarray)
        for j, (k, y) in heard.items():
            if y.shape != self._y.shape:
                raise build_malformed_error(
                    f"agent {self.i}",
                    j,
                    k,
                    y,
                    f"outputs of shape {self._y.shape}, as its own",
                )
            self._told_of[j] = (int(k), y)
        if not self.decided and all(self._knows(j) for j in self.neighbors):
            self._solve()

    def advance(self, measured: Vec | None = None) -> Vec:
        """Begin step k: return its input (m,), and move on to step k + 1.

        measured: (n,) state at the start of step k + 1; None for the state by the model
        """
        if not self.decided:
            self.tally.kept += 1
            self._decide(self.inputs)
        of = self.control.of
        states = of.states(self.x, self.inputs)
        u = self.u
        self.inputs = np.vstack([self.inputs[1:], of.gain @ states[of.T]])
        self.x = states[1] if measured is None else np.asarray(measured, float)
        self.k = self.k + 1
        self.decided = False
        return u

    def restart(self, x: Vec) -> None:
        """Restart at x (n,), for a robot that is not where its plan led.

        The new plan has zero inputs, and the neighbours receive it.
        """
        self.x = np.asarray(x, float)
        self._decide(np.zeros_like(self.inputs))

    def _knows(self, j: int) -> bool:
        """Return True if the last message of neighbour j contains its newest plan.

        Lower neighbours have decided step k by then, and higher neighbours step k - 1.
        """
        k = self._told_of[j][0] if j in self._told_of else self.k - 2
        return k == self.k or (k == self.k - 1 and j > self.i)

    def _solve(self) -> None:
        T = self.control.of.T
        plans = [self._told_of[j] for j in self.neighbors]
        others = np.array([y[self.k - k + 1 : self.k - k + 1 + T] for k, y in plans])
        tally = self.tally
        found = self.control.solve(self.x, others)
        if isinstance(found, str) and self.control.reach is not None:
            tally.loosened += 1
            found = self.control.approach(self.x, others)
        if isinstance(found, str):
            tally.infeasible = tally.infeasible + 1
            tally.why = f"step {self.k}: {found}"
        else:
            tally.solved += 1
        self._decide(self.inputs if isinstance(found, str) else found)

    def _decide(self, inputs: Mat) -> None:
        self.inputs = inputs
        self.decided = True
        self._k, self._y = self.k, self._outputs()

    def _outputs(self) -> Mat:
        """Return y (T + 2, d) of the plan, with one more step.

        A neighbour that decides the next step needs the additional step.
        """
        of = self.control.of
        return np.ascontiguousarray(of.states(self.x, self.inputs) @ of.C.T)


def integrators(h: float, axes: int) -> tuple[Mat, Mat]:
    """Return A (3 d, 3 d) and B (3 d, d) of x = (p, v, a) in d axes, with the jerk u as the input.

    p+ = p + h v + h^2/2 a + h^3/6 u,   v+ = v + h a + h^2/2 u,   a+ = a + h u

    h: s, time for which the jerk is held
    axes: d
    """
    one = np.eye(axes)
    A = np.array([[1.0, h, 0.5 * h**2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    return np.kron(A, one), np.kron(np.array([[h**3 / 6.0], [0.5 * h**2], [h]]), one)
