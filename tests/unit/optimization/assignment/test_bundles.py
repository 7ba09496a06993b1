import numpy as np
import pytest
from teams import run_team

from crazychoir.errors import ConfigError
from crazychoir.optimization.assignment.bundles import (
    CBBA,
    NO_WINNER,
    BidTable,
    SequentialAuction,
)
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import complete, erdos_renyi_connected, path, ring


class Discount:
    """A task is worth its value, and nine tenths of it for each one taken before: diminishing gain."""

    def __init__(self, values):
        self.start, self.values = (), np.asarray(values)

    def scores(self, path):
        scores = self.values * 0.9 ** len(path)
        scores[list(path)] = -np.inf
        return scores

    def insert(self, path, task):
        return (*path, task)


class Tour(Discount):
    """A task is worth 10 less the detour to it: the gain of a task may grow with others near it."""

    def __init__(self, home, places):
        self.start, self.home, self.places = (), home, places

    def scores(self, path):
        now = self._length(path)
        detours = [
            self._length(self.insert(path, j)) - now for j in range(len(self.places))
        ]
        return np.array(
            [
                -np.inf if j in path else 10.0 - detour
                for j, detour in enumerate(detours)
            ]
        )

    def insert(self, path, task):
        return min(
            ((*path[:n], task, *path[n:]) for n in range(len(path) + 1)),
            key=self._length,
        )

    def _length(self, path):
        way = np.vstack([self.home, *(self.places[j] for j in path), self.home])
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def greedy(bidders, tasks):
    """Winners and paths of the sequential greedy algorithm with all bids in one place."""
    paths, winners = [bidder.start for bidder in bidders], [NO_WINNER] * tasks
    while True:
        scores = np.array(
            [bidder.scores(path) for bidder, path in zip(bidders, paths, strict=True)]
        )
        scores = (
            np.where(np.array(winners) == NO_WINNER, scores, -np.inf)
            if tasks
            else np.array([[-np.inf]])
        )
        i, j = np.unravel_index(np.argmax(scores), scores.shape)
        if scores[i, j] == -np.inf:
            return tuple(winners), paths
        winners[j], paths[i] = int(i), bidders[i].insert(paths[i], int(j))


def links(robots, seed):
    return [ring, path, complete, lambda n: erdos_renyi_connected(n, 0.5, seed)][
        seed % 4
    ](robots)


def discounts(seed):
    chance = np.random.default_rng(seed)
    robots, tasks = chance.integers(1, 8), chance.integers(0, 12)
    values = np.where(
        chance.random((robots, tasks)) < 0.8,
        chance.random((robots, tasks)) + 0.1,
        -np.inf,
    )
    return [Discount(row) for row in values], int(tasks)


def tours(seed):
    chance = np.random.default_rng(seed)
    robots, tasks = chance.integers(2, 7), chance.integers(1, 12)
    places = chance.random((tasks, 2))
    return [Tour(chance.random(2), places) for _ in range(robots)], int(tasks)


def cbba(bidders, tasks, diameter, **options):
    return {
        i: CBBA(i, bidder, range(len(bidders)), tasks, diameter, **options)
        for i, bidder in enumerate(bidders)
    }


def auction(bidders, tasks, diameter):
    return {
        i: SequentialAuction(i, bidder, tasks, diameter)
        for i, bidder in enumerate(bidders)
    }


def check(agents, tasks):
    """All agree, and each has what it is said to have, on its path."""
    results = [agent.result for agent in agents.values()]
    assert len({(result.winners, result.rounds) for result in results}) == 1
    for i, result in enumerate(results):
        assert (
            sorted(result.path)
            == sorted(result.tasks)
            == [j for j in range(tasks) if result.winners[j] == i]
        )
    return results


def ended(make, bidders, tasks, seed):
    """The results of a team over links of this seed."""
    graph = links(len(bidders), seed)
    agents = make(bidders, tasks, graph.diameter())
    run_team(agents, graph)
    return check(agents, tasks)


def as_greedy(make, bidders, tasks, seed):
    """Require the winners and the paths of the sequential greedy algorithm."""
    results = ended(make, bidders, tasks, seed)
    winners, paths = greedy(bidders, tasks)
    assert results[0].winners == winners
    assert [result.path for result in results] == paths


@pytest.mark.parametrize("seed", range(24))
def test_with_diminishing_gain_cbba_is_the_sequential_greedy_algorithm(seed):
    as_greedy(cbba, *discounts(seed), seed)


@pytest.mark.parametrize("seed", range(12))
def test_with_any_gain_cbba_ends_without_a_conflict(seed):
    assert ended(cbba, *tours(seed), seed)[0].open_tasks == ()


@pytest.mark.parametrize("make", [discounts, tours])
@pytest.mark.parametrize("seed", range(8))
def test_a_sequential_auction_is_the_sequential_greedy_algorithm(seed, make):
    as_greedy(auction, *make(seed), seed)


def test_bundles_are_no_longer_than_allowed_and_the_rest_is_open():
    agents = cbba([Discount([1.0, 2.0, 3.0, 4.0])] * 3, 4, 1, most=1)
    run_team(agents, complete(3))
    assert agents[0].result.winners == (NO_WINNER, 2, 1, 0)  # equal bids: the lowest id
    assert agents[0].result.open_tasks == (0,)


@pytest.mark.parametrize("make", [cbba, auction])
def test_what_is_lost_on_the_way_changes_nothing(make):
    bidders, tasks = tours(3)
    graph = ring(len(bidders))
    results = []
    for loss in (0.0, 0.4):
        agents = make(bidders, tasks, graph.diameter())
        history = simulate(agents, graph, loss=loss, record=())
        results.append([agent.result for agent in agents.values()])
    assert history.lost > 10
    assert results[0] == results[1]


ME, K, M, N = 0, 1, 2, 3  # receiver, sender, others
# Table I of Choi, Brunet & How 2009: sender's winner, receiver's winner, the others with fresher stamps at the
# sender, whether the sender's bid is higher, and what the receiver does.
RULES = [
    (K, ME, "", True, "update"),
    (K, ME, "", False, "leave"),
    (K, K, "", False, "update"),
    (K, M, "M", False, "update"),
    (K, M, "", True, "update"),
    (K, M, "", False, "leave"),
    (K, NO_WINNER, "", True, "update"),
    (ME, ME, "", False, "leave"),
    (ME, K, "", False, "reset"),
    (ME, M, "M", False, "reset"),
    (ME, M, "", False, "leave"),
    (ME, NO_WINNER, "", True, "leave"),
    (M, ME, "M", True, "update"),
    (M, ME, "M", False, "leave"),
    (M, ME, "", True, "leave"),
    (M, K, "M", False, "update"),
    (M, K, "", True, "reset"),
    (M, M, "M", False, "update"),
    (M, M, "", True, "leave"),
    (M, N, "MN", False, "update"),
    (M, N, "M", True, "update"),
    (M, N, "N", False, "reset"),
    (M, N, "", True, "leave"),
    (M, NO_WINNER, "M", True, "update"),
    (M, NO_WINNER, "", True, "leave"),
    (NO_WINNER, ME, "MN", False, "leave"),
    (NO_WINNER, K, "", False, "update"),
    (NO_WINNER, M, "M", False, "update"),
    (NO_WINNER, M, "", False, "leave"),
    (NO_WINNER, NO_WINNER, "MN", False, "leave"),
]


@pytest.mark.parametrize(("theirs", "mine", "fresher", "higher", "action"), RULES)
def test_each_rule_of_the_paper_s_table(theirs, mine, fresher, higher, action):
    table = BidTable(ME, 1)
    known = {K: 5, M: 5, N: 5}
    table.hear(K, [-np.inf], [NO_WINNER], known | {ME: 0})
    table.bid[0], table.winner[0] = (-np.inf if mine == NO_WINNER else 2.0), mine
    stamps = {ME: 0, K: 6, M: 6 if "M" in fresher else 4, N: 6 if "N" in fresher else 4}
    bid = -np.inf if theirs == NO_WINNER else 3.0 if higher else 1.0
    table.hear(K, [bid], [theirs], stamps)
    after = {
        "update": (bid, theirs),
        "reset": (-np.inf, NO_WINNER),
        "leave": (-np.inf if mine == NO_WINNER else 2.0, mine),
    }
    assert (table.bid[0], table.winner[0]) == after[action]


def test_bad_scores_are_refused_with_robot_and_task():
    with pytest.raises(
        ConfigError,
        match="robot 4: score of task 1: found nan; allowed: a number, or -inf",
    ):
        CBBA(4, Discount([1.0, float("nan")]), [4], 2, 0)
    with pytest.raises(
        ConfigError,
        match=r"robot 4: scores: found shape \(2,\); allowed: \(3,\), one a task",
    ):
        SequentialAuction(4, Discount([1.0, 2.0]), 3, 0)
    with pytest.raises(ConfigError, match=r"robot 4: CBBA: found robots \[0, 1\]"):
        CBBA(4, Discount([1.0]), [0, 1], 1, 0)
