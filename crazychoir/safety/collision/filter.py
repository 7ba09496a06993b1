"""The collision filter: the safe acceleration that is nearest to the wanted one."""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.config.tables import CollisionTable
from crazychoir.numerics.kernels import kernel, memory, real, table, vector
from crazychoir.numerics.math3d import Triple, clip, dot
from crazychoir.safety.collision.barrier import (
    compute_barrier_acceleration,
    compute_closing_speed,
    compute_yield_share,
)
from crazychoir.safety.collision.cells import compute_cell_acceleration
from crazychoir.safety.collision.deadlock import PassingSide, turn_sideways
from crazychoir.safety.collision.motion import (
    compute_norm,
    limit_norm,
    predict_braking,
    predict_late_motion,
    scale_difference,
)
from crazychoir.safety.collision.neighbour_table import (
    NEIGHBOUR_AGES,
    NEIGHBOUR_ROW,
    SPEED_ALLOWANCE,
    NeighbourTable,
)
from crazychoir.safety.collision.projection import find_nearest_point
from crazychoir.safety.collision.relayed_states import RelayedStates
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import State, Vec

MOST_NEIGHBOURS = 16
"""Largest number of others that count, the nearest ones."""


class CollisionDistances(NamedTuple):
    """Distances, m, that the collision filter keeps, or from which on it acts."""

    standing_height: float = 0.08
    """Height in m above the ground below which a drone counts as standing on the floor."""
    standing_drone: float = 0.15
    """Distance in m to keep between the centres of two drones if one stands on the floor.

    At 0.137 m they would touch.
    """
    landing_beside: float = 0.2
    """Distance in m that a landing drone keeps from the centre of a drone on the floor."""
    silent_drone: float = 0.5
    """Distance in m between the ellipsoids of this drone and a silent one.

    Below it this drone brakes.
    """
    floor_gap: float = 0.2
    """Least height in m above the floor of a drone that gives way, unless it wants to be lower.
    """
    near_wall: float = 1.0
    """Distance in m from a side of the fence within which that side counts."""


COLLISION_DISTANCES = CollisionDistances()


class BrakingModel(NamedTuple):
    """How long a drone is assumed to go on, and how it then brakes."""

    command_time: float = 0.15
    """Seconds for which a drone is assumed to go on with its last command.

    Two drones that predict each other further ahead evade each other for ever.
    """
    silent_flight_time: float = 2.0
    """Longest time in s that a silent drone is assumed to fly on.

    Then it brakes because it does not receive the others' states.
    """
    gain: float = 4.0
    """Braking gain k in 1/s: the deceleration as a multiple of the speed."""
    holding_speed: float = 0.2
    """Speed in m/s below which a braking drone stays where it is."""


BRAKING_MODEL = BrakingModel()


# Indices of the figures f of the kernel.
FIGURE_LAG = 0  # s
FIGURE_DELAY = 1  # s
FIGURE_SCALE_X = 2  # diagonal of S, x
FIGURE_SCALE_Y = 3  # diagonal of S, y
FIGURE_SCALE_Z = 4  # diagonal of S, z
FIGURE_WIDTH = 5  # m: D
FIGURE_BRAKE = 6  # m/s2, of the barrier and of the cells
FIGURE_GAMMA = 7  # 1/s, of the barrier and of the cells
FIGURE_A_XY = 8  # m/s2, largest horizontal acceleration
FIGURE_A_Z = 9  # m/s2, largest vertical acceleration
FIGURE_TURN = 10  # sideways share of `turn_sideways`, with the sign of the side
FIGURE_RANGE = 11  # m, distance within which others count
FIGURE_UNSURE = 12  # m/s2, unknown acceleration of another drone
FIGURE_GROUND = 13  # m, height of the ground
FIGURE_V_MAX = 14  # m/s, largest speed of the others
FIGURE_CELLS = 15  # 1: `compute_cell_acceleration`, 0: `compute_barrier_acceleration`
FIGURE_STIFFNESS = 16  # 1/s, of the barrier and of the cells
FIGURE_WAITS = 17  # 0 while the drone lands, else 1


@kernel()
def _compute_wanted(x: Vec, ref: Vec, gains: Vec, follow: float) -> Triple:
    """Return the acceleration that the controller would ask for, (3,) m/s2.

    a_d + follow (kp (p_d - p) + kv (v_d - v))
    """
    return (
        ref[6] + follow * (gains[0] * (ref[0] - x[0]) + gains[3] * (ref[3] - x[3])),
        ref[7] + follow * (gains[1] * (ref[1] - x[1]) + gains[4] * (ref[4] - x[4])),
        ref[8] + follow * (gains[2] * (ref[2] - x[2]) + gains[5] * (ref[5] - x[5])),
    )


@kernel()
def _compute_braking(x: Vec, v: Triple, limit: float, out: Vec) -> Triple:
    """Return the acceleration that brings the drone to rest and keeps it there, (3,) m/s2.

        -k v - (k / 2)^2 (p - p_0)

    p_0: the place, kept in out[6:9], where the drone came to rest; the second term holds it there
        against the wind
    out: out[5] is 1 while the drone holds p_0
    """
    if out[5] == 0.0 and compute_norm((x[3], x[4], x[5])) < BRAKING_MODEL.holding_speed:
        out[5] = 1.0
        out[6] = x[0]
        out[7] = x[1]
        out[8] = x[2]
    k = BRAKING_MODEL.gain
    stiff = 0.25 * BRAKING_MODEL.gain * BRAKING_MODEL.gain * out[5]
    return limit_norm(
        (
            -k * v[0] - stiff * (x[0] - out[6]),
            -k * v[1] - stiff * (x[1] - out[7]),
            -k * v[2] - stiff * (x[2] - out[8]),
        ),
        limit,
    )


@kernel()
def _insert_plane(
    planes: Vec, near: Vec, count: int, d: float, normal: Triple, b: float, row: int
) -> int:
    """Insert a half space among the nearest ones, in the order of d, and return their number.

    planes: (., 4): the half spaces, from row 6 on
    near: (MOST_NEIGHBOURS, 2): d, and the row of the other drone in the traffic table
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
        if dot(normal, u) < planes[6 + k, 3]:
            return float(near[k, 1])
    return -1.0


@kernel()
def _compute_wall_bound(gap: float, away: float, f: Vec) -> float:
    """Return the least acceleration away from a wall, m/s2.

    gap: m, from the wall
    away: m/s, speed away from the wall, as in `compute_barrier_acceleration`
    f: the figures
    """
    speed, slope = compute_closing_speed(gap, f[FIGURE_BRAKE], f[FIGURE_STIFFNESS])
    return float(-f[FIGURE_GAMMA] * (speed + away) - slope * away)


@kernel()
def _fill_box(planes: Vec, floor: float, f: Vec) -> None:
    """Set rows 0 to 5: the accelerations that the drone can fly and that keep it above the floor.

    planes: (., 4): the half spaces
    floor: m/s2, least acceleration upwards
    f: the figures
    """
    for c in range(3):
        for side in range(2):
            k = 2 * c + side
            for n in range(3):
                planes[k, n] = 0.0
            planes[k, c] = 1.0 - 2.0 * side
            planes[k, 3] = -(f[FIGURE_A_Z] if c == 2 else f[FIGURE_A_XY])
    planes[4, 3] = clip(floor, -f[FIGURE_A_Z], f[FIGURE_A_Z])


@kernel()
def _append_walls(planes: Vec, m: int, p: Triple, v: Triple, box: Vec, f: Vec) -> int:
    """Append the half spaces that keep the drone inside its fence, without the floor.

    planes: (., 4): the half spaces
    m: number of rows so far
    p: m
    v: m/s
    box: (6,) m: lower corner, then upper corner
    f: the figures
    Returns the number of rows then.
    """
    for k in range(6):
        c = k % 3
        sign = 1.0 if k < 3 else -1.0
        gap = sign * (p[c] - box[k])
        if k != 2 and gap < COLLISION_DISTANCES.near_wall:
            for n in range(3):
                planes[m, n] = 0.0
            planes[m, c], planes[m, 3] = sign, _compute_wall_bound(gap, sign * v[c], f)
            m += 1
    return m


@kernel(
    vector,
    vector,
    vector,
    vector,
    real,
    table,
    real,
    vector,
    vector,
    table,
    table,
    memory,
)
def _filter_acceleration(
    x: Vec,
    a: Vec,
    ref: Vec,
    gains: Vec,
    follow: float,
    others: Vec,
    now: float,
    box: Vec,
    f: Vec,
    planes: Vec,
    near: Vec,
    out: Vec,
) -> bool:
    """Apply the law of CollisionFilter, and return whether it acts.

    x: (13,): state of this drone
    a: (3,) m/s2: its commanded acceleration
    ref: (14,): what it wants, as FullState.flat
    gains: (13,), as Gains.position
    follow: 1 to fly ref as a full state, 0 to fly its acceleration only
    others: (n, NEIGHBOUR_ROW.size): the table of Traffic
    now: s
    box: (6,) m: lower corner of the fence, then upper corner
    f: the figures
    planes: (., 4): work space for the half spaces
    near: (MOST_NEIGHBOURS, 2): work space, see _insert_plane
    out: (9,): the acceleration (3,), the row of the nearest drone in the way, whether this drone is
        cut off, whether it stays while it brakes, and the place (3,) where it stays
    """
    p, v = predict_late_motion(
        x, a, f[FIGURE_LAG], f[FIGURE_DELAY], BRAKING_MODEL.command_time
    )
    low = x[2] < f[FIGURE_GROUND] + COLLISION_DISTANCES.standing_height
    count = 0
    blind = False
    heard = 0
    silent = 0
    for j in range(others.shape[0]):
        other = others[j]
        age = now - other[NEIGHBOUR_ROW.state_time]
        stands = other[2] < f[FIGURE_GROUND] + COLLISION_DISTANCES.standing_height
        if not age < NEIGHBOUR_AGES.gone and not (stands and age < math.inf):
            other[NEIGHBOUR_ROW.meeting_time] = other[NEIGHBOUR_ROW.age_limit] = (
                math.inf
            )
            continue
        if not stands:
            heard += now - other[NEIGHBOUR_ROW.heard_time] < NEIGHBOUR_AGES.silent
            silent += now - other[NEIGHBOUR_ROW.heard_time] >= NEIGHBOUR_AGES.silent
        apart = compute_norm(
            (
                f[FIGURE_SCALE_X] * (x[0] - other[0]),
                f[FIGURE_SCALE_Y] * (x[1] - other[1]),
                f[FIGURE_SCALE_Z] * (x[2] - other[2]),
            )
        )
        speeds = compute_norm((x[3], x[4], x[5])) + compute_norm(
            (other[3], other[4], other[5])
        )
        other[NEIGHBOUR_ROW.meeting_time] = (apart - 2.0 * f[FIGURE_WIDTH]) / (
            speeds + SPEED_ALLOWANCE
        )
        other[NEIGHBOUR_ROW.age_limit] = (
            NEIGHBOUR_AGES.usable
            + max(apart - f[FIGURE_WIDTH] - COLLISION_DISTANCES.silent_drone, 0.0)
            / f[FIGURE_V_MAX]
        )
        if apart > f[FIGURE_RANGE] + 2.0 * f[FIGURE_V_MAX] * min(
            age, BRAKING_MODEL.silent_flight_time
        ):
            continue
        if stands and low and f[FIGURE_WAITS] > 0.0:
            continue
        scale = (
            (1.0, 1.0, 1.0)
            if stands
            else (f[FIGURE_SCALE_X], f[FIGURE_SCALE_Y], f[FIGURE_SCALE_Z])
        )
        beside = (
            COLLISION_DISTANCES.standing_drone
            if f[FIGURE_WAITS] > 0.0
            else COLLISION_DISTANCES.landing_beside
        )
        width = beside if stands else f[FIGURE_WIDTH]
        q, w = predict_late_motion(
            other,
            other[13:16],
            f[FIGURE_LAG],
            min(age, NEIGHBOUR_AGES.usable) + f[FIGURE_DELAY],
            BRAKING_MODEL.command_time,
        )
        d = max(compute_norm(scale_difference(p, q, scale)), 1e-3)
        if age > NEIGHBOUR_AGES.usable and not stands:
            if (
                f[FIGURE_WAITS] == 0.0
                or d
                > width
                + f[FIGURE_V_MAX]
                * (min(age, BRAKING_MODEL.silent_flight_time) - NEIGHBOUR_AGES.usable)
                + COLLISION_DISTANCES.silent_drone
            ):
                continue
            blind = True
            # As a rule the silent drone does not hear this one either.
            q, w = predict_braking(
                q, w, BRAKING_MODEL.gain, age - NEIGHBOUR_AGES.usable
            )
        r = scale_difference(p, q, scale)
        w = scale_difference(v, w, scale)
        d = max(compute_norm(r), 1e-3)
        n = (r[0] / d, r[1] / d, r[2] / d)
        side = (scale[0] * n[0], scale[1] * n[1], scale[2] * n[2])
        reach = compute_norm(side)
        # A standing drone does not run away while it is not heard.
        old = 0.0 if stands else min(age, NEIGHBOUR_AGES.usable)
        gap = d - width - 0.5 * f[FIGURE_UNSURE] * old * old * reach
        unsure = f[FIGURE_UNSURE] * old * reach
        brake = f[FIGURE_BRAKE] * reach
        # A drone that never gives way does not keep to its side.
        if f[FIGURE_CELLS] > 0.0 and other[NEIGHBOUR_ROW.share] < 1.0:
            own = (scale[0] * v[0], scale[1] * v[1], scale[2] * v[2])
            b = compute_cell_acceleration(
                r,
                w,
                own,
                gap,
                0.5 * unsure,
                brake,
                f[FIGURE_STIFFNESS],
                f[FIGURE_GAMMA],
            )
        else:
            b = compute_barrier_acceleration(
                r, w, gap, unsure, 2.0 * brake, f[FIGURE_STIFFNESS], f[FIGURE_GAMMA]
            )
            if not (low or stands) and other[NEIGHBOUR_ROW.share] < 1.0:
                away = (
                    scale[0] * v[0] * n[0]
                    + scale[1] * v[1] * n[1]
                    + scale[2] * v[2] * n[2]
                )
                b *= compute_yield_share(away, dot(n, w) - away) if b > 0.0 else 0.5
        normal = (side[0] / reach, side[1] / reach, side[2] / reach)
        count = _insert_plane(planes, near, count, d - width, normal, b / reach, j)
    cut_off = silent > heard
    blind = blind or (cut_off and f[FIGURE_WAITS] > 0.0)
    u = (
        _compute_braking(x, v, f[FIGURE_A_Z], out)
        if blind
        else _compute_wanted(x, ref, gains, follow)
    )
    out[4], out[5] = 1.0 if cut_off else 0.0, out[5] if blind else 0.0
    out[3] = _find_drone_in_the_way(planes, near, count, u)
    if not blind and out[3] < 0.0:
        return False
    floor = (
        min(box[2] + COLLISION_DISTANCES.floor_gap, ref[2]) if follow > 0.0 else box[2]
    )
    _fill_box(
        planes, -f[FIGURE_A_Z] if low else _compute_wall_bound(p[2] - floor, v[2], f), f
    )
    u = turn_sideways(u, planes, 6, 6 + count, f[FIGURE_TURN])
    _, u = find_nearest_point(u, planes, _append_walls(planes, 6 + count, p, v, box, f))
    out[0], out[1], out[2] = u
    return True


class CollisionFilter:
    """Turns a wanted acceleration into a safe one, by the states of this drone and the others.

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

    settings: [collision]
    traffic: the states of the others
    fence: from the floor upwards
    a_max: m/s2, with which the drone brakes
    v_max: m/s, largest speed of the others
    ground: m, height of the ground
    """

    def __init__(
        self,
        settings: CollisionTable,
        traffic: NeighbourTable,
        fence: Fence,
        a_max: float,
        v_max: float,
        ground: float,
    ) -> None:
        sx, sy, sz = settings.semi_axes
        self.traffic = traffic
        self.hearsay = RelayedStates(traffic)
        self._figures = np.array(
            [
                settings.lag,
                settings.delay,
                1.0,
                sx / sy,
                sx / sz,
                2.0 * sx + settings.margin,
                settings.brake,
                settings.gamma,
                1.5 * a_max,
                a_max,
                settings.turn,
                settings.range,
                settings.unsure,
                ground,
                v_max,
                float(settings.method == "cells"),
                settings.stiff,
                1.0,
            ]
        )
        self._box = (
            np.array([*fence.low, *fence.high])
            + np.repeat([1.0, -1.0], 3) * settings.margin
        )
        self._planes = np.zeros((6 + MOST_NEIGHBOURS + 6, 4))
        self._near = np.zeros((MOST_NEIGHBOURS, 2))
        self._out = np.zeros(9)
        self._accelerates = np.zeros(14)
        self._turn = settings.turn
        self.side = PassingSide(traffic.port.address)

    def look(self, now: float) -> None:
        """Make sure, now and then, that the drone hears the drones near it."""
        if self.traffic.look(now):
            self.hearsay.seek(now)

    def full_state(
        self, state: State, reference: Vec, gains: Vec, now: float, lands: bool = False
    ) -> Vec | None:
        """Return the safe acceleration, (3,) m/s2, of a drone that follows a full state.

        state: of the drone
        reference: (14,), as FullState.flat
        gains: (13,), as Gains.position
        now: s
        lands: whether the drone is landing
        Returns None if the drone may fly as it wants.
        """
        self._figures[FIGURE_WAITS], self._figures[FIGURE_TURN] = (
            0.0 if lands else 1.0,
            self._turn * self.side.sign,
        )
        safe = self._run(state, reference, gains, 1.0, now)
        if safe is not None:
            self.side.gives_way(state.p, reference[0:3], now)
        return safe

    def acceleration(self, state: State, a: Vec, gains: Vec, now: float) -> Vec | None:
        """Return the safe acceleration, (3,) m/s2, of a drone that follows an acceleration.

        state: of the drone
        a: (3,) m/s2: what it wants
        gains: (13,), as Gains.position
        now: s
        Returns None if the drone may fly as it wants.
        """
        self._accelerates[6:9] = a
        self._figures[FIGURE_WAITS] = 1.0
        self._figures[FIGURE_TURN] = self._turn
        return self._run(state, self._accelerates, gains, 0.0, now)

    def _run(
        self, state: State, reference: Vec, gains: Vec, follow: float, now: float
    ) -> Vec | None:
        traffic = self.traffic
        acts = _filter_acceleration(
            state.flat,
            state.a,
            reference,
            gains,
            follow,
            traffic.rows,
            now,
            self._box,
            self._figures,
            self._planes,
            self._near,
            self._out,
        )
        if not acts:
            return None
        return self._out[0:3].copy()

    @property
    def cut_off(self) -> bool:
        """Whether the drone hears at most half of all flying drones, itself included."""
        return bool(self._out[4])

    @property
    def gives_way_to(self) -> int | None:
        """Id of the nearest drone that this one last gave way to; None if it braked."""
        row = int(self._out[3])
        return None if row < 0 else self.traffic.ids[row]
