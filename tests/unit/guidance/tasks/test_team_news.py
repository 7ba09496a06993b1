"""TeamNews: gossip that makes books equal in spite of losses, witnesses, halves of a team, mended graphs."""

import asyncio

import pytest
from virtual_time import virtual

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.port import Bus
from crazychoir.guidance.tasks.task_book import Deed, Fate, Record, Task
from crazychoir.guidance.tasks.team_news import (
    BOOK_CHANNEL,
    NEWS_TIMING,
    NO_DRONE_FLIES_REASON,
    UNREACHED_REASON,
    TeamNews,
    mend_graph,
)
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph, graph_from_name
from crazychoir.types import Failure

TASK = Task(1, 0, False, (1.0, 0.0), (2.0, 0.0))


def team(clock, graph, loss=0.0):
    bus = Bus(clock, Impairment(3, [ImpairmentRule({"loss": loss})] if loss else []))
    return {
        i: TeamNews(
            Communicator(bus.port(i), graph), (), lambda i=i: (float(i), 0.0), False
        )
        for i in graph.ids
    }


async def gossiping(clock, news, seconds):
    jobs = [asyncio.ensure_future(one.gossip()) for one in news.values()]
    await clock.sleep(seconds)
    for job in jobs:
        job.cancel()
    await asyncio.gather(*jobs, return_exceptions=True)


@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_gossip_brings_all_to_everybody(loss):
    @virtual
    async def test(clock):
        news = team(clock, graph_from_name("ring", 6), loss)
        news[0].book.learn(TASK)
        number = news[3].say(deeds=(Deed(1, "pickup", 1),))
        assert not news[3].known(number)
        await gossiping(
            clock,
            news,
            12 * NEWS_TIMING.period if not loss else 30 * NEWS_TIMING.period,
        )
        for one in news.values():
            assert one.book.tasks == {1: TASK}
            assert one.standings()[1].fate is Fate.ABOARD
            assert sorted(one.book.alive(one.members)) == list(range(6))
        assert news[3].known(number)
        assert not news[3].known(number + 1000)

    test()


@virtual
async def test_more_than_half_must_be_known_to_know(clock):
    news = team(clock, graph_from_name("complete", 5))
    await gossiping(clock, news, 4 * NEWS_TIMING.period)
    number = news[0].say()
    for who in ((0, 1), (0, 1, 2)):
        await gossiping(clock, {i: news[i] for i in who}, 4 * NEWS_TIMING.period)
        assert news[0].known(number) == (len(who) == 3)


@virtual
async def test_a_restarted_robot_replaces_its_former_incarnation(clock):
    graph = graph_from_name("complete", 3)
    for former, present in ((9, 5), (5, 9)):
        bus = Bus(clock)
        news = {
            i: TeamNews(
                Communicator(bus.port(i, former), graph),
                (),
                lambda i=i: (float(i), 0.0),
                False,
            )
            for i in graph.ids
        }
        await gossiping(clock, news, 4 * NEWS_TIMING.period)
        bus.close(2)
        news[2] = TeamNews(
            Communicator(bus.port(2, present), graph), (), lambda: (2.0, 0.0), False
        )
        await gossiping(clock, news, 6 * NEWS_TIMING.period)
        assert [one.book.newest(2).incarnation for one in news.values()] == [
            present
        ] * 3


@virtual
async def test_what_is_no_book_is_dropped_and_counted_and_the_others_are_heard(clock):
    news = team(clock, graph_from_name("complete", 3))
    news[2].book.learn(TASK)

    async def nonsense():
        while True:
            await news[0].communicator.send(b"no book", (1, 2), channel=BOOK_CHANNEL)
            await clock.sleep(NEWS_TIMING.period)

    job = asyncio.ensure_future(nonsense())
    await gossiping(clock, {i: news[i] for i in (1, 2)}, 6 * NEWS_TIMING.period)
    job.cancel()
    assert news[1].book.tasks == {1: TASK}
    assert news[2].book.newest(1) is not None
    assert min(news[1].dropped, news[2].dropped) >= 3


def test_tasks_are_sent_only_to_robots_that_lack_them():
    @virtual
    async def test(clock):
        news = team(clock, graph_from_name("complete", 2))
        for one in news.values():
            for j in range(50):
                one.book.learn(Task(j, 0, False, (1.0, 0.0), (2.0, 0.0)))
        await gossiping(clock, news, 4 * NEWS_TIMING.period)
        before = news[0].communicator.port.counters.bytes
        await gossiping(clock, news, 5 * NEWS_TIMING.period)
        assert news[0].communicator.port.counters.bytes - before < 5 * 150
        news[0].book.learn(Task(99, 0, False, (1.0, 0.0), (2.0, 0.0)))
        await gossiping(clock, news, 3 * NEWS_TIMING.period)
        assert 99 in news[1].book.tasks

    test()


def test_a_team_change_is_told():
    @virtual
    async def test(clock):
        news = team(clock, graph_from_name("complete", 3))
        await gossiping(clock, news, 3 * NEWS_TIMING.period)
        key = news[0].key()
        news[0].changed.clear()
        news[2].say(out=True)
        await gossiping(clock, news, 2 * NEWS_TIMING.period)
        assert news[0].changed.is_set()
        assert (key, news[0].key()) == ((0, ()), (0, (2,)))

    test()


@pytest.mark.parametrize(
    ("left", "quorate"),
    [
        ((0, 1, 2, 3, 4, 5), True),
        ((2, 3, 4, 5), True),
        ((0, 4, 5), True),
        ((1, 2, 3), False),
        ((0, 5), False),
    ],
)
def test_more_than_half_of_the_last_team_may_decide_or_the_half_with_its_lowest(
    left, quorate
):
    @virtual
    async def test(clock):
        one = team(clock, graph_from_name("complete", 6))[left[0]]
        assert one.count()
        one.communicator.graph = graph_from_name("complete", left)
        assert one.count() == one.quorate == quorate
        one.communicator.graph = graph_from_name("complete", 6)
        assert one.count(), "all are back"

    test()


def test_a_team_may_shrink_step_by_step():
    @virtual
    async def test(clock):
        one = team(clock, graph_from_name("complete", 6))[0]
        for n in (6, 5, 4, 3, 2, 1):
            one.communicator.graph = graph_from_name("complete", range(n))
            assert one.count()

    test()


def test_a_graph_is_mended_where_it_fell_apart():
    ring = graph_from_name("ring", 6)
    assert mend_graph(ring) == ring
    assert mend_graph(ring, (1,)).edges() == ((0, 5), (2, 3), (3, 4), (4, 5))
    assert mend_graph(ring, (1, 4)).edges() == ((0, 2), (0, 5), (2, 3))
    assert mend_graph(Graph.from_edges((1, 2, 3), [])).edges() == ((1, 2), (2, 3))


@virtual
async def test_neighbours_say_for_a_robot_that_has_failed_without_a_word_that_it_is_out(
    clock,
):
    news = team(clock, graph_from_name("ring", 6), 0.4)
    await gossiping(clock, news, 30 * NEWS_TIMING.period)
    before = news[2].record
    await news[2].communicator.fail(Failure(2, "broken"))
    others = {i: one for i, one in news.items() if i != 2}
    await gossiping(clock, others, 30 * NEWS_TIMING.period)
    assert {one.key() for one in others.values()} == {(0, (2,))}
    assert all(one.changed.is_set() for one in others.values())
    again = Record(2, before.incarnation + 1, 1, (5.0, 5.0), life=before.life + 1)
    news[3].book.hear(again)
    await gossiping(clock, others, 30 * NEWS_TIMING.period)
    assert all(one.book.newest(2) == again for one in others.values()), (
        "a robot that is started again is a new robot"
    )


@pytest.mark.parametrize(
    ("who", "out", "why"),
    [
        ((0, 1, 2), (), ""),
        ((0, 1), (), ""),
        ((0, 1), (0,), ""),
        ((0,), (), UNREACHED_REASON),
        ((0,), (0,), UNREACHED_REASON),
        ((0, 1, 2), (0, 1, 2), NO_DRONE_FLIES_REASON),
    ],
)
def test_a_robot_that_hears_no_deciding_team_is_left_alone(who, out, why):
    """Some robots talk to robot 0, and some of these are out; all others have been silent for long."""

    @virtual
    async def test(clock):
        news = team(clock, graph_from_name("complete", 3))
        await gossiping(clock, news, 4 * NEWS_TIMING.period)
        for i in out:
            news[i].say(out=True)
        alone = asyncio.ensure_future(news[0].left_alone(10.0))
        await gossiping(
            clock,
            {i: news[i] for i in who},
            NEWS_TIMING.silence + 10.0 - 4 * NEWS_TIMING.period,
        )
        assert not alone.done() or why == NO_DRONE_FLIES_REASON
        await gossiping(clock, {i: news[i] for i in who}, 8 * NEWS_TIMING.period)
        assert news[0].alone == why
        assert alone.done() == bool(why)
        if why:
            assert alone.result() == f"{why} for 10 s"
        alone.cancel()

    test()


@virtual
async def test_a_busy_robot_is_not_left_alone_yet(clock):
    news = team(clock, graph_from_name("complete", 2))
    alone = asyncio.ensure_future(news[0].left_alone(10.0, lambda: clock.now() < 30.0))
    await clock.sleep(39.0)
    assert not alone.done()
    await clock.sleep(2.0)
    assert alone.done()
