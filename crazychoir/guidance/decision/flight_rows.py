"""The laws and the batch of flying drones: states go from the batch to the laws, references back."""

import math
from enum import IntEnum
from typing import Any

from crazychoir.filters.rows import FILTER_ROW, FilterRows
from crazychoir.flight.batch import (
    DRONE_ROW,
    MODE_NUMBERS,
    DroneRows,
    FlightReferenceKind,
)
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW, put_row
from crazychoir.guidance.decision.law_rows import (
    LAW_ROW,
    LawDecision,
    LawPermission,
    ReferenceKind,
)
from crazychoir.numerics.kernels import NO_COUNTING, kernel, rows_of, whole, wholes
from crazychoir.planning.plan_row import PLAN_ROW, PlanKind, PlanRows, is_plan_over
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import (
    LINK_ROW,
    LOSS_ROW,
    SWARM_ROW,
    LinkKind,
    LinkKinds,
)
from crazychoir.safety.airspace.late_states import LATE_ROW, keep_late, send_late
from crazychoir.safety.airspace.link_fates import link_kinds, pass_link
from crazychoir.safety.rules.limits import limit_acceleration
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Ints

TAKEOFF_NUMBER = MODE_NUMBERS[Mode.TAKEOFF]
HOVER_NUMBER = MODE_NUMBERS[Mode.HOVER]
FOLLOW_NUMBER = MODE_NUMBERS[Mode.FOLLOW]
ELSEWHERE_SOURCE = -1
"""`source` of an edge from a drone of another process: its states come as messages."""
NO_PLACE = -1
"""Row in the swarm of the sender of a state for a law: it is not used."""
FRAMES_SOURCE = -2
"""`source` of an edge from a drone of another process: its states come in frames."""


class Handover(IntEnum):
    """What becomes of the reference of a law."""

    TAKEN = 0
    """The drone flies it from the next stage on."""
    IGNORED = 1
    """The drone obeys its operator, or it rests already."""
    BY_HAND = 2
    """The pilot must decide: the mode changes, or the reference is unusual."""


@kernel()
def _find_permission(drone: Any) -> int:
    """Return what the mode of the drone allows its law: a LawPermission."""
    if drone.mode == HOVER_NUMBER or drone.mode == FOLLOW_NUMBER:
        return LawPermission.STEPS
    return LawPermission.WAITS if drone.mode == TAKEOFF_NUMBER else LawPermission.ENDS


@kernel(rows_of(LAW_ROW), rows_of(DRONE_ROW), rows_of(FILTER_ROW), **NO_COUNTING)
def look_rows(laws: Any, drones: DroneRows, filters: FilterRows) -> None:
    """Write the states of this tick, and what the pilots allow, into the rows of the laws.

    laws: (n,) of LAW_ROW
    drones: of the batch
    filters: of the batch
    """
    for r in range(laws.shape[0]):
        law = laws[r]
        drone = drones[law.place]
        law.has_state = drone.ticks
        if drone.ticks == 0:
            continue
        for c in range(13):
            law.state[c] = drone.state[c]
        for c in range(3):
            law.acceleration[c] = drone.acceleration[c]
        law.age = drone.age
        law.measured = filters[law.place].measured
        law.permission = _find_permission(drone)


@kernel()
def _is_due(edge: Any, now_ns: int) -> bool:
    """Return whether a state is due on an edge, and begin the next interval of its grid."""
    if edge.interval_ns == 0:
        return True
    if now_ns < edge.due_ns:
        return False
    late_ns = now_ns - edge.due_ns
    edge.due_ns += (late_ns // edge.interval_ns + 1) * edge.interval_ns
    return True


@kernel()
def _send_late(
    late: Any,
    late_count: Ints,
    links: Any,
    kinds: LinkKinds,
    losses: Any,
    e: int,
    sender: Any,
    born: float,
    now_ns: int,
) -> None:
    """Send the state of a neighbour to a law over a late link.

    e: row of the edge, and of its link
    sender: a record of SWARM_ROW or DRONE_ROW
    born: s, time of the state
    Other arguments as in deliver_rows.
    """
    send_late(
        late,
        late_count,
        links,
        kinds,
        losses,
        e,
        sender,
        e,
        NO_PLACE,
        born,
        True,
        now_ns,
    )


@kernel()
def _deliver_frame(
    edges: Any,
    e: int,
    swarm: Any,
    links: Any,
    kinds: LinkKinds,
    losses: Any,
    late: Any,
    late_count: Ints,
    now_ns: int,
) -> bool:
    """Let a law hear the newest state of a drone of another process, if it is new.

    e: row of the edge
    swarm: SWARM_ROW, of the airspace
    Other arguments as in deliver_rows.
    Returns whether Impairment must decide.
    """
    edge = edges[e]
    sender = swarm[edge.frame_place]
    if sender.number == edge.frame_number or sender.state_time == -math.inf:
        return False
    edge.frame_number = sender.number
    if not _is_due(edge, now_ns):
        return False
    fate = LinkKind.CLEAR
    if links.shape[0] > 0:
        fate = pass_link(links, kinds, losses, e, sender.number)
    if fate == LinkKind.CLEAR:
        age = now_ns / NS_PER_SECOND - sender.state_time
        put_row(edge, sender.state, sender.acceleration, sender.age, age, now_ns)
    elif fate == LinkKind.LATE:
        born = sender.state_time
        _send_late(late, late_count, links, kinds, losses, e, sender, born, now_ns)
    return bool(fate == LinkKind.BY_HAND)


@kernel()
def _deliver_late(edges: Any, late: Any, late_count: Ints, now_ns: int) -> None:
    """Let laws hear the states that have arrived late, and keep those on their way.

    Arguments as in deliver_rows.
    """
    kept = 0
    for k in range(late_count[0]):
        row = late[k]
        if row.arrival_ns > now_ns:
            kept = keep_late(late, k, kept)
            continue
        age = row.arrival_ns / NS_PER_SECOND - row.state_time
        put_row(
            edges[row.receiver],
            row.state,
            row.acceleration,
            row.state_age,
            age,
            row.arrival_ns,
        )
    late_count[0] = kept


@kernel(
    rows_of(HEARING_ROW),
    rows_of(DRONE_ROW),
    rows_of(SWARM_ROW),
    rows_of(LINK_ROW),
    link_kinds,
    rows_of(LOSS_ROW),
    rows_of(LATE_ROW),
    wholes,
    whole,
    wholes,
    **NO_COUNTING,
)
def deliver_rows(
    edges: Any,
    drones: DroneRows,
    swarm: Any,
    links: Any,
    kinds: LinkKinds,
    losses: Any,
    late: Any,
    late_count: Ints,
    now_ns: int,
    found: Ints,
) -> int:
    """Let laws hear the states of this tick of neighbours in this process, or from frames.

    edges: (e,) of HEARING_ROW
    drones: of the batch
    swarm: SWARM_ROW, of the airspace; empty without one
    links: (e,) of LINK_ROW; empty without a simulated network
    kinds: (e,): LinkKind of each link
    losses: (m,) of LOSS_ROW
    late: of LATE_ROW, with room for all copies of all states
    late_count: (1,): number of states on their way
    now_ns: ns
    found: (e,): receives the edges on which Impairment must decide, see LinkKind.BY_HAND
    Returns how many these are.
    """
    count = 0
    for e in range(edges.shape[0]):
        edge = edges[e]
        if edge.source == FRAMES_SOURCE:
            if _deliver_frame(
                edges, e, swarm, links, kinds, losses, late, late_count, now_ns
            ):
                found[count] = e
                count += 1
            continue
        if edge.source == ELSEWHERE_SOURCE or drones[edge.source].ticks == 0:
            continue
        if not _is_due(edge, now_ns):
            continue
        sender = drones[edge.source]
        fate = LinkKind.CLEAR
        if links.shape[0] > 0:
            fate = pass_link(links, kinds, losses, e, sender.number)
        if fate == LinkKind.BY_HAND:
            found[count] = e
            count += 1
            continue
        sender.sent += 1
        if fate == LinkKind.CUT:
            sender.lost += 1
        elif fate == LinkKind.LATE:
            born = now_ns / NS_PER_SECOND - sender.age
            _send_late(late, late_count, links, kinds, losses, e, sender, born, now_ns)
        else:
            put_row(
                edge, sender.state, sender.acceleration, sender.age, sender.age, now_ns
            )
    if late_count[0] > 0:
        _deliver_late(edges, late, late_count, now_ns)
    return count


@kernel()
def _hand_over_acceleration(law: Any, drone: Any) -> None:
    """Write an acceleration within the limits of the drone into its record."""
    drone.reference_kind = FlightReferenceKind.ACCELERATION
    drone.reference[12] = law.reference[12]
    limit_acceleration(
        drone.state[:],
        law.reference[6:9],
        drone.limits[:],
        drone.least_velocity_gain,
        drone.reference[6:9],
    )


@kernel()
def _is_usable(law: Any) -> bool:
    """Return whether the numbers of a reference are finite."""
    total = 0.0
    for c in range(14):
        total += 0.0 * law.reference[c]
    return bool(total == 0.0)


@kernel()
def _hand_over(law: Any, drone: Any, plan: Any, now_ns: int) -> int:
    """Let the drone fly the reference of its law; return what becomes of it: a Handover."""
    is_obeying = drone.mode == HOVER_NUMBER or drone.mode == FOLLOW_NUMBER
    if law.kind == ReferenceKind.HOVER:
        is_resting = (
            drone.mode == HOVER_NUMBER
            and drone.reference_kind == FlightReferenceKind.NONE
            and plan.kind == PlanKind.PIECES
            and is_plan_over(plan, now_ns / NS_PER_SECOND)
        )
        return Handover.IGNORED if is_resting else Handover.BY_HAND
    if not is_obeying:
        return Handover.BY_HAND
    if drone.is_held > 0 or drone.awaits_start > 0:
        return Handover.IGNORED
    if drone.mode != FOLLOW_NUMBER or not _is_usable(law):
        return Handover.BY_HAND
    if law.kind == ReferenceKind.ACCELERATION:
        if drone.has_follower == 0:
            return Handover.BY_HAND
        _hand_over_acceleration(law, drone)
    else:
        is_velocity = law.kind == ReferenceKind.VELOCITY
        drone.reference_kind = (
            FlightReferenceKind.VELOCITY
            if is_velocity
            else FlightReferenceKind.FULL_STATE
        )
        for c in range(14):
            drone.reference[c] = law.reference[c]
    drone.reference_ns = now_ns
    drone.is_beyond = 0
    return Handover.TAKEN


@kernel(
    rows_of(LAW_ROW),
    rows_of(DRONE_ROW),
    rows_of(PLAN_ROW),
    whole,
    wholes,
    **NO_COUNTING,
)
def hand_over_rows(
    laws: Any, drones: DroneRows, plans: PlanRows, now_ns: int, found: Ints
) -> int:
    """Let the drones fly the references of the laws that have stepped.

    laws: (n,) of LAW_ROW
    drones: of the batch
    plans: of the batch
    now_ns: ns
    found: (n,): receives the rows of the laws for which the pilots must decide
    Returns how many these are.
    """
    count = 0
    for r in range(laws.shape[0]):
        law = laws[r]
        if law.decision != LawDecision.STEP:
            continue
        drone = drones[law.place]
        if _hand_over(law, drone, plans[law.place], now_ns) == Handover.BY_HAND:
            found[count] = r
            count += 1
    return count
