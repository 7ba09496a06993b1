"""Hearing: states reach the near drones at their own times, and all far drones in rounds."""

import math

import numba

from crazychoir.numerics.kernels import (
    NO_COUNTING,
    kernel,
    matrix,
    real,
    rows_of,
    vector,
    wholes,
)
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import (
    AIRSPACE_RULES_ROW,
    ALL_BITS,
    DUE_ROW,
    FAR_ROW,
    FRAME_ROW,
    LINK_ROW,
    LISTENER_ROW,
    LOSS_ROW,
    MOTION_ROW,
    PACE_ROW,
    PAIR_ROW,
    ROUND_ROW,
    SWARM_ROW,
    LinkKind,
    LinkKinds,
    Missed,
)
from crazychoir.safety.airspace.late_states import LATE_ROW, keep_late, send_late
from crazychoir.safety.airspace.link_fates import (
    judge_link,
    link_kinds,
    needs_pair,
    pass_link,
)
from crazychoir.safety.airspace.motion import compute_late_motion
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.types import Bytes, Ints, Mat, Records, Vec

LARGEST_STATE_NORM = 1e6
"""Largest norm of a valid state (13,), in the units of its entries."""
LARGEST_ACCELERATION_NORM = 100.0
"""Largest norm of a valid acceleration, m/s2."""

integers = numba.types.Array(numba.int64, 1, "C", readonly=True)
"""An array (n,) of integers that a kernel reads."""
frame_rows = numba.types.Array(
    numba.from_dtype(FRAME_ROW), 1, "C", readonly=True, aligned=False
)
"""An array (n,) of FRAME_ROW that a kernel reads."""
byte_table = numba.uint8[:, ::1]
"""An array (m, n) of bytes that a kernel writes."""


@kernel()
def is_valid_acceleration(acceleration: Vec) -> bool:
    """Return whether an acceleration (3,) is finite and not too large."""
    squared = 0.0
    for c in range(3):
        squared += acceleration[c] * acceleration[c]
    return bool(squared < LARGEST_ACCELERATION_NORM * LARGEST_ACCELERATION_NORM)


@kernel()
def are_valid(state: Vec, acceleration: Vec) -> bool:
    """Return whether a state (13,) and an acceleration (3,) are finite and not too large."""
    squared = 0.0
    for c in range(13):
        squared += state[c] * state[c]
    is_state = squared < LARGEST_STATE_NORM * LARGEST_STATE_NORM
    return bool(is_state and is_valid_acceleration(acceleration))


@kernel(vector)
def is_valid_state(values: Vec) -> bool:
    """Return whether a state (13,) and an acceleration (3,) are finite and not too large.

    values: (16,)
    """
    return bool(are_valid(values[0:13], values[13:16]))


@kernel()
def take_newest(
    row: Records, number: int, state: Vec, acceleration: Vec, time: float, age: float
) -> bool:
    """Store the state of one drone, unless it is invalid or outdated; return whether it is stored.

    row: of the drone, one row of SWARM_ROW
    number: tick of the sender
    state: (13,), as State.flat
    acceleration: (3,) m/s2
    time: s, of the state
    age: s, of the state when it was sent
    """
    if (
        number == row.number
        or not time >= row.state_time
        or not are_valid(state, acceleration)
    ):
        return False
    row.number = number
    row.is_fresh = 1
    row.state_time = time
    row.age = age
    for c in range(13):
        row.state[c] = state[c]
    for c in range(3):
        row.acceleration[c] = acceleration[c]
    return True


@kernel(rows_of(SWARM_ROW), integers, integers, matrix, vector, **NO_COUNTING)
def take_states(
    swarm: Records, places: Ints, numbers: Ints, states: Mat, times: Vec
) -> None:
    """Store the states of the drones of this process, except invalid and outdated ones.

    swarm: SWARM_ROW, one row a drone
    places: (k,): rows of the swarm
    numbers: (k,): ticks of the senders
    states: (k, 16): state (13,) and acceleration (3,)
    times: (k,) s, times of the states
    """
    for k in range(places.shape[0]):
        take_newest(
            swarm[places[k]],
            numbers[k],
            states[k, 0:13],
            states[k, 13:16],
            times[k],
            0.0,
        )


@kernel()
def find_sorted(values: Ints, first: int, end: int, wanted: int) -> int:
    """Return the place of a number among increasing numbers, or -1.

    values: (n,)
    first: first place to search
    end: end of these places
    wanted: the number
    """
    low = first
    high = end
    while low < high:
        middle = (low + high) // 2
        if values[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    if low < end and values[low] == wanted:
        return int(low)
    return -1


@kernel(rows_of(SWARM_ROW), frame_rows, vector, integers, integers, **NO_COUNTING)
def take_frames(
    swarm: Records, rows: Records, times: Vec, hosts: Ints, bits: Ints
) -> bool:
    """Store the states that other processes have sent, except invalid and outdated ones.

    No other process may speak for a drone of this one, and no host for a drone of another host.

    swarm: SWARM_ROW, one row a drone
    rows: (k,) FRAME_ROW
    times: (k,) s, when the frame of each row was sent
    hosts: (k,), of the sender, as host in SWARM_ROW
    bits: (k,), of the sender, as process_bits in SWARM_ROW
    Returns whether one of the drones is now flown by another process than before.
    """
    has_changed = False
    for k in range(rows.shape[0]):
        frame_row = rows[k]
        place = find_sorted(swarm["drone"], 0, swarm.shape[0], frame_row.drone)
        if place < 0 or swarm[place].listener >= 0:
            continue
        if not 0.0 <= frame_row.age < NEIGHBOUR_AGES.gone:
            continue
        row = swarm[place]
        if row.host != hosts[k]:
            continue
        if take_newest(
            row,
            frame_row.number,
            frame_row.state[:],
            frame_row.acceleration[:],
            times[k] - frame_row.age,
            frame_row.age,
        ):
            has_changed |= row.process_bits != bits[k]
            row.process_bits = bits[k]
    return has_changed


@kernel()
def count_message(listeners: Records, at: int, sender: Records, fate: LinkKind) -> None:
    """Count a state that one drone has sent to another one.

    It counts for the sender. If another process flies the sender, only the receiver knows what
    became of the state, so it counts for the receiver.

    listeners: LISTENER_ROW
    at: number of the receiver
    sender: one row of SWARM_ROW
    fate: result of judge_link
    """
    row = listeners[sender.listener if sender.listener >= 0 else at]
    row.sent += 1
    row.lost += fate == LinkKind.CUT


@kernel()
def copy_motion(source: Records, target: Records) -> None:
    """Copy one row of MOTION_ROW to another one."""
    target.state_time = source.state_time
    target.heard_time = source.heard_time
    for c in range(3):
        target.place[c] = source.place[c]
        target.velocity[c] = source.velocity[c]
        target.acceleration[c] = source.acceleration[c]
    target.height = source.height
    target.share = source.share
    target.drone = source.drone


@kernel(forceinline=True)
def store_state(
    pair: Records,
    motion: Records,
    state: Vec,
    acceleration: Vec,
    state_time: float,
    lag: float,
) -> None:
    """Store a state in a pair, with what follows from it.

    pair: one row of PAIR_ROW
    motion: its row of MOTION_ROW
    state: (13,), as State.flat
    acceleration: (3,) m/s2, as State.a
    state_time: s
    lag: s, with which the other drone obeys
    """
    pair.state_time = state_time
    motion.state_time = state_time
    for c in range(13):
        pair.state[c] = state[c]
    motion.height = state[2]
    place, velocity = compute_late_motion(state, acceleration, lag)
    for c in range(3):
        pair.acceleration[c] = acceleration[c]
        motion.acceleration[c] = acceleration[c]
        motion.place[c] = place[c]
        motion.velocity[c] = velocity[c]


@kernel()
def note_hearing(
    pair: Records, motion: Records, heard_time: float, share: float
) -> None:
    """Note when a drone has heard another one itself, and which share that one takes.

    pair: one row of PAIR_ROW
    motion: its row of MOTION_ROW
    heard_time: s
    share: as in PAIR_ROW
    """
    pair.heard_time = heard_time
    motion.heard_time = heard_time
    pair.share = share
    motion.share = share


@kernel(forceinline=True)
def take_state(
    pair: Records,
    motion: Records,
    state: Vec,
    acceleration: Vec,
    state_time: float,
    share: float,
    lag: float,
) -> None:
    """Take a state that the other drone has sent itself, unless the pair knows a newer one.

    pair: one row of PAIR_ROW
    motion: its row of MOTION_ROW
    state: (13,), as State.flat
    acceleration: (3,) m/s2, as State.a
    state_time: s
    share: as in PAIR_ROW
    lag: s, with which the other drone obeys
    """
    if state_time >= pair.state_time:
        store_state(pair, motion, state, acceleration, state_time, lag)
    note_hearing(pair, motion, max(pair.heard_time, state_time), share)


@kernel(rows_of(PAIR_ROW), rows_of(MOTION_ROW), vector, real, real, real, numba.boolean)
def take_message(
    pairs: Records,
    motions: Records,
    values: Vec,
    state_time: float,
    share: float,
    lag: float,
    is_relayed: bool,
) -> None:
    """Take a state from a message, unless the pair knows a newer one.

    pairs: the pair, (1,) PAIR_ROW
    motions: (1,) MOTION_ROW
    values: (16,): state (13,) and acceleration (3,)
    state_time: s
    share: as in PAIR_ROW
    lag: s, with which the other drone obeys
    is_relayed: whether a third drone sent it
    """
    pair = pairs[0]
    state = values[0:13]
    acceleration = values[13:16]
    if not is_relayed:
        take_state(pair, motions[0], state, acceleration, state_time, share, lag)
    elif state_time >= pair.state_time:
        store_state(pair, motions[0], state, acceleration, state_time, lag)


@kernel()
def see_state(
    pair: Records, motion: Records, sender: Records, lag: float, now: float
) -> None:
    """Store the place where the cameras see the sender, if nothing was heard of it lately.

    The sender then counts as giving way to no other drone.

    pair: one row of PAIR_ROW
    motion: its row of MOTION_ROW
    sender: one row of SWARM_ROW
    lag: s, with which the sender obeys
    now: s
    """
    if (
        sender.seen_time > pair.state_time
        and now - pair.state_time > NEIGHBOUR_AGES.unheard
    ):
        for c in range(3):
            pair.acceleration[c] = 0.0
        store_state(
            pair,
            motion,
            sender.seen_state[:],
            pair.acceleration[:],
            sender.seen_time,
            lag,
        )
        note_hearing(pair, motion, pair.heard_time, 1.0)


@kernel()
def find_next_time(due_ns: int, interval_ns: int, now_ns: int) -> int:
    """Return the first time after now on a grid of times.

    due_ns: ns, a time of the grid, not after now
    interval_ns: ns, between two times of the grid
    now_ns: ns
    """
    return due_ns + ((now_ns - due_ns) // interval_ns + 1) * interval_ns


@kernel(forceinline=True)
def hear_pairs(
    listener: Records,
    at: int,
    listeners: Records,
    pairs: Records,
    motions: Records,
    paces: Records,
    dues: Records,
    swarm: Records,
    links: Records,
    kinds: LinkKinds,
    losses: Records,
    late: Records,
    late_count: Ints,
    lag: float,
    now_ns: int,
) -> int:
    """Let one drone hear the near drones that are due, and return how many wait for a verdict.

    Note whether drones of other processes need the state of this drone.

    listener: one row of LISTENER_ROW
    at: its number
    listeners: LISTENER_ROW
    pairs: PAIR_ROW
    motions: MOTION_ROW
    paces: PACE_ROW
    dues: DUE_ROW
    swarm: SWARM_ROW
    links: LINK_ROW, (listeners x swarm,)
    kinds: (listeners x swarm,): LinkKind of each link
    losses: LOSS_ROW
    late: LATE_ROW, with room for all copies of all states
    late_count: (1,): number of states on their way
    lag: s, with which drones obey
    now_ns: ns
    """
    waiting = 0
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        due = dues[k]
        if now_ns >= due.sending_ns:
            due.sending_ns = find_next_time(
                due.sending_ns, paces[k].sending_interval_ns, now_ns
            )
            listener.frame_due |= swarm[paces[k].other].process_bits
        if now_ns < due.hearing_ns:
            continue
        pace = paces[k]
        sender = swarm[pace.other]
        if sender.is_fresh == 0:
            continue
        due.hearing_ns = find_next_time(due.hearing_ns, pace.interval_ns, now_ns)
        fate = LinkKind.CLEAR
        link = at * swarm.shape[0] + pace.other
        if pace.is_told != 0:
            # The message to the law, whose link and sender count it there.
            if links.shape[0] > 0:
                fate = judge_link(links, kinds, losses, link, sender.number)
        elif links.shape[0] > 0:
            fate = pass_link(links, kinds, losses, link, sender.number)
        if fate != LinkKind.BY_HAND and pace.is_told == 0:
            count_message(listeners, at, sender, fate)
        if fate == LinkKind.CLEAR:
            take_state(
                pairs[k],
                motions[k],
                sender.state[:],
                sender.acceleration[:],
                sender.state_time,
                sender.share,
                lag,
            )
        elif fate == LinkKind.LATE:
            send_late(
                late,
                late_count,
                links,
                kinds,
                losses,
                link,
                sender,
                at,
                pace.other,
                sender.state_time,
                pace.is_told == 0,
                now_ns,
            )
        elif fate == LinkKind.BY_HAND:
            pairs[k].is_by_hand = 1
            waiting += 1
    return waiting


@kernel(forceinline=True)
def hear_late(
    late: Records,
    late_count: Ints,
    listeners: Records,
    pairs: Records,
    motions: Records,
    paces: Records,
    swarm: Records,
    missed: Bytes,
    lag: float,
    now_ns: int,
) -> None:
    """Let the drones hear the states that have arrived late, and keep those on their way.

    Arguments as in hear_pairs and hear_rounds.
    """
    kept = 0
    for k in range(late_count[0]):
        row = late[k]
        if row.arrival_ns > now_ns:
            kept = keep_late(late, k, kept)
        elif missed[row.receiver, row.other] == Missed.PAIRED:
            listener = listeners[row.receiver]
            end = listener.first_pair + listener.pair_count
            at = find_sorted(paces["other"], listener.first_pair, end, row.other)
            take_state(
                pairs[at],
                motions[at],
                row.state[:],
                row.acceleration[:],
                row.state_time,
                swarm[row.other].share,
                lag,
            )
    late_count[0] = kept


@kernel(forceinline=True)
def see_pairs(
    listener: Records,
    pairs: Records,
    motions: Records,
    swarm: Records,
    lag: float,
    now: float,
) -> None:
    """Let one drone use the places where the cameras see its near drones.

    listener: one row of LISTENER_ROW
    pairs: PAIR_ROW
    motions: MOTION_ROW
    swarm: SWARM_ROW
    lag: s, with which drones obey
    now: s
    """
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        sender = swarm[pairs[k].other]
        if sender.seen_time > -math.inf:
            see_state(pairs[k], motions[k], sender, lag, now)


@kernel()
def say_round(
    sender: Records, at: int, rounds: Records, far: Records, capacity: int
) -> None:
    """Keep the newest state of one drone as what it says to all far drones.

    sender: one row of SWARM_ROW
    at: its number
    rounds: ROUND_ROW, (swarm x capacity,)
    far: FAR_ROW, (swarm,)
    capacity: rounds that are kept of each drone
    """
    last = rounds[at * capacity + sender.round_count % capacity]
    sender.round_count += 1
    last.state_time = sender.state_time
    for c in range(13):
        last.state[c] = sender.state[c]
    for c in range(3):
        last.acceleration[c] = sender.acceleration[c]
    known = far[at]
    known.state_time = sender.state_time
    known.heard_time = sender.state_time
    for c in range(3):
        known.place[c] = sender.state[c]
        known.velocity[c] = sender.state[3 + c]


@kernel(forceinline=True)
def hear_rounds(
    at: int,
    senders: Ints,
    count: int,
    listeners: Records,
    swarm: Records,
    missed: Bytes,
    links: Records,
    kinds: LinkKinds,
    losses: Records,
    capacity: int,
) -> None:
    """Let one drone hear or miss the rounds of some far drones.

    at: number of the drone
    senders: rows of the far drones in the swarm
    count: number of these drones
    listeners: LISTENER_ROW
    swarm: SWARM_ROW
    missed: (listeners, swarm): rounds missed in a row, or Missed
    links: LINK_ROW, (listeners x swarm,)
    kinds: (listeners x swarm,): LinkKind of each link
    losses: LOSS_ROW
    capacity: rounds that are kept of each drone
    """
    heard = missed[at]
    place = listeners[at].place
    for k in range(count):
        other = senders[k]
        before = heard[other]
        if before == Missed.PAIRED or other == place:
            continue
        sender = swarm[other]
        fate = LinkKind.CLEAR
        if links.shape[0] > 0:
            link = at * swarm.shape[0] + other
            fate = LinkKind.LATE
            if not needs_pair(int(kinds[link])):
                fate = pass_link(links, kinds, losses, link, sender.number)
        if fate == LinkKind.CLEAR:
            heard[other] = 0
            continue
        sender.lacking_count += 1
        heard[other] = before + 1 if before < capacity - 1 else Missed.ALL


@kernel()
def say_rounds(
    swarm: Records,
    listeners: Records,
    rounds: Records,
    far: Records,
    rules: Records,
    has_network: bool,
    due: Ints,
    now_ns: int,
) -> int:
    """Keep the newest states of all drones that are due to speak to the far ones.

    Without a simulated network all drones hear it, so their bytes in `missed` stay zero.

    rules: one row of AIRSPACE_RULES_ROW
    has_network: whether a network is simulated
    due: (swarm,): receives the rows of drones with a round that a drone may miss, or has missed before
    now_ns: ns
    Other arguments as in say_round and hear_rounds.
    Returns the number of rows in `due`.
    """
    count = 0
    for j in range(swarm.shape[0]):
        sender = swarm[j]
        if sender.is_fresh == 0:
            continue
        sender.is_fresh = 0
        if now_ns < sender.round_due_ns:
            continue
        sender.round_due_ns = find_next_time(
            sender.round_due_ns, rules.far_interval_ns, now_ns
        )
        say_round(sender, j, rounds, far, rules.round_capacity)
        if sender.listener >= 0:
            listeners[sender.listener].frame_due = ALL_BITS
        if has_network or sender.lacking_count > 0:
            sender.lacking_count = 0
            due[count] = j
            count += 1
    return count


@kernel(
    rows_of(LISTENER_ROW),
    rows_of(PAIR_ROW),
    rows_of(MOTION_ROW),
    rows_of(PACE_ROW),
    rows_of(DUE_ROW),
    rows_of(SWARM_ROW),
    rows_of(ROUND_ROW),
    rows_of(FAR_ROW),
    byte_table,
    rows_of(LINK_ROW),
    link_kinds,
    rows_of(LOSS_ROW),
    rows_of(LATE_ROW),
    wholes,
    rows_of(AIRSPACE_RULES_ROW),
    wholes,
    numba.int64,
    **NO_COUNTING,
)
def hear_states(
    listeners: Records,
    pairs: Records,
    motions: Records,
    paces: Records,
    dues: Records,
    swarm: Records,
    rounds: Records,
    far: Records,
    missed: Bytes,
    links: Records,
    kinds: LinkKinds,
    losses: Records,
    late: Records,
    late_count: Ints,
    rules: Records,
    work: Ints,
    now_ns: int,
) -> int:
    """Let all drones of this process hear what is due, and return how many pairs wait for a verdict.

    rules: AIRSPACE_RULES_ROW, (1,)
    work: (swarm,): work space
    now_ns: ns
    Other arguments as in hear_pairs, say_round and hear_rounds.
    """
    waiting = 0
    lag = rules[0].lag
    for i in range(listeners.shape[0]):
        listener = listeners[i]
        listener.frame_due = 0
        waiting += hear_pairs(
            listener,
            i,
            listeners,
            pairs,
            motions,
            paces,
            dues,
            swarm,
            links,
            kinds,
            losses,
            late,
            late_count,
            lag,
            now_ns,
        )
        if rules[0].has_seen != 0:
            see_pairs(listener, pairs, motions, swarm, lag, now_ns / NS_PER_SECOND)
    if late_count[0] > 0:
        hear_late(
            late,
            late_count,
            listeners,
            pairs,
            motions,
            paces,
            swarm,
            missed,
            lag,
            now_ns,
        )
    count = say_rounds(
        swarm, listeners, rounds, far, rules[0], links.shape[0] > 0, work, now_ns
    )
    capacity = rules[0].round_capacity
    # The bytes of a listener are side by side.
    for i in range(listeners.shape[0]):
        hear_rounds(
            i,
            work,
            count,
            listeners,
            swarm,
            missed,
            links,
            kinds,
            losses,
            capacity,
        )
    return waiting
