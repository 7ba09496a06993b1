"""Far drones: what a drone knows of others that it hears in rounds only."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import Triple
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import FarCell, FarKind, Need
from crazychoir.safety.airspace.hearing import note_hearing, see_state, store_state
from crazychoir.safety.airspace.motion import compute_norm
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES, STATE_RATES
from crazychoir.types import Records

Recalled = tuple[Triple, Triple, float, float]
"""Place in m, velocity in m/s, time of both in s, and time of the last heard round in s."""


@kernel()
def find_far_kind(
    height: float, state_time: float, heard_time: float, rules: Records, now: float
) -> FarKind:
    """Return how a far drone counts.

    height: m, of its newest known place
    state_time: s, time of this place
    heard_time: s, time of the last state that the drone sent itself
    rules: one row of AIRSPACE_RULES_ROW
    now: s
    """
    if height < rules.standing_height or not now - state_time < NEIGHBOUR_AGES.gone:
        return FarKind.GROUNDED
    if now - heard_time < NEIGHBOUR_AGES.silent:
        return FarKind.HEARD
    return FarKind.SILENT


@kernel()
def count_far(listener: Records, kind: FarKind, change: int) -> None:
    """Count a far drone as heard or as silent.

    listener: one row of LISTENER_ROW
    kind: how it counts
    change: 1 or -1: the number of drones to add
    """
    if kind == FarKind.HEARD:
        listener.far_heard += change
    elif kind == FarKind.SILENT:
        listener.far_silent += change


@kernel()
def recall_round(
    other: int,
    swarm: Records,
    rounds: Records,
    capacity: int,
    missed: int,
    now: float,
) -> Recalled:
    """Return what a drone knows of a far one.

    other: row of the far drone
    swarm: SWARM_ROW
    rounds: ROUND_ROW, (swarm x capacity,)
    capacity: rounds that are kept of each drone
    missed: rounds missed in a row, or Missed.ALL
    now: s
    """
    sender = swarm[other]
    place = (0.0, 0.0, 0.0)
    velocity = (0.0, 0.0, 0.0)
    heard_time = -math.inf
    if missed < min(sender.round_count, capacity):
        last = rounds[other * capacity + (sender.round_count - 1 - missed) % capacity]
        place = (last.state[0], last.state[1], last.state[2])
        velocity = (last.state[3], last.state[4], last.state[5])
        heard_time = last.state_time
    if sender.seen_time > heard_time and now - heard_time > NEIGHBOUR_AGES.unheard:
        seen = sender.seen_state
        return (
            (seen[0], seen[1], seen[2]),
            (seen[3], seen[4], seen[5]),
            sender.seen_time,
            heard_time,
        )
    return place, velocity, heard_time, heard_time


@kernel()
def fill_pair(
    pair: Records,
    motion: Records,
    other: int,
    swarm: Records,
    rounds: Records,
    rules: Records,
    missed: int,
    now: float,
) -> None:
    """Fill a new pair with what a drone knows of a far one.

    pair: one row of PAIR_ROW
    motion: its row of MOTION_ROW
    rules: one row of AIRSPACE_RULES_ROW
    Other arguments as in recall_round.
    """
    sender = swarm[other]
    capacity = rules.round_capacity
    pair.other = other
    pair.drone = sender.drone
    motion.drone = sender.drone
    pair.turns = 0
    pair.asked_time = -math.inf
    pair.is_by_hand = 0
    pair.need = Need.NONE
    if missed < min(sender.round_count, capacity):
        last = rounds[other * capacity + (sender.round_count - 1 - missed) % capacity]
        store_state(
            pair,
            motion,
            last.state[:],
            last.acceleration[:],
            last.state_time,
            rules.lag,
        )
    else:
        for c in range(13):
            pair.state[c] = 0.0
        pair.state[9] = 1.0
        for c in range(3):
            pair.acceleration[c] = 0.0
        store_state(
            pair, motion, pair.state[:], pair.acceleration[:], -math.inf, rules.lag
        )
    note_hearing(pair, motion, pair.state_time, sender.share)
    see_state(pair, motion, sender, rules.lag, now)


@kernel()
def refresh_far(
    far: Records,
    grid: Records,
    swarm: Records,
    rounds: Records,
    rules: Records,
    now: float,
) -> None:
    """Note how all far drones count now, and whether they belong to a cell of the grid.

    far: FAR_ROW, (swarm,)
    grid: one row of GRID_ROW
    swarm: SWARM_ROW
    rounds: ROUND_ROW, (swarm x rounds that are kept,)
    rules: one row of AIRSPACE_RULES_ROW
    now: s
    """
    late = rules.far_interval_ns / NS_PER_SECOND + STATE_RATES.check_interval
    grid.lacking = 0
    grid.heard = 0
    grid.silent = 0
    grid.oldest = 0.0
    grid.fastest = 0.0
    for j in range(swarm.shape[0]):
        known = far[j]
        grid.lacking += swarm[j].lacking_count
        if rules.has_seen != 0:
            place, velocity, known.state_time, known.heard_time = recall_round(
                j, swarm, rounds, rules.round_capacity, 0, now
            )
            for c in range(3):
                known.place[c] = place[c]
                known.velocity[c] = velocity[c]
        known.kind = find_far_kind(
            known.place[2], known.state_time, known.heard_time, rules, now
        )
        grid.heard += known.kind == FarKind.HEARD
        grid.silent += known.kind == FarKind.SILENT
        age = now - known.state_time
        if age <= late:
            known.cell = 0
            grid.oldest = max(grid.oldest, age)
            grid.fastest = max(grid.fastest, compute_norm(known.velocity))
        else:
            known.cell = FarCell.LATE if age < math.inf else FarCell.UNKNOWN
