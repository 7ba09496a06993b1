"""Which states of the others each drone of a process hears, and which drones may be near it."""

import numpy as np
import pytest
from sky import TICK, Sky

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.tables import CollisionTable
from crazychoir.safety.airspace.airspace_rows import FRAME_ROW, Missed, Need
from crazychoir.safety.airspace.life_signs import find_heard_ns
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.state_rates import (
    FIRST_NEWS_TIME,
    NEIGHBOUR_AGES,
    compute_far_rate,
)
from crazychoir.safety.airspace.states_by_hand import STATE_BYTES
from crazychoir.types import LinkStatus, State

FAR = 50.0  # m, between two drones that cannot meet


def row_of(count, apart):
    """Return places in a row."""
    return [(apart * k, 0.0, 1.0) for k in range(count)]


def test_far_drones_have_no_pair_and_hear_each_other_in_rounds():
    sky = Sky(row_of(30, FAR))
    sky.fly(3.0)
    assert all(len(drone.rows) == 0 for drone in sky.drones)
    assert np.all(np.diag(sky.airspace.far.missed) == Missed.ALL), "not itself"
    ages = [sky.age(i, j) for i in range(30) for j in range(30) if i != j]
    assert max(ages) <= 1.0 / compute_far_rate(29) + TICK
    sky.airspace.report_messages()
    assert sky.bus.ports[3].counters.sent == 0, "a round is no message"


@pytest.mark.parametrize("apart", [0.5, FAR])
def test_it_says_when_a_drone_was_last_heard_from_itself(apart):
    cut = NetworkPartition(2.0, 99.0, (0,), (1,))
    sky = Sky(row_of(3, apart), others=(8,), partitions=[cut])
    assert find_heard_ns(sky.airspace, 0, 1) is None
    sky.fly(1.9)
    interval = 1.0 / compute_far_rate(3) + TICK
    for j in (1, 2):
        age = sky.bus.clock.now() - find_heard_ns(sky.airspace, 0, j) / 1e9
        assert 0.0 <= age <= interval
    sky.fly(2.0)
    assert find_heard_ns(sky.airspace, 0, 1) <= 2.0e9, "0 and 1 are cut off"
    assert find_heard_ns(sky.airspace, 0, 2) >= sky.bus.clock.now_ns() - interval * 1e9
    assert find_heard_ns(sky.airspace, 0, 8) is None, "it never spoke"
    assert find_heard_ns(sky.airspace, 0, 77) is None, "it is not of this swarm"


@pytest.mark.parametrize(
    ("apart", "speeds", "rate"),
    [
        (0.5, (0.0, 0.0), 50),
        (1.0, (0.0, 0.0), 20),
        (1.8, (0.0, 0.0), 5),
        (4.0, (1.0, -1.0), 20),
        (4.0, (1.0, 1.0), 2),
        (4.0, (0.0, 0.0), 2),
    ],
)
def test_near_drones_hear_each_other_more_often(apart, speeds, rate):
    """Drones that fly side by side come no nearer to each other."""
    far = [(1000.0 + FAR * k, 0.0, 1.0) for k in range(60)]
    sky = Sky([(0.0, 0.0, 1.0), (apart, 0.0, 1.0), *far])
    for velocity, speed in zip(sky.velocities, speeds, strict=False):
        velocity[1] = speed
    sky.fly(1.0)
    times = set()
    sky.fly(1.0, each=lambda: times.add(float(sky.drones[0].known(1)["state_time"])))
    assert len(times) == pytest.approx(rate, abs=1)


def test_pairs_are_in_the_order_of_their_ids_and_have_room_for_many():
    sky = Sky([(0.1 * k, 0.0, 1.0) for k in range(25)])
    sky.fly(1.5)
    for i, drone in enumerate(sky.drones):
        assert drone.rows["drone"].tolist() == [j for j in range(25) if j != i]
        assert drone.rows["state"][:, 0] == pytest.approx(
            [0.1 * j for j in range(25) if j != i]
        )


def test_a_pair_that_becomes_near_begins_with_what_the_drone_heard_last():
    """Drone 0 has not heard drone 1 for 4 s, so it may be near, but was last heard far away."""
    cut = NetworkPartition(1.0, 99.0, (0,), (1,))
    sky = Sky([(0.0, 0.0, 1.0), (4.8, 0.0, 1.0)], others=(8, 9), partitions=[cut])
    sky.fly(1.0 - TICK)
    sky.places[1][0] = 0.7
    sky.fly(4.0)
    row = sky.drones[0].row(1)
    assert row is not None
    assert row["state"][0] == 4.8
    assert row["heard_time"] <= 1.0
    assert row["need"] == Need.SOON
    sky.fly(10.0)
    assert sky.drones[0].row(1)["state"][0] == 4.8, "it is not forgotten"


def test_a_drone_that_comes_near_has_a_pair_before_it_is_in_range():
    sky = Sky([(0.0, 0.0, 1.0), (20.0, 0.0, 1.0), *row_of(30, FAR)[2:]])
    sky.velocities[1][:] = (-1.0, 0.0, 0.0)
    sky.fly(10.0)
    assert sky.drones[0].row(1) is None
    sky.fly(10.0 - CollisionTable().range - 0.1)
    assert sky.drones[0].row(1) is not None
    assert sky.drones[1].row(0) is not None
    sky.velocities[1][:] = (0.0, 5.0, 0.0)
    sky.fly(5.0)
    assert sky.drones[0].row(1) is None, "it is far again"
    assert sky.age(0, 1) < 0.5


@pytest.mark.parametrize("apart", [3.0, 4.5, 6.0])
def test_drones_that_fly_side_by_side_and_turn_have_a_pair_before_they_are_in_range(
    apart,
):
    """Both turn towards each other at their largest speed, between two checks."""
    sky = Sky([(0.0, 0.0, 1.0), (apart, 0.0, 1.0), *row_of(30, FAR)[2:]])
    for velocity in sky.velocities[0:2]:
        velocity[1] = 1.0
    sky.fly(2.0 + 3 * TICK)
    assert sky.drones[0].row(1) is None
    for velocity, speed in zip(sky.velocities, (1.0, -1.0), strict=False):
        velocity[:] = (speed, 0.0, 0.0)
    near = CollisionTable().range

    def look():
        if sky.places[1][0] - sky.places[0][0] < near:
            assert sky.drones[0].row(1) is not None
            assert sky.drones[1].row(0) is not None
            assert sky.age(0, 1) <= 0.2

    sky.fly(0.5 * apart - 0.2, each=look)


def test_what_others_tell_of_a_far_drone_is_not_forgotten():
    """Drone 1 falls silent, and another drone says that it is far away."""
    sky = Sky([(0.0, 0.0, 1.0), (6.0, 0.0, 1.0), *row_of(10, FAR)[2:]])
    sky.fly(1.0)
    sky.fly(10.0, silent=[1])
    assert sky.drones[0].row(1) is not None
    sky.drones[0].told((1, State.at((9.0, 0.0, 1.0))), 0.0)
    ages = []
    sky.fly(1.0, silent=[1], each=lambda: ages.append(sky.age(0, 1)))
    assert max(ages) <= 1.0 + TICK
    assert sky.drones[0].known(1)["state"][0] == 9.0


def test_a_drone_that_was_never_heard_may_be_anywhere_and_is_sought():
    sky = Sky(row_of(2, FAR), others=(7,))
    sky.fly(FIRST_NEWS_TIME - 0.2)
    assert sky.drones[0].row(7) is None, "its first state may be on its way"
    sought = []
    sky.fly(
        5.0, each=lambda: sought.append(sky.airspace.near.listeners["sought_count"][0])
    )
    row = sky.drones[0].row(7)
    assert row is not None
    assert row["state_time"] == -np.inf
    assert sum(sought) > 0


def test_losses_are_the_verdicts_of_the_simulated_network():
    """The compiled draws lose the same messages as Impairment.verdict."""
    for effects in (
        {"loss": 0.3},
        {"loss": 1.0},
        {"loss": 0.1, "p_good_bad": 0.1, "p_bad_good": 0.3, "loss_bad": 0.7},
        {"p_good_bad": 0.02, "p_bad_good": 0.2},
    ):
        rules = [ImpairmentRule(effects)]
        sky = Sky(row_of(2, 0.5), others=range(2, 60), rules=rules)
        network = Impairment(7, rules)
        heard, expected = [], []
        for _ in range(200):
            sent, _ = sky.counts(1, 0)
            sky.fly(TICK)
            if sky.counts(1, 0)[0] == sent:
                continue
            number = int(sky.airspace.numbers[1])
            known = sky.drones[0].known(1)
            heard.append(bool(known is not None and sky.age(0, 1) < 1e-6))
            verdict = network.verdict(
                1, 0, DRONE_TOPICS.state.name, number, 0, STATE_BYTES, 0.0
            )
            expected.append(bool(verdict.deliveries))
        assert heard == expected
        sent, lost = sky.counts(1, 0)
        assert 0 < lost <= sent


def test_a_partition_cuts_while_it_lasts():
    cut = NetworkPartition(2.0, 4.0, (0,), (1,))
    sky = Sky(row_of(3, 0.5), partitions=[cut])
    sky.fly(1.99)
    assert sky.age(0, 1) < 0.03
    sky.fly(2.0)
    assert sky.age(0, 1) == pytest.approx(2.0, abs=0.03)
    assert sky.age(0, 2) < 0.06
    sky.fly(0.5)
    assert sky.age(0, 1) < 0.06


def test_delayed_states_of_far_drones_arrive_late():
    sky = Sky(row_of(2, FAR), others=(7,), rules=[ImpairmentRule({"delay": 0.3})])
    sky.fly(2.0)
    row = sky.drones[0].row(1)
    assert row is not None
    assert 0.3 <= sky.age(0, 1) < 0.3 + 1.0 / compute_far_rate(2) + 2 * TICK


def test_changed_rules_apply_at_once():
    sky = Sky(row_of(2, 0.5))
    sky.fly(1.0)
    sky.bus.impairment.update({"loss": 1.0})
    sky.fly(1.0)
    assert sky.age(0, 1) == pytest.approx(1.0, abs=0.03)
    sky.bus.impairment.update({"clear": True})
    sky.fly(0.1)
    assert sky.age(0, 1) < 0.03


@pytest.mark.parametrize(("silent", "far"), [(3, FAR), (5, FAR), (3, 0.6), (5, 0.6)])
def test_heard_and_silent_drones_are_counted_whether_far_or_near(silent, far):
    cuts = [NetworkPartition(2.0, 99.0, (0,), tuple(range(1, 1 + silent)))]
    sky = Sky(row_of(9, far), partitions=cuts)
    sky.fly(2.0 + NEIGHBOUR_AGES.silent + 0.3)
    listener = sky.airspace.near.listeners[0]
    rows = sky.drones[0].rows
    is_heard = sky.bus.clock.now() - rows["heard_time"] < NEIGHBOUR_AGES.silent
    assert listener["far_heard"] + is_heard.sum() == 8 - silent
    assert listener["far_silent"] + (~is_heard).sum() == silent


def hear(sky, drone, number, p, age=0.0, sender_host=0):
    """Let the process hear a state of a drone from another process."""
    rows = np.zeros(1, FRAME_ROW)
    rows["drone"] = drone
    rows["number"] = number
    rows["age"] = age
    rows["state"] = State.at(p).flat
    host, bit = np.array([sender_host]), np.array([1])
    sky.airspace.hear_frames(rows, np.array([sky.airspace.now()]), host, bit)


def test_a_drone_heard_in_frames_is_heard_as_an_own_one():
    sky = Sky(row_of(2, 0.5), others=(5,))

    def frame():
        hear(sky, 5, sky.ticks, (0.0, 0.5, 1.0), age=0.02)

    sky.fly(1.5, each=frame)
    row = sky.drones[1].row(5)
    assert row["state"][1] == 0.5
    assert sky.age(1, 5) == pytest.approx(0.02)
    sky.fly(0.5)
    assert sky.age(1, 5) == pytest.approx(0.52), "no frame came"
    hear(sky, 5, 9999, (9.0, 9.0, 9.0), age=-1.0)
    hear(sky, 5, 9999, (9.0, 9.0, np.nan))
    hear(sky, 0, 9999, (9.0, 9.0, 9.0))
    hear(sky, 77, 1, (9.0, 9.0, 9.0))
    hear(sky, 5, 9999, (9.0, 9.0, 9.0), sender_host=1)
    sky.fly(0.1)
    assert sky.drones[1].row(5)["state"][0] == 0.0
    assert sky.drones[1].row(0)["state"][0] == 0.0, "its own process flies drone 0"


@pytest.mark.parametrize("effects", [{"loss": 0.3}, {"loss": 0.3, "jitter": 0.001}])
def test_a_state_from_another_process_counts_for_its_receiver(effects):
    sky = Sky([(0.0, 0.0, 1.0)], others=(5,), rules=[ImpairmentRule(effects)])
    sky.fly(5.0, each=lambda: hear(sky, 5, sky.ticks, (0.0, 0.5, 1.0)))
    sky.airspace.report_messages()
    counters = sky.bus.ports[0].counters
    sent, lost = sky.counts(5, 0)
    assert counters.sent == pytest.approx(500, abs=60)
    assert (counters.sent, counters.lost) == pytest.approx((sent, lost), abs=25)
    assert counters.lost / counters.sent == pytest.approx(0.3, abs=0.08)


def test_frames_are_due_in_rounds_and_for_near_drones_of_other_processes():
    sky = Sky(row_of(2, FAR), others=range(2, 60))
    due = []

    def frame():
        due.extend(np.flatnonzero(sky.airspace.due_frame()).tolist())
        hear(sky, 5, sky.ticks, (0.5, 0.0, 1.0))

    sky.fly(2.0, each=frame)
    due.clear()
    sky.fly(2.0, each=frame)
    assert due.count(0) == pytest.approx(2 * 50, abs=2), "near drone 5"
    assert due.count(1) == pytest.approx(2 * 2, abs=1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308, -1e9])
@pytest.mark.parametrize("at", [0, 13])
def test_an_invalid_state_never_enters(bad, at):
    sky = Sky(row_of(2, 0.5))
    sky.fly(1.0)
    values = np.concatenate([State.at((0.7, 0.0, 1.0)).flat, np.zeros(3)])
    values[at] = bad
    sky.ticks += 1
    sky.drones[1].publish(State(values[:13], 0.0, values[13:]), 0.0)
    sky.airspace.step()
    assert np.isfinite(sky.airspace.swarm["state"]).all()
    assert np.isfinite(sky.drones[0].rows["state"]).all()
    assert sky.age(0, 1) > 0.0


def test_the_place_where_cameras_see_a_drone_counts_while_nothing_is_heard_of_it():
    sky = Sky(row_of(1, FAR), others=(1,))
    for x, seconds in ((1.0, 1.5), (2.0, 0.1)):
        seen = State.at((x, 0.0, 1.0))
        sky.fly(seconds, each=lambda seen=seen: sky.airspace.see(1, seen, 0.0))
    sky.fly(0.3, each=lambda: sky.airspace.see(1, State.at((3.0, 0.0, 1.0)), 0.0))
    row = sky.drones[0].row(1)
    assert row["state"][0] == 3.0
    assert row["share"] == 1.0, "a drone that is not heard gives way to no other"
    assert row["heard_time"] == -np.inf
    sky.drones[0].hear((1, State.at((2.0, 0.0, 1.0))), 0.0)
    row = sky.drones[0].row(1)
    assert (row["state"][0], row["share"]) == (2.0, 0.5)
    sky.airspace.see(9, State.at((3.0, 0.0, 1.0)), 0.0)


def test_a_drone_with_a_silent_radio_gives_way_to_no_other():
    sky = Sky(row_of(2, 0.5))
    for silence, age, share in (
        (0.1, 0.1, 0.5),
        (0.2, 0.15, 1.0),
        (2.0, 0.0, 1.0),
        (0.0, 0.05, 0.5),
    ):
        sky.airspace.take_link(1, LinkStatus("up", silence), age)
        sky.airspace.take_link(7, LinkStatus("up", silence), age)
        sky.airspace.take_link(1, None, 9.0)
        sky.fly(1.2)
        assert sky.drones[0].row(1)["share"] == share
        assert sky.drones[0].deaf(1) == (share == 1.0)
    assert sky.drones[0].row(7) is None
    assert sky.drones[0].known(7) is None


def test_a_planner_keeps_all_others():
    sky = Sky(row_of(20, FAR))
    one = Neighbours(sky.airspace, 0, keeps_all=True)
    assert [int(j) for j in one.rows["drone"]] == one.ids
    assert one.row(7)["state_time"] == -np.inf
    sky.fly(2.0)
    assert [int(j) for j in one.rows["drone"]] == one.ids
    assert one.row(7)["state"][0] == 7 * FAR
