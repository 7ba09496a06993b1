"""The half space of accelerations that keeps one drone clear of another one."""

import math
from enum import IntEnum

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.safety.airspace.distances import BRAKING_MODEL, COLLISION_DISTANCES
from crazychoir.safety.airspace.motion import (
    PlaceAndVelocity,
    compute_norm,
    move_late,
    scale_difference,
)
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.collision.barrier import (
    compute_barrier_acceleration,
    compute_yield_share,
)
from crazychoir.safety.collision.cells import compute_cell_acceleration
from crazychoir.types import Records

LEAST_AXIS_DISTANCE = 0.05  # m
SPARE_SHARE = 1e-9
"""Share of a bound that is more than its rounding."""

Moves = tuple[Triple, Triple, Triple, Triple]
"""Predicted place m and velocity m/s of a drone, then of another one."""


class OtherKind(IntEnum):
    """How another drone counts for the collision filter."""

    IGNORED = 0
    """It is too far away, or not heard while this drone lands."""
    COUNTS = 1
    """It has a half space."""
    UNHEARD = 2
    """It may be near and is not heard: this drone must brake for it besides."""


@kernel()
def predict_other(row: Records, other: Records, age: float) -> PlaceAndVelocity:
    """Return the predicted place m and velocity m/s of another drone.

    row: one row of AVOID_ROW
    other: one row of MOTION_ROW
    age: s, of the other's state
    """
    return move_late(
        (other.place[0], other.place[1], other.place[2]),
        (other.velocity[0], other.velocity[1], other.velocity[2]),
        (other.acceleration[0], other.acceleration[1], other.acceleration[2]),
        min(age, NEIGHBOUR_AGES.usable) + row.delay,
        BRAKING_MODEL.command_time,
    )


@kernel()
def may_have_risen(row: Records, age: float, stands: bool) -> bool:
    """Return whether another drone may be anywhere above its last known place on the floor.

    It was not heard for so long that it may have taken off since. This drone does not land.

    row: one row of AVOID_ROW
    age: s, of the other's state
    stands: whether the other stood on the floor then
    """
    is_silent = NEIGHBOUR_AGES.silent <= age < NEIGHBOUR_AGES.gone
    return bool(stands and is_silent and row.lands == 0)


@kernel()
def find_judged_scale(row: Records, age: float, stands: bool) -> Triple:
    """Return the scale of the distance by which another drone is judged, see judge_other.

    Arguments as in may_have_risen.
    """
    is_anywhere_above = may_have_risen(row, age, stands)
    return row.scale[0], row.scale[1], 0.0 if is_anywhere_above else row.scale[2]


@kernel()
def judge_other(row: Records, d: float, age: float, stands: bool) -> OtherKind:
    """Return whether another drone counts, as an OtherKind.

    row: one row of AVOID_ROW
    d: m, distance of the predicted places, scaled by find_judged_scale
    age: s, of the other's state
    stands: whether the other stands on the floor
    """
    assumed = min(age, BRAKING_MODEL.silent_flight_time)
    if d > row.range + 2.0 * row.v_max * assumed:
        return OtherKind.IGNORED
    if age <= NEIGHBOUR_AGES.usable or stands:
        return OtherKind.COUNTS
    flown = row.v_max * (assumed - NEIGHBOUR_AGES.usable)
    if row.lands != 0 or d > row.width + flown + row.silent_gap:
        return OtherKind.IGNORED
    return OtherKind.UNHEARD


@kernel()
def keep_off_axis(r: Triple) -> Triple:
    """Return a relative place beside a vertical line, m, at least LEAST_AXIS_DISTANCE from it.

    On the line the direction away from it would be undefined: it is x there.

    r: m, relative place; r[2] = 0
    """
    d = compute_norm(r)
    if d < 1e-3:
        return LEAST_AXIS_DISTANCE, 0.0, 0.0
    longer = max(LEAST_AXIS_DISTANCE / d, 1.0)
    return r[0] * longer, r[1] * longer, 0.0


@kernel()
def compute_half_space(
    row: Records,
    other: Records,
    age: float,
    stands: bool,
    low: bool,
    moves: Moves,
) -> tuple[float, Triple, float]:
    """Return the half space of one other drone: the distance m, its normal, its right-hand side.

    This drone keeps beside a drone that may be anywhere above its place on the floor.

    row: one row of AVOID_ROW
    other: one row of MOTION_ROW
    age: s, of the other's state
    stands: whether the other stands on the floor
    low: whether this drone does
    moves: predicted place m and velocity m/s of this drone, then of the other one
    """
    p, v, q, w = moves
    scale = (row.scale[0], row.scale[1], row.scale[2])
    width = row.width
    has_risen = may_have_risen(row, age, stands)
    if has_risen:
        # Homes may be nearer to each other than the width.
        scale = (row.scale[0], row.scale[1], 0.0)
        width = row.least_width
    elif stands:
        scale = (1.0, 1.0, 1.0)
        width = (
            COLLISION_DISTANCES.standing_drone
            if row.lands == 0
            else COLLISION_DISTANCES.landing_beside
        )
    r = scale_difference(p, q, scale)
    w = scale_difference(v, w, scale)
    if has_risen:
        r = keep_off_axis(r)
    d = max(compute_norm(r), 1e-3)
    n = (r[0] / d, r[1] / d, r[2] / d)
    side = (scale[0] * n[0], scale[1] * n[1], scale[2] * n[2])
    reach = compute_norm(side)
    # A standing drone does not run away while it is not heard.
    old = 0.0 if stands else min(age, NEIGHBOUR_AGES.usable)
    gap = d - width - 0.5 * row.unsure * old * old * reach
    unsure = row.unsure * old * reach
    brake = row.brake * reach
    # A drone that never gives way does not keep to its side.
    if row.has_cells != 0 and other.share < 1.0:
        own = (scale[0] * v[0], scale[1] * v[1], scale[2] * v[2])
        b = compute_cell_acceleration(
            r, w, own, gap, 0.5 * unsure, brake, row.stiffness, row.gamma
        )
    else:
        b = compute_barrier_acceleration(
            r, w, gap, unsure, 2.0 * brake, row.stiffness, row.gamma
        )
        if not (low or stands) and other.share < 1.0:
            away = (
                scale[0] * v[0] * n[0] + scale[1] * v[1] * n[1] + scale[2] * v[2] * n[2]
            )
            b *= compute_yield_share(away, dot(n, w) - away) if b > 0.0 else 0.5
    normal = (side[0] / reach, side[1] / reach, side[2] / reach)
    return d - width, normal, b / reach


@kernel()
def is_surely_clear(
    row: Records, size: float, r: Triple, w: Triple, d: float, age: float
) -> bool:
    """Return whether the half space of another drone contains each acceleration of this size.

        gamma s(gap) > 2 size + (gamma + k) c + gamma unsure,   s: see compute_closing_speed

    It is cheap, and false for some half spaces that do. It puts the worst case of each term into
    `compute_barrier_acceleration`: the acceleration points at the other drone, the path of the
    other one is straight, and half of the barrier is left to it.

    row: one row of AVOID_ROW, without cells
    size: m/s2, of the acceleration
    r: m, relative predicted place, scaled by S
    w: m/s, relative predicted velocity, scaled by S
    d: m, |r|
    age: s, of the other's state, at most NEIGHBOUR_AGES.usable; the other drone flies
    """
    closing = max(-dot(r, w) / d, 0.0)
    gap = d - row.width - 0.5 * row.unsure * age * age
    needed = (
        2.0 * size
        + (row.gamma + row.stiffness) * closing
        + row.gamma * row.unsure * age
    ) / row.gamma
    needed *= 1.0 + SPARE_SHARE
    brake = 2.0 * row.brake * min(row.scale[0], row.scale[1], row.scale[2])
    knee = brake / (row.stiffness * row.stiffness)
    if gap < knee:
        return bool(row.stiffness * gap > needed)
    return bool(2.0 * brake * (gap - 0.5 * knee) > needed * needed)


@kernel()
def is_gone(age: float, stands: bool) -> bool:
    """Return whether another drone was not heard for so long that it counts no more.

    age: s, of its state
    stands: whether it stands on the floor
    """
    return bool(not age < NEIGHBOUR_AGES.gone and not (stands and age < math.inf))
