"""The high-level commander: take-off, landing, go_to, spiral and uploaded trajectories.

It computes in 32-bit floats.
"""

import math

import numpy as np

from crazychoir.numerics.kernels import kernel, real
from crazychoir.numerics.math3d import GRAVITY, Triple, dot, flat_attitude
from crazychoir.simulation.onboard.commander import HIGH_LEVEL, clear
from crazychoir.simulation.onboard.polynomial import (
    AXES,
    ONE,
    ZERO,
    A,
    F,
    J,
    P,
    Single,
    V,
    connect,
    duration,
    evaluate,
    short_way,
)
from crazychoir.simulation.onboard.record import (
    ABSOLUTE,
    PIECE,
    TRAJECTORIES,
    Fleet,
    Record,
    rows,
    whole,
)

# States of the planner.
IDLE = 0
FLYING = 1
LANDING = 2
# Answers of the planner.
OK = 0  # done
REFUSED = 1  # not possible in this state
UNKNOWN = 8  # no such trajectory
BUSY = 16  # the supervisor does not allow flight
SECONDS = F(1e-3)  # s a tick
SHORTEST = F(1e-3)
"""Shortest duration of a plan in s; chosen. A shorter plan is at its end at once, as one of 0 s."""
LONGEST = F(1e5)
"""Longest duration of a plan in s; chosen.

For a longer plan the powers of degree 7 exceed 32 bits.
"""
MOST = F(1e18)
"""Upper bound in m and rad for a plan and its derivatives; chosen.

Below it no controller that follows the plan overflows.
"""


@kernel()
def _now(fw: Record) -> Single:
    """Return the seconds since power-on, a 32-bit float with steps that grow with the uptime."""
    return F(fw.tick) * SECONDS


@kernel()
def _memory_piece(fw: Record, slot: int, k: int) -> Single:
    """Return piece k of an uploaded trajectory."""
    start = fw.planner.offset[slot] + k * PIECE
    return fw.memory[start : start + PIECE]


@kernel()
def _count(fw: Record) -> int:
    return fw.planner.pieces[fw.planner.slot] if fw.planner.slot >= 0 else 1


@kernel()
def _piece(fw: Record, k: int) -> Single:
    return (
        _memory_piece(fw, fw.planner.slot, k)
        if fw.planner.slot >= 0
        else fw.planner.piece[0:PIECE]
    )


@kernel()
def _total(fw: Record) -> Single:
    """Return the duration of all pieces in s, with the time scale."""
    total = ZERO
    for k in range(_count(fw)):
        total += duration(_piece(fw, k)) * fw.planner.timescale
    return total


@kernel()
def _find(fw: Record, t: Single) -> Single:
    """Evaluate the coefficients t s after the beginning, with the time scale.

    Return True while the trajectory lasts; after its end the last point is evaluated.
    """
    plan = fw.planner
    last = _count(fw) - 1
    for k in range(last + 1):
        c = _piece(fw, k)
        length = duration(c) * plan.timescale
        if t <= length or k == last:
            inside = min(t, length)
            evaluate(c, inside / plan.timescale, plan.out)
            return t <= length
        t -= length
    return False


@kernel()
def _stretch(fw: Record, moving: bool) -> None:
    """Apply the time scale and the direction to the derivatives; all are 0 after the end."""
    out = fw.planner.out
    s = fw.planner.timescale
    sign = -ONE if fw.planner.reversed else ONE
    for axis in range(AXES):
        out[V + axis] = out[V + axis] * sign / s if moving else ZERO
        out[A + axis] = out[A + axis] / (s * s) if moving else ZERO
        out[J + axis] = out[J + axis] * sign / (s * s * s) if moving else ZERO


@kernel()
def _move(fw: Record) -> None:
    """Move the point from the trajectory's own start to its start in flight: turn about z, shift."""
    plan = fw.planner
    out = plan.out
    turn = plan.shift[3] - plan.origin[3]
    c = F(math.cos(turn))
    s = F(math.sin(turn))
    for order in range(0, 16, 4):
        x = out[order]
        y = out[order + 1]
        if order == P:
            x = x - plan.origin[0]
            y = y - plan.origin[1]
        out[order] = c * x - s * y
        out[order + 1] = s * x + c * y
    out[0] += plan.shift[0]
    out[1] += plan.shift[1]
    out[2] += plan.shift[2] - plan.origin[2]
    out[3] += turn


@kernel()
def sample(fw: Record) -> bool:
    """Write the flat output at this moment to planner.out; return False if the plan has ended.

        x(t) = S + Rz(Y) (c((t - t0) / k) - c(0)),  v = x'/k, a = x''/k^2
        reversed: c at the end minus t

    k: time scale
    S, Y: position and heading at the start of a relative trajectory, else those of c itself
    """
    plan = fw.planner
    t = _now(fw) - plan.begin
    total = _total(fw)
    moving: bool = t <= total
    _find(fw, max(total - t, ZERO) if plan.reversed else t)
    _stretch(fw, moving)
    if plan.slot >= 0:
        _move(fw)
    return moving


@kernel()
def finished(fw: Record) -> bool:
    """Return True if no plan is being flown."""
    ended: bool = fw.planner.state == IDLE or _now(fw) - fw.planner.begin > _total(fw)
    return ended


@kernel()
def body_rates(a: Triple, j: Triple, yaw: float, yaw_rate: float) -> Triple:
    """Return the body rates of a flat output, rad/s.

        h = (j - (j . z_b) z_b) / |a + g e3|,   w = (-h . y_b, h . x_b, z_b_z yaw')

    a: m/s2, world
    j: m/s3, world
    yaw: rad
    yaw_rate: yaw', rad/s
    Source: Mellinger & Kumar 2011, ICRA.
    """
    f = (a[0], a[1], a[2] + GRAVITY)
    x, y, z = flat_attitude(f, yaw)
    n = math.sqrt(dot(f, f))
    if n < 1e-6:
        return 0.0, 0.0, yaw_rate
    along = dot(j, z)
    h = (
        (j[0] - along * z[0]) / n,
        (j[1] - along * z[1]) / n,
        (j[2] - along * z[2]) / n,
    )
    return -dot(h, y), dot(h, x), z[2] * yaw_rate


@kernel()
def _emit(fw: Record) -> None:
    """Write the evaluated point as a set-point: position and heading, with rates."""
    sp = fw.wanted
    out = fw.planner.out
    clear(sp)
    sp.mode_x = sp.mode_y = sp.mode_z = sp.mode_yaw = ABSOLUTE
    sp.x = out[P]
    sp.y = out[P + 1]
    sp.z = out[P + 2]
    sp.vx = out[V]
    sp.vy = out[V + 1]
    sp.vz = out[V + 2]
    sp.ax = out[A]
    sp.ay = out[A + 1]
    sp.az = out[A + 2]
    sp.jx = out[J]
    sp.jy = out[J + 1]
    sp.jz = out[J + 2]
    sp.yaw = math.degrees(out[P + 3])
    w = body_rates(
        (sp.ax, sp.ay, sp.az),
        (sp.jx, sp.jy, sp.jz),
        float(out[P + 3]),
        float(out[V + 3]),
    )
    sp.roll_rate = math.degrees(w[0])
    sp.pitch_rate = math.degrees(w[1])
    sp.yaw_rate = math.degrees(w[2])


@kernel()
def take_state(fw: Record) -> None:
    """Start the next plan from the present estimate."""
    plan = fw.planner
    plan.last[0] = F(fw.x)
    plan.last[1] = F(fw.y)
    plan.last[2] = F(fw.z)
    plan.last[3] = F(math.radians(fw.yaw))
    plan.last_v[0] = F(fw.vx)
    plan.last_v[1] = F(fw.vy)
    plan.last_v[2] = F(fw.vz)
    plan.last_v[3] = ZERO


@kernel()
def update(fw: Record) -> None:
    """Update the set-point at 100 Hz: the plan's, or the null set-point while the planner is idle.

    Nothing is written while another source is in control.
    """
    plan = fw.planner
    own = fw.priority <= HIGH_LEVEL
    if plan.state == IDLE:
        take_state(fw)
        if own:
            clear(fw.wanted)
    else:
        moving = sample(fw)
        for axis in range(AXES):
            plan.last[axis], plan.last_v[axis] = plan.out[P + axis], plan.out[V + axis]
        if own:
            _emit(fw)
        if plan.state == LANDING and not moving:
            plan.state = IDLE
    if own:
        fw.priority = HIGH_LEVEL
        fw.stamp = fw.tick


@kernel(rows, whole)
def tell_state(fleet: Fleet, i: int) -> None:
    """Start the next plan from the present estimate."""
    take_state(fleet[i])


@kernel(rows, whole)
def stop(fleet: Fleet, i: int) -> None:
    """Discard the plan: the motors are off while the planner is in control."""
    fw = fleet[i]
    fw.planner.state = IDLE


@kernel()
def _lasts(t: Single) -> bool:
    """Return True if a plan may last t s."""
    can: bool = SHORTEST <= t <= LONGEST
    return can


@kernel()
def _bounded(c: Single, timescale: Single) -> bool:
    """Return True if a piece and its derivatives stay below MOST: sum |c_n| T^n bounds them all."""
    bound = np.empty(PIECE, np.float32)
    out = np.empty(16, np.float32)
    for n in range(PIECE):
        bound[n] = abs(c[n])
    evaluate(bound, duration(bound), out)
    scale = ONE
    for order in range(0, 16, 4):
        for axis in range(AXES):
            if not out[order + axis] < MOST * scale:
                return False
        scale *= timescale
    return True


@kernel()
def _start(fw: Record, state: int) -> None:
    plan = fw.planner
    plan.state, plan.begin, plan.slot, plan.timescale, plan.reversed = (
        state,
        _now(fw),
        -1,
        ONE,
        0,
    )


@kernel()
def _fly(fw: Record, state: int, piece: Single) -> int:
    """Begin a plan of one piece.

    Chosen: return 1 if no drone can follow it; the plan before then continues.
    """
    t = duration(piece)
    if not ((t == ZERO or _lasts(t)) and _bounded(piece, ONE)):
        return REFUSED
    fw.planner.piece[0:PIECE] = piece
    _start(fw, state)
    return OK


@kernel()
def _here(fw: Record) -> None:
    """Evaluate the present point of the plan; without a plan, the last set-point or state."""
    plan = fw.planner
    if plan.state == FLYING or plan.state == LANDING:
        sample(fw)
        return
    for axis in range(AXES):
        plan.out[P + axis], plan.out[V + axis] = plan.last[axis], plan.last_v[axis]
        plan.out[A + axis] = ZERO


@kernel()
def _span(t: float) -> float:
    """Return the duration of a plan in s; a requested duration below SHORTEST becomes 0."""
    return 0.0 if t < SHORTEST else t


@kernel()
def _to(
    fw: Record,
    piece: Single,
    axis: int,
    t: Single,
    goal: Single,
    end_v: Single,
    start_v: Single,
    start_a: Single,
) -> None:
    start = np.zeros(3, np.float32)
    end = np.zeros(3, np.float32)
    start[0] = fw.planner.out[P + axis]
    start[1] = start_v
    start[2] = start_a
    end[0] = goal
    end[1] = end_v
    connect(piece, axis, t, start, end)


@kernel()
def _vertical(
    fw: Record, state: int, height: float, t: float, yaw: float, keep_yaw: float
) -> int:
    """Begin a plan from the last set-point, at rest, to the height above the same place."""
    plan = fw.planner
    piece = np.zeros(PIECE, np.float32)
    t = _span(t)
    for axis in range(AXES):
        plan.out[P + axis] = plan.last[axis]
    for axis in range(3):
        _to(
            fw,
            piece,
            axis,
            F(t),
            F(height) if axis == 2 else plan.last[axis],
            ZERO,
            ZERO,
            ZERO,
        )
    heading = plan.last[3] if keep_yaw > 0.0 else short_way(plan.last[3], F(yaw))
    _to(fw, piece, 3, F(t), heading, ZERO, ZERO, ZERO)
    piece[PIECE - 1] = F(max(t, 0.0))
    return _fly(fw, state, piece)


@kernel(rows, whole, real, real, real, real)
def take_off(
    fleet: Fleet, i: int, height: float, t: float, yaw: float, keep_yaw: float
) -> int:
    """Rise to a height; return 1 if the planner is not idle.

    height: m, world
    t: s; below 0: from the speed hlCommander.vtoff
    yaw: rad: heading at the end
    keep_yaw: above 0 to keep the heading
    """
    fw = fleet[i]
    if fw.planner.state != IDLE:
        return REFUSED
    speed = max(fw.planner.take_off_speed, 1e-3)
    return _vertical(
        fw,
        FLYING,
        height,
        t if t >= 0.0 else abs(height - fw.planner.last[2]) / speed,
        yaw,
        keep_yaw,
    )


@kernel(rows, whole, real, real, real, real)
def land(
    fleet: Fleet, i: int, height: float, t: float, yaw: float, keep_yaw: float
) -> int:
    """Descend to a height, then be idle; return 1 if the drone is already landing.

    It is possible from idle too: a drone that followed streamed set-points is told to land first,
    and then that the set-points have ended.
    height: m, world
    t: s; below 0: from the speed hlCommander.vland
    yaw: rad: heading at the end
    keep_yaw: above 0 to keep the heading
    """
    fw = fleet[i]
    if fw.planner.state == LANDING:
        return REFUSED
    speed = max(fw.planner.landing_speed, 1e-3)
    return _vertical(
        fw,
        LANDING,
        height,
        t if t >= 0.0 else abs(height - fw.planner.last[2]) / speed,
        yaw,
        keep_yaw,
    )


@kernel(rows, whole, real, real, real, real, real, real, real)
def go_to(
    fleet: Fleet,
    i: int,
    x: float,
    y: float,
    z: float,
    yaw: float,
    t: float,
    relative: float,
    linear: float,
) -> int:
    """Fly from the present set-point, with its velocity and acceleration, to a place at rest.

    x, y, z: m, world
    yaw: rad
    t: s
    relative: above 0 to add x, y, z, yaw to the present set-point
    linear: above 0 for a straight line with constant velocity, also at both ends
    """
    fw = fleet[i]
    _here(fw)
    out = fw.planner.out
    piece = np.zeros(PIECE, np.float32)
    t = _span(t)
    for axis in range(AXES):
        goal = F((x, y, z, yaw)[axis])
        if relative > 0.0:
            goal += out[P + axis]
        if axis == 3:
            goal = short_way(out[P + 3], goal)
        if linear > 0.0 and t > 0.0:
            v = (goal - out[P + axis]) / F(t)
            _to(fw, piece, axis, F(t), goal, v, v, ZERO)
        else:
            _to(fw, piece, axis, F(t), goal, ZERO, out[V + axis], out[A + axis])
    piece[PIECE - 1] = F(max(t, 0.0))
    return _fly(fw, FLYING, piece)


@kernel(rows, whole, real, real, real, real, real, real, real)
def spiral(
    fleet: Fleet,
    i: int,
    angle: float,
    r0: float,
    r1: float,
    climb: float,
    t: float,
    sideways: float,
    clockwise: float,
) -> int:
    """Fly one piece of degree 7 from radius r0 to r1 through an angle about a point.

    Chosen, as the ends of the spiral of constant speed: at both ends the place, velocity and
    acceleration are those of

        r(s) = r0 + (r1 - r0) s,  phi(s) = +-angle s,  s = t/T

    and the heading turns with it. In between, the piece is not a circle; it is meant for angles up
    to half a turn.
    angle: rad
    r0: m: radius at the beginning
    r1: m: radius at the end
    climb: m: change of the height
    t: s
    sideways: above 0 if the point lies ahead, else it lies to the side
    clockwise: above 0 to turn clockwise
    """
    fw = fleet[i]
    _here(fw)
    out = fw.planner.out
    piece = np.zeros(PIECE, np.float32)
    turn = -abs(angle) if clockwise > 0.0 else abs(angle)
    yaw = float(out[P + 3])
    towards = yaw if sideways > 0.0 else yaw + math.copysign(0.5 * math.pi, turn)
    cx = float(out[P]) + r0 * math.cos(towards)
    cy = float(out[P + 1]) + r0 * math.sin(towards)
    begin = towards + math.pi
    span = max(t, 1e-3)
    dr = (r1 - r0) / span
    w = turn / span
    start = np.zeros(3, np.float32)
    end = np.zeros(3, np.float32)
    for axis in range(2):
        centre = cy if axis else cx
        for stage in range(2):
            r, phi = (r1, begin + turn) if stage else (r0, begin)
            u = math.sin(phi) if axis else math.cos(phi)
            n = math.cos(phi) if axis else -math.sin(phi)
            row = end if stage else start
            row[0] = F(centre + r * u)
            row[1] = F(dr * u + r * w * n)
            row[2] = F(2.0 * dr * w * n - r * w * w * u)
        connect(piece, axis, F(span), start, end)
    for axis in range(2, 4):
        gap = F(climb) if axis == 2 else F(turn)
        speed = gap / F(span)
        _to(fw, piece, axis, F(span), out[P + axis] + gap, speed, speed, ZERO)
    piece[PIECE - 1] = F(span)
    return _fly(fw, FLYING, piece)


@kernel()
def _possible(fw: Record, k: int, timescale: Single) -> bool:
    """Return True if a drone can follow the pieces of slot k at this time scale.

    An upload may contain any numbers.
    """
    total = ZERO
    for n in range(fw.planner.pieces[k]):
        c = _memory_piece(fw, k, n)
        t = duration(c)
        if not (ZERO <= t <= LONGEST and _bounded(c, timescale)):
            return False
        total += t * timescale
    return _lasts(total)


@kernel(rows, whole, real, real, real, real, real)
def start_trajectory(
    fleet: Fleet,
    i: int,
    slot: float,
    timescale: float,
    relative: float,
    relative_yaw: float,
    backwards: float,
) -> int:
    """Fly an uploaded trajectory; return 8 if there is none.

    Chosen: return 1 if no drone can follow it.
    timescale: 2 takes twice the time
    relative: above 0 to shift it to the present set-point
    relative_yaw: above 0 to turn it to the present heading about its start (chosen)
    backwards: above 0 to fly it from its end to its start
    """
    fw = fleet[i]
    plan = fw.planner
    k = int(slot)
    if k < 0 or k >= TRAJECTORIES or plan.pieces[k] == 0 or not timescale > 0.0:
        return UNKNOWN
    if not _possible(fw, k, F(timescale)):
        return REFUSED
    _here(fw)
    here = plan.out[0:4].copy()
    _start(fw, FLYING)
    plan.slot = k
    plan.timescale = F(timescale)
    plan.reversed = 1 if backwards > 0.0 else 0
    _find(fw, _total(fw) if plan.reversed else ZERO)
    for axis in range(AXES):
        moved = relative_yaw if axis == 3 else relative
        plan.origin[axis] = plan.out[P + axis]
        plan.shift[axis] = here[axis] if moved > 0.0 else plan.origin[axis]
    if relative_yaw > 0.0:
        plan.shift[3] = short_way(plan.origin[3], here[3])
    return OK
