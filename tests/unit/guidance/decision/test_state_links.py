"""States reach the neighbours in a process when they are due, unless the simulated network loses them."""

import numpy as np
import pytest

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import EdgeEffects, ImpairmentRule
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.state_links import (
    LINK_ROW,
    LinkKind,
    PublishedStates,
    deliver_rows,
    set_link,
)

TICK_NS = 10_000_000
SEED = 11
DRONES = [4, 7, 9]
EDGES = [(7, 4), (9, 4), (4, 7), (4, 9)]


def published(tick, random):
    """Return what three drones publish in a tick; the last one is silent in every third."""
    numbers = np.full(3, tick)
    numbers[2] *= tick % 3 > 0
    return PublishedStates(
        random.normal(size=(3, 13)),
        random.normal(size=(3, 3)),
        np.full(3, 0.004),
        numbers,
    )


def link_rows(effects, interval_ns=0):
    links = np.zeros(len(EDGES), LINK_ROW)
    links["source"] = [DRONES.index(j) for j, _ in EDGES]
    links["interval_ns"] = interval_ns
    for e, edge in enumerate(EDGES):
        set_link(links[e : e + 1], SEED, edge, effects)
    return links, np.zeros(len(EDGES), HEARING_ROW)


@pytest.mark.parametrize("loss", [0.0, 0.3, 1.0])
def test_a_state_is_lost_as_the_simulated_network_loses_its_message(loss):
    links, hearings = link_rows(EdgeEffects(loss=loss))
    network = Impairment(SEED, [ImpairmentRule({"loss": loss})])
    random = np.random.default_rng(3)
    for tick in range(1, 300):
        said = published(tick, random)
        before = hearings["version"].copy()
        assert deliver_rows(links, hearings, *said, tick * TICK_NS) == 0
        for e, (j, i) in enumerate(EDGES):
            row = links["source"][e]
            arrives = said.numbers[row] > 0 and bool(
                network.verdict(j, i, "state", tick, 0, 144, 0.0).deliveries
            )
            assert hearings["version"][e] - before[e] == arrives
            if arrives:
                assert hearings["state"][e].tolist() == said.states[row].tolist()
                assert hearings["born_ns"][e] == tick * TICK_NS - 4_000_000
    counts = [network.counters[edge] for edge in EDGES]
    assert links["sent"].tolist() == [count.sent for count in counts]
    assert links["lost"].tolist() == [count.lost for count in counts]


def test_a_slow_reader_gets_one_state_in_each_interval():
    links, hearings = link_rows(EdgeEffects(), interval_ns=4 * TICK_NS)
    random = np.random.default_rng(3)
    for tick in range(1, 41):
        deliver_rows(links, hearings, *published(tick, random), tick * TICK_NS)
    assert hearings["received"].tolist() == [11, 11, 11, 11]


@pytest.mark.parametrize(
    "effects",
    [
        EdgeEffects(p_good_bad=0.1, p_bad_good=0.2),
        EdgeEffects(delay=0.01),
        EdgeEffects(jitter=0.01),
        EdgeEffects(duplicate=0.1),
        EdgeEffects(reorder=0.1),
        EdgeEffects(bandwidth=1e4),
    ],
)
def test_links_with_more_than_a_loss_are_left_to_the_caller(effects):
    links, hearings = link_rows(effects)
    said = published(1, np.random.default_rng(3))
    assert deliver_rows(links, hearings, *said, TICK_NS) == 4
    assert links["is_due"].tolist() == [1, 1, 1, 1]
    assert hearings["received"].sum() == links["sent"].sum() == 0


def test_nothing_is_delivered_from_another_process():
    links, hearings = link_rows(EdgeEffects())
    links["kind"] = LinkKind.ABSENT
    assert (
        deliver_rows(links, hearings, *published(1, np.random.default_rng(3)), TICK_NS)
        == 0
    )
    assert hearings["received"].sum() == 0
