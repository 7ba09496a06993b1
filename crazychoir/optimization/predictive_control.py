"""Model predictive control by quadratic programs: one robot's, and how the robots of a team solve theirs in turn."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.quadratic import MovingProgram, Polyhedron
from crazychoir.optimization.rounds.messages import INTEGER, malformed, parts
from crazychoir.types import Mat, Vec

DEAR = 1e4
"""Price of being out of reach by 1: beyond what it is worth to anybody."""
LEAST = 1e-12
"""A row of constraints whose length is below this is not in the hands of the inputs: it holds or does not."""


@dataclass(frozen=True)
class Prediction:
    """What a robot may do in the next T steps, and what it wants.

        min  sum_t=0..T-1 (x_t' Q x_t + u_t' R u_t) + x_T' P x_T
        s.t. x_t+1 = A x_t + B u_t,   G u_t <= h,   E x_t <= f for t = 1..T,   Z x_T = 0
        and then goes on by  u = K x

    A: (n, n);  B: (n, m);  C: (d, n), y = C x is what others are told;  E, f;  G, h;  Q: (n, n) >= 0;  R: (m, m) > 0;
    P: (n, n), 0 if left out;  K: (m, n), 0 if left out;  Z: (l, n), left out: free;  T: steps.
    """

    A: Mat
    B: Mat
    C: Mat
    Q: Mat
    R: Mat
    E: Mat
    f: Vec
    G: Mat
    h: Vec
    T: int
    P: Mat | None = None
    K: Mat | None = None
    Z: Mat | None = None

    @property
    def gain(self) -> Mat:
        """K."""
        return np.zeros((self.B.shape[1], len(self.A))) if self.K is None else self.K

    def states(self, x: Vec, u: Mat) -> Mat:
        """(T + 2, n): x_0 = x, those that inputs u (T, m) lead to, and the one after, by K."""
        found = [x]
        for k in range(self.T + 1):
            found.append(
                self.A @ found[-1]
                + self.B @ (u[k] if k < self.T else self.gain @ found[-1])
            )
        return np.array(found)


class _Program:
    """A quadratic program over z whose bounds and slopes move, its rows scaled once.

    P: (n, n);  rows: (m, n), of rows z <= bounds;  ends: (l, n), of ends z = e.
    """

    def __init__(self, P: Mat, rows: Mat, ends: Mat) -> None:
        self._lengths, scaled = _unit_rows(rows)
        self._end_lengths, scaled_ends = _unit_rows(ends)
        over = Polyhedron(
            scaled, np.zeros(len(scaled)), scaled_ends, np.zeros(len(ends))
        )
        self.program = MovingProgram(0.5 * (P + P.T), np.zeros(len(P)), over)

    def solve(self, slope: Vec, bounds: Vec, e: Vec) -> Vec | str:
        """z (n,), or why there is none."""
        self.program.move(bounds / self._lengths, e / self._end_lengths)
        return self.program.solve(slope)


class PredictiveControl:
    """The quadratic program of a Prediction, over its inputs alone, compiled once for all states and neighbours.

        x_t = F_t x_0 + H_t U,   U = (u_0, ..., u_T-1)
        min 1/2 U' 2 (H' Q_ H + R_) U + (2 H' Q_ F x_0)' U,   Q_ = diag(Q, ..., Q, P), R_ = diag(R, ..., R)

    reach: m, or whatever y is in:  |y_t - y_j,t| <= reach, in each entry, for t = 1..T and all others j; None: no such
    constraint. That is  max_j y_j,t - reach <= C x_t <= min_j y_j,t + reach:  two rows however many others there are.
    Raises ConfigError where R is not positive definite.
    """

    def __init__(self, of: Prediction, reach: float | None = None) -> None:
        self.of = of
        self.reach = reach
        self.F, self.H = _condensed(of.A, of.B, of.T)
        weights = np.kron(np.eye(of.T), of.Q)
        weights[-len(of.A) :, -len(of.A) :] = 0.0 if of.P is None else of.P
        self._hessian = 2.0 * (
            self.H.T @ weights @ self.H + np.kron(np.eye(of.T), of.R)
        )
        self._slope = 2.0 * self.H.T @ weights @ self.F
        end = np.zeros((0, len(of.A))) if of.Z is None else of.Z
        self._end = end @ self.F[-len(of.A) :]
        self._ends = end @ self.H[-len(of.A) :]
        self._rows, self._moved, self._fixed = self._constraints()
        try:
            self.program = _Program(self._hessian, self._rows, self._ends)
        except np.linalg.LinAlgError as error:
            raise ConfigError(
                "Prediction: R", f"{error}", "a positive definite matrix"
            ) from error

    def _constraints(self) -> tuple[Mat, Mat, Vec]:
        """Rows over U, what x_0 takes of their bounds, and the bounds: of states, of inputs, of what is to stay near.

        The bounds of the last ones, above and below, are those of the others: left out of the third.
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
    def _soft(self) -> _Program:
        """The program with one variable more, s: the excess of the reach."""
        size = len(self._hessian)
        near = np.arange(len(self._rows)) >= len(self._fixed)
        P = np.zeros((size + 1, size + 1))
        P[:size, :size] = self._hessian
        P[size, size] = 1.0
        rows = np.vstack(
            [np.column_stack([self._rows, -1.0 * near]), -np.eye(1, size + 1, size)]
        )
        return _Program(
            P, rows, np.column_stack([self._ends, np.zeros(len(self._ends))])
        )

    def solve(self, x: Vec, others: Mat) -> Mat | str:
        """The inputs (T, m) from x (n,), or why there are none: "infeasible", "too many steps", "not finite".

        others: (J, T, d), what y of the J others will be at t = 1..T.
        """
        found = self.program.solve(
            self._slope @ x, self._bounds(x, others), -self._end @ x
        )
        return found if isinstance(found, str) else found.reshape(self.of.T, -1)

    def approach(self, x: Vec, others: Mat) -> Mat | str:
        """The same where it is infeasible, as x is out of reach: as little out of reach as it can be.

        |y_t - y_j,t| <= reach + s,  s >= 0,  with DEAR s + s^2 / 2 more to minimise
        """
        slope = np.append(self._slope @ x, DEAR)
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


def _unit_rows(rows: Mat) -> tuple[Vec, Mat]:
    """Return the lengths (m,) of rows, 1 for those of zeros, and the rows (m, n) divided by them."""
    lengths = np.linalg.norm(rows, axis=1)
    is_zero = lengths <= LEAST
    lengths[is_zero] = 1.0
    scaled = np.ascontiguousarray(rows / lengths[:, None])
    scaled[is_zero] = 0.0
    return lengths, scaled


def _condensed(A: Mat, B: Mat, T: int) -> tuple[Mat, Mat]:
    """F (T n, n) and H (T n, T m):  x_t = A^t x_0 + sum_s<t A^(t-1-s) B u_s,  t = 1..T."""
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
class Tally:
    """How the steps went.

    solved;  loosened: of these, out of reach of neighbours, on the way back;  kept: not all neighbours were heard of in
    time;  infeasible, and kept;  why, the last time.
    """

    solved: int = 0
    loosened: int = 0
    kept: int = 0
    infeasible: int = 0
    why: str = ""


@dataclass
class SequentialMPC:
    """One robot's part of a team's model predictive control: in each step one after the other, by increasing id.

        |y_i - y_j| <= reach  at all steps of all plans, i and j neighbours

    In step k a robot solves once it knows what its lower neighbours have decided in step k and the higher ones in step
    k - 1, whose plans go on, as they were told, until they decide in their turn. So a plan that changes always fits
    plans that do not. A robot that does not hear enough before the step begins, or whose problem is infeasible, goes on
    with its own last plan, which all know already: where plans end in a set that K keeps (Z x = 0 with K = 0, say) that
    always fits, whatever is lost. Nothing is waited for, and messages may come late, twice or never.
    Where nothing fits, as one of them was pushed away, a plan is as little out of reach as it can be.
    x: (n,), where it is when step k begins;  inputs: (T, m), its plan from then on;  k: the step that is being decided.
    Source: Richards & How 2007, "Robust distributed model predictive control", Int. Journal of Control 80(9).
    """

    i: int
    neighbors: tuple[int, ...]
    control: PredictiveControl
    x: Vec
    k: int = 0
    tally: Tally = field(default_factory=Tally)
    asynchronous = True
    done = False

    def __post_init__(self) -> None:
        of = self.control.of
        self.inputs: Mat = np.zeros((of.T, of.B.shape[1]))
        self.decided = False
        self._k, self._y = -1, self._outputs()
        self._told_of: dict[int, tuple[int, Mat]] = {}

    @property
    def u(self) -> Vec:
        """(m,), the input of step k, as far as it is decided now."""
        first: Vec = self.inputs[0]
        return first

    def message(self) -> list[Any]:
        """[k, y (T + 2, d)]: the newest step that it has decided, and its outputs from then on."""
        return [self._k, self._y]

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take what neighbours say, and decide if that is enough."""
        parts(self.i, self.k, heard, INTEGER, np.ndarray)
        for j, (k, y) in heard.items():
            if y.shape != self._y.shape:
                raise malformed(
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
        """Step k begins: its input (m,) is applied, and returned, and step k + 1 is to be decided.

        measured: (n,), where it will be then; None: where the model says.
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
        """It is at x (n,), not where its plan was to lead: its plan, and what others hear of it, is to do nothing."""
        self.x = np.asarray(x, float)
        self._decide(np.zeros_like(self.inputs))

    def _knows(self, j: int) -> bool:
        """Whether what neighbour j has said is its newest plan: lower ones have decided before, higher ones not yet."""
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
        """(T + 2, d): y of the plan, with one step more: what it is told to be when the next step begins."""
        of = self.control.of
        return np.ascontiguousarray(of.states(self.x, self.inputs) @ of.C.T)


def integrators(h: float, axes: int) -> tuple[Mat, Mat]:
    """A (3 d, 3 d), B (3 d, d) of x = (p, v, a) in d axes, steered by the jerk, which is held for h s.

    p+ = p + h v + h^2/2 a + h^3/6 u,   v+ = v + h a + h^2/2 u,   a+ = a + h u
    """
    one = np.eye(axes)
    A = np.array([[1.0, h, 0.5 * h**2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    return np.kron(A, one), np.kron(np.array([[h**3 / 6.0], [0.5 * h**2], [h]]), one)
