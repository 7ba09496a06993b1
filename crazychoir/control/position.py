"""Position control by differential flatness: from reference and state to thrust and attitude."""

import math
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np

from crazychoir.control.gains import (
    FORMATION_GAINS,
    STANDARD_GAINS,
    Gains,
    TunedStrategy,
)
from crazychoir.control.trim import TRIM_ROW, Trim, learn_trim
from crazychoir.numerics.kernels import Records, kernel, memory, real, rows_of, vector
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    Triple,
    clip,
    dot,
    flat_attitude,
    flat_rates,
    is_finite,
    rotation_columns,
)
from crazychoir.platforms import PAPER_PLATFORM, Platform
from crazychoir.types import State, Vec


class FlatnessLayout(NamedTuple):
    """Sizes and places in the arrays of the kernels of flatness control."""

    gain_count: int = 13
    """Count of numbers in Gains.position, before those of Platform.flat in the figures of the
    kernels.
    """
    desired_size: int = 13
    """Size of the result of desired: thrust N; x_b, y_b, z_b of R_d (3 each); rate feed-forward
    w_d rad/s in the axes of R_d (3).
    """
    free_index: int = desired_size
    """Index where the kernels write whether F was not cut."""
    acceleration_start: int = desired_size + 1
    """First index where the kernels write the acceleration of F."""


FLATNESS_LAYOUT = FlatnessLayout()


class FlatnessLimits(NamedTuple):
    """Limits of the force, the feed-forward and the time step in flatness control."""

    least_lift: float = 0.2 * STANDARD_GRAVITY
    """Least upward desired acceleration, m/s2.

    The desired thrust always points up, far from F = 0 and from z_b parallel to x_c.
    """
    longest_gap: float = 0.1
    """Longest time in s between two desired attitudes that still define a rate."""
    height_share: float = 0.9
    """Largest upward share of the desired force: 26 degrees of tilt remain in the fastest climb.
    """
    largest_delay_rate: float = 1.0
    """Largest feed-forward in rad/s for the delay of the rates: a jump must not shake the drone.
    """
    acceleration_share: float = 0.95
    """Share of the thrust for the desired acceleration; the rest is left to the attitude."""


FLATNESS_LIMITS = FlatnessLimits()


class PositionKind(IntEnum):
    """The laws of position control that ship."""

    REFERENCE = 0
    """FlatnessPositionCtrl."""
    ACCELERATION = 1
    """FlatnessAccelerationCtrl."""


POSITION_ROW = np.dtype(
    [
        ("kind", np.int64),  # PositionKind
        ("figures", np.float64, 22),  # Gains.position, then Platform.flat
        ("memory", np.float64, 13),  # of the law from call to call
        ("called_at", np.float64),  # s, time of the newest state that the law used
        ("out", np.float64, 17),  # result, see FlatnessLayout
    ],
    align=True,
)
"""Record of the position control of a drone."""


class PositionControl(Protocol):
    """The strategy that turns a reference into a thrust and an attitude."""

    gains: Gains
    """The gains; new ones act from the next call on."""

    @property
    def acceleration(self) -> Vec:
        """The acceleration that the last call of `desired` asks for: (3,) m/s2, world, read-only."""
        ...

    def desired(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the desired (13,): thrust N, columns of R_d, rate feed-forward.

        The array belongs to the strategy and is valid until its next call.

        state: of the drone
        reference: (14,), as FullState.flat
        now: s
        Returns None if state or reference is not finite.
        """
        ...


@kernel()
def _compute_drag(q: Vec, v: Triple, platform: Vec) -> Triple:
    """Return R A R^T v / m, m/s2 world: the rotor drag that the thrust must balance."""
    bx, by, bz = rotation_columns((q[6], q[7], q[8], q[9]))
    x = platform[1] * dot(bx, v)
    y = platform[2] * dot(by, v)
    z = platform[3] * dot(bz, v)
    m = platform[0]
    return (
        (x * bx[0] + y * by[0] + z * bz[0]) / m,
        (x * bx[1] + y * by[1] + z * bz[1]) / m,
        (x * bx[2] + y * by[2] + z * bz[2]) / m,
    )


@kernel()
def _limit_force(f: Triple, max_tilt: float, most: float) -> Triple:
    """Return f with enough lift, a tilt of at most max_tilt and a length of at most `most`.

    Height comes first.
    """
    z = clip(f[2], FLATNESS_LIMITS.least_lift, FLATNESS_LIMITS.height_share * most)
    side = math.sqrt(f[0] * f[0] + f[1] * f[1])
    room = min(z * math.tan(max_tilt), math.sqrt(max(most * most - z * z, 0.0)))
    s = room / side if side > room else 1.0
    return (f[0] * s, f[1] * s, z)


@kernel()
def _compute_wish(x: Vec, ref: Vec, gains: Vec, follow: float, c: int) -> float:
    """Return the wanted acceleration along axis c: a_d - follow (kp (p - p_d) + kv (v - v_d))."""
    pull: float = gains[c] * (x[c] - ref[c]) + gains[3 + c] * (x[3 + c] - ref[3 + c])
    return float(ref[6 + c]) - follow * pull


@kernel(vector, vector, vector, vector, real, memory)
def _compute_flatness(
    x: Vec, ref: Vec, figures: Vec, trim: Vec, follow: float, out: Vec
) -> bool:
    """Apply the basic law of flatness control.

    follow = 1: FlatnessPositionCtrl without its delays
    follow = 0: FlatnessAccelerationCtrl without its lead

    x: (13,): state
    ref: (14,): reference
    figures: Gains.position, then Platform.flat
    trim: (3,)
    follow: 1 or 0
    out: (17,): desired, 1 where F was not cut, and the acceleration m/s2 that is left of the wish
    Returns False if x or ref is not finite.
    """
    if not (is_finite(x) and is_finite(ref)):
        return False
    gains = figures[: FLATNESS_LAYOUT.gain_count]
    platform = figures[FLATNESS_LAYOUT.gain_count :]
    v = (ref[3], ref[4], ref[5]) if follow > 0.0 else (x[3], x[4], x[5])
    drag = _compute_drag(x, v, platform)
    rise = _compute_drag(x, (ref[6], ref[7], ref[8]), platform)
    bx, _, bz = rotation_columns((x[6], x[7], x[8], x[9]))
    n = math.sqrt(max(bx[0] * bx[0] + bx[1] * bx[1], 1e-12))
    dx = (bx[0] * trim[1] - bx[1] * trim[2]) / n
    dy = (bx[1] * trim[1] + bx[0] * trim[2]) / n
    ax = _compute_wish(x, ref, gains, follow, 0)
    ay = _compute_wish(x, ref, gains, follow, 1)
    az = _compute_wish(x, ref, gains, follow, 2)
    rest = (drag[0] + dx, drag[1] + dy, drag[2] + STANDARD_GRAVITY)
    wish = (ax + rest[0], ay + rest[1], az + rest[2])
    f = _limit_force(
        wish, gains[6], FLATNESS_LIMITS.acceleration_share * platform[4] / platform[0]
    )
    axes = flat_attitude(f, ref[12])
    free = 1.0 if f == wish else 0.0
    jerk = (
        free * (ref[9] + rise[0]),
        free * (ref[10] + rise[1]),
        free * (ref[11] + rise[2]),
    )
    w = flat_rates(f, jerk, axes, ref[12], ref[13])
    thrust = (1.0 + trim[0]) * platform[0] * (dot(f, bz) + gains[10] * dot(jerk, bz))
    out[0] = clip(thrust, 0.0, platform[4])
    for c in range(3):
        out[1 + c] = axes[0][c]
        out[4 + c] = axes[1][c]
        out[7 + c] = axes[2][c]
        out[10 + c] = w[c]
        out[14 + c] = f[c] - rest[c]
    out[13] = free if thrust < platform[4] else 0.0
    return True


@kernel(vector, vector, vector, vector, memory, real, memory)
def _track_reference(
    x: Vec, ref: Vec, figures: Vec, trim: Vec, mem: Vec, h: float, out: Vec
) -> bool:
    """Apply the law of FlatnessPositionCtrl, h s after the last call.

    mem: (3,): w_r of the last call, NaN before the first
    out: (17,), as in `_compute_flatness`
    Returns False if x or ref is not finite.
    """
    if not _compute_flatness(x, ref, figures, trim, 1.0, out):
        return False
    f = (ref[6], ref[7], max(ref[8] + STANDARD_GRAVITY, FLATNESS_LIMITS.least_lift))
    w = flat_rates(
        f, (ref[9], ref[10], ref[11]), flat_attitude(f, ref[12]), ref[12], ref[13]
    )
    early = (
        figures[9] / h
        if 0.0 < h < FLATNESS_LIMITS.longest_gap and out[13] > 0.0
        else 0.0
    )
    for c in range(3):
        more = early * (w[c] - mem[c])
        out[10 + c] += (
            clip(
                more,
                -FLATNESS_LIMITS.largest_delay_rate,
                FLATNESS_LIMITS.largest_delay_rate,
            )
            if math.isfinite(more)
            else 0.0
        )
        mem[c] = w[c]
    return True


@kernel(vector, vector, vector, vector, memory, real, memory)
def _track_acceleration(
    x: Vec, ref: Vec, figures: Vec, trim: Vec, mem: Vec, h: float, desired: Vec
) -> bool:
    """Apply `_compute_flatness` without follow, with the rate feed-forward of roll and pitch.

    The feed-forward is `lead` times the low-passed rate w_f of R_d.

        owed += turn of R_d - w_f h,   w_f = owed (1 - exp(-cutoff h)) / h

    This is w_f' = cutoff (w(R_d) - w_f) for a steady h. For any h, the sum of the feed-forward
    equals the turns of R_d. Otherwise noise and late ticks would leave a drift of the attitude.

    mem: (13,): columns of the last R_d, w_f since then (2), owed rad (2)
    h: s since the last measurement. If 0, nothing new was measured, and w_f goes on. After a gap,
        or from NaN, w_f starts anew.
    desired: (17,), as out of `_compute_flatness`
    Returns False if x or ref is not finite.
    """
    if not _compute_flatness(x, ref, figures, trim, 0.0, desired):
        return False
    x_d = (desired[1], desired[2], desired[3])
    y_d = (desired[4], desired[5], desired[6])
    z_d = (desired[7], desired[8], desired[9])
    a = (mem[0], mem[1], mem[2])
    b = (mem[3], mem[4], mem[5])
    c = (mem[6], mem[7], mem[8])
    turn = (0.5 * (dot(c, y_d) - dot(b, z_d)), 0.5 * (dot(a, z_d) - dot(c, x_d)))
    for n in range(2):
        if h > 0.0:
            owed = mem[11 + n] + turn[n] - mem[9 + n] * h
            mem[11 + n] = (
                owed if h < FLATNESS_LIMITS.longest_gap and math.isfinite(owed) else 0.0
            )
            mem[9 + n] = mem[11 + n] * (1.0 - math.exp(-figures[8] * h)) / h
        desired[10 + n] = figures[7] * mem[9 + n]
    if h > 0.0:
        for k in range(9):
            mem[k] = desired[1 + k]
    return True


@kernel()
def compute_desired(
    position: Any, trim: Any, x: Vec, age: float, ref: Vec, now: float
) -> bool:
    """Write the result of a law of position control into its record.

    position: record of POSITION_ROW
    trim: record of TRIM_ROW
    x: (13,): state
    age: s, of the state
    ref: (14,): reference
    now: s
    Returns False, and changes nothing, if x or ref is not finite.
    """
    figures = position.figures[:]
    mem = position.memory[:]
    out = position.out[:]
    if position.kind == PositionKind.ACCELERATION:
        measured = max(now - age, position.called_at)
        h = measured - position.called_at
        if not _track_acceleration(x, ref, figures, trim.sure[:], mem, h, out):
            return False
        position.called_at = measured
        return True
    h = now - position.called_at
    if not _track_reference(x, ref, figures, trim.flat[:], mem, h, out):
        return False
    position.called_at = now
    if 0.0 < h < FLATNESS_LIMITS.longest_gap and out[FLATNESS_LAYOUT.free_index] > 0.0:
        learn_trim(trim, x, ref, figures[11:13], h)
    return True


@kernel(rows_of(POSITION_ROW), rows_of(TRIM_ROW), vector, real, vector, real)
def _compute_desired(
    rows: Records, trims: Records, x: Vec, age: float, ref: Vec, now: float
) -> bool:
    """Apply `compute_desired` to the first record."""
    return bool(compute_desired(rows[0], trims[0], x, age, ref, now))


class FlatnessPositionCtrl(TunedStrategy):
    """Tracks a flat trajectory: position, velocity, acceleration, jerk and yaw.

        F/m = g e3 + a_d - Kp (p - p_d) - Kv (v - v_d) + (1/m) R A R^T v_d + Rz d
        thrust = (1 + s) (F + T_f F') . R e3,   F'/m = j_d + (1/m) R A R^T a_d
        R_d: z_b along F, heading yaw_d;   w_d = w(F, F') + T_w w_r'

    w(F, F'): the rate at which R_d turns when F changes by F'
    w_r: that rate for the reference alone, differentiated from call to call
    T_f, T_w: thrust_delay and rate_delay of the gains: the feed-forward is early by as much as the
        drone is late
    s, d: of `trim`, which learns from each call while F is not cut

    F is cut to the largest tilt and thrust of the platform; the height takes precedence. While F is
    cut, w_d is computed without the jerk.
    rows: (1,) of POSITION_ROW, where figures and memory are kept; None for an array of its own
    Source: Mellinger & Kumar 2011; rotor drag as in Kai et al. 2017 and Faessler et al. 2018.
    """

    kind = PositionKind.REFERENCE
    first_memory = math.nan
    """Memory of the law before its first call."""

    def __init__(
        self,
        gains: Gains = STANDARD_GAINS,
        platform: Platform = PAPER_PLATFORM,
        trim: Trim | None = None,
        rows: Records | None = None,
    ) -> None:
        self._trim = Trim() if trim is None else trim
        self.platform = platform
        super().__init__(gains, np.zeros(1, POSITION_ROW) if rows is None else rows)
        self.rows["kind"] = self.kind
        self.rows["memory"] = self.first_memory
        self.rows["called_at"] = -math.inf
        self.rows["out"] = 0.0
        out = self.rows["out"][0]
        self._desired: Vec = out[: FLATNESS_LAYOUT.desired_size]
        self._acceleration: Vec = out[FLATNESS_LAYOUT.acceleration_start :]

    def _tuned(self, gains: Gains) -> Vec:
        return np.array([*gains.position, *self.platform.flat])

    @property
    def trim(self) -> Trim:
        """The trim of the drone."""
        return self._trim

    @property
    def acceleration(self) -> Vec:
        """The acceleration of the last call: (3,) m/s2, world.

        It is F/m after its limits, without gravity, drag and trim.
        """
        a = self._acceleration.copy()
        a.setflags(False)  # type: ignore[call-arg]  # faster by position than by name, in each tick
        return a

    def desired(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return thrust, attitude and rate feed-forward (13,).

        Returns None if state or reference is not finite.
        """
        is_usable = _compute_desired(
            self.rows, self._trim.rows, state.flat, state.age, reference, now
        )
        return self._desired if is_usable else None


class FlatnessAccelerationCtrl(FlatnessPositionCtrl):
    """Tracks an acceleration, the reference of a double-integrator law.

        F/m = g e3 + a_d + (1/m) R A R^T v + Rz d
        w_d = lead * w_f in roll and pitch,  w_f' = cutoff (w(R_d) - w_f)

    Position and velocity are left to that law. w(R_d) is the rate at which R_d turns.

    lead, cutoff: of the gains. Lead allows a faster law with the same rate loop, see
        `make_guidance_loop`.
    s, d: of `trim`, without the part that may be noise. The trim learns nothing here, because there
        is no wanted place.

    The other symbols are as in FlatnessPositionCtrl.
    """

    kind = PositionKind.ACCELERATION
    first_memory = 0.0

    def __init__(
        self,
        gains: Gains = FORMATION_GAINS,
        platform: Platform = PAPER_PLATFORM,
        trim: Trim | None = None,
        rows: Records | None = None,
    ) -> None:
        super().__init__(gains, platform, trim, rows)
