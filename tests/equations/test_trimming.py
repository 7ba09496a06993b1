"""Trimmed consensus: W-MSR and the trimmed mean follow their rules, and robustness its definition."""

from itertools import chain, combinations

import numpy as np
import pytest

from crazychoir.optimization.algorithms.resilient.robustness import robustness
from crazychoir.optimization.algorithms.resilient.trimming import WMSR, TrimmedMean
from crazychoir.team.graph import complete, erdos_renyi_connected, k_regular, ring, star
from crazychoir.types import Malformed


def w_msr(own, heard, F):
    """The rule for one entry, by lists."""
    larger = sorted(x for x in heard if x > own)
    smaller = sorted(x for x in heard if x < own)
    equal = [x for x in heard if x == own]
    kept = larger[: max(len(larger) - F, 0)] + smaller[F:] + equal
    return (own + sum(kept)) / (1 + len(kept))


def trimmed_mean(own, heard, F):
    kept = sorted(heard)[F : len(heard) - F]
    return (own + sum(kept)) / (1 + len(kept))


@pytest.mark.parametrize(("kind", "rule"), [(WMSR, w_msr), (TrimmedMean, trimmed_mean)])
@pytest.mark.parametrize("liars", [0, 1, 2])
def test_an_agent_keeps_the_values_that_its_rule_keeps(kind, rule, liars):
    chance = np.random.default_rng(3)
    for _ in range(50):
        own = chance.integers(-3, 4, 4).astype(float)
        heard = chance.integers(-3, 4, (6, 4)).astype(float)
        agent = kind(0, own, liars)
        agent.step(dict(enumerate(heard, start=1)))
        expected = [rule(own[n], list(heard[:, n]), liars) for n in range(4)]
        assert agent.x == pytest.approx(expected, abs=1e-12)


MALFORMED = (
    Malformed("bytes that do not decode"),
    "text",
    np.ones(3),
    np.full(4, np.nan),
)


@pytest.mark.parametrize(("kind", "rule"), [(WMSR, w_msr), (TrimmedMean, trimmed_mean)])
@pytest.mark.parametrize("malformed", MALFORMED)
def test_a_message_that_no_honest_agent_sends_uses_up_a_liar(kind, rule, malformed):
    chance = np.random.default_rng(5)
    own = chance.normal(size=4)
    heard = chance.normal(size=(5, 4))
    agent = kind(0, own, 2)
    agent.step({9: malformed} | dict(enumerate(heard, start=1)))
    expected = [rule(own[n], list(heard[:, n]), 1) for n in range(4)]
    assert agent.x == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("kind", [WMSR, TrimmedMean])
def test_an_agent_that_hears_malformed_messages_alone_keeps_its_value(kind):
    agent = kind(0, [1.0, 2.0], 1)
    agent.step({j: Malformed("") for j in (1, 2, 3)})
    assert agent.x.tolist() == [1.0, 2.0]


def robust_by_definition(graph, r):
    """Every two sets without a common agent: one of them has an agent that hears r outside."""

    def reaches(group):
        return any(len(set(graph.in_neighbors(i)) - group) >= r for i in group)

    ids = graph.ids
    groups = [
        set(group)
        for group in chain(*(combinations(ids, n) for n in range(1, len(ids))))
    ]
    return all(
        reaches(one) or reaches(two)
        for one in groups
        for two in groups
        if not one & two
    )


@pytest.mark.parametrize(
    "graph",
    [
        complete(6),
        ring(5),
        star(5),
        k_regular(7, 4),
        erdos_renyi_connected(6, 0.6, 1),
        erdos_renyi_connected(6, 0.7, 2, directed=True),
    ],
)
def test_robustness_is_the_largest_r_of_the_definition(graph):
    r = robustness(graph)
    assert robust_by_definition(graph, r)
    assert not robust_by_definition(graph, r + 1)


def test_a_complete_graph_is_robust_by_half_of_its_agents():
    assert [robustness(complete(n)) for n in range(2, 10)] == [1, 2, 2, 3, 3, 4, 4, 5]
