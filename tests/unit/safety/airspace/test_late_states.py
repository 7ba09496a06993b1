"""States on links that delay and duplicate messages."""

import numpy as np
import pytest
from sky import TICK, Sky

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.safety.airspace.airspace_rows import LinkKind
from crazychoir.safety.airspace.late_states import NO_COPY, LateStates, draw_delays
from crazychoir.safety.airspace.link_fates import find_losses, judge_link
from crazychoir.safety.airspace.state_links import StateLinks
from crazychoir.safety.airspace.states_by_hand import STATE_BYTES

EFFECTS = [
    {"delay": 0.02},
    {"jitter": 0.05},
    {"reorder": 0.3, "reorder_delay": 0.04},
    {"duplicate": 0.4},
    {"delay": 0.01, "jitter": 0.02, "duplicate": 0.5, "reorder": 0.2, "loss": 0.3},
    {"jitter": 0.01, "loss": 0.1, "p_good_bad": 0.1, "p_bad_good": 0.3},
    {"jitter": 0.01, "loss": 1.0},
]


@pytest.mark.parametrize("effects", EFFECTS)
def test_the_draws_are_those_of_the_simulated_network(effects):
    network = Impairment(5, [ImpairmentRule(effects)])
    links = StateLinks(network, [(3, (3, 7))])
    links.refresh(0.0)
    at = 1
    for number in range(400):
        fate = judge_link(links.rows, links.kinds, links.losses, at, number)
        delays = ()
        if fate != LinkKind.CUT:
            assert fate == LinkKind.LATE
            losses = find_losses(links.losses, int(links.kinds[at]))
            drawn = draw_delays(links.rows["key"][at], losses, number)
            delays = tuple(delay for delay in drawn if delay != NO_COPY)
        name = DRONE_TOPICS.state.name
        assert network.verdict(7, 3, name, number, 0, STATE_BYTES, 0.0).deliveries == (
            delays
        )


def test_states_arrive_as_late_as_their_link_and_are_counted():
    rules = [ImpairmentRule({"delay": 0.095, "duplicate": 0.5})]
    sky = Sky([(0.0, 0.0, 1.0), (0.5, 0.0, 1.0)], rules=rules)
    sky.velocities[1][0] = 0.1
    sky.fly(1.0)
    assert 0.1 - 1e-9 <= sky.age(0, 1) <= 0.1 + 2 * TICK
    place = sky.drones[0].row(1)["state"][0]
    assert place == pytest.approx(0.5 + 0.1 * (1.0 - sky.age(0, 1)), abs=2e-3)
    counters = sky.bus.impairment.counters[1, 0]
    assert counters.delayed == counters.sent > 40
    assert counters.duplicated == pytest.approx(0.5 * counters.sent, rel=0.4)


def test_a_partition_cuts_a_late_link_and_what_is_on_its_way_arrives():
    cut = NetworkPartition(1.0, 99.0, (0,), (1,))
    sky = Sky(
        [(0.0, 0.0, 1.0), (0.5, 0.0, 1.0)],
        rules=[ImpairmentRule({"delay": 0.2})],
        partitions=[cut],
    )
    sky.fly(1.0)
    before = sky.age(0, 1)
    sky.fly(0.15)
    assert sky.age(0, 1) == pytest.approx(before, abs=0.03), "it still arrives"
    sky.fly(1.0)
    assert sky.age(0, 1) == pytest.approx(1.15, abs=0.05)


def test_far_drones_hear_each_other_over_late_links_too():
    sky = Sky(
        [(0.0, 0.0, 1.0), (300.0, 0.0, 1.0)], rules=[ImpairmentRule({"jitter": 0.05})]
    )
    sky.fly(3.0)
    assert sky.drones[0].row(1) is not None
    assert sky.age(0, 1) < 0.2


def test_a_limited_bandwidth_fills_its_queue_in_the_order_of_all_messages():
    rules = [ImpairmentRule({"bandwidth": 4000.0, "queue": 0.1})]
    sky = Sky([(0.0, 0.0, 1.0), (0.5, 0.0, 1.0)], rules=rules)
    sky.fly(2.0)
    counters = sky.bus.impairment.counters[1, 0]
    assert counters.sent - counters.lost == pytest.approx(
        2.0 * 4000.0 / STATE_BYTES, rel=0.15
    )
    assert sky.age(0, 1) < 0.2


def test_room_is_made_for_all_copies_and_keeps_what_is_on_its_way():
    late = LateStates()
    late.make_room(3)
    assert len(late.rows) >= 6
    late.rows["arrival_ns"][:6] = np.arange(6)
    late.count[0] = 6
    late.make_room(100)
    assert len(late.rows) >= 206
    assert late.rows["arrival_ns"][:6].tolist() == list(range(6))
