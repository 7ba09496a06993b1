"""Limits of references: those of [flight] apply to everything that guidance wants."""

import math

import numpy as np

from crazychoir.config.tables import FlightTable
from crazychoir.control.gains import Gains
from crazychoir.numerics.kernels import kernel, memory, real, vector
from crazychoir.numerics.math3d import Triple, clip, dot
from crazychoir.types import Acceleration, FullState, State, Vec


@kernel()
def _compute_shortening(a: Triple, limit: float) -> float:
    """Return the factor, at most 1, that shortens the vector a to the length `limit`."""
    length = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    return limit / length if length > limit else 1.0


@kernel(vector, vector, vector, vector, memory)
def cut_full_state(x: Vec, ref: Vec, gains: Vec, limits: Vec, out: Vec) -> bool:
    """Apply the law of ReferenceLimits to a full-state reference.

    x: (13,): state of the drone
    ref: (14,): reference, as FullState.flat
    gains: (13,), as Gains.position
    limits: (4,): v_max, a_max, largest jerk, largest yaw rate
    out: (14,): the result
    Returns False if the reference is within the limits; out is then not to be used.
    """
    v_max = limits[0]
    a_max = limits[1]
    j_max = limits[2]
    w_max = limits[3]
    speed = _compute_shortening((ref[3], ref[4], ref[5]), v_max)
    lead = _compute_shortening((ref[6], ref[7], ref[8]), a_max) if speed == 1.0 else 0.0
    e = (ref[0] - x[0], ref[1] - x[1], ref[2] - x[2])
    far = _compute_shortening(
        (
            gains[0] / gains[3] * e[0],
            gains[1] / gains[4] * e[1],
            gains[2] / gains[5] * e[2],
        ),
        v_max,
    )
    pull = (
        gains[0] * far * e[0] + gains[3] * (speed * ref[3] - x[3]),
        gains[1] * far * e[1] + gains[4] * (speed * ref[4] - x[4]),
        gains[2] * far * e[2] + gains[5] * (speed * ref[5] - x[5]),
    )
    hard = _compute_shortening(pull, a_max)
    turn = _compute_shortening((ref[9], ref[10], ref[11]), j_max)
    for c in range(3):
        out[c] = x[c] + hard * far * e[c]
        out[3 + c] = x[3 + c] + hard * (speed * ref[3 + c] - x[3 + c])
        out[6 + c] = lead * ref[6 + c]
        out[9 + c] = turn * ref[9 + c] if lead == 1.0 else 0.0
    out[12], out[13] = ref[12], clip(ref[13], -w_max, w_max)
    return min(speed, lead, far, hard, turn) < 1.0 or abs(ref[13]) > w_max


@kernel()
def _cut_acceleration(x: Vec, wanted: Vec, limits: Vec, kv: float, out: Vec) -> None:
    """Apply the law of ReferenceLimits to a wanted acceleration.

    x: (13,): state of the drone
    wanted: (3,) m/s2, world
    limits: (4,), as for cut_full_state
    kv: 1/s
    out: (3,) m/s2: the result
    """
    v_max = limits[0]
    a_max = limits[1]
    hard = _compute_shortening((wanted[0], wanted[1], wanted[2]), a_max)
    a = (hard * wanted[0], hard * wanted[1], hard * wanted[2])
    v = (x[3], x[4], x[5])
    speed = math.sqrt(dot(v, v))
    excess = (
        max(dot(a, v) / speed - kv * (v_max - speed), 0.0) / speed
        if speed > 0.0
        else 0.0
    )
    a = (a[0] - excess * v[0], a[1] - excess * v[1], a[2] - excess * v[2])
    hard = _compute_shortening(a, a_max)
    for c in range(3):
        out[c] = hard * a[c]


@kernel()
def limit_acceleration(x: Vec, wanted: Vec, limits: Vec, kv: float, out: Vec) -> None:
    """Write the part of a wanted acceleration that the limits allow.

    x: (13,): state of the drone
    wanted: (3,) m/s2, world
    limits: (4,), as for cut_full_state
    kv: 1/s
    out: (3,) m/s2: the result
    """
    squared = wanted[0] * wanted[0] + wanted[1] * wanted[1] + wanted[2] * wanted[2]
    room = kv * (limits[0] - math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5]))
    if squared <= limits[1] * limits[1] and room > 0.0 and squared <= room * room:
        for c in range(3):
            out[c] = wanted[c]
        return
    _cut_acceleration(x, wanted, limits, kv, out)


@kernel(vector, vector, vector, real, memory)
def _limit_one_acceleration(
    x: Vec, wanted: Vec, limits: Vec, kv: float, out: Vec
) -> None:
    """Apply `limit_acceleration`; the arguments are the same."""
    limit_acceleration(x, wanted, limits, kv, out)


class ReferenceLimits:
    """Cuts a reference to v_max and a_max of [flight], and to the limits that follow from them.

        Acceleration:  a . v / |v| <= kv (v_max - |v|),  |a| <= a_max
        FullState:     |v_d| <= v_max (a cut velocity goes without acceleration),
                       |a_d| <= a_max (a cut acceleration goes without jerk),
                       |(kp / kv) (p_d - p)| <= v_max,  |kp (p_d - p) + kv (v_d - v)| <= a_max,
                       |j_d| <= kr a_max,  |yaw_d'| <= kr_yaw (1 rad)

    A reference within the limits stays as it is, to the bit. The drone flies to a far place at
    v_max and follows a reference that runs away at 2 v_max. No reference asks for more than
    2 a_max, however its place, velocity and acceleration jump.

    Jerk and yaw rate are fed forward to the body rates. If nothing else in the reference agrees
    with them, they tilt the drone until its attitude control outweighs them: by at most a_max m/s2
    more, and 1 rad of yaw.

    flight: speed_limit and acceleration_limit are v_max and a_max
    gains: of the controller that flies FullStates: kp 1/s2, kv 1/s, kr 1/s
    """

    def __init__(self, flight: FlightTable, gains: Gains) -> None:
        self.a_max = flight.acceleration_limit
        self.gains = gains.position
        """(13,), as Gains.position."""
        self.least_velocity_gain = min(gains.kv)
        """1/s, the least kv of the axes."""
        roll, pitch, yaw = gains.kr
        self.figures = np.array(
            [flight.speed_limit, self.a_max, min(roll, pitch) * self.a_max, yaw * 1.0]
        )
        """(4,): v_max m/s, a_max m/s2, largest jerk m/s3, largest yaw rate rad/s."""

    def acceleration(
        self, reference: Acceleration, state: State
    ) -> Acceleration | None:
        """Return the part of an acceleration reference that the limits allow.

        state: of the drone
        Returns None for a reference of another shape, or with numbers that are not finite.
        """
        wanted = np.asarray(reference.a, dtype=float)
        if wanted.shape != (3,):
            return None
        if not math.isfinite(sum(wanted.tolist()) + reference.yaw):
            return None
        out = np.empty(3)
        _limit_one_acceleration(
            state.flat, wanted, self.figures, self.least_velocity_gain, out
        )
        return Acceleration(out, reference.yaw)

    def full_state(self, reference: FullState, state: State) -> FullState:
        """Return a reference that pulls the drone in `state` no harder than the limits allow."""
        out = np.empty(14)
        is_cut = cut_full_state(
            state.flat, reference.flat, self.gains, self.figures, out
        )
        return FullState(out) if is_cut else reference
