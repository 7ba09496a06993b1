"""The compiled stages of a tick that belong to flight: judge what is quiet, follow, turn to evade."""

import math

from crazychoir.control.position import FLATNESS_LAYOUT
from crazychoir.control.rows import (
    CONTROL_ROW,
    INPUT_SIZE,
    CompiledControllerKind,
    fly_controller,
)
from crazychoir.filters.row_filter import estimate_row
from crazychoir.filters.rows import FILTER_ROW, FilterRows, histories
from crazychoir.flight.batch import (
    DRONE_ROW,
    MODE_NUMBERS,
    Course,
    DroneRows,
    FlightControllerKind,
    FlightReferenceKind,
)
from crazychoir.flight.clearance import CLEARANCE_TIMES, PLAN_DEVIATION
from crazychoir.flight.estimate import write_believed_state
from crazychoir.flight.flight_limits import SEEN_AGE, TOUCHDOWN_LIMITS
from crazychoir.numerics.kernels import (
    NO_COUNTING,
    Record,
    Records,
    kernel,
    memory,
    real,
    rows_of,
    table,
    whole,
    wholes,
)
from crazychoir.planning.plan_row import (
    PLAN_ROW,
    PlanKind,
    PlanRows,
    has_pieces,
    is_plan_over,
    sample_plan,
)
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import LISTENER_ROW, MOTION_ROW
from crazychoir.safety.airspace.hearing import is_valid_acceleration
from crazychoir.safety.collision.avoidance import AVOID_ROW, avoid_row
from crazychoir.safety.rules.guard import GUARD_ROW, Action, GuardRows, is_quiet
from crazychoir.safety.rules.limits import cut_full_state
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Ints, Mat, Vec

GROUND_NUMBER = MODE_NUMBERS[Mode.GROUND]
TAKEOFF_NUMBER = MODE_NUMBERS[Mode.TAKEOFF]
FOLLOW_NUMBER = MODE_NUMBERS[Mode.FOLLOW]
HOVER_NUMBER = MODE_NUMBERS[Mode.HOVER]
RETURN_NUMBER = MODE_NUMBERS[Mode.RETURN]
LAND_NUMBER = MODE_NUMBERS[Mode.LAND]
CUT_NUMBER = MODE_NUMBERS[Mode.CUT]
NO_REFERENCE_AGE = -1.0
"""Age that says that the drone needs no reference."""


@kernel()
def _write_believed_flight(
    drone: Record, plan: Record, now: float, planned: Vec
) -> None:
    """Assume that an unseen drone is where it should be, if its filter does not know its commands.

    planned: (14,), work space
    """
    if plan.kind != PlanKind.NONE and has_pieces(plan, now):
        sample_plan(plan, now, planned)
        write_believed_state(planned, drone.state[:])
    elif drone.has_flown > 0:
        write_believed_state(drone.flown[:], drone.state[:])


@kernel(
    rows_of(DRONE_ROW),
    rows_of(PLAN_ROW),
    rows_of(FILTER_ROW),
    histories,
    whole,
    real,
    memory,
    memory,
    **NO_COUNTING,
)
def estimate_drones(
    drones: DroneRows,
    plans: PlanRows,
    filters: FilterRows,
    history: Vec,
    now_ns: int,
    now: float,
    work: Vec,
    planned: Vec,
) -> None:
    """Estimate the state of each drone that ticks; a drone that was never seen ticks no more.

    Filters by hand have written their records before.

    history: (n, R, 5): commands of each drone
    now_ns: ns
    now: s, the same time
    work: (13,), work space
    planned: (14,), work space
    """
    for k in range(drones.shape[0]):
        drone = drones[k]
        if drone.ticks == 0:
            continue
        drone.ticked_ns = now_ns
        drone.number += 1
        estimate_row(filters[k], history[k], work, now)
        if filters[k].is_known == 0:
            drone.ticks = 0
            continue
        drone.is_known = 1
        # A filter may take an early pose to be measured up to a quarter of a period later than now.
        # Others refuse such ages. An age that is not a number stays one.
        drone.age = 0.0 if filters[k].age < 0.0 else filters[k].age
        for c in range(13):
            drone.state[c] = filters[k].state[c]
        if drone.knows_commands == 0 and drone.age > SEEN_AGE:
            _write_believed_flight(drone, plans[k], now, planned)
        # Others refuse a state with an invalid acceleration. Zero stands for an unknown one.
        is_valid = is_valid_acceleration(drone.commanded[:])
        for c in range(3):
            drone.acceleration[c] = drone.commanded[c] if is_valid else 0.0
            drone.commanded[c] = 0.0


@kernel()
def _flies_reference(drone: Record) -> bool:
    """Return whether this tick flies the reference of guidance, not a plan."""
    return bool(
        drone.mode == FOLLOW_NUMBER
        and drone.obeyed == Action.NOMINAL
        and drone.reference_kind != FlightReferenceKind.NONE
    )


@kernel()
def _is_far_off_plan(drone: Record, plan: Record, now: float, planned: Vec) -> bool:
    """Return whether a drone that was pushed aside is so far from its plan that the plan changes.

    planned: (14,), work space
    """
    if drone.is_aside == 0 or drone.obeyed == Action.BRAKE:
        return False
    sample_plan(plan, now, planned)
    far = _compute_distance(planned, drone.state)
    limit = (
        PLAN_DEVIATION.landing_distance
        if drone.mode == LAND_NUMBER
        else PLAN_DEVIATION.waiting_distance
    )
    return bool(far > limit)


@kernel()
def _compute_distance(a: Vec, b: Vec) -> float:
    """Return the distance in m of two places, the first three numbers of each array."""
    x = a[0] - b[0]
    y = a[1] - b[1]
    z = a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel()
def _needs_plan(drone: Record, plan: Record, now: float, planned: Vec) -> bool:
    """Return whether Python must begin, load or change the plan of this drone.

    planned: (14,), work space
    """
    if _flies_reference(drone):
        return False
    if plan.kind != PlanKind.PIECES or not has_pieces(plan, now):
        return True
    is_arriving = drone.mode == TAKEOFF_NUMBER or drone.mode == FOLLOW_NUMBER
    has_arrived = drone.reference_kind == FlightReferenceKind.NONE and is_plan_over(
        plan, now
    )
    if is_arriving and has_arrived:
        return True
    return _is_far_off_plan(drone, plan, now, planned)


@kernel()
def _may_end_flight(drone: Record, plan: Record, now: float) -> bool:
    """Return whether a leg of a return, a landing, or the flight itself may be over."""
    if drone.mode == RETURN_NUMBER:
        return bool(is_plan_over(plan, now))
    if drone.mode == LAND_NUMBER:
        is_low = drone.state[2] < drone.ground + TOUCHDOWN_LIMITS.floor_height
        return bool(is_low or drone.age > SEEN_AGE or is_plan_over(plan, now))
    deaf_at = drone.cut_off_since + CLEARANCE_TIMES.cut_off_timeout
    return bool(now >= deaf_at)


@kernel()
def _needs_judge(
    drone: Record, plan: Record, guard: Record, now: float, planned: Vec
) -> bool:
    """Return whether Python must decide what this flying drone does in this tick.

    planned: (14,), work space
    """
    if drone.is_by_hand > 0 or drone.obeyed != Action.NOMINAL:
        return True
    age = NO_REFERENCE_AGE
    if drone.reference_kind != FlightReferenceKind.NONE:
        age = max(0.0, (drone.ticked_ns - drone.reference_ns) / NS_PER_SECOND)
    is_low = age < 0.0 and (drone.mode == TAKEOFF_NUMBER or drone.mode == LAND_NUMBER)
    if not is_quiet(guard, drone.state[:], drone.age, age, is_low):
        return True
    if _may_end_flight(drone, plan, now):
        return True
    return bool(_needs_plan(drone, plan, now, planned))


@kernel()
def _count_fence_tick(drone: Record, plan: Record, now: float) -> None:
    """Count a tick at the fence, after a flight to a place outside has ended there."""
    is_guided = (
        drone.mode == FOLLOW_NUMBER
        or drone.mode == HOVER_NUMBER
        or drone.mode == TAKEOFF_NUMBER
    )
    if is_guided and drone.is_beyond > 0 and drone.is_held == 0:
        drone.fence_ticks += 1 if is_plan_over(plan, now) else 0


@kernel(rows_of(DRONE_ROW), wholes, whole, wholes, **NO_COUNTING)
def find_late_rows(
    drones: DroneRows, patience_ns: Ints, now_ns: int, found: Ints
) -> int:
    """Find the running drones that have had no tick for longer than their patience.

    patience_ns: (n,) ns, of each drone
    now_ns: ns
    found: (n,): receives their rows
    Returns how many these are.
    """
    count = 0
    for k in range(drones.shape[0]):
        drone = drones[k]
        if drone.is_running > 0 and now_ns - drone.ticked_ns > patience_ns[k]:
            found[count] = k
            count += 1
    return count


@kernel(
    rows_of(DRONE_ROW),
    rows_of(PLAN_ROW),
    rows_of(GUARD_ROW),
    real,
    memory,
    wholes,
    **NO_COUNTING,
)
def find_rows_to_judge(
    drones: DroneRows,
    plans: PlanRows,
    guards: GuardRows,
    now: float,
    planned: Vec,
    found: Ints,
) -> int:
    """Decide the course of each drone that ticks and for which nothing happens.

    now: s
    planned: (14,), work space
    found: (n,): receives the rows of the others, for which Python decides
    Returns how many these are.
    """
    count = 0
    for k in range(drones.shape[0]):
        drone = drones[k]
        if drone.ticks == 0:
            continue
        drone.course = Course.NOTHING
        drone.controller = FlightControllerKind.NONE
        is_off = drone.mode == GROUND_NUMBER or drone.mode == CUT_NUMBER
        if drone.is_by_hand == 0 and is_off:
            drone.course = Course.IDLE
            drone.cut_off_since = math.inf
        elif is_off or _needs_judge(drone, plans[k], guards[k], now, planned):
            found[count] = k
            count += 1
        else:
            drone.course = Course.FOLLOW
            _count_fence_tick(drone, plans[k], now)
    return count


@kernel()
def _follow_full_state(drone: Record, is_exact: bool) -> None:
    """Fly the full state in `wanted`.

    is_exact: whether it is what was wanted, so that the trim may learn from its error
    """
    drone.controller = FlightControllerKind.TRACKER
    drone.has_flown = 1
    for c in range(14):
        drone.flown[c] = drone.wanted[c]
    drone.learns_trim = 1 if is_exact and drone.age <= SEEN_AGE else 0


@kernel()
def _follow_reference(drone: Record, plan: Record) -> None:
    """Fly the reference of guidance: an acceleration as it is, a full state within the limits."""
    plan.kind = PlanKind.NONE
    if drone.reference_kind == FlightReferenceKind.ACCELERATION:
        drone.controller = FlightControllerKind.FOLLOWER
        drone.has_flown = 0
        for c in range(14):
            drone.wanted[c] = 0.0
        for c in range(6, 9):
            drone.wanted[c] = drone.reference[c]
        drone.wanted[12] = drone.reference[12]
        return
    if drone.reference_kind == FlightReferenceKind.VELOCITY:
        for c in range(3):
            drone.reference[c] = drone.state[c]
        for c in range(6, 12):
            drone.reference[c] = 0.0
        drone.reference[13] = 0.0
    is_cut = cut_full_state(
        drone.state[:],
        drone.reference[:],
        drone.gains[:],
        drone.limits[:],
        drone.wanted[:],
    )
    if not is_cut:
        for c in range(14):
            drone.wanted[c] = drone.reference[c]
    _follow_full_state(drone, not is_cut)


@kernel()
def _follow_plan(drone: Record, plan: Record, now: float, planned: Vec) -> None:
    """Fly the set-point of the plan; a drone that was pushed aside comes back within the limits.

    planned: (14,), work space
    """
    sample_plan(plan, now, planned)
    plan.is_waiting = 0
    is_exact = True
    for c in range(14):
        drone.wanted[c] = planned[c]
    if drone.is_aside > 0 and drone.obeyed != Action.BRAKE:
        far = _compute_distance(planned, drone.state)
        comes_back = now < drone.gave_way + PLAN_DEVIATION.gentle_return_time
        is_aside = far > PLAN_DEVIATION.back_distance and comes_back
        drone.is_aside = 1 if is_aside else 0
        is_cut = cut_full_state(
            drone.state[:], planned, drone.gains[:], drone.limits[:], drone.wanted[:]
        )
        is_exact = not is_cut
        if not is_cut:
            for c in range(14):
                drone.wanted[c] = planned[c]
    is_low = drone.mode == TAKEOFF_NUMBER and drone.state[2] < drone.lift_off_height
    _follow_full_state(drone, is_exact and not is_low)


@kernel(rows_of(DRONE_ROW), rows_of(PLAN_ROW), real, memory, **NO_COUNTING)
def follow_rows(drones: DroneRows, plans: PlanRows, now: float, planned: Vec) -> None:
    """Write what each drone with the course FOLLOW flies, and by which controller.

    now: s
    planned: (14,), work space
    """
    for k in range(drones.shape[0]):
        drone = drones[k]
        if drone.ticks == 0 or drone.course != Course.FOLLOW:
            continue
        if _flies_reference(drone):
            _follow_reference(drone, plans[k])
        else:
            _follow_plan(drone, plans[k], now, planned)


@kernel()
def _evade(drone: Record, safe: Vec, other: int, is_on_plan: bool, now: float) -> None:
    """Fly the acceleration of the collision filter.

    safe: (3,) m/s2
    other: id of the drone that this one evades; -1: it brakes
    is_on_plan: whether the drone flies a plan; it then comes back to the plan later
    now: s
    """
    yaw = drone.wanted[12]
    for c in range(6):
        drone.wanted[c] = drone.state[c]
    for c in range(3):
        drone.wanted[6 + c] = safe[c]
        drone.wanted[9 + c] = 0.0
    drone.wanted[12] = yaw
    drone.wanted[13] = 0.0
    _follow_full_state(drone, False)
    drone.evades = 1
    drone.evades_drone = other
    drone.gave_way = now
    drone.evasion_ticks += 1
    if is_on_plan:
        drone.is_aside = 1


@kernel(rows_of(DRONE_ROW), table, memory, wholes, real, **NO_COUNTING)
def publish_drones(
    drones: DroneRows, states: Mat, times: Vec, numbers: Ints, now: float
) -> None:
    """Give the states of the drones that tick to the airspace.

    states: (k, 16): state (13,) and acceleration (3,) of each own drone of the airspace
    times: (k,) s, times of the states
    numbers: (k,): numbers of their ticks
    now: s
    """
    for k in range(drones.shape[0]):
        drone = drones[k]
        if drone.ticks == 0 or drone.listener < 0:
            continue
        at = drone.listener
        for c in range(13):
            states[at, c] = drone.state[c]
        for c in range(3):
            states[at, 13 + c] = drone.acceleration[c]
        times[at] = now - drone.age
        numbers[at] = drone.number


@kernel()
def _ask_filter(drone: Record, avoid: Record) -> None:
    """Write what the drone wants into the record of its collision filter."""
    is_tracker = drone.controller == FlightControllerKind.TRACKER
    for c in range(13):
        avoid.state[c] = drone.state[c]
        avoid.gains[c] = drone.gains[c]
    for c in range(3):
        avoid.acceleration[c] = drone.acceleration[c]
    for c in range(14):
        avoid.reference[c] = drone.wanted[c]
    avoid.follows = 1 if is_tracker else 0
    avoid.lands = 1 if is_tracker and drone.mode == LAND_NUMBER else 0


@kernel()
def _obey_filter(drone: Record, avoid: Record, plan: Record, now: float) -> bool:
    """Fly what the collision filter has answered; return whether to note it.

    Braking is noted in each tick, everything else when it changes.
    """
    if avoid.is_cut_off > 0:
        drone.cut_off_since = min(drone.cut_off_since, now)
    else:
        drone.cut_off_since = math.inf
    was_evading = drone.evades > 0
    before = drone.evades_drone
    if avoid.acts == 0:
        drone.evades = 0
        return bool(was_evading)
    _evade(drone, avoid.safe, avoid.gives_way_to, plan.kind != PlanKind.NONE, now)
    is_braking = drone.evades_drone < 0
    return bool(not was_evading or is_braking or drone.evades_drone != before)


@kernel(
    rows_of(DRONE_ROW),
    rows_of(PLAN_ROW),
    rows_of(AVOID_ROW),
    rows_of(LISTENER_ROW),
    rows_of(MOTION_ROW),
    real,
    table,
    table,
    wholes,
    **NO_COUNTING,
)
def avoid_drones(
    drones: DroneRows,
    plans: PlanRows,
    avoids: Records,
    listeners: Records,
    motions: Records,
    now: float,
    planes: Mat,
    near: Mat,
    found: Ints,
) -> int:
    """Keep each drone with a collision filter and the course FOLLOW clear of the others.

    avoids: of the batch
    listeners: of the airspace
    motions: of the airspace: how the drones near by move
    now: s
    planes: work space, see make_planes
    near: work space, see make_nearest
    found: (n,): receives the rows of the drones with an evasion to note
    Returns how many these are.
    """
    count = 0
    for k in range(drones.shape[0]):
        drone = drones[k]
        if drone.ticks == 0 or drone.course != Course.FOLLOW or drone.avoids == 0:
            continue
        _ask_filter(drone, avoids[k])
        avoid_row(avoids[k], listeners[drone.listener], motions, now, planes, near)
        if _obey_filter(drone, avoids[k], plans[k], now):
            found[count] = k
            count += 1
    return count


@kernel()
def _control_drone(drone: Record, control: Record, now: float) -> bool:
    """Compute the input of the sender by the drone's controller.

    Returns False, and changes nothing, if the controller is in Python.
    """
    is_tracker = drone.controller == FlightControllerKind.TRACKER
    controller = control.tracker if is_tracker else control.follower
    if controller.kind == CompiledControllerKind.BY_HAND:
        return False
    if is_tracker:
        control.trim.is_frozen = 1 - drone.learns_trim
    fly_controller(
        controller,
        control.trim,
        drone.state[:],
        drone.age,
        drone.wanted[:],
        True,
        now,
        drone.command[:INPUT_SIZE],
    )
    first = FLATNESS_LAYOUT.acceleration_start
    is_flatness = controller.kind == CompiledControllerKind.FLATNESS
    for c in range(3):
        drone.commanded[c] = (
            controller.position.out[first + c]
            if is_flatness
            else controller.last[6 + c]
        )
    return True


@kernel(rows_of(DRONE_ROW), rows_of(CONTROL_ROW), real, wholes, **NO_COUNTING)
def control_drones(
    drones: DroneRows, controls: Records, now: float, found: Ints
) -> int:
    """Compute the input of the sender for each drone that ticks and gets a command.

    now: s
    found: (n,): receives the rows of the drones with a command that is made or sent in Python
    Returns how many these are.
    """
    count = 0
    for k in range(drones.shape[0]):
        drone = drones[k]
        drone.is_computed = 0
        if drone.ticks == 0 or drone.course == Course.NOTHING:
            continue
        is_done = False
        if drone.sends_rows > 0:
            if drone.course == Course.IDLE:
                for c in range(INPUT_SIZE):
                    drone.command[c] = 0.0
                is_done = True
            else:
                is_done = _control_drone(drone, controls[k], now)
        drone.is_computed = 1 if is_done else 0
        if not is_done or drone.has_world_row == 0:
            found[count] = k
            count += 1
    return count
