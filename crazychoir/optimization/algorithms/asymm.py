"""ASYMM: the asynchronous method of multipliers, for problems that need not be convex."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems.smooth import (
    SmoothFunction,
    SmoothProblem,
    descend_once,
)
from crazychoir.optimization.rounds.iteration import copy_state
from crazychoir.optimization.rounds.messages import (
    INTEGER_TYPES,
    REAL_NUMBER_TYPES,
    check_array,
    check_parts,
)
from crazychoir.optimization.rounds.stopping import Flags
from crazychoir.types import PerNeighbor, Vec


@dataclass(frozen=True, slots=True)
class AsymmLimits:
    """Limits of the penalties of ASYMM, and when an agent counts as calm, growing or stuck."""

    largest_penalty: float = 1e5
    """Largest penalty rho and s."""
    calm_times: int = 5
    """Number of times in a row that an agent must find its gradient small.

    In this time the last steps of the other agents can arrive.
    """
    growing_change: float = 0.05
    """Largest last change of nu_ij, relative to 1 + |nu_ij|, that counts as converged."""
    unmet_tolerance: float = 1e-3
    """Tolerance of a constraint at the largest penalty, relative to 1 + |x_k|.

    A constraint that is missed by more will not be met.
    """


ASYMM_LIMITS = AsymmLimits()


@dataclass(frozen=True, slots=True)
class PenaltySchedule:
    """Penalties rho and s and the tolerance e of the epochs of ASYMM, the same at all agents."""

    epochs: int = 25
    """Number of epochs until done."""
    penalty: float = 1.0
    """First value of rho and s."""
    tolerance: float = 0.1
    """First value of e."""
    growth: float = 2.0
    """Factor of rho and s where a violation has not fallen enough, above 1."""
    shrink: float = 0.5
    """Part of the last violation that is small enough, between 0 and 1."""
    sharpen: float = 0.5
    """Factor of e after each epoch, between 0 and 1."""

    def require_valid(self, i: int) -> None:
        """Raise ConfigError of agent i for a value out of range."""
        for name, value, most in (
            ("penalty", self.penalty, ASYMM_LIMITS.largest_penalty),
            ("tolerance", self.tolerance, np.inf),
        ):
            if not 0.0 < value <= most:
                raise ConfigError(
                    f"agent {i}: {name}", f"{value}", f"above 0, at most {most:g}"
                )
        for name, value in (
            ("shrink", self.shrink),
            ("sharpen", self.sharpen),
            ("1 / growth", 1.0 / self.growth),
        ):
            if not 0.0 < value < 1.0:
                raise ConfigError(
                    f"agent {i}: {name}", f"{value:g}", "above 0, below 1"
                )
        if self.epochs < 1:
            raise ConfigError(
                f"agent {i}: epochs", self.epochs, "1 or more, the same at all agents"
            )


STANDARD_SCHEDULE = PenaltySchedule()


MOST_STEPS: Final = 5_000
"""Largest number of steps of an agent in an epoch."""
Heard = tuple[int, bytes, Vec, Vec, float]
"""Message of a neighbour: epoch, bits of the logical AND, x_j, nu_ji, rho_ji."""


class ASYMM:
    """Asynchronous method of multipliers for a common variable.

    It solves min sum_i f_i(x)  s.t.  h_i(x) = 0, g_i(x) <= 0 for all i.

    Time is divided into epochs. In an epoch, agent i minimises its part of the augmented
    Lagrangian. It makes one step each time it wakes, with the latest x_j of its neighbours:

        L_i(x) = f_i(x) + sum_{j in N_i} [ (nu_ij - nu_ji)'x + (rho_ij + rho_ji)/2 |x - x_j|^2 ]
                 + l_i'h_i(x) + s_i/2 |h_i(x)|^2
                 + 1/(2 s_i) sum_r [ max(0, m_ir + s_i g_ir(x))^2 - m_ir^2 ]

    It stops its steps when |grad L_i| <= e. The epoch ends when all agents have been there (a
    distributed logical AND), or when a neighbour is in the next epoch. Then the agent computes its
    multipliers for the next epoch, and waits for those of its neighbours:

        nu_ij <- nu_ij + rho_ij (x_i - x_j),   l_i <- l_i + s_i h_i(x_i)
        m_i <- max(0, m_i + s_i g_i(x_i))

    rho_ij and s_i grow by the factor `growth` if the violation they penalise has not fallen to
    `shrink` of its last value and is larger than e explains. e falls by the factor `sharpen`.
    After the last epoch no agent makes another step, and a second logical AND tells when all agents
    have ended. So no agent is done while another agent may still fail.
    Each message contains the full state, so a later message replaces all lost ones. There is no
    step size.
    The graph is static and undirected. f_i, h_i, g_i are twice differentiable and need not be
    convex: x is a local minimum.

    i: id of the agent
    neighbors: N_i
    diameter: diameter of the graph
    x: (n,) start
    problem: f_i, h_i and g_i
    schedule: the penalties and tolerances of the epochs
    epoch: the present epoch
    nu: multipliers nu_ij by neighbour
    rho: penalties rho_ij by neighbour

    Raises ConfigError or SolverError if a function has a wrong shape or is not finite.
    Raises SolverError if nu_ij, l_i or m_i changes by more than ASYMM_LIMITS.growing_change in the last epoch, as when
    no x meets the constraints of all agents.
    Raises SolverError if |grad L_i| is not small after MOST_STEPS steps of an epoch, as when L_i
    has no minimum.
    Source: Farina, Garulli, Giannitrapani & Notarstefano 2019, Automatica 103, 243-253; here with a
    Newton step.
    """

    asynchronous = True
    waits = True
    connected = True
    undirected = True

    def __init__(
        self,
        i: int,
        neighbors: Iterable[int],
        diameter: int,
        x: ArrayLike,
        problem: SmoothProblem,
        schedule: PenaltySchedule = STANDARD_SCHEDULE,
    ) -> None:
        schedule.require_valid(i)
        self.i = i
        self.where = f"agent {i}"
        self.neighbors = tuple(sorted(neighbors))
        self.x = copy_state(f"{self.where}: x", x)
        self.epochs = schedule.epochs
        self.tolerance = schedule.tolerance
        self._schedule = schedule
        self.epoch = 0
        self.k = 0
        self.nu = {j: np.zeros_like(self.x) for j in self.neighbors}
        self.rho = dict.fromkeys(self.neighbors, schedule.penalty)
        self._gap = dict.fromkeys(self.neighbors, np.inf)
        self._own = _AugmentedLagrangian(
            self.where, len(self.x), problem, schedule.penalty
        )
        self.diameter = diameter
        self._flags = Flags(diameter, False)
        self._calm = self._steps = 0
        self._heard: dict[int, Heard] = {}

    @property
    def done(self) -> bool:
        """True if all agents have ended the last epoch."""
        return self.epoch >= self.epochs and self._flags.agreed

    def message(self) -> PerNeighbor:
        """Return [epoch, bits of the logical AND, x_i, nu_ij, rho_ij] for each neighbour."""
        bits = self._flags.message()
        return PerNeighbor(
            {
                j: [self.epoch, bits, self.x, self.nu[j], self.rho[j]]
                for j in self.neighbors
            }
        )

    def step(self, heard: Mapping[int, Any]) -> None:
        """Take the messages; then make a step, enter the next epoch, or wait."""
        self.k += 1
        said = check_parts(
            self.i,
            self.k,
            heard,
            INTEGER_TYPES,
            bytes,
            object,
            object,
            REAL_NUMBER_TYPES,
        )
        for j, (epoch, bits, x, nu, rho) in said.items():
            self._heard[j] = (
                epoch,
                bits,
                check_array(self.i, j, x, self.x),
                check_array(self.i, j, nu, self.x),
                rho,
            )
        others = [self._heard[j] for j in self.neighbors if j in self._heard]
        if len(others) < len(self.neighbors) or any(
            epoch < self.epoch for epoch, *_ in others
        ):
            return
        if all(epoch == self.epoch for epoch, *_ in others):
            ready = self.epoch >= self.epochs or self._is_calm()
            self._flags.step(
                ready, {j: bits for j, (_, bits, *_) in self._heard.items()}
            )
            if self.epoch >= self.epochs or not self._flags.agreed:
                return
        self._ascend()

    def _is_calm(self) -> bool:
        """Make a step unless the gradient is small.

        Returns True if the gradient has been small for some time.
        """
        self._calm = 0 if self._descend() else self._calm + 1
        return self._calm >= ASYMM_LIMITS.calm_times

    def _descend(self) -> bool:
        """Make a step unless the gradient is small; return True if x has changed."""
        slope = np.zeros_like(self.x)
        pull = 0.0
        centre = np.zeros_like(self.x)
        for j, (_, _, x, nu, rho) in self._heard.items():
            both = self.rho[j] + rho
            slope += self.nu[j] - nu
            pull += both
            centre += both * x

        def value(x: Vec) -> float:
            return self._own.value(x) + float(slope @ x + x @ (0.5 * pull * x - centre))

        def gradient(x: Vec) -> Vec:
            return self._own.gradient(x) + slope + pull * x - centre

        if (length := float(np.linalg.norm(gradient(self.x)))) <= self.tolerance:
            return False
        self._steps += 1
        if self._steps > MOST_STEPS:
            found = f"epoch {self.epoch}: |grad L| = {length:.3g} > {self.tolerance:.3g} after {MOST_STEPS} steps"
            raise SolverError(
                f"{self.where}: {found}, at x = {self.x.tolist()}",
                "no minimum, or tolerance too sharp",
            )
        before = self.x
        self.x = descend_once(value, gradient, self.x)
        return self.x is not before

    def _ascend(self) -> None:
        """Compute the multipliers of the next epoch."""
        schedule = self._schedule
        for j, (_, _, x, *_) in self._heard.items():
            self.nu[j] = self.nu[j] + self.rho[j] * (self.x - x)
            gap = float(np.linalg.norm(self.x - x))
            size = float(np.linalg.norm(self.nu[j]))
            if self.epoch + 1 == self.epochs and self.rho[
                j
            ] * gap > ASYMM_LIMITS.growing_change * (1.0 + size):
                why = "constraints that exclude each other, or too few epochs"
                found = (
                    f"x is {gap:.3g} from that of agent {j} after {self.epochs} epochs"
                )
                raise SolverError(f"{self.where}: {found}", why)
            if (
                gap > schedule.shrink * self._gap[j]
                and self.rho[j] * gap > self.tolerance
            ):
                self.rho[j] = min(
                    schedule.growth * self.rho[j], ASYMM_LIMITS.largest_penalty
                )
            self._gap[j] = gap
        if self.epoch + 1 == self.epochs:
            self._own.require_met(self.x, self.epochs)
        self._own.ascend(self.x, schedule.growth, schedule.shrink, self.tolerance)
        self.epoch += 1
        self.tolerance *= schedule.sharpen
        self._flags = Flags(self.diameter, False)
        self._calm = self._steps = 0


class _AugmentedLagrangian:
    """f_i with its constraints in an augmented Lagrangian of its own.

    where: text that names the agent, for errors
    n: length of x
    problem: objective f, equalities h(x) = 0 and inequalities g(x) <= 0
    penalty: first value of s
    l: multipliers of h
    m: multipliers of g
    """

    def __init__(
        self, where: str, n: int, problem: SmoothProblem, penalty: float
    ) -> None:
        nothing = SmoothFunction(lambda x: np.zeros(0), lambda x: np.zeros((0, n)))
        self._f = problem.objective
        self._h = problem.equalities or nothing
        self._g = problem.inequalities or nothing
        self._where = where
        self.s = penalty
        self._missed = np.inf
        self.l: Vec | float = 0.0
        self.m: Vec | float = 0.0

    def _parts(self, x: Vec) -> list[tuple[Vec, Any]]:
        parts = (
            ("objective", self._f),
            ("equalities", self._h),
            ("inequalities", self._g),
        )
        return [part.at(x, f"{self._where}: {name}") for name, part in parts]

    def value(self, x: Vec) -> float:
        """Return f + l'h + s/2 |h|^2 + 1/(2s) sum max(0, m + s g)^2.

        It differs from L_i without the neighbours' terms by a constant.
        """
        (f, _), (h, _), (g, _) = self._parts(x)
        short = np.maximum(0.0, self.m + self.s * g)
        return float(
            f[0]
            + np.sum(h * (self.l + 0.5 * self.s * h))
            + short @ short / (2.0 * self.s)
        )

    def gradient(self, x: Vec) -> Vec:
        """Return grad f + J_h'(l + s h) + J_g' max(0, m + s g)."""
        (_, df), (h, dh), (g, dg) = self._parts(x)
        total: Vec = (
            df[0]
            + dh.T @ (self.l + self.s * h)
            + dg.T @ np.maximum(0.0, self.m + self.s * g)
        )
        return total

    def require_met(self, x: Vec, epochs: int) -> None:
        """Check the constraints and multipliers in the last epoch.

        Raises SolverError if the multipliers still change by much, or if a constraint is not met.
        """
        (_, _), (h, _), (g, _) = self._parts(x)
        m = np.maximum(0.0, self.m + self.s * g)
        for name, missed, multipliers in (
            ("equalities", np.abs(h), self.l),
            ("inequalities", np.maximum(0.0, g), m),
        ):
            if not len(missed):
                continue
            row = int(np.argmax(missed))
            size = float(np.linalg.norm(multipliers))
            is_growing = self.s * missed[row] > ASYMM_LIMITS.growing_change * (
                1.0 + size
            )
            is_stuck = self.s >= ASYMM_LIMITS.largest_penalty and missed[
                row
            ] > ASYMM_LIMITS.unmet_tolerance * (1.0 + float(np.abs(x).max()))
            if is_growing or is_stuck:
                found = f"{name}, row {row}: violated by {missed[row]:.3g} after {epochs} epochs"
                why = "constraints that exclude each other, or too few epochs"
                raise SolverError(f"{self._where}: {found}, at x = {x.tolist()}", why)

    def ascend(self, x: Vec, growth: float, shrink: float, tolerance: float) -> None:
        """Compute l and m, and raise s if the violation has not fallen."""
        (_, _), (h, _), (g, _) = self._parts(x)
        m = np.maximum(0.0, self.m + self.s * g)
        missed = float(np.linalg.norm(np.concatenate([h, (m - self.m) / self.s])))
        self.l = self.l + self.s * h
        self.m = m
        if missed > shrink * self._missed and self.s * missed > tolerance:
            self.s = min(growth * self.s, ASYMM_LIMITS.largest_penalty)
        self._missed = missed
