"""The choice of the drones that a drone asks for states of others."""

import math

import numba

from crazychoir.numerics.kernels import NO_COUNTING, kernel, rows_of, wholes
from crazychoir.numerics.math3d import Triple
from crazychoir.safety.airspace.airspace_rows import (
    AIRSPACE_RULES_ROW,
    LISTENER_ROW,
    PACE_ROW,
    PAIR_ROW,
    ROUND_ROW,
    SWARM_ROW,
    Missed,
    Need,
)
from crazychoir.safety.airspace.far_drones import recall_round
from crazychoir.safety.airspace.hearing import byte_table
from crazychoir.safety.airspace.motion import compute_norm
from crazychoir.safety.airspace.pair_paces import find_pair
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES, RELAY_REQUESTS
from crazychoir.types import Bytes, Ints, Records, Vec

NO_DRONE = -1  # place in the swarm of no drone
NEAREST_ASKED = RELAY_REQUESTS.nearest_asked
MOST_SOUGHT = (
    0,
    RELAY_REQUESTS.most_soon,
    RELAY_REQUESTS.most_now,
    RELAY_REQUESTS.most_standing,
)
"""(4,): largest number of drones about which a drone asks in one check, for each Need but GONE."""
MOST_QUESTIONS = (sum(MOST_SOUGHT) + RELAY_REQUESTS.most_gone) * (NEAREST_ASKED + 1)
"""Largest number of questions of a drone in one check."""


@kernel()
def recall_heard(
    at: int,
    other: int,
    listeners: Records,
    pairs: Records,
    paces: Records,
    swarm: Records,
    rounds: Records,
    missed: Bytes,
    rules: Records,
    now: float,
) -> tuple[Triple, bool]:
    """Return where a drone knows another one, m, and whether it hears it.

    other: row of the other drone in the swarm
    Other arguments as in choose_asked.
    """
    lack = missed[at, other]
    if lack != Missed.PAIRED:
        place, _, _, heard_time = recall_round(
            other, swarm, rounds, rules.round_capacity, lack, now
        )
        return place, now - heard_time < NEIGHBOUR_AGES.silent
    pair = pairs[find_pair(listeners[at], paces, other)]
    place = (pair.state[0], pair.state[1], pair.state[2])
    return place, now - pair.heard_time < NEIGHBOUR_AGES.silent


@kernel()
def is_asked(drone: int, questions: Ints, first: int, end: int) -> bool:
    """Return whether one of some questions goes to a drone.

    drone: row of the drone in the swarm
    questions: (MOST_QUESTIONS, 2): rows of the asked and of the sought drones
    first: first question
    end: end of these questions
    """
    found = False
    for q in range(first, end):
        found |= questions[q, 0] == drone
    return found


@kernel()
def add_question(drone: int, sought: int, questions: Ints, count: int) -> int:
    """Add a question, and return the new number of questions.

    drone: row of the asked drone in the swarm
    sought: row of the sought drone
    questions: (MOST_QUESTIONS, 2): rows of the asked and of the sought drones
    count: number of questions so far
    """
    questions[count, 0] = drone
    questions[count, 1] = sought
    return count + 1


@kernel()
def choose_nearest(
    sought: int,
    state: Vec,
    heard: Ints,
    count: int,
    places: Vec,
    questions: Ints,
    asked: int,
) -> int:
    """Choose the heard drones that are nearest to a place, to ask them about a sought drone.

    sought: row of the sought drone in the swarm
    state: a state (13,) at the place
    heard: (count,): rows of the heard drones in the swarm
    count: number of heard drones
    places: (n, 3) m: their places, in the same order
    questions: receives pairs of asked and sought drones
    asked: number of questions so far
    Returns the new number of questions.
    """
    first = asked
    for _ in range(NEAREST_ASKED):
        best = NO_DRONE
        least = math.inf
        for k in range(count):
            apart = compute_norm(
                (
                    places[k, 0] - state[0],
                    places[k, 1] - state[1],
                    places[k, 2] - state[2],
                )
            )
            if heard[k] == sought or not apart < least:
                continue
            if not is_asked(heard[k], questions, first, asked):
                best = heard[k]
                least = apart
        if best != NO_DRONE:
            asked = add_question(best, sought, questions, asked)
    return asked


@kernel()
def choose_in_turn(
    sought: int,
    turn: int,
    heard: Ints,
    count: int,
    questions: Ints,
    first: int,
    asked: int,
) -> int:
    """Choose the heard drone that has its turn, or the next one without a question.

    turn: number of the turn, from 0 on
    first: first question about the sought drone
    Other arguments and result as in choose_nearest.
    """
    for step in range(count):
        drone = heard[(turn + step) % count]
        if drone != sought and not is_asked(drone, questions, first, asked):
            return add_question(drone, sought, questions, asked)
    return asked


@kernel()
def find_longest_waiting(listener: Records, pairs: Records, need: int) -> int:
    """Return the row of the pair about which was not asked for longest; -1: there is none.

    listener: one row of LISTENER_ROW
    pairs: PAIR_ROW
    need: Need of the pairs among which it chooses
    """
    best = -1
    least = math.inf
    for k in range(listener.first_pair, listener.first_pair + listener.pair_count):
        pair = pairs[k]
        if pair.need == need and (best < 0 or pair.asked_time < least):
            best = k
            least = pair.asked_time
    return best


@kernel()
def ask_about_gone(
    listener: Records,
    pairs: Records,
    here: Vec,
    heard: Ints,
    count: int,
    places: Vec,
    questions: Ints,
    asked: int,
    now: float,
) -> int:
    """Ask the same few drones about all drones that are gone; return the number of questions.

    They are the heard drones nearest to the asking one, because a drone that is gone matters if it is
    near, and one more in turn.

    listener: one row of LISTENER_ROW
    pairs: PAIR_ROW
    here: (13,), state of the asking drone
    now: s
    Other arguments as in choose_nearest.
    """
    if count == 0:
        return asked
    first = asked
    end = asked
    for n in range(RELAY_REQUESTS.most_gone):
        k = find_longest_waiting(listener, pairs, Need.GONE)
        if k < 0:
            break
        pair = pairs[k]
        if n == 0:
            asked = choose_nearest(
                pair.other, here, heard, count, places, questions, asked
            )
            # All gone drones are asked about equally often: the turn of one is that of all.
            turn = listener.place + pair.turns
            asked = choose_in_turn(
                pair.other, turn, heard, count, questions, first, asked
            )
            end = asked
        else:
            for q in range(first, end):
                asked = add_question(questions[q, 0], pair.other, questions, asked)
        pair.need = Need.NONE
        pair.asked_time = now
        pair.turns += 1
    return asked


@kernel(
    numba.int64,
    rows_of(LISTENER_ROW),
    rows_of(PAIR_ROW),
    rows_of(PACE_ROW),
    rows_of(SWARM_ROW),
    rows_of(ROUND_ROW),
    byte_table,
    rows_of(AIRSPACE_RULES_ROW),
    numba.float64,
    wholes,
    numba.float64[:, ::1],
    numba.int64[:, ::1],
    **NO_COUNTING,
)
def choose_asked(
    at: int,
    listeners: Records,
    pairs: Records,
    paces: Records,
    swarm: Records,
    rounds: Records,
    missed: Bytes,
    rules: Records,
    now: float,
    heard: Ints,
    places: Vec,
    questions: Ints,
) -> int:
    """Choose which drones one drone asks for which states; return the number of questions.

    For each Need it asks about a few drones, and begins with the pairs that have waited longest. So
    drones that stand or are gone take no turns of drones for which it brakes.

    at: number of the drone
    listeners: LISTENER_ROW
    pairs: PAIR_ROW
    paces: PACE_ROW
    swarm: SWARM_ROW
    rounds: ROUND_ROW, (swarm x rounds that are kept,)
    missed: (listeners, swarm): rounds missed in a row, or Missed
    rules: AIRSPACE_RULES_ROW, (1,)
    now: s
    heard: (swarm,): work space
    places: (swarm, 3): work space
    questions: (MOST_QUESTIONS, 2): receives the rows of the asked and of the sought drones
    """
    listener = listeners[at]
    count = 0
    for other in range(swarm.shape[0]):
        if other == listener.place:
            continue
        place, is_heard = recall_heard(
            at,
            other,
            listeners,
            pairs,
            paces,
            swarm,
            rounds,
            missed,
            rules[0],
            now,
        )
        if is_heard:
            heard[count] = other
            for c in range(3):
                places[count, c] = place[c]
            count += 1
    asked = 0
    for need in range(Need.SOON, Need.STANDING + 1):
        for _ in range(MOST_SOUGHT[need]):
            k = find_longest_waiting(listener, pairs, need)
            if k < 0:
                break
            pair = pairs[k]
            pair.need = Need.NONE
            first = asked
            asked = choose_nearest(
                pair.other, pair.state, heard, count, places, questions, asked
            )
            # Drones that ask together, and questions about several drones, go to different ones.
            turn = listener.place + pair.drone + pair.turns
            asked = choose_in_turn(
                pair.other, turn, heard, count, questions, first, asked
            )
            if asked > first:
                pair.asked_time = now
                pair.turns += 1
    here = swarm[listener.place].state
    return ask_about_gone(
        listener, pairs, here, heard, count, places, questions, asked, now
    )
