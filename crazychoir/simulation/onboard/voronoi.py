"""Collision avoidance on board: set-points are kept inside the drone's buffered Voronoi cell.

The cell is the set of places, relative to the drone, that stay on its side of every peer. It is
described by faces n . x <= b with unit normals n. Six more faces are those of a box: of the flight
area, and of the distance that the drone may fly within the horizon.

Source: Zhou, Wang, Bandyopadhyay & Schwager 2017, IEEE RA-L 2(2), buffered Voronoi cells; the
order of the steps: crazyflie-firmware, collision_avoidance.c.
"""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import kernel, real
from crazychoir.numerics.math3d import Triple, dot
from crazychoir.simulation.onboard.record import (
    AVOIDANCE_MEMORY,
    AXIS_MODES,
    Fleet,
    Record,
    rows,
    whole,
)


class CellSettings(NamedTuple):
    """Figures of the buffered Voronoi cell that are not parameters."""

    inside_tolerances: float = 10.0
    """Tolerances of the projection by which a place may lie outside and still count as inside."""
    change_share: float = 0.1
    """Share of the squared tolerance of all faces below which Dykstra's projection ends."""


CELL_SETTINGS = CellSettings()
PRESENT_PLACE = (0.0, 0.0, 0.0)
"""The place of the drone, relative to itself."""


@kernel(rows, whole, whole, real, real, real)
def hear_peer(fleet: Fleet, i: int, number: int, x: float, y: float, z: float) -> None:
    """Remember the position of another drone.

    As in the firmware, AVOIDANCE_MEMORY.peer_count drones have a place in the memory, and none is
    forgotten; a drone without a place is ignored, and so is the number 0.

    number: last byte of the other drone's address
    x, y, z: m, world
    """
    fw = fleet[i]
    av = fw.avoidance
    for k in range(AVOIDANCE_MEMORY.peer_count):
        if av.peers[k] == 0 or av.peers[k] == number:
            av.peers[k] = number
            av.positions[k, 0] = x
            av.positions[k, 1] = y
            av.positions[k, 2] = z
            av.heard_at[k] = fw.tick
            return


@kernel()
def _add_face(av: Record, x: float, y: float, z: float, bound: float) -> None:
    """Add the face n . x <= bound with the unit normal n = (x, y, z)."""
    k = av.faces
    av.normals[k, 0] = x
    av.normals[k, 1] = y
    av.normals[k, 2] = z
    av.bounds[k] = bound
    av.faces = k + 1


@kernel()
def _add_peer_face(av: Record, x: float, y: float, z: float) -> None:
    """Add the face between the drone and a peer at (x, y, z) m relative to it.

        n = E^-2 d / |E^-2 d|,   b = (|E^-1 d| / 2 - 1) |E^-1 d| / |E^-2 d|

    d: m: place of the peer
    E: radii of the ellipsoid, m: half of the least distance on each axis
    """
    sx = x / av.radius_x
    sy = y / av.radius_y
    sz = z / av.radius_z
    distance = math.sqrt(sx * sx + sy * sy + sz * sz)
    nx = sx / av.radius_x
    ny = sy / av.radius_y
    nz = sz / av.radius_z
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    _add_face(
        av,
        nx / length,
        ny / length,
        nz / length,
        (0.5 * distance - 1.0) * distance / length,
    )


@kernel()
def _write_cell(fw: Record) -> None:
    """Write the faces of the cell: those of the peers heard lately, then those of the box."""
    av = fw.avoidance
    av.faces = 0
    for k in range(AVOIDANCE_MEMORY.peer_count):
        late = av.peer_age >= 0 and fw.tick - av.heard_at[k] > av.peer_age
        if av.peers[k] != 0 and not late:
            p = av.positions
            _add_peer_face(av, p[k, 0] - fw.x, p[k, 1] - fw.y, p[k, 2] - fw.z)
    far = av.horizon * av.speed
    _add_face(av, 1.0, 0.0, 0.0, min(far, av.box_max_x - fw.x))
    _add_face(av, 0.0, 1.0, 0.0, min(far, av.box_max_y - fw.y))
    _add_face(av, 0.0, 0.0, 1.0, min(far, av.box_max_z - fw.z))
    _add_face(av, -1.0, 0.0, 0.0, min(far, fw.x - av.box_min_x))
    _add_face(av, 0.0, -1.0, 0.0, min(far, fw.y - av.box_min_y))
    _add_face(av, 0.0, 0.0, -1.0, min(far, fw.z - av.box_min_z))


@kernel()
def _normal(av: Record, k: int) -> Triple:
    return av.normals[k, 0], av.normals[k, 1], av.normals[k, 2]


@kernel()
def _measure_excess(av: Record, p: Triple) -> float:
    """Return how far p is outside the face that it violates most, m; not above 0 in the cell."""
    excess = -math.inf
    for k in range(av.faces):
        excess = max(excess, dot(_normal(av, k), p) - av.bounds[k])
    return excess


@kernel()
def _is_inside(av: Record, p: Triple) -> bool:
    """Return whether p counts as inside the cell."""
    most = CELL_SETTINGS.inside_tolerances * av.tolerance
    return bool(_measure_excess(av, p) <= most)


@kernel()
def _measure_way(av: Record, start: Triple, way: Triple) -> float:
    """Return the share of a way from a place in the cell at which it meets a face.

    It is infinite if the way meets no face, and negative from a place outside.
    """
    share = math.inf
    for k in range(av.faces):
        speed = dot(_normal(av, k), way)
        if speed > 0.0:
            share = min(share, (av.bounds[k] - dot(_normal(av, k), start)) / speed)
    return share


@kernel()
def _project_once(av: Record, p: Triple) -> tuple[Triple, float]:
    """Make one pass of Dykstra's algorithm; return the place and the sum of squared changes.

        y = x - z_k,  x <- y - max(n_k . y - b_k, 0) n_k,  z_k <- x - y

    p: m: x before the pass
    """
    x, y, z = p
    changes = 0.0
    c = av.corrections
    for k in range(av.faces):
        n = _normal(av, k)
        free = (x - c[k, 0], y - c[k, 1], z - c[k, 2])
        excess = max(dot(n, free) - av.bounds[k], 0.0)
        change = (-excess * n[0], -excess * n[1], -excess * n[2])
        changes += (
            (change[0] - c[k, 0]) ** 2
            + (change[1] - c[k, 1]) ** 2
            + (change[2] - c[k, 2]) ** 2
        )
        c[k, 0], c[k, 1], c[k, 2] = change
        x = free[0] + change[0]
        y = free[1] + change[1]
        z = free[2] + change[2]
    return (x, y, z), changes


@kernel()
def _project(av: Record, p: Triple) -> Triple:
    """Return the place in the cell nearest to p, by Dykstra's algorithm.

    It ends when the corrections of all faces change little, or after av.passes passes; the place
    may then be outside.
    Source: Boyle & Dykstra 1986; end: Birgin & Raydan 2005, SIAM J. Sci. Comput. 26(4).
    """
    if _measure_excess(av, p) <= av.tolerance:
        return p
    for k in range(av.faces):
        av.corrections[k, 0] = 0.0
        av.corrections[k, 1] = 0.0
        av.corrections[k, 2] = 0.0
    least = CELL_SETTINGS.change_share * av.faces * av.tolerance**2
    for _ in range(av.passes):
        p, changes = _project_once(av, p)
        if changes < least:
            break
    return p


@kernel()
def _choose_goal(av: Record, goal: Triple, anyway: bool) -> Triple:
    """Return the place in the cell to fly to instead of a goal.

    Near a wall on its way the drone steps aside to its right, so that two drones that face each
    other do not wait for each other:

        goal <- goal + (1 - s / s_0)^2 goal x e_3

    s: m: distance to the wall along the way to the goal
    s_0: m: av.sidestep
    anyway: step aside for a wall behind the goal as well, as for a velocity
    """
    share = _measure_way(av, PRESENT_PLACE, goal)
    if share >= 1.0 and not anyway:
        return goal
    free = share * math.sqrt(dot(goal, goal))
    if free <= av.sidestep:
        aside = (1.0 - free / av.sidestep) ** 2
        goal = (goal[0] + aside * goal[1], goal[1] - aside * goal[0], goal[2])
    return _project(av, goal)


@kernel()
def _keep_place(fw: Record, x: float, y: float, z: float) -> None:
    """Remember the place to stay at while the cell is empty."""
    av = fw.avoidance
    av.kept_x = x
    av.kept_y = y
    av.kept_z = z


@kernel()
def _write_velocity(sp: Record, v: Triple, scale: float) -> None:
    sp.vx = scale * v[0]
    sp.vy = scale * v[1]
    sp.vz = scale * v[2]


@kernel()
def _limit_velocity(fw: Record, sp: Record) -> None:
    """Change a velocity so that the drone stays in its cell until the horizon.

    A drone outside its cell flies back to it; without a place to fly to, it stands still.
    """
    av = fw.avoidance
    t = av.horizon
    if _is_inside(av, PRESENT_PLACE):
        goal = _choose_goal(av, (t * sp.vx, t * sp.vy, t * sp.vz), True)
        scale = 1.0 / t
    else:
        goal = _project(av, PRESENT_PLACE)
        distance = math.sqrt(dot(goal, goal))
        scale = av.speed / distance if distance > av.speed else 1.0
    _write_velocity(sp, goal, scale if _is_inside(av, goal) else 0.0)
    _keep_place(fw, fw.x, fw.y, fw.z)


@kernel()
def _stay(fw: Record, sp: Record) -> None:
    """Stay at the last place that was in the cell, or here without one."""
    av = fw.avoidance
    if math.isnan(av.kept_x + av.kept_y + av.kept_z):
        _keep_place(fw, fw.x, fw.y, fw.z)
    sp.x = av.kept_x
    sp.y = av.kept_y
    sp.z = av.kept_z
    _write_velocity(sp, PRESENT_PLACE, 0.0)


@kernel()
def _limit_place(fw: Record, sp: Record) -> None:
    """Change a place, or a place with a velocity, to one in the cell.

    A place that is changed has no velocity; else the velocity is reduced so that the drone stays in
    the cell for 1 s.
    """
    av = fw.avoidance
    wish = (sp.x - fw.x, sp.y - fw.y, sp.z - fw.z)
    goal = _choose_goal(av, wish, False)
    changed = goal[0] != wish[0] or goal[1] != wish[1] or goal[2] != wish[2]
    v = (sp.vx, sp.vy, sp.vz)
    if not _is_inside(av, goal):
        _stay(fw, sp)
    elif changed:
        sp.x = fw.x + goal[0]
        sp.y = fw.y + goal[1]
        sp.z = fw.z + goal[2]
        _write_velocity(sp, PRESENT_PLACE, 0.0)
    elif dot(v, v) > 0.0:
        _write_velocity(sp, v, min(_measure_way(av, wish, v), 1.0))
    _keep_place(fw, sp.x, sp.y, sp.z)


@kernel()
def avoid_peers(fw: Record) -> None:
    """Write fw.avoided: the set-point fw.wanted, changed so that the drone avoids its peers.

    By its mode along x, a set-point is a place or a velocity on all axes; any other is not changed.
    """
    fw.avoided = fw.wanted
    sp = fw.avoided
    if sp.mode_x == AXIS_MODES.velocity:
        _write_cell(fw)
        _limit_velocity(fw, sp)
    elif sp.mode_x == AXIS_MODES.absolute:
        _write_cell(fw)
        _limit_place(fw, sp)
