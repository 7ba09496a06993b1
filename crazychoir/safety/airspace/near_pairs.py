"""Near pairs: which drones could meet soon, and how often these hear each other.

Only such pairs have a record. The far ones hear each other in rounds, and only the number of rounds
that a drone has missed in a row is kept of each pair. A drone that has missed none is looked for in
the grid of the airspace, so the work of a drone does not grow with the swarm.
"""

import math

import numba

from crazychoir.numerics.kernels import NO_COUNTING, kernel, rows_of, wholes
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import (
    AIRSPACE_RULES_ROW,
    DUE_ROW,
    FAR_ROW,
    GRID_ROW,
    LISTENER_ROW,
    MOTION_ROW,
    NEVER_NS,
    PACE_ROW,
    PAIR_ROW,
    ROUND_ROW,
    SWARM_ROW,
    LinkKinds,
    Missed,
    Need,
)
from crazychoir.safety.airspace.far_drones import (
    count_far,
    fill_pair,
    find_far_kind,
    recall_round,
    refresh_far,
)
from crazychoir.safety.airspace.hearing import (
    byte_table,
    copy_motion,
    integers,
)
from crazychoir.safety.airspace.link_fates import link_kinds, needs_pair
from crazychoir.safety.airspace.near_grid import build_grid, find_cells
from crazychoir.safety.airspace.nearness import (
    compute_distance,
    compute_reach,
    compute_relative_speed,
    compute_speed,
    find_need,
    is_behind,
    is_near,
    is_told_newer,
    is_unknown,
    measure_pair,
)
from crazychoir.safety.airspace.pair_paces import (
    copy_due,
    copy_pace,
    fill_pace,
    find_pair,
    find_sending_interval,
    is_told,
    set_interval,
)
from crazychoir.safety.airspace.state_rates import (
    CHECKS_UNTIL_GONE_SOUGHT,
    STATE_RATES,
)
from crazychoir.types import Bytes, Ints, Records, Vec

CHECK_NS = int(NS_PER_SECOND * STATE_RATES.check_interval)  # ns, between two checks


@kernel()
def copy_pair(source: Records, target: Records) -> None:
    """Copy one row of PAIR_ROW to another one."""
    target.other = source.other
    target.drone = source.drone
    for c in range(13):
        target.state[c] = source.state[c]
    for c in range(3):
        target.acceleration[c] = source.acceleration[c]
    target.state_time = source.state_time
    target.heard_time = source.heard_time
    target.share = source.share
    target.meeting_time = source.meeting_time
    target.age_limit = source.age_limit
    target.turns = source.turns
    target.asked_time = source.asked_time
    target.is_by_hand = source.is_by_hand
    target.need = source.need


@kernel()
def move_pair(
    source: int,
    target: int,
    pairs: Records,
    motions: Records,
    paces: Records,
    dues: Records,
) -> None:
    """Copy a pair to another row of all tables of pairs.

    source: row of the pair
    target: the other row
    Other arguments as in check_distances.
    """
    copy_pair(pairs[source], pairs[target])
    copy_motion(motions[source], motions[target])
    copy_pace(paces[source], paces[target])
    copy_due(dues[source], dues[target])


@kernel(forceinline=True)
def find_staying_pairs(
    at: int,
    listeners: Records,
    pairs: Records,
    swarm: Records,
    rounds: Records,
    far: Records,
    kinds: LinkKinds,
    rules: Records,
    work: Ints,
    now: float,
) -> int:
    """Write the rows of the pairs of one drone that stay near to `work`, and return their number.

    Arguments as in check_distances; now: s
    """
    listener = listeners[at]
    own = swarm[listener.place].state
    own_speed = compute_speed(own)
    count = 0
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        pair = pairs[k]
        count_far(listener, far[pair.other].kind, -1)
        apart = compute_distance(own, pair.state, rules.scale)
        speeds = own_speed + compute_speed(pair.state)
        stays = is_behind(pair, far[pair.other])
        stays |= is_told_newer(pair, far[pair.other])
        stays |= listener.keeps_all != 0
        if pair.state_time > -math.inf:
            velocity = (pair.state[3], pair.state[4], pair.state[5])
            speed = compute_relative_speed(own, velocity)
            stays |= is_near(apart, speed, now - pair.state_time, rules)
        if rules.has_late != 0:
            stays |= needs_pair(int(kinds[at * swarm.shape[0] + pair.other]))
        if stays:
            measure_pair(pair, apart, speeds, rules, now)
            work[count] = k
            count += 1
        else:
            kind = find_far_kind(
                pair.state[2], pair.state_time, pair.heard_time, rules, now
            )
            count_far(listener, kind, 1)
    return count


@kernel(forceinline=True)
def append_if_near(
    at: int,
    other: int,
    own: Vec,
    listener: Records,
    far: Records,
    missed: Bytes,
    rules: Records,
    work: Ints,
    count: int,
    now: float,
) -> int:
    """Append a drone to `work` if no round of it was missed and it has become near.

    at: number of the drone that looks
    other: row of the other one in the swarm
    own: (13,), newest state of the drone that looks
    listener: its row of LISTENER_ROW
    work: receives the row of the other drone at `count`
    now: s
    Other arguments as in check_distances.
    Returns the new length of `work`.
    """
    if missed[at, other] != 0:
        return count
    known = far[other]
    apart = compute_distance(own, known.place, rules.scale)
    speed = compute_relative_speed(own, known.velocity)
    if is_near(apart, speed, now - known.state_time, rules):
        count_far(listener, known.kind, -1)
        work[count] = other
        return count + 1
    return count


@kernel(forceinline=True)
def find_in_cells(
    at: int,
    listeners: Records,
    swarm: Records,
    far: Records,
    missed: Bytes,
    rules: Records,
    grid: Records,
    begins: Ints,
    order: Ints,
    work: Ints,
    count: int,
    now: float,
) -> int:
    """Append the drones of the cells around one drone that have become near.

    Drones with missed rounds are left out, see find_by_bytes.

    work: receives the rows of these drones in the swarm, from `count` on
    now: s
    Other arguments as in check_distances.
    Returns the new length of `work`.
    """
    listener = listeners[at]
    own = swarm[listener.place].state
    reach = compute_reach(compute_speed(own) + grid.fastest, grid.oldest, rules)
    x_first, x_end = find_cells(own[0], reach, 0, grid, rules)
    y_first, y_end = find_cells(own[1], reach, 1, grid, rules)
    z_first, z_end = find_cells(own[2], reach, 2, grid, rules)
    for z in range(z_first, z_end):
        for y in range(y_first, y_end):
            if x_end <= x_first:
                continue
            line = (z * grid.counts[1] + y) * grid.counts[0]
            for n in range(begins[line + x_first], begins[line + x_end]):
                count = append_if_near(
                    at,
                    order[n],
                    own,
                    listener,
                    far,
                    missed,
                    rules,
                    work,
                    count,
                    now,
                )
    for n in range(grid.late_first, grid.late_end):
        count = append_if_near(
            at, order[n], own, listener, far, missed, rules, work, count, now
        )
    return count


@kernel()
def find_by_bytes(
    at: int,
    listeners: Records,
    swarm: Records,
    rounds: Records,
    far: Records,
    missed: Bytes,
    kinds: LinkKinds,
    rules: Records,
    looks_at_all: bool,
    work: Ints,
    count: int,
    now_ns: int,
) -> int:
    """Append the drones that have become near, among the drones with missed rounds.

    looks_at_all: whether the other drones are looked at as well
    work: receives the rows of these drones in the swarm, from `count` on
    Other arguments as in check_distances.
    Returns the new length of `work`.
    """
    listener = listeners[at]
    own = swarm[listener.place].state
    now = now_ns / NS_PER_SECOND
    for j in range(swarm.shape[0]):
        lack = missed[at, j]
        if lack == Missed.PAIRED or (lack == 0 and not looks_at_all):
            continue
        if j == listener.place:
            continue
        count_far(listener, far[j].kind, -1)
        place, velocity, state_time, heard_time = recall_round(
            j, swarm, rounds, rules.round_capacity, lack, now
        )
        stays = is_unknown(lack, rules, now_ns) or listener.keeps_all != 0
        if state_time > -math.inf:
            apart = compute_distance(own, place, rules.scale)
            speed = compute_relative_speed(own, velocity)
            stays |= is_near(apart, speed, now - state_time, rules)
        if rules.has_late != 0:
            stays |= needs_pair(int(kinds[at * swarm.shape[0] + j]))
        if stays:
            work[count] = j
            count += 1
        else:
            kind = find_far_kind(place[2], state_time, heard_time, rules, now)
            count_far(listener, kind, 1)
    return count


@kernel()
def sort_rows(work: Ints, first: int, end: int) -> None:
    """Sort a few whole numbers that are almost in order.

    work: (n,)
    first: first place to sort
    end: end of the places to sort
    """
    for n in range(first + 1, end):
        row = work[n]
        m = n - 1
        while m >= first and work[m] > row:
            work[m + 1] = work[m]
            m -= 1
        work[m + 1] = row


@kernel()
def find_back(
    other: int, place: int, listeners: Records, paces: Records, swarm: Records
) -> int:
    """Return the row of what another drone knows of this one, or -1.

    other: row of the other drone in the swarm
    place: row of this drone in the swarm
    listeners: LISTENER_ROW
    paces: PACE_ROW
    swarm: SWARM_ROW
    """
    receiver = swarm[other].listener
    if receiver < 0:
        return -1
    return int(find_pair(listeners[receiver], paces, place))


@kernel(forceinline=True)
def pace_pair(
    at: int,
    k: int,
    listeners: Records,
    pairs: Records,
    paces: Records,
    dues: Records,
    swarm: Records,
    rules: Records,
) -> None:
    """Send the own state to another drone as often as the distance demands.

    at: number of the drone
    k: row of its pair
    Other arguments as in check_distances.
    """
    place = listeners[at].place
    pace = paces[k]
    interval_ns = find_sending_interval(pairs[k], swarm[place].state[2], rules)
    if pace.sending_interval_ns == interval_ns:
        return
    pace.sending_interval_ns = interval_ns
    if dues[k].sending_ns != NEVER_NS:
        dues[k].sending_ns %= rules.far_interval_ns
    back = find_back(pace.other, place, listeners, paces, swarm)
    if back >= 0:
        set_interval(paces[back], dues[back], interval_ns, swarm[place].phase_ns)


@kernel()
def drop_pairs(
    at: int,
    count: int,
    listeners: Records,
    pairs: Records,
    motions: Records,
    paces: Records,
    dues: Records,
    swarm: Records,
    missed: Bytes,
    rules: Records,
    work: Ints,
) -> None:
    """Drop the pairs of one drone that are far, and close the gaps.

    count: number of pairs that stay; `work` has their rows
    Other arguments as in check_distances.
    """
    listener = listeners[at]
    kept = 0
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        if kept < count and work[kept] == k:
            target = listener.first_pair + kept
            kept += 1
            if target != k:
                move_pair(k, target, pairs, motions, paces, dues)
            continue
        pair = pairs[k]
        missed[at, pair.other] = 0
        pair.meeting_time = math.inf
        pair.age_limit = math.inf
        pace_pair(at, k, listeners, pairs, paces, dues, swarm, rules)
    listener.pair_count = count


@kernel()
def add_pairs(
    at: int,
    first: int,
    end: int,
    listeners: Records,
    pairs: Records,
    motions: Records,
    paces: Records,
    dues: Records,
    told: Ints,
    swarm: Records,
    rounds: Records,
    missed: Bytes,
    rules: Records,
    work: Ints,
    now_ns: int,
) -> None:
    """Add the new pairs of one drone, such that all its pairs are ordered by id.

    first: place in `work` of the first new pair
    end: end of the new pairs
    work: rows of the other drones of the new pairs in the swarm, in this order
    Other arguments as in check_distances.
    """
    listener = listeners[at]
    own = swarm[listener.place].state
    own_speed = compute_speed(own)
    now = now_ns / NS_PER_SECOND
    old = listener.first_pair + listener.pair_count - 1
    new = end - 1
    listener.pair_count += end - first
    target = listener.first_pair + listener.pair_count - 1
    while new >= first:
        other = work[new]
        if old >= listener.first_pair and paces[old].other > other:
            move_pair(old, target, pairs, motions, paces, dues)
            old -= 1
        else:
            pair = pairs[target]
            fill_pair(
                pair,
                motions[target],
                other,
                swarm,
                rounds,
                rules,
                missed[at, other],
                now,
            )
            fill_pace(
                paces[target],
                dues[target],
                other,
                swarm[other],
                is_told(listener, told, other),
                rules.far_interval_ns,
                now_ns,
            )
            back = find_back(other, listener.place, listeners, paces, swarm)
            if back >= 0:
                set_interval(
                    paces[target],
                    dues[target],
                    paces[back].sending_interval_ns,
                    swarm[other].phase_ns,
                )
            apart = compute_distance(own, pair.state, rules.scale)
            measure_pair(pair, apart, own_speed + compute_speed(pair.state), rules, now)
            swarm[other].lacking_count -= missed[at, other] != 0
            missed[at, other] = Missed.PAIRED
            new -= 1
        target -= 1


@kernel(forceinline=True)
def pace_pairs(
    at: int,
    listeners: Records,
    pairs: Records,
    paces: Records,
    dues: Records,
    swarm: Records,
    rules: Records,
    now: float,
) -> None:
    """Set how often the pairs of one drone send, and for which it should ask others.

    Arguments as in check_distances; now: s
    """
    listener = listeners[at]
    listener.check_count += 1
    listener.sought_count = 0
    # Not all drones ask about gone drones in the same check.
    turn = listener.check_count + listener.place
    seeks_gone = turn % CHECKS_UNTIL_GONE_SOUGHT == 0
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        pair = pairs[k]
        pair.need = find_need(pair, rules.standing_height, seeks_gone, now)
        listener.sought_count += pair.need != Need.NONE
        pace_pair(at, k, listeners, pairs, paces, dues, swarm, rules)


@kernel(forceinline=True)
def check_pairs(
    at: int,
    listeners: Records,
    pairs: Records,
    motions: Records,
    paces: Records,
    dues: Records,
    told: Ints,
    swarm: Records,
    rounds: Records,
    far: Records,
    missed: Bytes,
    kinds: LinkKinds,
    rules: Records,
    grid: Records,
    begins: Ints,
    order: Ints,
    work: Ints,
    now_ns: int,
) -> bool:
    """Check the distances of one drone, and return whether there is room for its pairs.

    Arguments as in check_distances. Without room, the check is not done.
    """
    listener = listeners[at]
    now = now_ns / NS_PER_SECOND
    listener.far_heard = grid.heard
    listener.far_silent = grid.silent
    count_far(listener, far[listener.place].kind, -1)
    staying = find_staying_pairs(
        at, listeners, pairs, swarm, rounds, far, kinds, rules, work, now
    )
    looks_at_all = listener.keeps_all != 0 or rules.has_late != 0
    end = staying
    if looks_at_all or grid.lacking > 0:
        end = find_by_bytes(
            at,
            listeners,
            swarm,
            rounds,
            far,
            missed,
            kinds,
            rules,
            looks_at_all,
            work,
            staying,
            now_ns,
        )
    if not looks_at_all:
        end = find_in_cells(
            at,
            listeners,
            swarm,
            far,
            missed,
            rules,
            grid,
            begins,
            order,
            work,
            end,
            now,
        )
    listener.pairs_needed = end
    if end > listener.pair_capacity:
        return False
    if staying < listener.pair_count:
        drop_pairs(
            at,
            staying,
            listeners,
            pairs,
            motions,
            paces,
            dues,
            swarm,
            missed,
            rules,
            work,
        )
    if end > staying:
        sort_rows(work, staying, end)
        add_pairs(
            at,
            staying,
            end,
            listeners,
            pairs,
            motions,
            paces,
            dues,
            told,
            swarm,
            rounds,
            missed,
            rules,
            work,
            now_ns,
        )
    pace_pairs(at, listeners, pairs, paces, dues, swarm, rules, now)
    return True


@kernel()
def is_check_due(at: int, listeners: Records, swarm: Records, now_ns: int) -> bool:
    """Return whether the distances of one drone are due for a check.

    at: number of the drone
    listeners: LISTENER_ROW
    swarm: SWARM_ROW
    now_ns: ns
    """
    listener = listeners[at]
    if now_ns < listener.check_ns:
        return False
    is_lost = swarm[listener.place].state_time == -math.inf
    return bool(not is_lost or listener.keeps_all != 0)


@kernel(
    rows_of(LISTENER_ROW),
    rows_of(PAIR_ROW),
    rows_of(MOTION_ROW),
    rows_of(PACE_ROW),
    rows_of(DUE_ROW),
    integers,
    rows_of(SWARM_ROW),
    rows_of(ROUND_ROW),
    rows_of(FAR_ROW),
    byte_table,
    link_kinds,
    rows_of(AIRSPACE_RULES_ROW),
    rows_of(GRID_ROW),
    wholes,
    wholes,
    wholes,
    numba.int64,
    **NO_COUNTING,
)
def check_distances(
    listeners: Records,
    pairs: Records,
    motions: Records,
    paces: Records,
    dues: Records,
    told: Ints,
    swarm: Records,
    rounds: Records,
    far: Records,
    missed: Bytes,
    kinds: LinkKinds,
    rules: Records,
    grid: Records,
    begins: Ints,
    order: Ints,
    work: Ints,
    now_ns: int,
) -> int:
    """Find the near pairs of all drones that are due for a check.

    listeners: LISTENER_ROW
    pairs: PAIR_ROW
    motions: MOTION_ROW
    paces: PACE_ROW
    dues: DUE_ROW
    told: (k,): rows of drones in the swarm that laws hear, see Airspace.note_told
    swarm: SWARM_ROW
    rounds: ROUND_ROW, (swarm x rounds that are kept,)
    far: FAR_ROW, (swarm,)
    missed: (listeners, swarm): rounds missed in a row, or Missed
    kinds: (listeners x swarm,): LinkKind of each link, if a link may delay messages
    rules: AIRSPACE_RULES_ROW, (1,)
    grid: GRID_ROW, (1,)
    begins: (CELLS_PER_DRONE x swarm + 1,): where the cells of the grid begin in `order`
    order: (swarm,): rows of the swarm in the order of the cells
    work: (swarm,): work space
    now_ns: ns
    Returns the number of drones that need room for more pairs. Their checks are not done then.
    """
    has_grid = False
    lacking = 0
    for at in range(listeners.shape[0]):
        if not is_check_due(at, listeners, swarm, now_ns):
            continue
        if not has_grid:
            has_grid = True
            refresh_far(far, grid[0], swarm, rounds, rules[0], now_ns / NS_PER_SECOND)
            build_grid(far, grid[0], rules[0], begins, order)
        if not check_pairs(
            at,
            listeners,
            pairs,
            motions,
            paces,
            dues,
            told,
            swarm,
            rounds,
            far,
            missed,
            kinds,
            rules[0],
            grid[0],
            begins,
            order,
            work,
            now_ns,
        ):
            lacking += 1
            continue
        listener = listeners[at]
        listener.check_ns += ((now_ns - listener.check_ns) // CHECK_NS + 1) * CHECK_NS
    return lacking


@kernel(
    rows_of(LISTENER_ROW),
    rows_of(PACE_ROW),
    rows_of(DUE_ROW),
    rows_of(SWARM_ROW),
    integers,
    **NO_COUNTING,
)
def tell_pairs(
    listeners: Records,
    paces: Records,
    dues: Records,
    swarm: Records,
    told: Ints,
) -> None:
    """Note for all pairs whether the law of the drone hears each state of the other one.

    Arguments as in check_distances.
    """
    for at in range(listeners.shape[0]):
        listener = listeners[at]
        for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
            pace = paces[k]
            pace.is_told = is_told(listener, told, pace.other)
            back = find_back(pace.other, listener.place, listeners, paces, swarm)
            if back >= 0:
                interval_ns = paces[back].sending_interval_ns
                set_interval(pace, dues[k], interval_ns, swarm[pace.other].phase_ns)
