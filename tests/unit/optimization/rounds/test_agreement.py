import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.agreement import (
    find_best_offer,
    find_greatest,
    find_highest_bids,
    flood_offers,
    flood_values,
    require_same_everywhere,
)
from crazychoir.team.graph import graph_from_name


def together(programs, graph):
    """Run one generator a robot to the end; returns their values and the number of rounds."""
    messages = {i: None for i in programs}
    values, rounds = {}, 0
    for i, program in programs.items():
        try:
            messages[i] = next(program)
        except StopIteration as end:
            values[i] = end.value
    while len(values) < len(programs):
        rounds += 1
        sent = dict(messages)
        for i, program in programs.items():
            try:
                messages[i] = program.send({j: sent[j] for j in graph.neighbors(i)})
            except StopIteration as end:
                values[i] = end.value
    return values, rounds


@pytest.fixture(params=["ring", "complete", "path", "star"])
def team(request):
    return graph_from_name(request.param, 6)


def test_a_flood_brings_everybody_everything_in_diameter_rounds(team):
    values, rounds = together(
        {i: flood_values(i, [i * 1.5], team.diameter()) for i in team.ids}, team
    )
    assert rounds == team.diameter()
    assert all(
        list(known.items()) == [(j, [j * 1.5]) for j in range(6)]
        for known in values.values()
    )


def test_a_flood_one_round_short_misses_one_agent():
    team = graph_from_name("path", 6)
    values, _ = together({i: flood_values(i, i, 4) for i in team.ids}, team)
    assert 5 not in values[0]


def test_offers_of_few_agents_reach_all_and_the_others_send_nothing(team):
    offers = {
        i: flood_offers(i, "plan" if i in (2, 5) else None, team.diameter())
        for i in team.ids
    }
    assert next(flood_offers(0, None, 3)) == []
    values, rounds = together(offers, team)
    assert rounds == team.diameter()
    assert all(known == {2: "plan", 5: "plan"} for known in values.values())


def test_an_offer_is_sent_once():
    program = find_best_offer([5.0, 0, "a"], 4)
    assert next(program) == [5.0, 0, "a"]
    assert program.send({1: [7.0, 1, "b"]}) is None
    assert program.send({1: [3.0, 2, "c"]}) == [3.0, 2, "c"]
    assert program.send({1: None}) is None


def test_a_flood_sends_each_item_once():
    program = flood_values(0, "a", 3)
    assert next(program) == [[0, "a"]]
    assert program.send({1: [[1, "b"]], 2: [[1, "b"]]}) == [[1, "b"]]
    assert program.send({1: [[1, "b"], [0, "a"]]}) == []


def test_the_best_offer_is_the_cheapest_and_then_of_the_lowest_id(team):
    costs = {0: None, 1: 4.0, 2: 3.0, 3: 3.0, 4: None, 5: 9.0}
    offers = {i: None if c is None else [c, i, f"plan {i}"] for i, c in costs.items()}
    values, rounds = together(
        {i: find_best_offer(offers[i], team.diameter()) for i in team.ids}, team
    )
    assert rounds == team.diameter()
    assert set(map(tuple, values.values())) == {(3.0, 2, "plan 2")}


def test_no_offer_is_none(team):
    values, _ = together(
        {i: find_best_offer(None, team.diameter()) for i in team.ids}, team
    )
    assert set(values.values()) == {None}


def test_the_highest_bid_wins_each_task_and_ties_go_to_the_lowest_id(team):
    bids = {i: {7: [0.5, i]} for i in team.ids}
    bids[3] = {7: [0.5, 3], 2: [0.1, 3]}
    bids[4] = {2: [0.2, 4]}
    values, _ = together(
        {i: find_highest_bids(bids[i], team.diameter()) for i in team.ids}, team
    )
    assert all(value == {2: [0.2, 4], 7: [0.5, 0]} for value in values.values())


@pytest.mark.parametrize(
    ("program", "heard", "error"),
    [
        (
            lambda: flood_values(3, "a", 2),
            "x",
            r"agent 3: flood: message of agent 5, round 1: found str; allowed: a list of",
        ),
        (
            lambda: flood_values(3, "a", 2),
            None,
            r"agent 3: flood: message of agent 5, round 1: found NoneType",
        ),
        (
            lambda: flood_values(3, "a", 2),
            [[1, 2, 3]],
            r"agent 3: flood: .* round 1: found a list of 1: list; allowed",
        ),
        (
            lambda: flood_values(3, "a", 2),
            [[[1], "b"]],
            r"agent 3: flood: message of agent 5, round 1: found",
        ),
        (
            lambda: find_best_offer([1.0, 3], 2),
            7.0,
            r"best offer: .* agent 5, round 1: found float; allowed: an",
        ),
        (
            lambda: find_best_offer([1.0, 3], 2),
            [0.5],
            r"best offer: .* agent 5, round 1: found a list of 1: float",
        ),
        (
            lambda: find_best_offer([1.0, 3], 2),
            [[], 1],
            r"best offer: .*agent 5, round 1: found a list of 2: list, int",
        ),
        (
            lambda: find_highest_bids({}, 2),
            [[1, "dear", 2]],
            r"highest bids: .* agent 5, round 1: found a list of 1",
        ),
        (
            lambda: find_greatest(np.ones(2), 2),
            np.ones(3),
            r"greatest: .* agent 5, round 1: found shape \(3,\); .*2,",
        ),
        (
            lambda: find_greatest(np.ones(2), 2),
            [1.0, 2.0],
            r"greatest: .* agent 5, round 1: found a list of 2: float",
        ),
    ],
)
def test_a_malformed_message_names_the_neighbour_and_the_round(program, heard, error):
    running = program()
    first = next(running)
    running.send({5: first})
    with pytest.raises(ConfigError, match=error):
        running.send({5: heard})


def test_what_cannot_be_compared_is_not_the_same():
    running = require_same_everywhere([1.0, 2.0], "agent 3", "b")
    next(running)
    with pytest.raises(ConfigError, match="agent 3: b of agent 5"):
        running.send({5: np.ones(2)})
