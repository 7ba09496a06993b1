"""GTAdam: gradient tracking with the adaptive momentum of Adam."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError
from crazychoir.optimization.problems.gradient import CheckedFunction, Gradient
from crazychoir.optimization.rounds.mixing import Rows
from crazychoir.optimization.rounds.step_size import StepSize
from crazychoir.optimization.rounds.tracking import Tracking
from crazychoir.types import Vec

SMALL_ENOUGH_STEP = (
    "well below (1 - s)^2 sqrt(epsilon) / L, s the second largest singular value of W"
)
"""Steps with which GTAdam converges, for error texts."""


@dataclass(frozen=True)
class Momentum:
    """The parameters of Adam, the same at all agents."""

    beta_1: float = 0.9
    """Share of the old first moment, 0 or more and below 1."""
    beta_2: float = 0.999
    """Share of the old second moment, 0 or more and below 1."""
    epsilon: float = 1e-8
    """Added to the second moment, above 0: it bounds the step where the gradient is small."""
    largest: float = 1e6
    """G, bound on the entries of the second moment, above 0."""

    def __post_init__(self) -> None:
        for name in ("beta_1", "beta_2"):
            if not 0.0 <= (beta := getattr(self, name)) < 1.0:
                raise ConfigError(f"Momentum: {name}", beta, "0 or more, below 1")
        for name in ("epsilon", "largest"):
            if not (value := getattr(self, name)) > 0.0:
                raise ConfigError(f"Momentum: {name}", value, "above 0")


STANDARD_MOMENTUM: Final = Momentum()
"""Parameters of Adam that are commonly used."""


class GTAdam(Tracking):
    """Gradient tracking with first and second moments, for  min sum_i f_i(x), f_i smooth.

        m_i(k+1) = b1 m_i(k) + (1 - b1) y_i(k)
        v_i(k+1) = min(b2 v_i(k) + (1 - b2) y_i(k)^2, G)                 in each entry
        x_i(k+1) = sum_j w_ij x_j(k) - a m_i(k+1) / sqrt(v_i(k+1) + e)   in each entry
        y_i(k+1) = sum_j w_ij y_j(k) + grad f_i(x_i(k+1)) - grad f_i(x_i(k))
        m_i(0) = v_i(0) = 0,   y_i(0) = grad f_i(x_i(0))

    The moments have no correction of their start. Each entry has a step of its own scale, which
    helps where entries of x are scaled differently. One message of [x_i, y_i] travels in each round.
    The cost may change while the method runs: it follows.

    i: id of the agent
    x: start, any shape, the same shape at all agents
    weights: row i, doubly stochastic, or one row for each graph of a sequence
    gradient: grad f_i, also a stochastic one, see `Samples`
    step: a, constant. With f_i strongly convex and L-smooth, convergence is linear if the step is
        small enough. Near the optimum the step of an entry is a / sqrt(v_i + e): up to a / sqrt(e),
        which must be a step with which `GradientTracking` converges. With a small e that is a very
        small step, and a larger one may jump forever near the optimum
    moments: b1, b2, e and G
    rounds: number of rounds until done; None for no end
    Raises ConfigError that names the step if x grows without end.
    Source: Carnevale, Farina, Notarnicola & Notarstefano 2023, "GTAdam: Gradient tracking with
    adaptive momentum for distributed online optimization", IEEE Trans. Control Netw. Syst. 10(3),
    1436-1448.
    """

    same = ("step_size", "moments")

    def __init__(
        self,
        i: int,
        x: ArrayLike,
        weights: Rows,
        gradient: Gradient,
        step: float | StepSize,
        moments: Momentum = STANDARD_MOMENTUM,
        rounds: int | None = None,
    ) -> None:
        super().__init__(i, x, weights, step, SMALL_ENOUGH_STEP, rounds)
        self.gradient = CheckedFunction(i, "gradient", gradient)
        self.moments = moments
        self.first = np.zeros_like(self.x)
        self.second = np.zeros_like(self.x)
        self.track(self.gradient(0, self.x))

    def estimate(self, k: int, x: Vec) -> Vec:
        """Return grad f_i(x)."""
        return self.gradient(k, x)

    def direction(self) -> Vec:
        """Update the moments; return m_i / sqrt(v_i + e)."""
        m = self.moments
        self.first = m.beta_1 * self.first + (1.0 - m.beta_1) * self.y
        second = m.beta_2 * self.second + (1.0 - m.beta_2) * self.y**2
        self.second = np.minimum(second, m.largest)
        direction: Vec = self.first / np.sqrt(self.second + m.epsilon)
        return direction
