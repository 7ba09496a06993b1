"""A smooth reference towards a place that jumps, for the result of an optimisation in flight."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import Record, kernel, real, rows_of, vector
from crazychoir.types import FullState, Mat, Records, Vec


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


SMOOTHER_ROW = np.dtype(
    [
        ("keep", np.float64, 16),  # F, row by row, see compute_transition
        ("take", np.float64, 4),  # g
        ("state", np.float64, 12),  # x: position, velocity, acceleration, jerk
        ("place", np.float64, 3),  # m: u, the place that runs to the goal
        ("stride", np.float64),  # m: way of this place in one period
        ("period", np.float64),  # s
    ],
    align=True,
)
"""The memory of one GoalSmoother."""


@kernel()
def smooth_row(row: Record, goal: Vec, seconds: float) -> None:
    """Move the reference of a smoother on, see GoalSmoother.

    row: one row of SMOOTHER_ROW
    goal: (3,) m, during this time
    seconds: s, in whole periods; at least one period passes
    """
    for _ in range(max(1, int(np.rint(seconds / row.period)))):
        squared = 0.0
        for c in range(3):
            way = goal[c] - row.place[c]
            squared += way * way
        share = min(1.0, row.stride / math.sqrt(squared)) if squared > 0.0 else 1.0
        for c in range(3):
            row.place[c] += share * (goal[c] - row.place[c])
            x = (row.state[c], row.state[3 + c], row.state[6 + c], row.state[9 + c])
            for k in range(4):
                moved = row.take[k] * row.place[c]
                for m in range(4):
                    moved += row.keep[4 * k + m] * x[m]
                row.state[3 * k + c] = moved


@kernel(rows_of(SMOOTHER_ROW), vector, real)
def smooth_first_row(rows: Records, goal: Vec, seconds: float) -> None:
    """Move the reference of the first smoother on: see `smooth_row`."""
    smooth_row(rows[0], goal, seconds)


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
        keep, take = compute_transition(self.w, period)
        self.rows: Records = np.zeros(1, SMOOTHER_ROW)
        """(1,) of SMOOTHER_ROW."""
        self.rows["keep"] = keep.reshape(-1)
        self.rows["take"] = take
        self.rows["place"] = p
        self.rows["state"][0, 0:3] = p
        self.rows["stride"] = v_max * period
        self.rows["period"] = period

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
        later = float(self.rows["period"][0]) if seconds is None else seconds
        smooth_first_row(self.rows, np.asarray(goal, float), later)
        return FullState(np.concatenate([self.rows["state"][0], [yaw, 0.0]]))


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
