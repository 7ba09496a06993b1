"""Can it be flown? Speed, acceleration, jerk, thrust, tilt and body rates of a trajectory, against limits."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import kernel, matrix, table
from crazychoir.numerics.math3d import GRAVITY, dot, flat_attitude, flat_rates
from crazychoir.planning.trajectory import Trajectory, setpoints
from crazychoir.types import Mat, Vec

RATE = 200.0  # Hz, of the instants that are looked at
LEAST = 200  # instants, of a short trajectory
TOLERANCE = 1e-3  # of a limit: what lies between the instants
DEMANDS = (
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
UNITS = ("m/s", "m/s2", "m/s3", "rad/s", "rad", "N", "rad/s", "rad/s", "rad/s")
THRUST = DEMANDS.index("thrust")


@kernel(matrix, table)
def _demands(references: Mat, out: Mat) -> None:
    """What each reference (14,) asks for, into a row of out (9,) in the order of DEMANDS; the thrust in N/kg."""
    for k in range(references.shape[0]):
        x = references[k]
        o = out[k]
        a = (x[6], x[7], x[8])
        j = (x[9], x[10], x[11])
        f = (a[0], a[1], a[2] + GRAVITY)
        thrust = math.sqrt(dot(f, f))
        o[0] = math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5])
        o[1], o[2], o[3] = math.sqrt(dot(a, a)), math.sqrt(dot(j, j)), abs(x[13])
        o[4] = math.acos(min(max(f[2] / max(thrust, 1e-9), -1.0), 1.0))
        o[5] = thrust
        w = flat_rates(f, j, flat_attitude(f, x[12]), x[12], x[13])
        for c in range(3):
            o[6 + c] = abs(w[c]) if math.isfinite(w[c]) else math.inf


def demands(references: Mat, mass: float) -> Mat:
    """What references (n, 14) ask of a drone of `mass` kg: (n, 9), columns as in DEMANDS.

        f = a + g e3,  thrust = m |f|,  cos tilt = f_z / |f|,  (p, q, r): the rates at which the attitude of f turns

    m/s, m/s2, m/s3, rad/s, rad, N, then |p|, |q|, |r| rad/s in the body frame; without drag.
    Infinite rates: free fall, whose attitude is any.  Source: Mellinger & Kumar 2011, ICRA, section III.
    """
    out = np.empty((len(references), len(DEMANDS)))
    _demands(np.ascontiguousarray(references), out)
    out[:, THRUST] *= mass
    return out


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a flight may ask for; what is not given is not limited.

    v_max: m/s;  a_max: m/s2;  j_max: m/s3;  yaw_rate_max: rad/s;  tilt_max: rad;  thrust_max: N, of all motors;
    rate_max: rad/s, body, about x, y, z;  mass: kg, for the thrust;  low, high: m world, the corners of the fence.
    """

    v_max: float = math.inf
    a_max: float = math.inf
    j_max: float = math.inf
    yaw_rate_max: float = math.inf
    tilt_max: float = math.inf
    thrust_max: float = math.inf
    rate_max: Sequence[float] = (math.inf, math.inf, math.inf)
    mass: float = 1.0
    low: Sequence[float] = (-math.inf, -math.inf, -math.inf)
    high: Sequence[float] = (math.inf, math.inf, math.inf)

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
        if self.thrust_max <= self.mass * GRAVITY:
            weight = self.mass * GRAVITY
            raise ConfigError(
                "Limits: thrust_max",
                self.thrust_max,
                f"more than the weight, {weight:.3g} N",
            )

    @property
    def largest(self) -> Vec:
        """(9,) in the order of DEMANDS."""
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
        """Raise a ConfigError unless speed and acceleration are limited: without, nothing says how fast to fly."""
        for name in ("v_max", "a_max"):
            if math.isinf(getattr(self, name)):
                raise ConfigError(
                    f"{where}: limits: {name}",
                    math.inf,
                    "a finite number, since no times are given",
                )

    def check_places(self, places: Mat, where: str) -> None:
        """Raise a ConfigError that names the first of places (n, 3) m outside of the fence."""
        inside = np.all(
            (places >= np.asarray(self.low) - 1e-9)
            & (places <= np.asarray(self.high) + 1e-9),
            axis=1,
        )
        if not inside.all():
            k = int(np.argmin(inside))
            fence = f"places within the fence, {list(self.low)} to {list(self.high)} m"
            raise ConfigError(f"{where}[{k}]", places[k].round(3).tolist(), fence)


def references(trajectory: Trajectory) -> tuple[Vec, Mat]:
    """Times (n,) and references (n, 14) at which a trajectory is judged: 200 a second, at least 200."""
    return setpoints(trajectory, max(RATE, LEAST / trajectory.duration))


def peaks(trajectory: Trajectory, mass: float = 1.0) -> dict[str, float]:
    """The largest value of each of DEMANDS on the way, by name; mass: kg."""
    _, x = references(trajectory)
    return dict(zip(DEMANDS, demands(x, mass).max(axis=0).tolist(), strict=True))


def check(trajectory: Trajectory, limits: Limits) -> None:
    """Raise a ConfigError that says when, where and by how much the trajectory first leaves the limits."""
    check_references(*references(trajectory), limits)


def check_references(t: Vec, x: Mat, limits: Limits) -> None:
    """`check` for references x (n, 14) at the times t (n,) s."""
    if not np.isfinite(x).all():
        k = int(np.argmin(np.isfinite(x).all(axis=1)))
        raise ConfigError(
            f"trajectory at {t[k]:.2f} s", x[k].tolist(), "finite numbers"
        )
    limits.check_places(x[:, 0:3], "trajectory: set-point")
    asked = demands(x, limits.mass)
    largest = limits.largest
    over = asked > largest * (1.0 + TOLERANCE)
    if over.any():
        k = int(np.argmax(over.any(axis=1)))
        n = int(np.argmax(over[k]))
        most = asked[:, n].max()
        when = t[int(np.argmax(asked[:, n]))]
        found = (
            f"{asked[k, n]:.3g} {UNITS[n]}, and {most:.3g} {UNITS[n]} at {when:.2f} s"
        )
        allowed = f"at most {largest[n]:.3g} {UNITS[n]}"
        raise ConfigError(
            f"trajectory at {t[k]:.2f} s: {DEMANDS[n]}",
            found,
            allowed,
            "Give it more time.",
        )


def keeps(trajectory: Trajectory, limits: Limits) -> bool:
    """Whether the trajectory passes the `check`."""
    try:
        check(trajectory, limits)
    except ConfigError:
        return False
    return True
