"""The survey: its order, what it makes of samples, and what it picks."""

import numpy as np
import pytest

from crazychoir.radio.survey.survey import SURVEY_PLAN, Sample, Survey, run_survey

LOST = np.nan


def sample(acknowledged, retries=0, round_trip=0.001, rssi=-50.0):
    came = np.array(acknowledged, bool)
    n = len(came)
    full = [
        np.broadcast_to(np.asarray(value, float), n)
        for value in (retries, round_trip, rssi)
    ]
    return Sample(came, full[0].astype(int), full[1], np.where(came, full[2], np.nan))


class Scripted:
    """Channels with a given ack rate a pass."""

    def __init__(self, rates):
        self.rates, self.calls = {c: iter(rate) for c, rate in rates.items()}, []

    def measure(self, channel, packets, retries):
        self.calls.append((channel, packets, retries))
        came = round(packets * next(self.rates[channel])) if retries == 0 else packets
        return sample([True] * came + [False] * (packets - came))


def surveyed(rates, passes=2):
    found = Survey(tuple(rates), passes=passes, packets=20, seed=1)
    run_survey(found, Scripted(rates))
    return found


def test_each_pass_visits_every_channel_in_another_order():
    visits = list(Survey(range(0, 40, 2), passes=4, seed=3).visits())
    orders = [[v.channel for v in visits if v.number == number] for number in range(4)]
    assert [v.number for v in visits] == sorted(v.number for v in visits)
    assert all(sorted(order) == list(range(0, 40, 2)) for order in orders)
    assert len({tuple(order) for order in orders}) == 4


def test_the_order_is_that_of_the_seed():
    assert list(Survey(range(20), seed=3).visits()) == list(
        Survey(range(20), seed=3).visits()
    )
    assert list(Survey(range(20), seed=3).visits()) != list(
        Survey(range(20), seed=4).visits()
    )


def test_a_visit_measures_without_and_with_retries_and_is_watched():
    probe, seen = Scripted({4: [1.0], 8: [0.5]}), []
    run_survey(
        Survey((4, 8), passes=1, packets=20),
        probe,
        lambda found, visit: seen.append(visit.channel),
    )
    assert [call[1:] for call in probe.calls] == [
        (20, 0),
        (20, SURVEY_PLAN.retries),
    ] * 2
    assert seen == [channel for channel, _, _ in probe.calls[::2]]


def test_the_worst_pass_counts_not_the_mean():
    found = surveyed({4: [1.0, 0.6], 8: [0.75, 0.75]})
    by_channel = {row.channel: row for row in found.measured()}
    assert (by_channel[4].worst, by_channel[4].mean) == (0.6, 0.8)
    assert found.pick(1, 5) == (8,)


def test_the_mean_decides_between_equal_worst_passes_then_the_lower_channel():
    assert surveyed({4: [0.6, 0.7], 8: [0.6, 0.9]}).pick(1, 5) == (8,)
    assert surveyed({4: [0.6, 0.7], 8: [0.6, 0.7]}).pick(1, 5) == (4,)


def test_what_is_measured_is_counted():
    found = Survey((4,), passes=2)
    single = sample([True, False, True, True], rssi=[-50.0, LOST, -52.0, LOST])
    took = [0.001, 0.002, 0.003, 0.009]
    retried = sample(
        [True, True, True, False], [0, 0, 2, 3], took, [-54.0, LOST, LOST, LOST]
    )
    found.take(4, single, retried)
    found.take(4, sample([True] * 4, rssi=LOST), sample([False] * 4, 3, 0.009))
    (row,) = found.measured()
    assert row.passes == (0.75, 1.0)
    assert row.retries == (2, 0, 1, 0, 5)
    assert row.round_trip == pytest.approx((0.002, np.percentile(took[:3], 95)))
    assert row.rssi == pytest.approx((-52.0, np.std([-50.0, -52.0, -54.0])))


def test_a_channel_without_any_answer_is_known_as_that():
    found = Survey((4, 6), passes=1)
    found.take(4, sample([False] * 4), sample([False] * 4, 3))
    (row,) = found.measured()
    assert (row.passes, row.retries, row.round_trip, row.rssi) == (
        (0.0,),
        (0, 0, 0, 0, 4),
        None,
        None,
    )
