"""One planning of a team in flight: the same plan for all, from where they are, of what is free."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import SolverError
from crazychoir.guidance.delivery import replanning
from crazychoir.guidance.delivery.replanning import (
    AUCTION_METHOD,
    Replanning,
    TaskBonds,
    identify_tasks,
)
from crazychoir.guidance.tasks.task_book import Deed, Record, Task, TaskBook
from crazychoir.routing.distributed.pickup_delivery import PickupDelivery
from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.search.parallel_auction import run_parallel_auction
from crazychoir.team.graph import Graph

IDS = (2, 3, 5, 8)
GRAPH = Graph.from_edges(IDS, [(2, 3), (3, 5), (5, 8), (2, 8)])
HOMES = {2: (0.0, 0.0), 3: (10.0, 0.0), 5: (0.0, 10.0), 8: (10.0, 10.0)}
OWN = random_instance(4, 1, 0)


def task(j, pickup, delivery, **changes):
    return Task(j, 1, False, pickup, delivery, **changes)


def problem(i, start, robots=None):
    """Return the problem of robot i: capacity 2, capable of each task that names robot i or no robot."""

    def of(goods):
        may = np.array([not t.robots or i in t.robots for t in goods.tasks], bool)
        return replace(
            OWN.local(0),
            robot=i,
            home=np.array(HOMES[i]),
            start=np.array(start),
            capacity=2.0,
            tasks=goods.public(1.0),
            aboard=np.array(goods.mine, bool),
            capable=may & (np.array(goods.free, bool) | np.array(goods.mine, bool)),
        )

    return of


def planned(
    books,
    bound=None,
    carried=None,
    graph=GRAPH,
    method=AUCTION_METHOD,
    starts=HOMES,
    recover=False,
):
    agents = {}
    for i in graph.ids:
        bonds = TaskBonds((bound or {}).get(i, ()), (carried or {}).get(i, ()))
        agents[i] = Replanning(
            i, graph, books[i], bonds, problem(i, starts[i]), recover, method
        )
    while not all(agent.done for agent in agents.values()):
        assert not any(agent.done for agent in agents.values()), "all end in one round"
        messages = {i: decode(encode(agent.message())) for i, agent in agents.items()}
        for i, agent in agents.items():
            agent.step({j: messages[j] for j in graph.neighbors(i)})
    return {i: agent.result for i, agent in agents.items()}


def records(**changes):
    return [Record(i, 1, 1, HOMES[i], **changes) for i in IDS]


def stops(share):
    return [(stop.task, stop.kind) for stop in share.stops]


NEAR_2, NEAR_8 = task(4, (1.0, 0.0), (2.0, 0.0)), task(6, (9.0, 10.0), (8.0, 10.0))


def test_every_robot_plans_with_the_knowledge_of_all():
    books = {i: TaskBook([], records()) for i in IDS}
    books[5].learn(NEAR_2)
    books[3].learn(NEAR_8)
    shares = planned(books)
    assert stops(shares[2]) == [(4, "pickup"), (4, "delivery")]
    assert stops(shares[8]) == [(6, "pickup"), (6, "delivery")]
    assert stops(shares[3]) == stops(shares[5]) == []
    assert {identify_tasks(share.book) for share in shares.values()} == {
        ((4, 1, False), (6, 1, False))
    }
    assert not any(share.ended for share in shares.values())
    assert 4 not in books[2].tasks, "what is known here stays as it was"


def test_the_plan_begins_where_the_robots_are():
    books = {i: TaskBook([NEAR_2], records()) for i in IDS}
    assert stops(planned(books, starts=HOMES | {5: (1.0, 0.1), 2: (9.0, 9.0)})[5]) == [
        (4, "pickup"),
        (4, "delivery"),
    ]


def test_tasks_that_a_robot_carries_or_is_bound_to_are_not_reassigned():
    gone = task(7, (5.0, 5.0), (1.0, 9.0))
    books = {i: TaskBook([NEAR_2, NEAR_8, gone], records()) for i in IDS}
    shares = planned(books, bound={3: (6,)}, carried={5: (7,)})
    assert stops(shares[5]) == [(7, "delivery")]
    assert stops(shares[2]) == [(4, "pickup"), (4, "delivery")]
    assert not any(s == 6 for share in shares.values() for s, _ in stops(share))


def test_goods_of_a_robot_that_is_gone_are_fetched_from_where_it_fell_if_wanted():
    fallen = Record(1, 1, 9, (9.0, 0.5), (Deed(4, "pickup", 1),))
    books = {i: TaskBook([NEAR_2], [*records(), fallen]) for i in IDS}
    assert not any(stops(share) for share in planned(books).values())
    shares = planned(books, recover=True)
    assert stops(shares[3]) == [(4, "pickup"), (4, "delivery")]


def test_tasks_that_no_robot_can_serve_are_named_and_the_team_ends():
    heavy, foreign = (
        task(1, (1.0, 1.0), (2.0, 2.0), load=3.0),
        task(9, (1.0, 1.0), (2.0, 2.0), robots=(77,)),
    )
    books = {i: TaskBook([heavy, foreign], records(idle=True)) for i in IDS}
    assert {(share.unserved, share.ended) for share in planned(books).values()} == {
        ((1, 9), True)
    }


BUSY = [{"bound": {3: (6,)}}, {"carried": {3: (6,)}}, {"idle": False}, {"task": NEAR_2}]


@pytest.mark.parametrize("busy", BUSY, ids=lambda busy: next(iter(busy)))
def test_the_team_ends_when_all_are_idle_and_no_task_is_left(busy):
    books = {i: TaskBook([NEAR_8], records(idle=True)) for i in IDS}
    for book in books.values():
        done = Deed(6, "pickup", 1), Deed(6, "delivery", 1)
        book.hear(Record(2, 1, 2, HOMES[2], done, idle=busy.get("idle", True)))
    assert all(share.ended for share in planned(books).values()) == ("idle" not in busy)
    if "task" in busy:
        books[8].learn(busy["task"])
    if "idle" not in busy:
        shares = planned(books, bound=busy.get("bound"), carried=busy.get("carried"))
        assert not any(share.ended for share in shares.values())


def test_one_robot_alone_plans_without_others():
    graph = Graph.from_edges((5,), [])
    share = planned({5: TaskBook([NEAR_2], records()[2:3])}, graph=graph)[5]
    assert stops(share) == [(4, "pickup"), (4, "delivery")]


def length(share, start, home, tasks):
    points = [
        start,
        *(getattr(tasks[stop.task], stop.kind) for stop in share.stops),
        home,
    ]
    return sum(np.linalg.norm(np.subtract(a, b)) for a, b in pairwise(points))


@pytest.mark.parametrize("seed", range(3))
def test_a_method_of_pickup_delivery_finds_no_longer_plan_and_serves_the_same(seed):
    draw = np.random.default_rng(seed)
    tasks = {
        j: task(j, *map(tuple, draw.uniform(0, 10, (2, 2)).tolist()))
        for j in range(1, 8)
    }
    nobody = task(9, (1.0, 1.0), (2.0, 2.0), robots=(77,))
    books = {i: TaskBook([*tasks.values(), nobody], records()) for i in IDS}
    starts = {i: tuple(draw.uniform(0, 10, 2)) for i in IDS}
    carried = {3: (1,), 8: (2,)}
    lengths = {}
    for method in (AUCTION_METHOD, "columns", "resource-columns"):
        shares = planned(books, carried=carried, starts=starts, method=method)
        served = sorted(stop for share in shares.values() for stop in stops(share))
        assert served == sorted(
            [(j, "delivery") for j in tasks] + [(j, "pickup") for j in tasks if j > 2]
        )
        assert {share.unserved for share in shares.values()} == {(9,)}
        assert (1, "delivery") in stops(shares[3])
        lengths[method] = sum(
            length(shares[i], starts[i], HOMES[i], tasks) for i in IDS
        )
    assert (
        max(lengths["columns"], lengths["resource-columns"])
        <= lengths[AUCTION_METHOD] + 1e-6
    )


def test_goods_that_only_a_robot_far_away_may_carry_are_fetched(monkeypatch):
    monkeypatch.setitem(HOMES, 2, (900.0, 0.0))
    books = {
        i: TaskBook([task(4, (1.0, 0.0), (2.0, 0.0), robots=(2,))], records())
        for i in IDS
    }
    shares = planned(books, method="columns")
    assert stops(shares[2]) == [(4, "pickup"), (4, "delivery")]


def test_goods_aboard_are_delivered_by_any_method_whatever_is_left_of_the_limit(
    monkeypatch,
):
    books = {i: TaskBook([NEAR_2, NEAR_8], records()) for i in IDS}
    short = problem

    def tired(i, start):
        return lambda goods: replace(
            short(i, start)(goods), left=1.0 if i == 3 else None
        )

    monkeypatch.setitem(globals(), "problem", tired)
    for method in (AUCTION_METHOD, "columns", "resource-columns", "resource"):
        shares = planned(books, carried={3: (6,)}, method=method)
        assert stops(shares[3]) == [(6, "delivery")]
        assert stops(shares[2]) == [(4, "pickup"), (4, "delivery")]


# A method that raises ------------------------------------------------------------------------------------------

CARRIED = {3: (6,)}


def with_trouble(monkeypatch, who, after, **options):
    """Return the shares of a planning in which PickupDelivery raises in step `after` at some members."""
    step = PickupDelivery.step

    def broken(self, heard):
        step(self, heard)
        if IDS[self._member.place.robot] in who and (
            self.k == after or (after is None and self.done)
        ):
            raise SolverError("columns", "no plan found")

    monkeypatch.setattr(PickupDelivery, "step", broken)
    books = {i: TaskBook([NEAR_2, NEAR_8], records()) for i in IDS}
    return planned(books, carried=CARRIED, **options)


@pytest.mark.parametrize("after", [1, 2, 5, None])
@pytest.mark.parametrize("who", [(8,), (2, 3), IDS])
def test_a_method_that_raises_leaves_the_plan_of_the_auction(monkeypatch, who, after):
    books = {i: TaskBook([NEAR_2, NEAR_8], records()) for i in IDS}
    auction = planned(books, carried=CARRIED)
    shares = with_trouble(monkeypatch, who, after, method="columns")
    assert [stops(shares[i]) for i in IDS] == [stops(auction[i]) for i in IDS]
    why = f"robot {who[0]}: SolverError: columns: the solver ended with status no plan found"
    assert [share.trouble for share in shares.values()] == [{"columns": why}] * 4


def test_an_auction_that_raises_leaves_what_is_aboard_to_be_delivered(monkeypatch):
    def broken(robot, *args):
        if robot == 5:
            raise KeyError("a bug")
        return (yield from run_parallel_auction(robot, *args))

    monkeypatch.setattr(replanning, "run_parallel_auction", broken)
    books = {i: TaskBook([NEAR_2, NEAR_8], records()) for i in IDS}
    shares = planned(books, carried=CARRIED, method="columns")
    assert [stops(shares[i]) for i in IDS] == [[], [(6, "delivery")], [], []]
    assert {share.unserved for share in shares.values()} == {(4,)}
    assert not any(share.ended for share in shares.values())
    (why,) = {share.trouble[AUCTION_METHOD] for share in shares.values()}
    assert why.startswith("robot 5: KeyError: 'a bug' (test_replanning.py:")


def test_a_planning_in_which_one_robot_has_no_problem_is_dropped(monkeypatch):
    def broken(i, start):
        return lambda goods: 1 / 0

    monkeypatch.setitem(globals(), "problem", broken)
    shares = planned({i: TaskBook([NEAR_2], records(idle=True)) for i in IDS})
    assert all(
        "robot 2: ZeroDivisionError" in share.trouble[AUCTION_METHOD]
        for share in shares.values()
    )
    assert all(share.ended for share in shares.values()), (
        "on the ground no robot plans for ever"
    )


@pytest.mark.parametrize(
    "nonsense",
    [b"no book", [b"no book", [], []], [TaskBook().wire(), ["x"], []], None, 7],
)
def test_a_robot_that_sends_an_invalid_book_is_dropped_by_all_alike(nonsense):
    books = {i: TaskBook([NEAR_2], records()) for i in IDS}
    agents = {
        i: Replanning(i, GRAPH, books[i], TaskBonds(), problem(i, HOMES[i]))
        for i in IDS
    }
    while not all(agent.done for agent in agents.values()):
        messages = {i: agent.message() for i, agent in agents.items()}
        if agents[8].k == 0:
            messages[8] = [[8, nonsense]]
        for i, agent in agents.items():
            agent.step({j: messages[j] for j in GRAPH.neighbors(i)})
    assert stops(agents[2].result) == [(4, "pickup"), (4, "delivery")]
    assert [list(agents[i].result.dropped) for i in IDS] == [[8], [8], [8], []]


def test_bonds_hold_though_the_book_beside_them_is_none():
    """Without bonds, another robot would serve the bound task too, and no robot would deliver the goods aboard."""
    foreign = task(7, (5.0, 5.0), (1.0, 9.0))
    books = {i: TaskBook([NEAR_2, NEAR_8, foreign], records()) for i in IDS}
    bound, carried = {8: (6,)}, {8: (7,)}
    whole = planned(books, bound, carried)
    torn = planned(books | {8: Torn(books[8])}, bound, carried)
    assert [stops(torn[i]) for i in IDS] == [stops(whole[i]) for i in IDS]
    assert stops(torn[8]) == [(7, "delivery")]
    assert [list(share.dropped) for share in torn.values()] == [[8]] * 4


class Torn(TaskBook):
    """A book that no robot can read."""

    def __init__(self, book):
        super().__init__(book.tasks.values(), book.records.values())

    def wire(self, tasks=True):
        return b"no book"


def test_goods_of_an_unknown_task_are_not_planned_for():
    books = {i: TaskBook([NEAR_2], records()) for i in IDS}
    assert stops(planned(books, carried={8: (77,)})[2]) == [
        (4, "pickup"),
        (4, "delivery"),
    ]
