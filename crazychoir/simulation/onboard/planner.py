"""The high-level commander: take-off, landing, go_to, spiral and uploaded trajectories.

It computes in 32-bit floats.
"""

import math
from typing import NamedTuple

import numpy as np

from crazychoir.firmware.memories import TRAJECTORY_MEMORY
from crazychoir.firmware.planning import PLANNER_STATES
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.numerics.kernels import kernel, real
from crazychoir.numerics.math3d import (
    Triple,
    clip,
    dot,
    flat_attitude,
)
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES, clear_setpoint
from crazychoir.simulation.onboard.polynomial import (
    POLYNOMIAL_LAYOUT,
    SINGLE_NUMBERS,
    Single,
    connect_ends,
    evaluate_piece,
    float32,
    read_duration,
    unwrap_angle,
)
from crazychoir.simulation.onboard.record import (
    AXIS_MODES,
    Fleet,
    Record,
    rows,
    whole,
)
from crazychoir.simulation.onboard.units import FIRMWARE_GRAVITY


class PlanLimits(NamedTuple):
    """Unit and limits of the duration of a plan, and the bound on its values, as 32-bit floats."""

    tick_seconds: np.float32 = float32(1e-3)
    """s a tick."""
    shortest_duration: np.float32 = float32(1e-3)
    """Shortest duration of a plan in s; chosen. A shorter plan is at its end at once, as one of 0
    s.
    """
    longest_duration: np.float32 = float32(1e5)
    """Longest duration of a plan in s; chosen.

    For a longer plan the powers of degree 7 exceed 32 bits.
    """
    largest_value: np.float32 = float32(1e18)
    """Upper bound in m and rad for a plan and its derivatives; chosen.

    Below it no controller that follows the plan overflows.
    """


PLAN_LIMITS = PlanLimits()


@kernel()
def _read_uptime(fw: Record) -> Single:
    """Return the seconds since power-on, a 32-bit float with steps that grow with the uptime."""
    return float32(fw.tick) * PLAN_LIMITS.tick_seconds


@kernel()
def _read_memory_piece(fw: Record, slot: int, k: int) -> Single:
    """Return piece k of an uploaded trajectory."""
    start = fw.planner.offset[slot] + k * TRAJECTORY_MEMORY.piece_size
    return fw.memory[start : start + TRAJECTORY_MEMORY.piece_size]


@kernel()
def _count_pieces(fw: Record) -> int:
    return fw.planner.pieces[fw.planner.slot] if fw.planner.slot >= 0 else 1


@kernel()
def _read_piece(fw: Record, k: int) -> Single:
    return (
        _read_memory_piece(fw, fw.planner.slot, k)
        if fw.planner.slot >= 0
        else fw.planner.piece[0 : TRAJECTORY_MEMORY.piece_size]
    )


@kernel()
def _sum_durations(fw: Record) -> Single:
    """Return the duration of all pieces in s, with the time scale."""
    total = SINGLE_NUMBERS.zero
    for k in range(_count_pieces(fw)):
        total += read_duration(_read_piece(fw, k)) * fw.planner.timescale
    return total


@kernel()
def _evaluate_at(fw: Record, t: Single) -> Single:
    """Evaluate the coefficients t s after the beginning, with the time scale.

    Return True while the trajectory lasts; after its end the last point is evaluated.
    """
    plan = fw.planner
    last = _count_pieces(fw) - 1
    for k in range(last + 1):
        c = _read_piece(fw, k)
        length = read_duration(c) * plan.timescale
        if t <= length or k == last:
            inside = min(t, length)
            evaluate_piece(c, inside / plan.timescale, plan.out)
            return t <= length
        t -= length
    return False


@kernel()
def _scale_derivatives(fw: Record, moving: bool) -> None:
    """Apply the time scale and the direction to the derivatives; all are 0 after the end."""
    out = fw.planner.out
    s = fw.planner.timescale
    sign = -SINGLE_NUMBERS.one if fw.planner.reversed else SINGLE_NUMBERS.one
    for axis in range(POLYNOMIAL_LAYOUT.axis_count):
        out[POLYNOMIAL_LAYOUT.velocity + axis] = (
            out[POLYNOMIAL_LAYOUT.velocity + axis] * sign / s
            if moving
            else SINGLE_NUMBERS.zero
        )
        out[POLYNOMIAL_LAYOUT.acceleration + axis] = (
            out[POLYNOMIAL_LAYOUT.acceleration + axis] / (s * s)
            if moving
            else SINGLE_NUMBERS.zero
        )
        out[POLYNOMIAL_LAYOUT.jerk + axis] = (
            out[POLYNOMIAL_LAYOUT.jerk + axis] * sign / (s * s * s)
            if moving
            else SINGLE_NUMBERS.zero
        )


@kernel()
def _move_to_start(fw: Record) -> None:
    """Turn the point about the z axis of the trajectory's own coordinates, and shift it.

    As in the firmware, a trajectory that turns starts at the present place only if its own start
    is at the origin.
    """
    plan = fw.planner
    out = plan.out
    turn = plan.shift[3] - plan.origin[3]
    c = float32(math.cos(turn))
    s = float32(math.sin(turn))
    for order in range(0, 16, 4):
        x = out[order]
        y = out[order + 1]
        out[order] = c * x - s * y
        out[order + 1] = s * x + c * y
    for axis in range(3):
        out[axis] += plan.shift[axis] - plan.origin[axis]
    out[3] += turn


@kernel()
def sample_plan(fw: Record) -> bool:
    """Write the flat output at this moment to planner.out; return False if the plan has ended.

        x(t) = S - c(s_0) + Rz(Y) c(s),   v = dx/dt,   a = dv/dt
        s = (t - t0) / k;  if the plan is reversed, s = (duration of c) - (t - t0) / k

    c: the polynomials of the plan
    t0: start of the plan, s; there s = s_0
    k: time scale
    S, Y: for a relative trajectory, the position of its start, and its turn about z; else those of c
    """
    plan = fw.planner
    t = _read_uptime(fw) - plan.begin
    total = _sum_durations(fw)
    moving: bool = t <= total
    _evaluate_at(fw, max(total - t, SINGLE_NUMBERS.zero) if plan.reversed else t)
    _scale_derivatives(fw, moving)
    if plan.slot >= 0:
        _move_to_start(fw)
    return moving


@kernel()
def is_finished(fw: Record) -> bool:
    """Return True if no plan is being flown."""
    state = fw.planner.state
    if state == PLANNER_STATES.idle or state == PLANNER_STATES.disabled:
        return True
    ended: bool = _read_uptime(fw) - fw.planner.begin > _sum_durations(fw)
    return ended


@kernel()
def compute_flat_body_rates(
    a: Triple, j: Triple, yaw: float, yaw_rate: float
) -> Triple:
    """Return the body rates of a flat output, rad/s.

        h = (j - (j . z_b) z_b) / |a + g e3|,   w = (-h . y_b, h . x_b, z_b_z yaw')

    a: m/s2, world
    j: m/s3, world
    yaw: rad
    yaw_rate: yaw', rad/s
    Source: Mellinger & Kumar 2011, ICRA.
    """
    f = (a[0], a[1], a[2] + FIRMWARE_GRAVITY)
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
def _write_setpoint(fw: Record) -> None:
    """Write the evaluated point as a set-point: position and heading, with rates."""
    sp = fw.wanted
    out = fw.planner.out
    clear_setpoint(sp)
    sp.mode_x = sp.mode_y = sp.mode_z = sp.mode_yaw = AXIS_MODES.absolute
    sp.x = out[POLYNOMIAL_LAYOUT.position]
    sp.y = out[POLYNOMIAL_LAYOUT.position + 1]
    sp.z = out[POLYNOMIAL_LAYOUT.position + 2]
    sp.vx = out[POLYNOMIAL_LAYOUT.velocity]
    sp.vy = out[POLYNOMIAL_LAYOUT.velocity + 1]
    sp.vz = out[POLYNOMIAL_LAYOUT.velocity + 2]
    sp.ax = out[POLYNOMIAL_LAYOUT.acceleration]
    sp.ay = out[POLYNOMIAL_LAYOUT.acceleration + 1]
    sp.az = out[POLYNOMIAL_LAYOUT.acceleration + 2]
    sp.jx = out[POLYNOMIAL_LAYOUT.jerk]
    sp.jy = out[POLYNOMIAL_LAYOUT.jerk + 1]
    sp.jz = out[POLYNOMIAL_LAYOUT.jerk + 2]
    sp.yaw = math.degrees(out[POLYNOMIAL_LAYOUT.position + 3])
    w = compute_flat_body_rates(
        (sp.ax, sp.ay, sp.az),
        (sp.jx, sp.jy, sp.jz),
        float(out[POLYNOMIAL_LAYOUT.position + 3]),
        float(out[POLYNOMIAL_LAYOUT.velocity + 3]),
    )
    sp.roll_rate = math.degrees(w[0])
    sp.pitch_rate = math.degrees(w[1])
    sp.yaw_rate = math.degrees(w[2])


@kernel()
def take_state(fw: Record) -> None:
    """Start the next plan from the present estimate."""
    plan = fw.planner
    plan.last[0] = float32(fw.x)
    plan.last[1] = float32(fw.y)
    plan.last[2] = float32(fw.z)
    plan.last[3] = float32(math.radians(fw.yaw))
    plan.last_v[0] = float32(fw.vx)
    plan.last_v[1] = float32(fw.vy)
    plan.last_v[2] = float32(fw.vz)
    plan.last_v[3] = SINGLE_NUMBERS.zero


@kernel()
def update(fw: Record) -> None:
    """Update the set-point at 100 Hz: the plan's, or the null set-point while the planner is idle.

    Nothing is written while another source is in control, or while the planner is disabled: then
    the last set-point grows old.
    """
    plan = fw.planner
    own = fw.priority <= SETPOINT_PRIORITIES.high_level
    if plan.state == PLANNER_STATES.disabled:
        take_state(fw)
        return
    if plan.state == PLANNER_STATES.idle:
        take_state(fw)
        if own:
            clear_setpoint(fw.wanted)
    else:
        moving = sample_plan(fw)
        for axis in range(POLYNOMIAL_LAYOUT.axis_count):
            plan.last[axis], plan.last_v[axis] = (
                plan.out[POLYNOMIAL_LAYOUT.position + axis],
                plan.out[POLYNOMIAL_LAYOUT.velocity + axis],
            )
        if own:
            _write_setpoint(fw)
        if plan.state == PLANNER_STATES.landing and not moving:
            plan.state = PLANNER_STATES.idle
    if own:
        fw.priority = SETPOINT_PRIORITIES.high_level
        fw.stamp = fw.tick


@kernel(rows, whole)
def tell_state(fleet: Fleet, i: int) -> None:
    """Start the next plan from the present estimate."""
    take_state(fleet[i])


@kernel(rows, whole)
def stop(fleet: Fleet, i: int) -> None:
    """Discard the plan: the motors are off while the planner is in control."""
    fw = fleet[i]
    fw.planner.state = PLANNER_STATES.idle


@kernel()
def _is_flyable_duration(t: Single) -> bool:
    """Return True if a plan may last t s."""
    can: bool = PLAN_LIMITS.shortest_duration <= t <= PLAN_LIMITS.longest_duration
    return can


@kernel()
def _is_bounded(c: Single, timescale: Single) -> bool:
    """Return True if a piece and its derivatives stay below PLAN_LIMITS.largest_value.

    The sum of |c_n| T^n bounds them all.
    """
    bound = np.empty(TRAJECTORY_MEMORY.piece_size, np.float32)
    out = np.empty(16, np.float32)
    for n in range(TRAJECTORY_MEMORY.piece_size):
        bound[n] = abs(c[n])
    evaluate_piece(bound, read_duration(bound), out)
    scale = SINGLE_NUMBERS.one
    for order in range(0, 16, 4):
        for axis in range(POLYNOMIAL_LAYOUT.axis_count):
            if not out[order + axis] < PLAN_LIMITS.largest_value * scale:
                return False
        scale *= timescale
    return True


@kernel()
def _is_finite(piece: Single) -> bool:
    """Return True if all coefficients and the duration of a piece are finite."""
    total = 0.0
    for n in range(TRAJECTORY_MEMORY.piece_size):
        total += 0.0 * piece[n]  # 0, or NaN if the number is not finite
    finite: bool = total == 0.0
    return finite


@kernel()
def _start_plan(fw: Record, state: int) -> None:
    plan = fw.planner
    plan.state = state
    plan.begin = _read_uptime(fw)
    plan.slot = -1
    plan.timescale = SINGLE_NUMBERS.one
    plan.reversed = 0


@kernel()
def _begin_plan(fw: Record, state: int, piece: Single) -> int:
    """Begin a plan of one piece.

    A piece that is not finite is accepted, and disables the planner: its set-points are no numbers
    (crtp_commander_high_level.c).
    Choice of this model: return 1 if no drone can follow a finite piece; the plan before then
    continues.
    """
    if not _is_finite(piece):
        fw.planner.state = PLANNER_STATES.disabled
        return FIRMWARE_RESULTS.done
    t = read_duration(piece)
    if not (
        (t == SINGLE_NUMBERS.zero or _is_flyable_duration(t))
        and _is_bounded(piece, SINGLE_NUMBERS.one)
    ):
        return FIRMWARE_RESULTS.refused
    fw.planner.piece[0 : TRAJECTORY_MEMORY.piece_size] = piece
    _start_plan(fw, state)
    return FIRMWARE_RESULTS.done


@kernel()
def _evaluate_present_point(fw: Record) -> None:
    """Evaluate the present point of the plan; without a plan, the last set-point or state."""
    plan = fw.planner
    if plan.state == PLANNER_STATES.flying or plan.state == PLANNER_STATES.landing:
        sample_plan(fw)
        return
    for axis in range(POLYNOMIAL_LAYOUT.axis_count):
        (
            plan.out[POLYNOMIAL_LAYOUT.position + axis],
            plan.out[POLYNOMIAL_LAYOUT.velocity + axis],
        ) = plan.last[axis], plan.last_v[axis]
        plan.out[POLYNOMIAL_LAYOUT.acceleration + axis] = SINGLE_NUMBERS.zero


@kernel()
def _limit_duration(t: float) -> float:
    """Return the duration of a plan in s; a requested duration below PLAN_LIMITS.shortest_duration becomes 0."""
    return 0.0 if t < PLAN_LIMITS.shortest_duration else t


@kernel()
def _connect_axis(
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
    start[0] = fw.planner.out[POLYNOMIAL_LAYOUT.position + axis]
    start[1] = start_v
    start[2] = start_a
    end[0] = goal
    end[1] = end_v
    connect_ends(piece, axis, t, start, end)


@kernel()
def _begin_vertical_plan(
    fw: Record, state: int, height: float, t: float, yaw: float, keep_yaw: float
) -> int:
    """Begin a plan from the last set-point, at rest, to the height above the same place."""
    plan = fw.planner
    piece = np.zeros(TRAJECTORY_MEMORY.piece_size, np.float32)
    t = _limit_duration(t)
    for axis in range(POLYNOMIAL_LAYOUT.axis_count):
        plan.out[POLYNOMIAL_LAYOUT.position + axis] = plan.last[axis]
    for axis in range(3):
        _connect_axis(
            fw,
            piece,
            axis,
            float32(t),
            float32(height) if axis == 2 else plan.last[axis],
            SINGLE_NUMBERS.zero,
            SINGLE_NUMBERS.zero,
            SINGLE_NUMBERS.zero,
        )
    heading = (
        plan.last[3] if keep_yaw > 0.0 else unwrap_angle(plan.last[3], float32(yaw))
    )
    _connect_axis(
        fw,
        piece,
        3,
        float32(t),
        heading,
        SINGLE_NUMBERS.zero,
        SINGLE_NUMBERS.zero,
        SINGLE_NUMBERS.zero,
    )
    piece[TRAJECTORY_MEMORY.piece_size - 1] = float32(t)
    return _begin_plan(fw, state, piece)


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
    if fw.planner.state != PLANNER_STATES.idle:
        return FIRMWARE_RESULTS.refused
    speed = max(fw.planner.take_off_speed, 1e-3)
    return _begin_vertical_plan(
        fw,
        PLANNER_STATES.flying,
        height,
        abs(height - fw.planner.last[2]) / speed if t < 0.0 else t,
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
    if fw.planner.state == PLANNER_STATES.landing:
        return FIRMWARE_RESULTS.refused
    speed = max(fw.planner.landing_speed, 1e-3)
    return _begin_vertical_plan(
        fw,
        PLANNER_STATES.landing,
        height,
        abs(height - fw.planner.last[2]) / speed if t < 0.0 else t,
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
    _evaluate_present_point(fw)
    out = fw.planner.out
    piece = np.zeros(TRAJECTORY_MEMORY.piece_size, np.float32)
    t = _limit_duration(t)
    for axis in range(POLYNOMIAL_LAYOUT.axis_count):
        goal = float32((x, y, z, yaw)[axis])
        if relative > 0.0:
            goal += out[POLYNOMIAL_LAYOUT.position + axis]
        if axis == 3:
            goal = unwrap_angle(out[POLYNOMIAL_LAYOUT.position + 3], goal)
        if linear > 0.0 and t > 0.0:
            v = (goal - out[POLYNOMIAL_LAYOUT.position + axis]) / float32(t)
            _connect_axis(fw, piece, axis, float32(t), goal, v, v, SINGLE_NUMBERS.zero)
        else:
            _connect_axis(
                fw,
                piece,
                axis,
                float32(t),
                goal,
                SINGLE_NUMBERS.zero,
                out[POLYNOMIAL_LAYOUT.velocity + axis],
                out[POLYNOMIAL_LAYOUT.acceleration + axis],
            )
    piece[TRAJECTORY_MEMORY.piece_size - 1] = float32(t)
    return _begin_plan(fw, PLANNER_STATES.flying, piece)


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
    angle: rad, limited to a turn; a negative angle is flown backwards
    r0: m: radius at the beginning, at least 0
    r1: m: radius at the end, at least 0
    climb: m: change of the height
    t: s
    sideways: above 0 if the point lies ahead of a clockwise spiral and behind another; else it
        lies to the right of a clockwise spiral and to the left of another
    clockwise: above 0 to turn clockwise
    """
    fw = fleet[i]
    _evaluate_present_point(fw)
    out = fw.planner.out
    piece = np.zeros(TRAJECTORY_MEMORY.piece_size, np.float32)
    side = -1.0 if clockwise > 0.0 else 1.0
    turn = side * clip(angle, -2.0 * math.pi, 2.0 * math.pi)
    r0 = max(r0, 0.0)
    r1 = max(r1, 0.0)
    yaw = float(out[POLYNOMIAL_LAYOUT.position + 3])
    towards = yaw + 0.5 * math.pi * (1.0 + side if sideways > 0.0 else side)
    cx = float(out[POLYNOMIAL_LAYOUT.position]) + r0 * math.cos(towards)
    cy = float(out[POLYNOMIAL_LAYOUT.position + 1]) + r0 * math.sin(towards)
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
            row[0] = float32(centre + r * u)
            row[1] = float32(dr * u + r * w * n)
            row[2] = float32(2.0 * dr * w * n - r * w * w * u)
        connect_ends(piece, axis, float32(span), start, end)
    for axis in range(2, 4):
        gap = float32(climb) if axis == 2 else float32(turn)
        speed = gap / float32(span)
        _connect_axis(
            fw,
            piece,
            axis,
            float32(span),
            out[POLYNOMIAL_LAYOUT.position + axis] + gap,
            speed,
            speed,
            SINGLE_NUMBERS.zero,
        )
    piece[TRAJECTORY_MEMORY.piece_size - 1] = float32(span)
    return _begin_plan(fw, PLANNER_STATES.flying, piece)


@kernel()
def _is_finite_slot(fw: Record, k: int) -> bool:
    """Return True if all numbers of the pieces of slot k are finite."""
    finite = True
    for n in range(fw.planner.pieces[k]):
        finite = finite and _is_finite(_read_memory_piece(fw, k, n))
    return finite


@kernel()
def _is_flyable_slot(fw: Record, k: int, timescale: Single) -> bool:
    """Return True if a drone can follow the pieces of slot k at this time scale.

    An upload may contain any numbers.
    """
    total = SINGLE_NUMBERS.zero
    for n in range(fw.planner.pieces[k]):
        c = _read_memory_piece(fw, k, n)
        t = read_duration(c)
        if not (
            SINGLE_NUMBERS.zero <= t <= PLAN_LIMITS.longest_duration
            and _is_bounded(c, timescale)
        ):
            return False
        total += t * timescale
    return _is_flyable_duration(total)


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
    """Fly an uploaded trajectory; return an answer of FIRMWARE_RESULTS.

    The firmware answers 0 also if there is no such trajectory, and then does nothing. A trajectory
    with a number that is not finite, or a timescale that is not or is 0, disables the planner.
    Choice of this model: it returns 1 if no drone can follow the trajectory.
    slot: number of the trajectory
    timescale: factor on the duration; 2 takes twice the time
    relative: above 0 to shift the start to the present set-point
    relative_yaw: above 0 to turn a relative trajectory to the present heading; it turns about the
        origin of its own coordinates
    backwards: above 0 to fly from the end to the start
    """
    fw = fleet[i]
    plan = fw.planner
    k = int(slot)
    if k < 0 or k >= TRAJECTORY_MEMORY.slot_count or plan.pieces[k] == 0:
        return FIRMWARE_RESULTS.done
    if not (_is_finite_slot(fw, k) and math.isfinite(timescale) and timescale != 0.0):
        plan.state = PLANNER_STATES.disabled
        return FIRMWARE_RESULTS.done
    if timescale < 0.0 or not _is_flyable_slot(fw, k, float32(timescale)):
        return FIRMWARE_RESULTS.refused
    _evaluate_present_point(fw)
    here = plan.out[0:4].copy()
    _start_plan(fw, PLANNER_STATES.flying)
    plan.slot = k
    plan.timescale = float32(timescale)
    plan.reversed = 1 if backwards > 0.0 else 0
    _evaluate_at(fw, _sum_durations(fw) if plan.reversed else SINGLE_NUMBERS.zero)
    for axis in range(POLYNOMIAL_LAYOUT.axis_count):
        plan.origin[axis] = plan.out[POLYNOMIAL_LAYOUT.position + axis]
        moved = relative > 0.0 and axis < 3
        plan.shift[axis] = here[axis] if moved else plan.origin[axis]
    if relative > 0.0 and relative_yaw > 0.0:
        plan.shift[3] = unwrap_angle(plan.origin[3], here[3])
    return FIRMWARE_RESULTS.done
