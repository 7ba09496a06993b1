"""A smooth reference towards a place that jumps, for the result of an optimisation in flight."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.types import FullState, Mat, Vec


@dataclass(frozen=True, slots=True)
class PulseResponse:
    """The pulse response of the smoothing filter, and how fast the filter may be."""

    slope: float = 0.4481
    """Integral of |h'|, where h(t) = t^3 e^-t / 6 is the pulse response of the filter for w = 1.
    """
    curvature: float = 0.3750
    """Integral of |h''| of the same pulse response."""
    largest_frequency: float = 10.0
    """Largest w in 1/s: with a larger one, the attitude control could not follow the rest of a
    jump.
    """


PULSE_RESPONSE = PulseResponse()


class GoalSmoother:
    """Turns a goal that jumps or moves in steps into a full state with continuous p, v, a and j.

        |u'| <= v_max towards the goal,   (1/w d/dt + 1)^4 p = u

    A place u runs to the goal at v_max at most, and p follows it through four equal lags. The pulse
    response h is nowhere negative, so

        |v| <= v_max,  |a| <= v_max w int |h'| = 0.448 w v_max,  |j| <= 0.375 w^2 v_max

    A goal that moves evenly is followed 4 / w s late. A goal that stands is reached within 1 % of
    the distance after |distance| / v_max + 10.1 / w s.

    p: (3,) m, where the reference starts at rest
    v_max: m/s
    a_max: m/s2; it gives w, which is at most PULSE_RESPONSE.largest_frequency 1/s
    period: s, of the steps
    Raises ConfigError for a limit or a period that is not positive.
    """

    def __init__(self, p: Vec, v_max: float, a_max: float, period: float) -> None:
        for name, value in (("v_max", v_max), ("a_max", a_max), ("period", period)):
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"Smoother: {name}", value, "a positive number")
        self.w = min(
            PULSE_RESPONSE.largest_frequency, a_max / (PULSE_RESPONSE.slope * v_max)
        )
        self.v_max = v_max
        self.period = period
        self._u = np.array(p, float)
        self._x = np.zeros((4, len(p)))
        self._x[0] = self._u
        self._keep, self._take = compute_transition(self.w, period)

    @property
    def lag(self) -> float:
        """Delay in s behind a goal that moves evenly."""
        return 4.0 / self.w

    def step(
        self, goal: Vec, seconds: float | None = None, yaw: float = 0.0
    ) -> FullState:
        """Return the reference after some time.

        goal: (3,) m, during this time
        seconds: s, in whole periods; None for one period
        yaw: rad
        """
        for _ in range(1 if seconds is None else max(1, round(seconds / self.period))):
            way = np.asarray(goal) - self._u
            far = float(np.linalg.norm(way))
            most = self.v_max * self.period
            self._u = self._u + way * min(1.0, most / far if far > 0.0 else 1.0)
            self._x = self._keep @ self._x + np.outer(self._take, self._u)
        return FullState(np.concatenate([self._x.reshape(-1), [yaw, 0.0]]))


def compute_transition(w: float, h: float) -> tuple[Mat, Vec]:
    """Return F and g of x(t + h) = F x(t) + g u for (1/w d/dt + 1)^4 p = u, with u held.

        F = e^(-w h) sum_k (h (A + w I))^k / k!, k = 0..3,   g = (1, 0, 0, 0) - F (1, 0, 0, 0)

    x = (p, v, a, j). A is the companion matrix of (s + w)^4. So A + w I is nilpotent, and the sum
    is finite.

    w: 1/s
    h: s
    """
    a = np.diag(np.ones(3), 1)
    a[3] = [-(w**4), -4.0 * w**3, -6.0 * w**2, -4.0 * w]
    n = h * (a + w * np.eye(4))
    keep: Mat = math.exp(-w * h) * (np.eye(4) + n + n @ n / 2.0 + n @ n @ n / 6.0)
    first = np.array([1.0, 0.0, 0.0, 0.0])
    return keep, first - keep @ first
