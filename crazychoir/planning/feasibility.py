"""Feasibility: speed, acceleration, jerk, thrust, tilt and body rates of a trajectory."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import kernel, matrix, table
from crazychoir.numerics.math3d import STANDARD_GRAVITY, dot, flat_attitude, flat_rates
from crazychoir.planning.trajectory import Trajectory, sample_setpoints
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class FeasibilityCheck:
    """How closely a trajectory is checked against its limits."""

    rate: float = 200.0
    """Hz, of the checks."""
    least_checks: int = 200
    """Least number of checks."""
    tolerance: float = 1e-3
    """Share of a limit that is left for the times between two checks."""


FEASIBILITY_CHECK = FeasibilityCheck()


DEMAND_NAMES = (
    "speed",
    "acceleration",
    "jerk",
    "yaw_rate",
    "tilt",
    "thrust",
    "roll_rate",
    "pitch_rate",
    "body_yaw_rate",
)
"""Names of what a trajectory demands; the columns of `compute_demands`."""
DEMAND_UNITS = ("m/s", "m/s2", "m/s3", "rad/s", "rad", "N", "rad/s", "rad/s", "rad/s")
"""Units of DEMAND_NAMES."""
THRUST_COLUMN = DEMAND_NAMES.index("thrust")
"""Column of the thrust."""


@kernel(matrix, table)
def _fill_demands(references: Mat, out: Mat) -> None:
    """Compute the demands of each reference; the thrust in N/kg.

    references: (n, 14)
    out: (n, 9): the result, in the order of DEMAND_NAMES
    """
    for k in range(references.shape[0]):
        x = references[k]
        o = out[k]
        a = (x[6], x[7], x[8])
        j = (x[9], x[10], x[11])
        f = (a[0], a[1], a[2] + STANDARD_GRAVITY)
        thrust = math.sqrt(dot(f, f))
        o[0] = math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5])
        o[1] = math.sqrt(dot(a, a))
        o[2] = math.sqrt(dot(j, j))
        o[3] = abs(x[13])
        o[4] = math.acos(min(max(f[2] / max(thrust, 1e-9), -1.0), 1.0))
        o[5] = thrust
        w = flat_rates(f, j, flat_attitude(f, x[12]), x[12], x[13])
        for c in range(3):
            o[6 + c] = abs(w[c]) if math.isfinite(w[c]) else math.inf


def compute_demands(references: Mat, mass: float) -> Mat:
    """Return what references demand of a drone.

        f = a + g e3,  thrust = m |f|,  cos tilt = f_z / |f|
        (p, q, r): the rates at which the attitude of f turns

    The drag is not included. Rates are infinite in free fall, where any attitude is possible.

    references: (n, 14)
    mass: kg
    Returns (n, 9), columns as in DEMAND_NAMES: m/s, m/s2, m/s3, rad/s, rad, N, then |p|, |q|, |r| rad/s
    in the body frame.
    Source: Mellinger & Kumar 2011, ICRA, section III.
    """
    out = np.empty((len(references), len(DEMAND_NAMES)))
    _fill_demands(np.ascontiguousarray(references), out)
    out[:, THRUST_COLUMN] *= mass
    return out


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of what a flight may demand. Values that are not given are not limited.

    Raises ConfigError for values that are not positive, a fence with low not below high, or a
    thrust below the weight.
    """

    v_max: float = math.inf
    """m/s."""
    a_max: float = math.inf
    """m/s2."""
    j_max: float = math.inf
    """m/s3."""
    yaw_rate_max: float = math.inf
    """rad/s."""
    tilt_max: float = math.inf
    """rad."""
    thrust_max: float = math.inf
    """N, of all motors."""
    rate_max: Sequence[float] = (math.inf, math.inf, math.inf)
    """rad/s, body, about x, y, z."""
    mass: float = 1.0
    """kg, for the thrust."""
    low: Sequence[float] = (-math.inf, -math.inf, -math.inf)
    """m, world: lower corner of the fence."""
    high: Sequence[float] = (math.inf, math.inf, math.inf)
    """m, world: upper corner of the fence."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = np.asarray(getattr(self, field.name), dtype=float)
            if value.shape not in ((), (3,)) or np.isnan(value).any():
                raise ConfigError(
                    f"Limits: {field.name}", value.tolist(), "a number, or three a list"
                )
            if field.name not in ("low", "high") and value.min() <= 0.0:
                raise ConfigError(
                    f"Limits: {field.name}", value.tolist(), "positive numbers"
                )
        if not np.all(np.less(self.low, self.high)):
            raise ConfigError(
                "Limits: low", list(self.low), f"below high = {list(self.high)}, each"
            )
        if self.thrust_max <= self.mass * STANDARD_GRAVITY:
            weight = self.mass * STANDARD_GRAVITY
            raise ConfigError(
                "Limits: thrust_max",
                self.thrust_max,
                f"more than the weight, {weight:.3g} N",
            )

    @property
    def largest(self) -> Vec:
        """(9,) in the order of DEMAND_NAMES."""
        scalars = (
            self.v_max,
            self.a_max,
            self.j_max,
            self.yaw_rate_max,
            self.tilt_max,
            self.thrust_max,
        )
        return np.array([*scalars, *self.rate_max])

    def check_timed(self, where: str) -> None:
        """Raise ConfigError unless speed and acceleration are limited.

        Without these limits it is unknown how fast to fly.
        """
        for name in ("v_max", "a_max"):
            if math.isinf(getattr(self, name)):
                raise ConfigError(
                    f"{where}: limits: {name}",
                    math.inf,
                    "a finite number, since no times are given",
                )

    def check_places(self, places: Mat, where: str) -> None:
        """Raise ConfigError for the first of places (n, 3) m that is outside of the fence."""
        inside = np.all(
            (places >= np.asarray(self.low) - 1e-9)
            & (places <= np.asarray(self.high) + 1e-9),
            axis=1,
        )
        if not inside.all():
            k = int(np.argmin(inside))
            fence = f"places within the fence, {list(self.low)} to {list(self.high)} m"
            raise ConfigError(f"{where}[{k}]", places[k].round(3).tolist(), fence)


def sample_references(trajectory: Trajectory) -> tuple[Vec, Mat]:
    """Return times (n,) and references (n, 14) at which a trajectory is checked.

    They are 200 a second, at least 200.
    """
    return sample_setpoints(
        trajectory,
        max(
            FEASIBILITY_CHECK.rate, FEASIBILITY_CHECK.least_checks / trajectory.duration
        ),
    )


def compute_peaks(trajectory: Trajectory, mass: float = 1.0) -> dict[str, float]:
    """Return the largest value of each of DEMAND_NAMES, by name.

    mass: kg
    """
    _, x = sample_references(trajectory)
    return dict(
        zip(DEMAND_NAMES, compute_demands(x, mass).max(axis=0).tolist(), strict=True)
    )


def check_limits(trajectory: Trajectory, limits: Limits) -> None:
    """Raise ConfigError, with when, where and by how much, if the trajectory leaves the limits."""
    check_references(*sample_references(trajectory), limits)


def check_references(t: Vec, x: Mat, limits: Limits) -> None:
    """Apply `check_limits` to references x (n, 14) at the times t (n,) s."""
    if not np.isfinite(x).all():
        k = int(np.argmin(np.isfinite(x).all(axis=1)))
        raise ConfigError(
            f"trajectory at {t[k]:.2f} s", x[k].tolist(), "finite numbers"
        )
    limits.check_places(x[:, 0:3], "trajectory: set-point")
    asked = compute_demands(x, limits.mass)
    largest = limits.largest
    over = asked > largest * (1.0 + FEASIBILITY_CHECK.tolerance)
    if over.any():
        k = int(np.argmax(over.any(axis=1)))
        n = int(np.argmax(over[k]))
        most = asked[:, n].max()
        when = t[int(np.argmax(asked[:, n]))]
        found = f"{asked[k, n]:.3g} {DEMAND_UNITS[n]}, and {most:.3g} {DEMAND_UNITS[n]} at {when:.2f} s"
        allowed = f"at most {largest[n]:.3g} {DEMAND_UNITS[n]}"
        raise ConfigError(
            f"trajectory at {t[k]:.2f} s: {DEMAND_NAMES[n]}",
            found,
            allowed,
            "Give it more time.",
        )


def is_within_limits(trajectory: Trajectory, limits: Limits) -> bool:
    """Return whether the trajectory passes the `check_limits`."""
    try:
        check_limits(trajectory, limits)
    except ConfigError:
        return False
    return True
