"""The avoid stage: the safe acceleration of each drone that is nearest to its wanted one."""

import numpy as np

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple, clip, dot
from crazychoir.safety.airspace.distances import BRAKING_MODEL, COLLISION_DISTANCES
from crazychoir.safety.airspace.motion import (
    compute_norm,
    limit_norm,
    predict_braking,
    predict_late_motion,
    scale_difference,
)
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.collision.barrier import (
    compute_closing_speed,
)
from crazychoir.safety.collision.deadlock import (
    PASSING_SIDE_FIELDS,
    note_giving_way,
    turn_sideways,
)
from crazychoir.safety.collision.half_spaces import (
    OtherKind,
    compute_half_space,
    find_judged_scale,
    is_gone,
    is_surely_clear,
    judge_other,
    predict_other,
)
from crazychoir.safety.collision.projection import find_nearest_point
from crazychoir.types import Mat, Records, Vec

MOST_NEIGHBOURS = 16
"""Largest number of others that count, the nearest ones."""
AVOID_ROW = np.dtype(
    [
        # What the drone wants
        ("state", np.float64, 13),  # as State.flat
        ("acceleration", np.float64, 3),  # m/s2, commanded in the last tick
        ("reference", np.float64, 14),  # as FullState.flat
        ("gains", np.float64, 13),  # as Gains.position
        (
            "follows",
            np.int64,
        ),  # 1: flies `reference` as a full state; 0: its acceleration only
        ("lands", np.int64),  # 1: the drone comes down
        # The answer
        ("acts", np.int64),  # 1: the drone must fly `safe`
        ("safe", np.float64, 3),  # m/s2
        ("gives_way_to", np.int64),  # id of the nearest drone in the way; -1: none
        (
            "is_cut_off",
            np.int64,
        ),  # 1: hears at most half of all flying drones, itself included
        # The memory of the drone
        ("rests", np.int64),  # 1: stays at rest_place while it brakes
        ("rest_place", np.float64, 3),  # m
        *PASSING_SIDE_FIELDS,
        # The figures of the drone
        ("listener", np.int64),  # row of LISTENER_ROW
        ("lag", np.float64),  # s
        ("delay", np.float64),  # s
        ("scale", np.float64, 3),  # diagonal of S
        ("width", np.float64),  # m: D
        ("least_width", np.float64),  # m: D without the margin
        ("brake", np.float64),  # m/s2, of the barrier and of the cells
        ("gamma", np.float64),  # 1/s, of the barrier and of the cells
        ("stiffness", np.float64),  # 1/s, of the barrier and of the cells
        ("largest_horizontal", np.float64),  # m/s2
        ("largest_vertical", np.float64),  # m/s2
        ("turn", np.float64),  # sideways share of `turn_sideways`
        ("range", np.float64),  # m, distance within which others count
        ("unsure", np.float64),  # m/s2, unknown acceleration of another drone
        ("ground", np.float64),  # m, height of the ground
        ("v_max", np.float64),  # m/s, largest speed of the others
        ("silent_gap", np.float64),  # m, see compute_silent_gap
        (
            "has_cells",
            np.int64,
        ),  # 1: compute_cell_acceleration; 0: compute_barrier_acceleration
        ("box", np.float64, 6),  # m: lower corner of the fence, then upper corner
    ]
)
"""The avoid stage of one drone."""


def make_planes() -> Mat:
    """Return work space for the half spaces of one drone, (., 4)."""
    return np.zeros((6 + MOST_NEIGHBOURS + 6, 4))


def make_nearest() -> Mat:
    """Return work space for the nearest others, (MOST_NEIGHBOURS, 2), see _insert_plane."""
    return np.zeros((MOST_NEIGHBOURS, 2))


@kernel()
def _compute_wanted(row: Records) -> Triple:
    """Return the acceleration that the controller would ask for, (3,) m/s2.

    a_d + follow (kp (p_d - p) + kv (v_d - v))

    row: one row of AVOID_ROW
    """
    x = row.state
    ref = row.reference
    gains = row.gains
    follow = float(row.follows)
    return (
        ref[6] + follow * (gains[0] * (ref[0] - x[0]) + gains[3] * (ref[3] - x[3])),
        ref[7] + follow * (gains[1] * (ref[1] - x[1]) + gains[4] * (ref[4] - x[4])),
        ref[8] + follow * (gains[2] * (ref[2] - x[2]) + gains[5] * (ref[5] - x[5])),
    )


@kernel()
def _compute_braking(row: Records, v: Triple) -> Triple:
    """Return the acceleration that brings the drone to rest and keeps it there, (3,) m/s2.

        -k v - (k / 2)^2 (p - p_0)

    p_0: the place where the drone came to rest; the second term holds it there against the wind

    row: one row of AVOID_ROW
    v: (3,) m/s, predicted
    """
    x = row.state
    rest = row.rest_place
    if (
        row.rests == 0
        and compute_norm((x[3], x[4], x[5])) < BRAKING_MODEL.holding_speed
    ):
        row.rests = 1
        rest[0] = x[0]
        rest[1] = x[1]
        rest[2] = x[2]
    k = BRAKING_MODEL.gain
    stiff = 0.25 * BRAKING_MODEL.gain * BRAKING_MODEL.gain * row.rests
    return limit_norm(
        (
            -k * v[0] - stiff * (x[0] - rest[0]),
            -k * v[1] - stiff * (x[1] - rest[1]),
            -k * v[2] - stiff * (x[2] - rest[2]),
        ),
        row.largest_vertical,
    )


@kernel()
def _insert_plane(
    planes: Vec, near: Vec, count: int, d: float, normal: Triple, b: float, row: int
) -> int:
    """Insert a half space among the nearest ones, in the order of d, and return their number.

    planes: (., 4): the half spaces, from row 6 on
    near: (MOST_NEIGHBOURS, 2): d, and the row of the other drone in MOTION_ROW
    count: number of half spaces so far
    d: m, the distance
    normal: normal of the half space
    b: its right-hand side
    row: row of the other drone
    """
    if count == MOST_NEIGHBOURS:
        if d >= near[MOST_NEIGHBOURS - 1, 0]:
            return count
        count -= 1
    k = count
    while k > 0 and near[k - 1, 0] > d:
        near[k, 0], near[k, 1] = near[k - 1, 0], near[k - 1, 1]
        for c in range(4):
            planes[6 + k, c] = planes[5 + k, c]
        k -= 1
    near[k, 0] = d
    near[k, 1] = row
    planes[6 + k, 0] = normal[0]
    planes[6 + k, 1] = normal[1]
    planes[6 + k, 2] = normal[2]
    planes[6 + k, 3] = b
    return count + 1


@kernel(forceinline=True)
def _find_drone_in_the_way(planes: Vec, near: Vec, count: int, u: Triple) -> float:
    """Return the row of the nearest drone with a half space that does not contain u, -1 without one.

    planes: (., 4): the half spaces, from row 6 on
    near: (MOST_NEIGHBOURS, 2): as in `_insert_plane`
    count: number of half spaces
    u: m/s2, the acceleration
    """
    for k in range(count):
        normal = (planes[6 + k, 0], planes[6 + k, 1], planes[6 + k, 2])
        # What is no number is in no half space.
        if not dot(normal, u) >= planes[6 + k, 3]:
            return float(near[k, 1])
    return -1.0


@kernel()
def _compute_wall_bound(gap: float, away: float, row: Records) -> float:
    """Return the least acceleration away from a wall, m/s2.

    gap: m, from the wall
    away: m/s, speed away from the wall, as in `compute_barrier_acceleration`
    row: one row of AVOID_ROW
    """
    speed, slope = compute_closing_speed(gap, row.brake, row.stiffness)
    return float(-row.gamma * (speed + away) - slope * away)


@kernel()
def _fill_box(planes: Vec, floor: float, row: Records) -> None:
    """Set rows 0 to 5: the accelerations that the drone can fly and that keep it above the floor.

    planes: (., 4): the half spaces
    floor: m/s2, least acceleration upwards
    row: one row of AVOID_ROW
    """
    for c in range(3):
        for side in range(2):
            k = 2 * c + side
            for n in range(3):
                planes[k, n] = 0.0
            planes[k, c] = 1.0 - 2.0 * side
            planes[k, 3] = -(row.largest_vertical if c == 2 else row.largest_horizontal)
    planes[4, 3] = clip(floor, -row.largest_vertical, row.largest_vertical)


@kernel()
def _append_walls(planes: Vec, m: int, p: Triple, v: Triple, row: Records) -> int:
    """Append the half spaces that keep the drone inside its fence, without the floor.

    planes: (., 4): the half spaces
    m: number of rows so far
    p: m
    v: m/s
    row: one row of AVOID_ROW
    Returns the number of rows then.
    """
    for k in range(6):
        c = k % 3
        sign = 1.0 if k < 3 else -1.0
        gap = sign * (p[c] - row.box[k])
        if k != 2 and gap < COLLISION_DISTANCES.near_wall:
            for n in range(3):
                planes[m, n] = 0.0
            planes[m, c], planes[m, 3] = (
                sign,
                _compute_wall_bound(gap, sign * v[c], row),
            )
            m += 1
    return m


@kernel()
def _is_way_clear(
    row: Records,
    listener: Records,
    motions: Records,
    now: float,
    p: Triple,
    v: Triple,
    u: Triple,
) -> bool:
    """Return whether no other drone keeps this one from an acceleration.

    Note whether this drone is cut off.

    row: one row of AVOID_ROW
    listener: its row of LISTENER_ROW
    motions: MOTION_ROW, of the pairs
    now: s
    p: (3,) m, predicted place of this drone
    v: (3,) m/s, its predicted velocity
    u: (3,) m/s2
    """
    floor = row.ground + COLLISION_DISTANCES.standing_height
    low = row.state[2] < floor
    size = compute_norm(u)
    scale = (row.scale[0], row.scale[1], row.scale[2])
    is_clear = True
    heard = listener.far_heard
    silent = listener.far_silent
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        other = motions[k]
        age = now - other.state_time
        stands = other.height < floor
        if is_gone(age, stands):
            continue
        if not stands:
            if now - other.heard_time < NEIGHBOUR_AGES.silent:
                heard += 1
            else:
                silent += 1
        if not is_clear or (stands and low and row.lands == 0):
            continue
        q, w = predict_other(row, other, age)
        r = scale_difference(p, q, find_judged_scale(row, age, stands))
        d = max(compute_norm(r), 1e-3)
        kind = judge_other(row, d, age, stands)
        if kind == OtherKind.IGNORED:
            continue
        if kind == OtherKind.COUNTS and not stands and row.has_cells == 0:
            relative = scale_difference(v, w, scale)
            if is_surely_clear(row, size, r, relative, d, age):
                continue
        moves = (p, v, q, w)
        _, normal, b = compute_half_space(row, other, age, stands, low, moves)
        is_clear = kind == OtherKind.COUNTS and dot(normal, u) >= b
    row.is_cut_off = silent > heard
    return is_clear and (row.is_cut_off == 0 or row.lands != 0)


@kernel()
def _constrain_all(
    row: Records,
    listener: Records,
    motions: Records,
    now: float,
    p: Triple,
    v: Triple,
    planes: Mat,
    near: Mat,
) -> tuple[int, bool]:
    """Insert the half spaces of all near drones.

    row: one row of AVOID_ROW
    listener: its row of LISTENER_ROW
    motions: MOTION_ROW, of the pairs
    now: s
    p: (3,) m, predicted place of this drone
    v: (3,) m/s, its predicted velocity
    planes: (., 4): work space, see make_planes
    near: work space, see make_nearest
    Returns the number of half spaces, and whether a drone that may be near is not heard.
    """
    floor = row.ground + COLLISION_DISTANCES.standing_height
    low = row.state[2] < floor
    count = 0
    is_blind = False
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        other = motions[k]
        age = now - other.state_time
        stands = other.height < floor
        if is_gone(age, stands) or (stands and low and row.lands == 0):
            continue
        q, w = predict_other(row, other, age)
        scale = find_judged_scale(row, age, stands)
        d = max(compute_norm(scale_difference(p, q, scale)), 1e-3)
        kind = judge_other(row, d, age, stands)
        if kind == OtherKind.IGNORED:
            continue
        if kind == OtherKind.UNHEARD:
            # As a rule the silent drone does not hear this one either.
            unheard = age - NEIGHBOUR_AGES.usable
            q, w = predict_braking(q, w, BRAKING_MODEL.gain, unheard)
            is_blind = True
        d, normal, b = compute_half_space(row, other, age, stands, low, (p, v, q, w))
        count = _insert_plane(planes, near, count, d, normal, b, k)
    return count, is_blind


@kernel()
def avoid_row(
    row: Records,
    listener: Records,
    motions: Records,
    now: float,
    planes: Mat,
    near: Mat,
) -> None:
    """Turn the wanted acceleration of one drone into a safe one, by the states of this drone and the others.

        min |u - u_n|^2   s.t.   n_ij . S u >= share b_ij  for each other drone j in range,
                                 |u_c| <= most,  the fence
        |S (p_i - p_j)| >= D,   S = diag(1, s_x / s_y, s_x / s_z),   D = 2 s_x + margin

    s: semi-axes of the ellipsoid around each drone
    b_ij: of `compute_barrier_acceleration`, or of `compute_cell_acceleration` for another drone that gives way as well
    u_n: what is wanted, turned to the side where another drone is in the way

    Places and velocities are those of `predict_late_motion`, so that the lag of the drones counts. Constraints
    that cannot all be met are relaxed by the least violation: the fence first, the nearest drone
    last, the floor never. Drones on the floor are balls of COLLISION_DISTANCES.standing_drone m; a drone that takes
    off ignores them.

    A drone brakes if another drone that may be near has been silent for NEIGHBOUR_AGES.usable s, or if more than
    half of the other drones that flew have been silent for NEIGHBOUR_AGES.silent s. It does not brake for this
    while it lands. It keeps clear of the place where the silent drone is if that drone brakes too.
    After the same silence a drone on the floor may have taken off: this one keeps beside its place, at any
    height.

    Most drones have a clear way: it is found with few half spaces, and without the nearest point.

    row: one row of AVOID_ROW
    listener: its row of LISTENER_ROW
    motions: MOTION_ROW, of the pairs
    now: s
    planes: (., 4): work space, see make_planes
    near: work space, see make_nearest
    """
    x = row.state
    p, v = predict_late_motion(
        x[:], row.acceleration[:], row.lag, row.delay, BRAKING_MODEL.command_time
    )
    u = _compute_wanted(row)
    if _is_way_clear(row, listener, motions, now, p, v, u):
        row.rests = 0
        row.gives_way_to = -1
        row.acts = 0
        return
    count, is_blind = _constrain_all(row, listener, motions, now, p, v, planes, near)
    is_blind |= row.is_cut_off != 0 and row.lands == 0
    if is_blind:
        u = _compute_braking(row, v)
    else:
        row.rests = 0
    blocked = _find_drone_in_the_way(planes, near, count, u)
    row.gives_way_to = motions[int(blocked)].drone if blocked >= 0.0 else -1
    row.acts = is_blind or blocked >= 0.0
    if row.acts == 0:
        return
    low = x[2] < row.ground + COLLISION_DISTANCES.standing_height
    floor = row.box[2]
    turn = row.turn
    if row.follows != 0:
        floor = min(floor + COLLISION_DISTANCES.floor_gap, row.reference[2])
        turn *= row.side
    least = (
        -row.largest_vertical if low else _compute_wall_bound(p[2] - floor, v[2], row)
    )
    _fill_box(planes, least, row)
    u = turn_sideways(u, planes, 6, 6 + count, turn)
    m = _append_walls(planes, 6 + count, p, v, row)
    _, u = find_nearest_point(u, planes, m)
    for c in range(3):
        row.safe[c] = u[c]
    if row.follows != 0:
        note_giving_way(row, row.state, row.reference, now)
