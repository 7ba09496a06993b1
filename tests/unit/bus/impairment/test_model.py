import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from crazychoir.bus.impairment import model
from crazychoir.bus.impairment.model import (
    LOST_MESSAGE,
    UNDELAYED_MESSAGE,
    EdgeCounters,
    Impairment,
)
from crazychoir.bus.impairment.random_draws import (
    RANDOM_DRAWS,
    bad_states,
    draw,
    draw_key,
)
from crazychoir.bus.impairment.rules import (
    EdgeEffects,
    ImpairmentRule,
    NetworkPartition,
    effects_on_edge,
)
from crazychoir.errors import ConfigError

N = 100_000
U64 = st.integers(0, 2**64 - 1)


def impaired(seed=1, **effects):
    impairment = Impairment(seed)
    impairment.update(effects)
    return impairment


def one(
    impairment,
    number=0,
    attempt=0,
    channel="a",
    source=1,
    destination=2,
    size=100,
    now=0.0,
):
    return impairment.verdict(source, destination, channel, number, attempt, size, now)


def losses(impairment, count, **where):
    return np.array(
        [one(impairment, number, **where) is LOST_MESSAGE for number in range(count)]
    )


# The draws.


def uniforms(draws):
    return np.array(list(draws)) / RANDOM_DRAWS.range_size


@pytest.mark.parametrize("along", ["number", "attempt", "key"])
def test_draws_are_uniform_and_neighbours_independent(along):
    counters = {
        "number": lambda k: (12345, k, 0),
        "attempt": lambda k: (12345, 7, k),
        "key": lambda k: (draw_key(1, k, 2, "a"), 0, 0),
    }[along]
    u = uniforms(draw(*counters(k)) for k in range(N))
    assert abs(u.mean() - 0.5) < 4 / np.sqrt(12 * N)
    assert chisquare(np.histogram(u, 256, (0, 1))[0]).pvalue > 1e-4
    for lag in (1, 2, 3, RANDOM_DRAWS.block_size):
        pairs = np.histogram2d(u[:-lag], u[lag:], 16, [[0, 1], [0, 1]])[0]
        assert chisquare(pairs.ravel()).pvalue > 1e-4
        assert abs(np.corrcoef(u[:-lag], u[lag:])[0, 1]) < 4.5 / np.sqrt(N)


def test_every_bit_of_a_draw_is_fair():
    draws = np.array([draw(99, k, 1) for k in range(20_000)], dtype=np.uint64)
    for bit in range(64):
        ones = int(((draws >> np.uint64(bit)) & np.uint64(1)).sum())
        assert abs(ones - 10_000) < 4.5 * np.sqrt(5000)


@given(U64, U64, st.integers(0, 1000))
def test_draws_are_in_range(key, number, attempt):
    assert 0 <= draw(key, number, attempt) < RANDOM_DRAWS.range_size


def test_draws_are_the_same_for_ever():
    assert draw_key(1, 2, 3, "a") == 0x68A4CE582964B58B
    assert draw(0, 1, 0) == 0xE220A8397B1DCDAF  # the first output of SplitMix64 from 0
    assert draw(0, 2, 0) == 0x6E789E6AA1B965F4


def test_attempts_and_numbers_do_not_share_draws():
    grid = {draw(5, number, attempt) for number in range(300) for attempt in range(300)}
    assert len(grid) == 90_000


# Loss.


def test_nothing_set_is_inactive():
    impairment = Impairment(1)
    assert not impairment.active
    assert one(impairment) is UNDELAYED_MESSAGE
    assert impaired(loss=0.1).active


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.5, 1.0])
def test_loss_has_its_probability_and_is_counted(loss):
    impairment = impaired(loss=loss)
    lost = losses(impairment, 20_000).sum()
    assert abs(lost - 20_000 * loss) <= 4.5 * np.sqrt(20_000 * loss * (1 - loss))
    assert impairment.counters == {(1, 2): EdgeCounters(20_000, lost, 0, 0)}


@pytest.mark.parametrize(
    "other",
    [
        {"source": 3},
        {"destination": 3},
        {"source": 2, "destination": 1},
        {"channel": "b"},
        {"channel": 0},
    ],
)
def test_edges_directions_and_channels_are_independent(other):
    impairment = impaired(loss=0.5)
    agree = np.mean(losses(impairment, 10_000) == losses(impairment, 10_000, **other))
    assert abs(agree - 0.5) < 4.5 * 0.5 / np.sqrt(10_000)


def test_attempts_are_independent():
    impairment = impaired(loss=0.5)
    agree = np.mean(losses(impairment, 10_000) == losses(impairment, 10_000, attempt=1))
    assert abs(agree - 0.5) < 4.5 * 0.5 / np.sqrt(10_000)


def test_another_seed_gives_other_verdicts():
    agree = np.mean(
        losses(impaired(1, loss=0.5), 10_000) == losses(impaired(2, loss=0.5), 10_000)
    )
    assert abs(agree - 0.5) < 4.5 * 0.5 / np.sqrt(10_000)


RICH = {
    "loss": 0.2,
    "p_good_bad": 0.05,
    "p_bad_good": 0.3,
    "delay": 0.01,
    "jitter": 0.02,
    "duplicate": 0.3,
    "reorder": 0.2,
}


@given(
    st.permutations(
        [(number, attempt) for number in range(0, 2000, 97) for attempt in range(3)]
    )
)
def test_verdicts_do_not_depend_on_the_order_of_calls(order):
    expected = impaired(7, **RICH)
    table = {pair: one(expected, *pair) for pair in sorted(order)}
    shuffled = impaired(7, **RICH)
    assert {pair: one(shuffled, *pair) for pair in order} == table


# Bursts; their law is tested in tests/equations.


def test_resending_gets_out_of_a_burst():
    impairment = impaired(p_good_bad=0.2, p_bad_good=0.1)
    for number in range(2000):
        assert any(
            one(impairment, number, attempt) is UNDELAYED_MESSAGE
            for attempt in range(200)
        )


def test_few_blocks_of_burst_states_are_kept_and_the_others_are_computed_again(
    monkeypatch,
):
    computed = []

    def compute(key, number, *rates):
        computed.append(number)
        return bad_states(key, number, *rates)

    monkeypatch.setattr(model, "bad_states", compute)
    impairment = impaired(p_good_bad=0.2, p_bad_good=0.1)
    size = RANDOM_DRAWS.block_size
    kept = RANDOM_DRAWS.kept_blocks
    for _ in range(3):
        for block in range(kept):
            one(impairment, block * size)
    assert computed == list(range(kept)), "each is computed once"
    one(impairment, kept * size)
    one(impairment, size)
    one(impairment, 0)
    assert computed == [*range(kept), kept, 0], "the oldest one was forgotten"


def test_loss_in_the_good_state_adds_to_bursts():
    rate = losses(
        impaired(p_good_bad=0.05, p_bad_good=0.2, loss_bad=0.5, loss=0.1), N
    ).mean()
    assert rate == pytest.approx(0.8 * 0.1 + 0.2 * 0.5, abs=0.01)


# Time.


def test_delay_and_jitter():
    impairment = impaired(delay=0.01, jitter=0.02)
    delays = np.array(
        [one(impairment, number).deliveries[0] for number in range(20_000)]
    )
    assert delays.min() >= 0.01
    assert delays.max() < 0.03
    assert delays.mean() == pytest.approx(0.02, abs=1e-4)
    assert impairment.counters[1, 2].delayed == 20_000
    assert one(impaired(delay=0.01)).deliveries == (0.01,)


def test_duplicates_have_their_probability_and_a_delay_of_their_own():
    impairment = impaired(duplicate=0.25, jitter=0.02)
    verdicts = [one(impairment, number).deliveries for number in range(20_000)]
    twice = np.array([delays for delays in verdicts if len(delays) == 2])
    assert len(twice) == pytest.approx(5000, abs=4.5 * np.sqrt(20_000 * 0.1875))
    assert impairment.counters[1, 2].duplicated == len(twice)
    assert abs(np.corrcoef(twice.T)[0, 1]) < 0.07
    assert {len(delays) for delays in verdicts} == {1, 2}


def test_reordering_makes_some_late():
    impairment = impaired(reorder=0.1, reorder_delay=0.04)
    late = [one(impairment, number).deliveries[0] for number in range(20_000)]
    assert sorted(set(late)) == [0.0, 0.04]
    assert late.count(0.04) == pytest.approx(2000, abs=4.5 * np.sqrt(1800))
    assert impairment.counters[1, 2].delayed == late.count(0.04)


def test_bandwidth_queues_messages_and_drops_what_waits_too_long():
    impairment = impaired(bandwidth=1000.0, queue=0.25)
    delays = [
        one(impairment, number, size=100, now=1.0).deliveries for number in range(5)
    ]
    assert delays[:3] == [
        (pytest.approx(0.1),),
        (pytest.approx(0.2),),
        (pytest.approx(0.3),),
    ]
    assert delays[3:] == [(), ()]
    assert impairment.counters[1, 2].lost == 2
    assert one(impairment, 5, size=100, now=1.2).deliveries == (pytest.approx(0.2),)
    assert one(impairment, 6, size=100, now=9.0).deliveries == (pytest.approx(0.1),)
    assert one(impairment, 0, source=2, destination=1, now=1.0).deliveries == (
        pytest.approx(0.1),
    )


# Partitions.


def test_partitions_cut_both_ways_while_they_last():
    impairment = Impairment(1)
    impairment.begin(0.0)
    impairment.update({"partitions": [{"since": 5, "until": 9, "a": [0, 1], "b": [2]}]})
    for i, j in ((0, 2), (2, 0), (1, 2)):
        assert [
            one(impairment, source=i, destination=j, now=now).deliveries
            for now in (4.9, 5.0, 8.9, 9.0)
        ] == [
            (0.0,),
            (),
            (),
            (0.0,),
        ]
    for i, j in ((0, 1), (0, 3), (2, 3)):
        assert one(impairment, source=i, destination=j, now=6.0) is UNDELAYED_MESSAGE


def test_partitions_count_from_the_oldest_go_and_cut_no_link_before():
    impairment = Impairment(1, partitions=[NetworkPartition(5.0, 9.0, (1,))])
    cut = [
        time for time in range(200) if not one(impairment, now=float(time)).deliveries
    ]
    assert (cut, impairment.age(100.0)) == ([], 0.0)
    for now, age, first in [
        (100.0, 0.0, 105),
        (101.5, 2.0, 105),
        (103.0, 0.0, 105),
        (104.0, 6.0, 103),
    ]:
        impairment.begin(now, age)
        cut = [
            time
            for time in range(200)
            if not one(impairment, now=float(time)).deliveries
        ]
        assert cut == list(range(first, first + 4))
    assert impairment.age(104.0) == 6.0


def test_the_queue_of_a_bandwidth_knows_no_go():
    impairment = Impairment(1, [ImpairmentRule({"bandwidth": 1000.0, "queue": 10.0})])
    waits = []
    for now in (50.0, 50.0, 50.0):
        waits += one(impairment, size=100, now=now).deliveries
        impairment.begin(now)
    assert waits == pytest.approx([0.1, 0.2, 0.3])


def test_a_cut_is_added_to_the_partitions_once():
    impairment = Impairment(1, partitions=[NetworkPartition(5.0, 9.0, (0,), (1,))])
    for drone in (2, 3, 3):
        impairment.update({"cut": {"a": [drone]}})
    assert [partition["a"] for partition in impairment.describe()["partitions"]] == [
        (0,),
        (2,),
        (3,),
    ]
    impairment.update(
        {"clear": True, "cut": {"since": 1.0, "until": 2.0, "a": [4], "b": [5]}}
    )
    assert impairment.partitions == (NetworkPartition(1.0, 2.0, (4,), (5,)),)
    impairment.update({"partitions": [], "loss": 0.1})
    assert impairment.partitions == ()
    for wrong in (3, {"a": []}, {"from": 3}):
        with pytest.raises(ConfigError, match="partition"):
            impairment.update({"cut": wrong})


def test_a_partition_with_one_side_is_against_everybody_else():
    impairment = Impairment(1, partitions=[NetworkPartition(0.0, 1.0, (0, 1))])
    impairment.begin(0.0)
    assert one(impairment, source=0, destination=9) is LOST_MESSAGE
    assert one(impairment, source=9, destination=1) is LOST_MESSAGE
    assert one(impairment, source=0, destination=1) is UNDELAYED_MESSAGE
    assert one(impairment, source=8, destination=9) is UNDELAYED_MESSAGE


# Rules.


def test_the_rule_nearest_to_the_edge_wins_field_by_field():
    rules = [
        ImpairmentRule({"delay": 0.4}, edge=(1, 2), directed=True),
        ImpairmentRule({"delay": 0.3, "loss": 0.3}, edge=(2, 1)),
        ImpairmentRule({"loss": 0.2, "jitter": 0.2}, drone=2),
        ImpairmentRule({"loss": 0.1, "reorder": 0.1}),
    ]
    assert effects_on_edge(rules, 1, 2) == EdgeEffects(
        delay=0.4, loss=0.3, jitter=0.2, reorder=0.1
    )
    assert effects_on_edge(rules, 2, 1) == EdgeEffects(
        delay=0.3, loss=0.3, jitter=0.2, reorder=0.1
    )
    assert (
        effects_on_edge(rules, 2, 5)
        == effects_on_edge(rules, 5, 2)
        == EdgeEffects(loss=0.2, jitter=0.2, reorder=0.1)
    )
    assert effects_on_edge(rules, 5, 6) == EdgeEffects(loss=0.1, reorder=0.1)


def test_updates_change_fields_of_the_rule_of_their_scope():
    impairment = impaired(loss=0.3)
    impairment.update({"delay": 0.1})
    impairment.update({"edge": [1, 2], "loss": 1.0})
    impairment.update({"edge": [2, 1], "jitter": 0.5})
    assert effects_on_edge(impairment.rules, 2, 1) == EdgeEffects(
        loss=1.0, delay=0.1, jitter=0.5
    )
    impairment.update({"edge": [1, 2], "loss": None, "jitter": None})
    assert impairment.describe()["rules"] == [{"loss": 0.3, "delay": 0.1}]
    impairment.update({"loss": 0.0})
    assert one(impairment).deliveries == (0.1,)
    impairment.update({"clear": True, "drone": 1, "loss": 1})
    assert impairment.describe() == {
        "seed": 1,
        "rules": [{"drone": 1, "loss": 1}],
        "partitions": [],
    }
    impairment.update({"clear": True})
    assert not impairment.active


def test_updates_act_at_once_and_keep_the_counters():
    impairment = impaired(loss=1.0)
    assert one(impairment) is LOST_MESSAGE
    impairment.update({"loss": 0.0})
    assert one(impairment) is UNDELAYED_MESSAGE
    assert impairment.counters[1, 2] == EdgeCounters(sent=2, lost=1)


def test_what_is_described_can_be_set_again():
    first = impaired(loss=0.2)
    first.update({"edge": [3, 1], "directed": True, "delay": 0.1})
    first.update(
        {"partitions": [{"a": [1]}, {"since": 1, "until": 2, "a": [0], "b": [3]}]}
    )
    second = Impairment(1)
    said = json.loads(json.dumps(first.describe(), allow_nan=False))
    for rule in said["rules"]:
        second.update(rule)
    second.update({"partitions": said["partitions"]})
    assert second.describe() == first.describe()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"los": 0.3}, "impairment: found los; allowed: loss, p_good_bad"),
        (
            {"loss": 1.5},
            "impairment: loss: found 1.5; allowed: a probability from 0 to 1",
        ),
        ({"loss": -0.1}, "impairment: loss: found -0.1"),
        ({"loss": float("nan")}, "impairment: loss: found nan"),
        ({"loss": "much"}, "impairment: loss: found much"),
        ({"loss": True}, "impairment: loss: found True"),
        ({"delay": -1}, "impairment: delay: found -1; allowed: s, from 0 to 3600"),
        (
            {"bandwidth": float("inf")},
            "impairment: bandwidth: found inf; allowed: bytes/s",
        ),
        ({"p_good_bad": 0.1}, "p_good_bad and p_bad_good together"),
        ({"p_good_bad": 0.1, "p_bad_good": 0.0}, "a burst never ends"),
        (
            {"p_good_bad": 0.6, "p_bad_good": 0.5},
            "found p_good_bad + p_bad_good = 1.1; allowed: at most 1",
        ),
        (
            {"edge": [1], "loss": 0.1},
            "impairment: edge: found (1,); allowed: two drone ids",
        ),
        ({"edge": "1-2", "loss": 0.1}, "impairment: edge: found 1-2"),
        ({"edge": [1, 1], "loss": 0.1}, "two different drones"),
        ({"edge": [1, -2], "loss": 0.1}, "two drone ids"),
        ({"edge": [1, 2], "drone": 1, "loss": 0.1}, "not both"),
        ({"drone": "3", "loss": 0.1}, "a drone's id"),
        ({"directed": True, "loss": 0.1}, "with an edge only"),
        (
            {"edge": [1, 2]},
            "impairment: found {'edge': [1, 2]}; allowed: at least one of loss",
        ),
        ({"partitions": [3]}, "a list of tables"),
        ({"partitions": 3}, "a list of tables"),
        (
            {"partitions": [{"from": 3}]},
            "partition: found from; allowed: since, until, a, b",
        ),
        ({"partitions": [{"since": 9, "until": 5, "a": [1]}]}, "0 <= since < until"),
        ({"partitions": [{"since": "now", "a": [1]}]}, "0 <= since < until"),
        ({"partitions": [{"a": []}]}, "a not empty"),
        ({"partitions": [{"a": 3}]}, "lists of drone ids"),
        ({"partitions": [{"a": [1], "b": [1]}]}, "no drone on both sides"),
    ],
)
def test_wrong_changes_are_explained_and_change_nothing(changes, text):
    impairment = impaired(loss=0.25)
    with pytest.raises(ConfigError) as caught:
        impairment.update(changes)
    assert text in str(caught.value)
    assert impairment.describe()["rules"] == [{"loss": 0.25}]


def test_verdicts_are_the_same_for_ever():
    impairment = impaired(11, **RICH)
    kinds = "".join(
        str(len(one(impairment, number).deliveries)) for number in range(40)
    )
    assert kinds == "1121120112000000000100000201110011200002"


def test_bursts_are_made_of_neighbours():
    lost = losses(impaired(p_good_bad=0.05, p_bad_good=0.2), 20_000)
    follow = np.mean([b for a, b in pairwise(lost) if a])
    assert follow == pytest.approx(0.8, abs=0.03)
