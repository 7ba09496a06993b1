"""When a drone last heard another one: its states are signs of its life."""

import math

from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace import Airspace


def find_heard_ns(airspace: Airspace, listener: int, j: int) -> int | None:
    """Return the time of the last state that drone j sent itself to an own drone, ns; None: unknown.

    listener: number of the own drone in this process
    """
    place = airspace.places.get(j)
    if place is None:
        return None
    pair = airspace.pair(listener, j)
    if pair is not None:
        heard_time = float(pair["heard_time"][0])
    else:
        heard_time = _find_round_time(airspace, listener, place)
    return round(heard_time * NS_PER_SECOND) if heard_time > -math.inf else None


def _find_round_time(airspace: Airspace, listener: int, place: int) -> float:
    """Return the time in s of the last round of a far drone that an own drone has heard.

    place: row of the far drone in the swarm
    Returns -inf if the round is not kept.
    """
    far = airspace.far
    capacity = int(airspace.rules["round_capacity"][0])
    count = int(airspace.swarm["round_count"][place])
    missed = int(far.missed[listener, place])
    if missed >= min(count, capacity):
        return -math.inf
    last = place * capacity + (count - 1 - missed) % capacity
    return float(far.rounds["state_time"][last])
