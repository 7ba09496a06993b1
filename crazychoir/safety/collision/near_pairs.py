"""Near pairs: which drones could meet soon, and how often these hear each other.

Only such pairs have a record. The far ones hear each other in rounds, and only the number of rounds
that a drone has missed in a row is kept of each pair.
"""

import math

import numba

from crazychoir.numerics.kernels import kernel, rows_of
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.collision.airspace_rows import (
    AIRSPACE_RULES_ROW,
    LINK_ROW,
    LISTENER_ROW,
    PAIR_ROW,
    ROUND_ROW,
    SWARM_ROW,
    LinkKind,
    Missed,
)
from crazychoir.safety.collision.distances import BRAKING_MODEL, COLLISION_DISTANCES
from crazychoir.safety.collision.hearing import byte_table, see_state
from crazychoir.safety.collision.motion import compute_norm
from crazychoir.safety.collision.state_rates import (
    FIRST_NEWS_TIME,
    NEIGHBOUR_AGES,
    RELAY_LEAD_TIME,
    RELAY_REQUESTS,
    SPEED_ALLOWANCE,
    STATE_RATES,
    find_interval,
)
from crazychoir.types import Bytes, Records, Vec

CHECK_NS = int(NS_PER_SECOND * STATE_RATES.check_interval)  # ns, between two checks
FIRST_NEWS_NS = int(NS_PER_SECOND * FIRST_NEWS_TIME)


@kernel()
def compute_distance(p: Vec, q: Vec, scale: Vec) -> float:
    """Return |S (p - q)| in m."""
    return compute_norm(
        (
            scale[0] * (p[0] - q[0]),
            scale[1] * (p[1] - q[1]),
            scale[2] * (p[2] - q[2]),
        )
    )


@kernel()
def compute_speeds(x: Vec, y: Vec) -> float:
    """Return the sum of the speeds in two states (13,), m/s."""
    return compute_norm((x[3], x[4], x[5])) + compute_norm((y[3], y[4], y[5]))


@kernel()
def compute_age_limit(apart: float, rules: Records) -> float:
    """Return the age in s of a state beyond which a drone brakes for want of a newer one.

    apart: m
    rules: one row of AIRSPACE_RULES_ROW
    """
    return float(
        NEIGHBOUR_AGES.usable
        + max(apart - rules.width - COLLISION_DISTANCES.silent_drone, 0.0) / rules.v_max
    )


@kernel()
def is_near(own: Vec, other: Vec, age: float, rules: Records) -> bool:
    """Return whether two drones could meet, or need each other's states more often than in rounds.

    Both may fly until the next check. A drone that is not heard may be anywhere within its largest
    speed times its age.

    own: (13,), newest state of this drone
    other: (13,), newest known state of the other one
    age: s, of that state
    rules: one row of AIRSPACE_RULES_ROW
    """
    if not age < NEIGHBOUR_AGES.gone:
        return True
    apart = compute_distance(own, other, rules.scale)
    if age > compute_age_limit(apart, rules) - RELAY_LEAD_TIME:
        return True
    flown = (
        2.0
        * rules.v_max
        * (min(age, BRAKING_MODEL.silent_flight_time) + STATE_RATES.check_interval)
    )
    meets = 2.0 * rules.width + STATE_RATES.later * (
        compute_speeds(own, other) + SPEED_ALLOWANCE
    )
    brakes = (
        rules.width
        + COLLISION_DISTANCES.silent_drone
        + rules.v_max * (STATE_RATES.long_wait - NEIGHBOUR_AGES.usable)
    )
    return bool(apart - flown < max(rules.range, meets, brakes))


@kernel()
def measure_pair(own: Vec, pair: Records, rules: Records, now: float) -> None:
    """Store how soon a pair could meet, and how old its state may become.

    own: (13,), newest state of this drone
    pair: one row of PAIR_ROW
    rules: one row of AIRSPACE_RULES_ROW
    now: s
    """
    age = now - pair.state_time
    stands = pair.state[2] < rules.standing_height
    if not age < NEIGHBOUR_AGES.gone and not (stands and age < math.inf):
        pair.meeting_time = math.inf
        pair.age_limit = math.inf
        return
    apart = compute_distance(own, pair.state, rules.scale)
    pair.meeting_time = (apart - 2.0 * rules.width) / (
        compute_speeds(own, pair.state) + SPEED_ALLOWANCE
    )
    pair.age_limit = compute_age_limit(apart, rules)


@kernel()
def is_sought(pair: Records, check_count: int, now: float) -> bool:
    """Return whether a drone should ask others for a newer state in this check.

    It asks less often for a drone if RELAY_LEAD_TIME s of asking have not helped.

    pair: one row of PAIR_ROW
    check_count: number of this check
    now: s
    """
    age = now - pair.state_time
    if not age < NEIGHBOUR_AGES.gone:
        return check_count % RELAY_REQUESTS.checks_if_gone == 0
    needed = max(RELAY_REQUESTS.least_age, pair.age_limit - RELAY_LEAD_TIME)
    if age <= needed:
        return False
    if age < needed + RELAY_LEAD_TIME:
        return True
    return check_count % RELAY_REQUESTS.checks_if_unanswered == 0


@kernel()
def find_pair(listener: Records, pairs: Records, other: int) -> int:
    """Return the row of the pair of a drone with another one, or -1.

    listener: one row of LISTENER_ROW
    pairs: PAIR_ROW
    other: row of SWARM_ROW
    """
    low = listener.first_pair
    high = low + listener.pair_count
    while low < high:
        middle = (low + high) // 2
        if pairs[middle].other < other:
            low = middle + 1
        else:
            high = middle
    if low < listener.first_pair + listener.pair_count and pairs[low].other == other:
        return int(low)
    return -1


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
    target.interval_ns = source.interval_ns
    target.due_ns = source.due_ns
    target.sending_interval_ns = source.sending_interval_ns
    target.sending_due_ns = source.sending_due_ns
    target.turns = source.turns
    target.is_by_hand = source.is_by_hand
    target.is_sought = source.is_sought


@kernel()
def fill_far_pair(
    pair: Records,
    other: int,
    swarm: Records,
    rounds: Records,
    capacity: int,
    missed: int,
    now: float,
) -> None:
    """Fill a pair with what a drone knows of a far one.

    pair: one row of PAIR_ROW
    other: row of the far drone
    swarm: SWARM_ROW
    rounds: ROUND_ROW, (swarm x capacity,)
    capacity: rounds that are kept of each drone
    missed: rounds missed in a row, or Missed.ALL
    now: s
    """
    sender = swarm[other]
    pair.other = other
    pair.drone = sender.drone
    pair.share = sender.share
    pair.turns = 0
    pair.is_by_hand = 0
    pair.is_sought = 0
    if missed < min(sender.round_count, capacity):
        last = rounds[other * capacity + (sender.round_count - 1 - missed) % capacity]
        for c in range(13):
            pair.state[c] = last.state[c]
        for c in range(3):
            pair.acceleration[c] = last.acceleration[c]
        pair.state_time = last.state_time
    else:
        for c in range(13):
            pair.state[c] = 0.0
        pair.state[9] = 1.0
        for c in range(3):
            pair.acceleration[c] = 0.0
        pair.state_time = -math.inf
    pair.heard_time = pair.state_time
    see_state(pair, sender, now)


@kernel()
def plan_times(
    pair: Records, sender: Records, far_interval_ns: int, now_ns: int
) -> None:
    """Set when a new pair hears and sends: as often as far drones, in the next round.

    pair: one row of PAIR_ROW
    sender: the other drone, one row of SWARM_ROW
    far_interval_ns: ns
    now_ns: ns
    """
    pair.sending_interval_ns = far_interval_ns
    pair.sending_due_ns = now_ns
    pair.interval_ns = far_interval_ns if sender.listener >= 0 else 1
    pair.due_ns = sender.round_due_ns if sender.listener >= 0 else 0


@kernel()
def set_interval(pair: Records, interval_ns: int, far_interval_ns: int) -> None:
    """Change how often a pair hears; it hears at once, then on the sender's grid of times.

    pair: one row of PAIR_ROW
    interval_ns: ns
    far_interval_ns: ns
    """
    if pair.interval_ns != interval_ns:
        pair.interval_ns = interval_ns
        pair.due_ns %= far_interval_ns


@kernel()
def pace_pair(
    pair: Records,
    at: int,
    listeners: Records,
    pairs: Records,
    swarm: Records,
    missed: Bytes,
    rules: Records,
) -> None:
    """Send the own state to another drone as often as the distance demands.

    A drone that stands on the floor sends it as to far drones: it comes near no other drone.

    pair: what the sender knows of the receiver, one row of PAIR_ROW
    at: row of the sender in the swarm
    listeners: LISTENER_ROW
    pairs: PAIR_ROW
    swarm: SWARM_ROW
    missed: (listeners, swarm)
    rules: one row of AIRSPACE_RULES_ROW
    """
    far_interval_ns = rules.far_interval_ns
    interval_ns = far_interval_ns
    if swarm[at].state[2] >= rules.standing_height:
        interval_ns = find_interval(pair.meeting_time, pair.age_limit, far_interval_ns)
    if pair.sending_interval_ns != interval_ns:
        pair.sending_interval_ns = interval_ns
        pair.sending_due_ns %= far_interval_ns
    receiver = swarm[pair.other].listener
    if receiver < 0 or missed[receiver, at] != Missed.PAIRED:
        return
    found = find_pair(listeners[receiver], pairs, at)
    if found >= 0:
        set_interval(pairs[found], interval_ns, far_interval_ns)


@kernel()
def count_far(pair: Records, listener: Records, rules: Records, now: float) -> None:
    """Count a far drone as heard or as silent, if it flies.

    pair: what is known of it, one row of PAIR_ROW
    listener: one row of LISTENER_ROW
    rules: one row of AIRSPACE_RULES_ROW
    now: s
    """
    if (
        pair.state[2] < rules.standing_height
        or not now - pair.state_time < NEIGHBOUR_AGES.gone
    ):
        return
    if now - pair.heard_time < NEIGHBOUR_AGES.silent:
        listener.far_heard += 1
    else:
        listener.far_silent += 1


@kernel()
def is_behind(pair: Records, sender: Records, rounds: Records, capacity: int) -> bool:
    """Return whether a drone has heard nothing since the latest round of another one.

    It must not forget the pair: it would then count as having heard that round.

    pair: one row of PAIR_ROW
    sender: the other drone, one row of SWARM_ROW
    rounds: ROUND_ROW, (swarm x capacity,)
    capacity: rounds that are kept of each drone
    """
    if sender.round_count == 0:
        return True
    last = rounds[pair.other * capacity + (sender.round_count - 1) % capacity]
    return bool(pair.heard_time < last.state_time)


@kernel()
def is_unknown(missed: int, rules: Records, now_ns: int) -> bool:
    """Return whether another drone may be anywhere, because it was not heard for long.

    missed: rounds missed in a row, or Missed.ALL
    rules: one row of AIRSPACE_RULES_ROW
    now_ns: ns
    """
    if missed == Missed.ALL:
        return bool(now_ns - rules.began_ns >= FIRST_NEWS_NS)
    # The rounds that are left keep what is known until the next checks.
    return bool(missed >= rules.round_capacity - 4)


@kernel()
def check_pairs(
    at: int,
    listeners: Records,
    pairs: Records,
    swarm: Records,
    rounds: Records,
    missed: Bytes,
    links: Records,
    rules: Records,
    found: Records,
    now_ns: int,
) -> int:
    """Write the near pairs of one drone to `found`, ordered by id, and return their number.

    Arguments as in check_distances.
    """
    listener = listeners[at]
    own = swarm[listener.place].state
    capacity = rules.round_capacity
    now = now_ns / NS_PER_SECOND
    listener.far_heard = 0
    listener.far_silent = 0
    count = 0
    k = listener.first_pair
    for j in range(swarm.shape[0]):
        if j == listener.place:
            continue
        lack = missed[at, j]
        pair = found[count]
        if lack == Missed.PAIRED:
            copy_pair(pairs[k], pair)
            k += 1
            stays = is_behind(pair, swarm[j], rounds, capacity)
        else:
            fill_far_pair(pair, j, swarm, rounds, capacity, lack, now)
            plan_times(pair, swarm[j], rules.far_interval_ns, now_ns)
            stays = is_unknown(lack, rules, now_ns)
        if pair.state_time > -math.inf:
            stays |= is_near(own, pair.state, now - pair.state_time, rules)
        if links.shape[0] > 0:
            stays |= links[at * swarm.shape[0] + j].kind == LinkKind.BY_HAND
        stays |= listener.keeps_all != 0
        if stays:
            measure_pair(own, pair, rules, now)
            count += 1
        else:
            count_far(pair, listener, rules, now)
            if lack == Missed.PAIRED:
                pair.meeting_time = math.inf
                pair.age_limit = math.inf
                pace_pair(pair, listener.place, listeners, pairs, swarm, missed, rules)
    return count


@kernel()
def take_pairs(
    at: int,
    count: int,
    listeners: Records,
    pairs: Records,
    swarm: Records,
    missed: Bytes,
    rules: Records,
    found: Records,
    now: float,
) -> None:
    """Replace the pairs of one drone by the first `count` rows of `found`.

    Arguments as in check_distances; now: s
    """
    listener = listeners[at]
    listener.check_count += 1
    listener.sought_count = 0
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        missed[at, pairs[k].other] = 0
    for k in range(count):
        pair = pairs[listener.first_pair + k]
        copy_pair(found[k], pair)
        missed[at, pair.other] = Missed.PAIRED
        sender = swarm[pair.other]
        if sender.listener >= 0:
            back = find_pair(listeners[sender.listener], pairs, listener.place)
            if back >= 0:
                set_interval(
                    pair, pairs[back].sending_interval_ns, rules.far_interval_ns
                )
    listener.pair_count = count
    for k in range(count):
        pair = pairs[listener.first_pair + k]
        pair.is_sought = is_sought(pair, listener.check_count, now)
        listener.sought_count += pair.is_sought
        pace_pair(pair, listener.place, listeners, pairs, swarm, missed, rules)


@kernel(
    rows_of(LISTENER_ROW),
    rows_of(PAIR_ROW),
    rows_of(SWARM_ROW),
    rows_of(ROUND_ROW),
    byte_table,
    rows_of(LINK_ROW),
    rows_of(AIRSPACE_RULES_ROW),
    rows_of(PAIR_ROW),
    numba.int64,
)
def check_distances(
    listeners: Records,
    pairs: Records,
    swarm: Records,
    rounds: Records,
    missed: Bytes,
    links: Records,
    rules: Records,
    found: Records,
    now_ns: int,
) -> int:
    """Find the near pairs of all drones that are due for a check.

    listeners: LISTENER_ROW
    pairs: PAIR_ROW
    swarm: SWARM_ROW
    rounds: ROUND_ROW, (swarm x rounds that are kept,)
    missed: (listeners, swarm): rounds missed in a row, or Missed
    links: LINK_ROW, (listeners x swarm,)
    rules: AIRSPACE_RULES_ROW, (1,)
    found: PAIR_ROW, (swarm,): work space
    now_ns: ns
    Returns the first drone that needs room for more pairs, or -1. Its check is not done then.
    """
    for at in range(listeners.shape[0]):
        listener = listeners[at]
        is_lost = swarm[listener.place].state_time == -math.inf
        if now_ns < listener.check_ns or (is_lost and listener.keeps_all == 0):
            continue
        count = check_pairs(
            at, listeners, pairs, swarm, rounds, missed, links, rules[0], found, now_ns
        )
        if count > listener.pair_capacity:
            return at
        now = now_ns / NS_PER_SECOND
        take_pairs(at, count, listeners, pairs, swarm, missed, rules[0], found, now)
        listener.check_ns += ((now_ns - listener.check_ns) // CHECK_NS + 1) * CHECK_NS
    return -1
