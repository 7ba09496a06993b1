"""The collision filter: the safe acceleration that is nearest to the wanted one."""

import math

import numpy as np

from crazychoir.config.tables import Collision
from crazychoir.numerics.kernels import kernel, memory, real, table, vector
from crazychoir.numerics.math3d import Triple, clip, dot
from crazychoir.safety.collision.barrier import approach, barrier, part
from crazychoir.safety.collision.cells import cell
from crazychoir.safety.collision.deadlock import Side, turned
from crazychoir.safety.collision.motion import late, length, resting, scaled, shrunk
from crazychoir.safety.collision.neighbour_table import (
    BORN,
    BORNE,
    GONE,
    HEARD,
    SHARE,
    SILENT,
    SLOW,
    SOON,
    USABLE,
    Traffic,
)
from crazychoir.safety.collision.projection import nearest
from crazychoir.safety.collision.relayed_states import Hearsay
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import State, Vec

MOST = 16
"""Largest number of others that count, the nearest ones."""
STANDING = 0.08
"""Height in m above the ground below which a drone counts as standing on the floor."""
BODY = 0.15
"""Distance in m to keep between the centres of two drones if one stands on the floor.

At 0.137 m they would touch.
"""
BESIDE = 0.2
"""Distance in m that a landing drone keeps from the centre of a drone on the floor."""
NEAR = 0.5
"""Distance in m between the ellipsoids of this drone and a silent one.

Below it this drone brakes.
"""
LASTS = 0.15
"""Seconds for which a drone is assumed to go on with its last command.

Two drones that predict each other further ahead evade each other for ever.
"""
HIDES = 2.0
"""Longest time in s that a silent drone is assumed to fly on.

Then it brakes because it does not receive the others' states.
"""
BRAKES = 4.0
"""Braking gain k in 1/s: the deceleration as a multiple of the speed."""
HOLDS = 0.2
"""Speed in m/s below which a braking drone stays where it is."""
FLOOR_GAP = 0.2
"""Least height in m above the floor of a drone that gives way, unless it wants to be lower."""
NEAR_WALL = 1.0
"""Distance in m from a side of the fence within which that side counts."""

# Indices of the figures f of the kernel:

# LAG s, DELAY s
# SX, SY, SZ: diagonal of S
# WIDTH m: D
# BRAKE m/s2, GAMMA 1/s, STIFF 1/s: of `barrier` and `cell`
# A_XY, A_Z m/s2: largest horizontal and vertical acceleration
# TURN: sideways share of `turned`, with the sign of the side
# RANGE m: distance within which others count
# UNSURE m/s2: unknown acceleration of another drone
# GROUND m: height of the ground
# V_MAX m/s: largest speed of the others
# CELLS: 1 for `cell`, 0 for `barrier`
# WAITS: 0 while the drone lands, else 1
LAG, DELAY, SX, SY, SZ, WIDTH, BRAKE, GAMMA, A_XY = range(9)
A_Z, TURN, RANGE, UNSURE, GROUND, V_MAX, CELLS, STIFF, WAITS = range(9, 18)
"""-"""


@kernel()
def _wanted(x: Vec, ref: Vec, gains: Vec, follow: float) -> Triple:
    """Return the acceleration that the controller would ask for, (3,) m/s2.

    a_d + follow (kp (p_d - p) + kv (v_d - v))
    """
    return (
        ref[6] + follow * (gains[0] * (ref[0] - x[0]) + gains[3] * (ref[3] - x[3])),
        ref[7] + follow * (gains[1] * (ref[1] - x[1]) + gains[4] * (ref[4] - x[4])),
        ref[8] + follow * (gains[2] * (ref[2] - x[2]) + gains[5] * (ref[5] - x[5])),
    )


@kernel()
def _braking(x: Vec, v: Triple, limit: float, out: Vec) -> Triple:
    """Return the acceleration that brings the drone to rest and keeps it there, (3,) m/s2.

        -k v - (k / 2)^2 (p - p_0)

    p_0: the place, kept in out[6:9], where the drone came to rest; the second term holds it there
        against the wind
    out: out[5] is 1 while the drone holds p_0
    """
    if out[5] == 0.0 and length((x[3], x[4], x[5])) < HOLDS:
        out[5] = 1.0
        out[6] = x[0]
        out[7] = x[1]
        out[8] = x[2]
    k = BRAKES
    stiff = 0.25 * BRAKES * BRAKES * out[5]
    return shrunk(
        (
            -k * v[0] - stiff * (x[0] - out[6]),
            -k * v[1] - stiff * (x[1] - out[7]),
            -k * v[2] - stiff * (x[2] - out[8]),
        ),
        limit,
    )


@kernel()
def _insert(
    planes: Vec, near: Vec, count: int, d: float, normal: Triple, b: float, row: int
) -> int:
    """Insert a half space among the nearest ones, in the order of d, and return their number.

    planes: (., 4): the half spaces, from row 6 on
    near: (MOST, 2): d, and the row of the other drone in the traffic table
    count: number of half spaces so far
    d: m, the distance
    normal: normal of the half space
    b: its right-hand side
    row: row of the other drone
    """
    if count == MOST:
        if d >= near[MOST - 1, 0]:
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


@kernel()
def _wall(gap: float, away: float, f: Vec) -> float:
    """Return the least acceleration away from a wall, m/s2.

    gap: m, from the wall
    away: m/s, speed away from the wall, as in `barrier`
    f: the figures
    """
    speed, slope = approach(gap, f[BRAKE], f[STIFF])
    return float(-f[GAMMA] * (speed + away) - slope * away)


@kernel()
def _box(planes: Vec, floor: float, f: Vec) -> None:
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
            planes[k, 3] = -(f[A_Z] if c == 2 else f[A_XY])
    planes[4, 3] = clip(floor, -f[A_Z], f[A_Z])


@kernel()
def _walls(planes: Vec, m: int, p: Triple, v: Triple, box: Vec, f: Vec) -> int:
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
        if k != 2 and gap < NEAR_WALL:
            for n in range(3):
                planes[m, n] = 0.0
            planes[m, c], planes[m, 3] = sign, _wall(gap, sign * v[c], f)
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
def _filtered(
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
    others: (n, COLUMNS): the table of Traffic
    now: s
    box: (6,) m: lower corner of the fence, then upper corner
    f: the figures
    planes: (., 4): work space for the half spaces
    near: (MOST, 2): work space, see _insert
    out: (9,): the acceleration (3,), the row of the nearest drone in the way, whether this drone is
        cut off, whether it stays while it brakes, and the place (3,) where it stays
    """
    p, v = late(x, a, f[LAG], f[DELAY], LASTS)
    low = x[2] < f[GROUND] + STANDING
    count = 0
    blind = False
    heard = 0
    silent = 0
    for j in range(others.shape[0]):
        other = others[j]
        age = now - other[BORN]
        stands = other[2] < f[GROUND] + STANDING
        if not age < GONE and not (stands and age < math.inf):
            other[SOON] = other[BORNE] = math.inf
            continue
        if not stands:
            heard += now - other[HEARD] < SILENT
            silent += now - other[HEARD] >= SILENT
        apart = length(
            (
                f[SX] * (x[0] - other[0]),
                f[SY] * (x[1] - other[1]),
                f[SZ] * (x[2] - other[2]),
            )
        )
        speeds = length((x[3], x[4], x[5])) + length((other[3], other[4], other[5]))
        other[SOON] = (apart - 2.0 * f[WIDTH]) / (speeds + SLOW)
        other[BORNE] = USABLE + max(apart - f[WIDTH] - NEAR, 0.0) / f[V_MAX]
        if apart > f[RANGE] + 2.0 * f[V_MAX] * min(age, HIDES):
            continue
        if stands and low and f[WAITS] > 0.0:
            continue
        scale = (1.0, 1.0, 1.0) if stands else (f[SX], f[SY], f[SZ])
        width = f[WIDTH] if not stands else BODY if f[WAITS] > 0.0 else BESIDE
        q, w = late(other, other[13:16], f[LAG], min(age, USABLE) + f[DELAY], LASTS)
        d = max(length(scaled(p, q, scale)), 1e-3)
        if age > USABLE and not stands:
            if (
                f[WAITS] == 0.0
                or d > width + f[V_MAX] * (min(age, HIDES) - USABLE) + NEAR
            ):
                continue
            blind = True
            # As a rule the silent drone does not hear this one either.
            q, w = resting(q, w, BRAKES, age - USABLE)
        r = scaled(p, q, scale)
        w = scaled(v, w, scale)
        d = max(length(r), 1e-3)
        n = (r[0] / d, r[1] / d, r[2] / d)
        side = (scale[0] * n[0], scale[1] * n[1], scale[2] * n[2])
        reach = length(side)
        # A standing drone does not run away while it is not heard.
        old = 0.0 if stands else min(age, USABLE)
        gap = d - width - 0.5 * f[UNSURE] * old * old * reach
        unsure = f[UNSURE] * old * reach
        brake = f[BRAKE] * reach
        # A drone that never gives way does not keep to its side.
        if f[CELLS] > 0.0 and other[SHARE] < 1.0:
            own = (scale[0] * v[0], scale[1] * v[1], scale[2] * v[2])
            b = cell(r, w, own, gap, 0.5 * unsure, brake, f[STIFF], f[GAMMA])
        else:
            b = barrier(r, w, gap, unsure, 2.0 * brake, f[STIFF], f[GAMMA])
            if not (low or stands) and other[SHARE] < 1.0:
                away = (
                    scale[0] * v[0] * n[0]
                    + scale[1] * v[1] * n[1]
                    + scale[2] * v[2] * n[2]
                )
                b *= part(away, dot(n, w) - away) if b > 0.0 else 0.5
        normal = (side[0] / reach, side[1] / reach, side[2] / reach)
        count = _insert(planes, near, count, d - width, normal, b / reach, j)
    cut_off = silent > heard
    blind = blind or (cut_off and f[WAITS] > 0.0)
    u = _braking(x, v, f[A_Z], out) if blind else _wanted(x, ref, gains, follow)
    out[4], out[5] = 1.0 if cut_off else 0.0, out[5] if blind else 0.0
    acts = blind
    out[3] = -1.0
    for k in range(6 + count - 1, 5, -1):
        if dot((planes[k, 0], planes[k, 1], planes[k, 2]), u) < planes[k, 3]:
            acts = True
            out[3] = near[k - 6, 1]
    if not acts:
        return False
    floor = min(box[2] + FLOOR_GAP, ref[2]) if follow > 0.0 else box[2]
    _box(planes, -f[A_Z] if low else _wall(p[2] - floor, v[2], f), f)
    u = turned(u, planes, 6, 6 + count, f[TURN])
    _, u = nearest(u, planes, _walls(planes, 6 + count, p, v, box, f))
    out[0], out[1], out[2] = u
    return True


class CollisionFilter:
    """Turns a wanted acceleration into a safe one, by the states of this drone and the others.

        min |u - u_n|^2   s.t.   n_ij . S u >= share b_ij  for each other drone j in range,
                                 |u_c| <= most,  the fence
        |S (p_i - p_j)| >= D,   S = diag(1, s_x / s_y, s_x / s_z),   D = 2 s_x + margin

    s: semi-axes of the ellipsoid around each drone
    b_ij: of `barrier`, or of `cell` for another drone that gives way as well
    u_n: what is wanted, turned to the side where another drone is in the way

    Places and velocities are those of `late`, so that the lag of the drones counts. Constraints
    that cannot all be met are relaxed by the least violation: the fence first, the nearest drone
    last, the floor never. Drones on the floor are balls of BODY m; a drone that takes off ignores
    them.

    A drone brakes if another drone that may be near has been silent for USABLE s, or if more than
    half of the other drones that flew have been silent for SILENT s. It does not brake for this
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
        settings: Collision,
        traffic: Traffic,
        fence: Fence,
        a_max: float,
        v_max: float,
        ground: float,
    ) -> None:
        sx, sy, sz = settings.semi_axes
        self.traffic = traffic
        self.hearsay = Hearsay(traffic)
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
        self._planes = np.zeros((6 + MOST + 6, 4))
        self._near = np.zeros((MOST, 2))
        self._out = np.zeros(9)
        self._accelerates = np.zeros(14)
        self._turn = settings.turn
        self.side = Side(traffic.port.address)

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
        self._figures[WAITS], self._figures[TURN] = (
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
        self._accelerates[6:9], self._figures[WAITS], self._figures[TURN] = (
            a,
            1.0,
            self._turn,
        )
        return self._run(state, self._accelerates, gains, 0.0, now)

    def _run(
        self, state: State, reference: Vec, gains: Vec, follow: float, now: float
    ) -> Vec | None:
        traffic = self.traffic
        acts = _filtered(
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
