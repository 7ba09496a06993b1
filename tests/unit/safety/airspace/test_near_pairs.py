"""The pairs that the grid finds, beside a plain scan over all drones."""

import numpy as np
import pytest
from sky import Sky

from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import Missed
from crazychoir.safety.airspace.distances import BRAKING_MODEL
from crazychoir.safety.airspace.pair_tables import PairTables
from crazychoir.safety.airspace.state_rates import (
    FIRST_NEWS_TIME,
    NEIGHBOUR_AGES,
    RELAY_LEAD_TIME,
    SPEED_ALLOWANCE,
    STATE_RATES,
)


def is_plainly_near(own, other, age, rules):
    """Return whether two states are near, from the equations alone."""
    apart = np.linalg.norm(rules["scale"] * (own[0:3] - other[0:3]))
    width, v_max = rules["width"], rules["v_max"]
    gap = max(apart - width - rules["silent_gap"], 0.0)
    age_limit = NEIGHBOUR_AGES.usable + gap / v_max
    if age >= NEIGHBOUR_AGES.gone or age > age_limit - RELAY_LEAD_TIME:
        return True
    lasts = min(age, BRAKING_MODEL.silent_flight_time) + STATE_RATES.check_interval
    speed = np.linalg.norm(own[3:6] - other[3:6])
    meets = 2.0 * width + STATE_RATES.later * (speed + SPEED_ALLOWANCE)
    waits = STATE_RATES.long_wait - NEIGHBOUR_AGES.usable
    brakes = width + rules["silent_gap"] + v_max * waits
    return apart - 2.0 * v_max * lasts < max(rules["range"], meets, brakes)


def scan_plainly(sky, listener, now):
    """Return the rows of the swarm that are near, and the numbers of far drones by their kind."""
    airspace = sky.airspace
    rules = airspace.rules[0]
    own = airspace.swarm["state"][airspace.own_places[listener]]
    near, heard, silent = [], 0, 0
    for j in sky.drones[listener].ids:
        place = airspace.places[j]
        sender = airspace.swarm[place]
        known = sky.drones[listener].known(j)
        missed = airspace.far.missed[listener, place]
        if missed == Missed.PAIRED:
            heard_time = known["heard_time"]
            last = place * rules["round_capacity"]
            last += (sender["round_count"] - 1) % rules["round_capacity"]
            is_kept = sender["round_count"] == 0
            is_kept |= heard_time < airspace.far.rounds["state_time"][last]
        else:
            heard_time = -np.inf if known is None else known["state_time"]
            is_kept = rules["round_capacity"] - 4 <= missed <= Missed.MOST
            if missed == Missed.ALL:
                is_kept = now - 1e-9 * rules["began_ns"] >= FIRST_NEWS_TIME
        if known is None:
            if is_kept:
                near.append(place)
            continue
        age = now - known["state_time"]
        if is_kept or is_plainly_near(own, known["state"], age, rules):
            near.append(place)
        elif known["state"][2] >= rules["standing_height"]:
            is_heard = now - heard_time < NEIGHBOUR_AGES.silent
            heard += is_heard
            silent += not is_heard
    return near, heard, silent


@pytest.mark.parametrize(
    ("seed", "own", "box", "loss"),
    [(1, 25, 6.0, 0.0), (2, 25, 12.0, 0.2), (3, 40, 15.0, 0.5), (4, 1, 8.0, 0.0)],
)
def test_the_pairs_are_those_of_a_plain_scan(seed, own, box, loss):
    draws = np.random.default_rng(seed)
    places = draws.uniform(-box, box, (own, 3))
    places[:, 2] = draws.uniform(0.0, 2.0, own)
    cut = NetworkPartition(1.0, 3.0, (0,), (1, 2, 3))
    sky = Sky(
        places,
        others=range(own, own + 5),
        rules=[ImpairmentRule({"loss": loss})] if loss else [],
        partitions=[cut],
    )
    for velocity in sky.velocities:
        velocity[0:2] = draws.normal(0.0, 0.6, 2)
    check_all = sky.airspace._check_all
    checked = []

    def compare(now_ns):
        before = sky.airspace.near.listeners.copy()
        expected = {
            listener: scan_plainly(sky, listener, now_ns / NS_PER_SECOND)
            for listener in np.flatnonzero(before["check_ns"] <= now_ns).tolist()
        }
        check_all(now_ns)
        after = sky.airspace.near.listeners
        was_checked = after["check_count"] != before["check_count"]
        for listener in np.flatnonzero(was_checked).tolist():
            row = after[listener]
            near, heard, silent = expected[listener]
            assert sky.airspace.pairs_of(listener)["other"].tolist() == near
            assert (row["far_heard"], row["far_silent"]) == (heard, silent)
            checked.append(len(near))

    sky.airspace._check_all = compare
    silent = range(own // 2, own // 2 + 3)
    sky.fly(1.5)
    sky.fly(2.5, silent=silent)
    sky.fly(0.5)
    assert len(checked) > 40 * own
    assert own == 1 or 5 * len(checked) < sum(checked) < (own + 4) * len(checked)


def test_room_for_pairs_is_made_seldom():
    """Drones gain pairs one after the other; room is made for all of them at once."""
    tables = PairTables(np.arange(40), np.arange(40))
    made = 0
    for needed in range(1, 100):
        for k in range(40):
            tables.listeners["pairs_needed"][k] = needed
            if needed > tables.listeners["pair_capacity"][k]:
                tables.make_room()
                made += 1
    assert made <= 40
    assert np.all(tables.listeners["pair_capacity"] <= 1.5 * 100)
