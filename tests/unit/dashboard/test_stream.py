import asyncio
import json

import numpy as np
import pytest
from message_parts import deafen
from virtual_time import virtual

from crazychoir.bus.commands import ANSWER_TEXTS, Commander, CommandServer
from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import NetworkPartition
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard import operator
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.model import PAGE_DATA, SwarmModel
from crazychoir.dashboard.operator import PageOperator
from crazychoir.dashboard.polling import POLLING_LIMITS, Overview, TaskBoard
from crazychoir.dashboard.receipts import RECEIPT_KINDS, RECEIPT_TEXTS
from crazychoir.dashboard.stream import (
    STREAM_LIMITS,
    CloseCode,
    PageStream,
)
from crazychoir.errors import Refused
from crazychoir.types import State, Status


class Socket:
    """A page: what it was sent; slow: s that each message takes."""

    def __init__(self, clock, slow=0.0):
        self.clock, self.slow = clock, slow
        self.frames, self.texts, self.closed = [], [], None
        self.asks = asyncio.Queue()

    async def send_bytes(self, data):
        await self.clock.sleep(self.slow)
        self.frames.append((self.clock.now(), data))

    async def send_text(self, data):
        self.texts.append(json.loads(data))

    async def receive_text(self):
        asked = await self.asks.get()
        if asked is None:
            raise ConnectionError
        return asked if isinstance(asked, str) else json.dumps(asked)

    async def close(self, code, reason=None):
        self.closed = code

    def told(self, kind):
        return [text[kind] for text in self.texts if kind in text]


class Server:
    """Three drones: each does what it is told; drone 0 refuses tasks; and the server of their page."""

    def __init__(self, clock):
        self.clock, self.obeyed = clock, []
        drones = [{"id": i, "home": [1.0 * i, 0.0, 0.0]} for i in range(3)]
        self.config = SwarmConfig.of(
            {"name": "a", "drones": drones, "edges": [[0, 1], [1, 2]]}
        )
        self.bus = Bus(clock)
        self.sent = 0
        self.networks, self.routes = (
            [Impairment(1) for _ in range(3)],
            [[], [[1.0, 2.0, 0.5], [0.123, 0, 0.5]], []],
        )
        for i in range(3):
            CommandServer(
                self.bus.port(i),
                lambda verb, arguments, i=i: self.execute(i, verb, arguments),
                print,
            )
        self.commander, self.watch = (
            Commander(self.bus.port(PORT_ADDRESSES.first_observer)),
            EventLog(clock),
        )
        self.desk, self.replays = CommandDesk(self, self.watch), False
        self.model = SwarmModel(
            self.bus,
            PORT_ADDRESSES.first_observer,
            self.config,
            self.watch,
            EventLog(clock),
        )
        self.overview, self.board = (
            Overview(self.desk),
            TaskBoard(self.desk, self.model),
        )
        self.stream = PageStream(
            self.model, self.desk, self.watch, self.overview, self.board
        )
        self.actors = [
            asyncio.create_task(one.run())
            for one in (self.stream, self.overview, self.board)
        ]

    def is_there(self, i):
        return i in self.bus.ports

    async def execute(self, i, verb, arguments):
        self.obeyed.append((i, verb, arguments))
        if verb == "overview":
            self.sent += 10
            links = {1: [self.sent, 3 * self.sent // 10]} if i == 0 else {}
            return {
                "links": links,
                "network": self.networks[i].describe(),
                "route": self.routes[i],
            }
        if verb == "impair":
            return Impairment(1).describe()
        if verb.startswith("firmware"):
            return self.firmware(i, verb, **arguments)
        if i == 0 and verb.startswith("task"):
            raise Refused("drone 0", "this drone has landed; ask another drone")
        return {"tasks": [{"id": 4}]} if verb == "task_list" else {"id": 4}

    def firmware(self, i, verb, name="", value=0.0):
        """Drone 2 has no firmware; the others have one parameter of one byte."""
        if i == 2:
            raise Refused("drone 2", "it has no firmware here")
        if verb == "firmware_list":
            return {"led.bitmask": ["uint8_t", True]}
        if value > 255:
            raise Refused(f"drone {i}", "allowed: 0 to 255")
        return {"led.bitmask": int(value)}

    def those(self, *verbs):
        return [one for one in self.obeyed if one[1] in verbs]

    def page(self, **options):
        socket = Socket(self.clock, **options)
        operator = PageOperator(self.config, self.desk, self.board)
        socket.serving = asyncio.create_task(self.stream.serve(socket, operator))
        return socket

    async def end(self):
        self.desk.close()
        for task in self.actors:
            task.cancel()
        await asyncio.gather(*self.actors, return_exceptions=True)


def served(test):
    """A test of a server with one page, in virtual time."""

    async def story(clock):
        server = Server(clock)
        await test(clock, server, server.page())
        await server.end()

    story.__name__ = test.__name__
    return virtual(story)


@virtual
async def test_each_page_gets_thirty_frames_a_second_and_a_slow_page_delays_no_other(
    clock,
):
    server = Server(clock)
    quick, slow = server.page(), server.page(slow=0.5)
    server.bus.ports[1].publish(DRONE_TOPICS.state, State.at((1.0, 2.0, 3.0)))
    await clock.sleep(2.0)
    assert abs(len(quick.frames) - 2.0 * PAGE_DATA.state_rate) <= 2
    assert 3 <= len(slow.frames) <= 5
    assert np.frombuffer(quick.frames[-1][1], "<f4", offset=8)[17:20].tolist() == [
        1.0,
        2.0,
        3.0,
    ]
    assert clock.now() - slow.frames[-1][0] < 0.6, "the newest, not the next"
    assert quick.told("about")[0]["ids"] == [0, 1, 2]
    assert len(quick.told("drones")) == 4
    await server.end()


@virtual
async def test_drones_are_asked_nothing_while_no_page_is_open(clock):
    server = Server(clock)
    await clock.sleep(3.0)
    assert server.obeyed == []
    page = server.page()
    await clock.sleep(3.0)
    assert server.those("overview")
    page.asks.put_nowait(None)
    await page.serving
    await clock.sleep(0.2)
    server.obeyed.clear()
    frame = server.stream.frame
    await clock.sleep(2.0)
    assert server.obeyed == []
    assert server.stream.frame is frame, "nor is any frame made"
    await server.end()


@virtual
async def test_a_command_of_one_page_shows_on_every_page_and_on_later_ones(
    clock,
):
    server = Server(clock)
    one, other = server.page(), server.page()
    await clock.sleep(0.5)
    one.asks.put_nowait({"ask": "order", "verb": "hold", "drones": [2, 2]})
    await clock.sleep(0.5)
    assert server.those("hold") == [(2, "hold", {})]
    late = server.page()
    await clock.sleep(0.2)
    for page in (one, other, late):
        (receipt,) = page.told("receipts")[-1]
        assert (receipt["verb"], receipt["answers"]) == (
            "hold",
            {"2": ["done", {"id": 4}]},
        )
    await server.end()


@served
async def test_what_is_malformed_or_wrong_is_refused_and_the_page_stays(
    clock, server, page
):
    bad = [
        "{",
        "[]",
        '{"ask":"explode"}',
        '{"ask":"order","verb":"land","drones":[7]}',
        '{"ask":"go-to","drones":[1]}',
        '{"ask":"draw","strokes":[[[0,0,1e9]]]}',
        '{"ask":"fly","drones":[1]}',
        '{"ask":"impair","loss":1.5}',
        '{"ask":"load","name":"a.svg","text":""}',
        '{"ask":"impair","drones":[0,1,2],"loss":0.1}',
        '{"ask":"draw","strokes":' + "[" * 3000,
    ]
    for text in bad:
        page.asks.put_nowait(text)
    await clock.sleep(1.0)
    assert len(page.told("refused")) == len(bad)
    assert not server.those("land", "go-to", "fly", "impair")
    page.asks.put_nowait({"ask": "order", "verb": "land"})
    await clock.sleep(0.5)
    assert len(server.those("land")) == 3
    assert page.closed is None


@served
async def test_a_stop_waits_for_nothing_that_was_asked_before(clock, server, page):
    await clock.sleep(1.5)
    execute = server.execute

    async def slow(i, verb, arguments):
        if verb == "task_add":
            await clock.sleep(4.0)
        return await execute(i, verb, arguments)

    server.execute = slow
    page.asks.put_nowait({"ask": "add-task", "pickup": [1.0, 2.0]})
    await clock.sleep(0.1)
    page.asks.put_nowait({"ask": "stop"})
    await clock.sleep(0.3)
    assert server.bus.stopped
    (receipt,) = [
        one
        for told in page.told("receipts")
        for one in told
        if one["verb"] == "emergency stop"
    ][-1:]
    assert {kind for kind, _ in receipt["answers"].values()} == {"done"}
    assert not server.those("task_add")
    await clock.sleep(5.0)
    assert server.those("task_add")


@served
async def test_the_newer_of_two_drawings_counts_whichever_is_planned_first(
    clock, server, page
):

    async def aside(work, message, config):
        await clock.sleep(2.0 if message.height == 0.5 else 1.0)
        return work(message, config)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operator, "_run_in_thread", aside)
        for height in (0.5, 0.7):
            page.asks.put_nowait(
                {"ask": "draw", "strokes": [[[0, 0, 0], [1, 1, 0]]], "height": height}
            )
        await clock.sleep(3.5)
    assert [plan["points"][-1] for plan in page.told("plan")] == [[1.0, 0.0, 0.7]]


@virtual
async def test_one_drawing_is_planned_at_a_time_then_the_newest_waiting_one(
    clock,
):
    server, planning, most, begun = Server(clock), [], [], []
    page = server.page()

    async def aside(work, message, config):
        planning.append(message.height)
        begun.append(message.height)
        most.append(len(planning))
        await clock.sleep(1.0)
        planning.remove(message.height)
        return work(message, config)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operator, "_run_in_thread", aside)
        for height in (0.5, 0.6, 0.7, 0.8):
            page.asks.put_nowait(
                {"ask": "draw", "strokes": [[[0, 0, 0], [1, 1, 0]]], "height": height}
            )
            await clock.sleep(0.1)
        await clock.sleep(3.0)
    assert (begun, max(most)) == ([0.5, 0.8], 1)
    assert [plan["points"][-1] for plan in page.told("plan")] == [[1.0, 0.0, 0.8]]
    await server.end()


@served
async def test_what_a_page_asks_for_without_end_is_refused_but_never_a_stop(
    clock, server, page
):
    await clock.sleep(0.1)
    for _ in range(STREAM_LIMITS.most_messages + 100):
        page.asks.put_nowait({"ask": "order", "verb": "hold", "drones": [0]})
    page.asks.put_nowait({"ask": "stop"})
    page.asks.put_nowait({"ask": "order", "verb": "land", "drones": [1]})
    await clock.sleep(0.2)
    assert len(server.desk.book.receipts) > 1
    assert server.desk.book.receipts[-1].verb == "emergency stop"
    assert server.bus.stopped
    (refused,) = page.told("refused")
    assert str(STREAM_LIMITS.most_messages) in refused
    assert page.closed is None
    await clock.sleep(STREAM_LIMITS.counting_time)
    page.asks.put_nowait({"ask": "order", "verb": "land", "drones": [1]})
    await clock.sleep(0.2)
    assert server.those("land") == [(1, "land", {})]


@served
async def test_what_was_asked_for_is_done_though_its_page_is_gone(clock, server, page):
    await clock.sleep(1.5)
    for words in (
        {"ask": "order", "verb": "hold"},
        {"ask": "add-task", "pickup": [1.0, 2.0]},
        {"ask": "stop"},
        None,
    ):
        page.asks.put_nowait(words)
    await page.serving
    assert [receipt.verb for receipt in server.desk.book.receipts][:2] == [
        "hold",
        "emergency stop",
    ]
    await clock.sleep(1.0)
    assert server.bus.stopped
    assert server.those("task_add")


@served
async def test_an_unforeseen_error_is_refused_with_its_reason_and_the_page_stays(
    clock, server, page
):

    def fails(*arguments, **named):
        raise AssertionError("unknown status keyword 'a' in marked section")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operator, "answer_load", fails)
        patch.setattr(operator, "flight_places", fails)
        page.asks.put_nowait({"ask": "load", "name": "a.svg", "text": "<![a["})
        page.asks.put_nowait({"ask": "go-to", "drones": [1], "p": [0, 0, 1]})
        await clock.sleep(0.5)
    why = "AssertionError: unknown status keyword 'a' in marked section"
    assert page.told("refused") == [why, why]
    page.asks.put_nowait({"ask": "order", "verb": "land", "drones": [1]})
    await clock.sleep(0.5)
    assert server.those("land")
    assert not page.serving.done()


@served
async def test_a_page_that_floods_its_line_is_closed(clock, server, page):
    await clock.sleep(0.1)
    for _ in range(STREAM_LIMITS.flood_messages):
        page.asks.put_nowait("{")
    await clock.sleep(0.5)
    assert page.closed == CloseCode.POLICY_VIOLATION
    assert server.stream.pages == 0
    pages = [server.page() for _ in range(STREAM_LIMITS.most_pages + 1)]
    await clock.sleep(0.5)
    assert [page.closed for page in pages] == [None] * STREAM_LIMITS.most_pages + [
        CloseCode.TRY_AGAIN_LATER
    ]


@served
async def test_links_are_asked_in_turn_and_show_what_was_lost_lately(
    clock, server, page
):
    await clock.sleep(4.0)
    assert page.told("links")[-1] == {"0-1": 0.3}


@served
async def test_routes_are_sent_with_the_news_and_forgotten_when_a_drone_stops_answering(
    clock, server, page
):
    await clock.sleep(2.0)
    assert page.told("routes")[-1] == {"1": [[1.0, 2.0, 0.5], [0.12, 0.0, 0.5]]}
    execute = server.execute

    async def refuse(i, verb, arguments):
        if (i, verb) == (1, "overview"):
            raise Refused("drone 1", "its process ends")
        return await execute(i, verb, arguments)

    server.execute = refuse
    await clock.sleep(2.0)
    assert page.told("routes")[-1] == {}
    assert server.overview.networks.keys() == {0, 2}


@served
async def test_the_network_that_is_simulated_is_told_and_by_drone_where_these_differ(
    clock, server, page
):
    for network in server.networks:
        network.update({"loss": 0.3})
    await clock.sleep(2.0)
    assert page.told("network")[-1] == {"rules": [{"loss": 0.3}], "words": "loss 0.3"}
    server.networks[1].update({"clear": True})
    await clock.sleep(2.0)
    assert (
        page.told("network")[-1]["words"]
        == "drones 0, 2: loss 0.3 | drones 1: nothing: perfect"
    )


@served
async def test_tasks_are_listed_and_a_drone_that_refuses_one_leaves_it_to_the_next(
    clock, server, page
):
    await clock.sleep(3.0)
    assert page.told("tasks")[-1] == [{"id": 4}]
    page.asks.put_nowait(
        {"ask": "add-task", "pickup": [1.0, 2.0], "delivery": [0.0, 1.0], "load": 2.0}
    )
    page.asks.put_nowait({"ask": "cancel-task", "id": 4})
    await clock.sleep(1.0)
    asked = {"pickup": [1.0, 2.0], "delivery": [0.0, 1.0], "load": 2.0}
    assert server.those("task_add") == [(1, "task_add", asked)], (
        "drone 0 is known to refuse"
    )
    assert server.those("task_cancel") == [(1, "task_cancel", {"id": 4})]


@served
async def test_a_task_that_one_drone_may_have_heard_is_given_to_no_other_drone(
    clock, server, page
):
    added = []

    async def slow(i, verb, arguments):
        if verb == "task_add":
            added.append(i)
            await clock.sleep(60.0)
        return {"tasks": []}

    server.execute = slow
    page.asks.put_nowait({"ask": "add-task", "pickup": [1.0, 2.0]})
    await clock.sleep(12.0)
    assert added == [0]
    (receipt,) = server.desk.book.receipts
    assert receipt.answers == {
        0: (RECEIPT_KINDS.unfinished, "accepted, not done within 5 s")
    }
    deafen(server.bus.ports[0])
    server.board._k = 0
    await server.board.ask("task_add", "", pickup=[1.0, 2.0])
    assert added == [0]
    assert server.desk.book.receipts[-1].answers[0][0] == RECEIPT_KINDS.silent
    assert len(server.desk.book.receipts) == 2


@served
async def test_tasks_are_taken_from_a_drone_that_hears_more_than_half_of_the_swarm(
    clock, server, page
):
    execute = server.execute

    async def own(i, verb, arguments):
        if verb == "task_list" and i:
            server.obeyed.append((i, verb, arguments))
            return {"tasks": [{"id": i}]}
        return await execute(i, verb, arguments)

    async def say(seconds, **silent):
        for _ in range(round(4 * seconds)):
            for i in range(3):
                server.bus.ports[i].publish(
                    DRONE_TOPICS.status,
                    Status("mission", suspect=silent.get(f"d{i}", [])),
                )
            await clock.sleep(0.25)

    server.execute = own
    await say(4.0)
    assert page.told("tasks")[-1] == [{"id": 1}], "drone 0 refuses"
    await say(2.0, d1=[0, 2], d0=[1], d2=[1])
    assert page.told("tasks")[-1] == [{"id": 2}]
    await say(2.0)
    assert page.told("tasks")[-1] == [{"id": 2}], "the same drone is still asked"
    server.obeyed.clear()
    await say(4.0, d0=[1, 2], d1=[0, 2], d2=[0, 1])
    assert {i for i, *_ in server.those("task_list")} == {2}, (
        "no drone hears more than half of the swarm"
    )


@virtual
async def test_a_mission_without_tasks_is_asked_seldom(clock):
    server = Server(clock)

    async def refuse(i, verb, arguments):
        server.obeyed.append((i, verb, arguments))
        raise Refused("drone", "this mission has no command 'task_list'")

    server.execute = refuse
    page = server.page()
    await clock.sleep(3.0 + POLLING_LIMITS.no_tasks_pause - 1.0)
    assert len(server.those("task_list")) == 3
    assert page.told("tasks")[-1] is None
    await server.end()


@served
async def test_the_network_is_changed_for_all_links_for_one_drone_s_or_for_one(
    clock, server, page
):
    for words in (
        {"loss": 0.3},
        {"loss": 0.5, "delay": 0.1, "drones": [1]},
        {"loss": 0, "drones": [2, 0]},
        {"cut": True, "drones": [0]},
        {"clear": True},
    ):
        page.asks.put_nowait({"ask": "impair", **words})
    await clock.sleep(0.5)
    told = [arguments for i, verb, arguments in server.those("impair") if i == 0]
    assert [
        {key: value for key, value in one.items() if value is not None} for one in told
    ] == [
        {"loss": 0.3},
        {"loss": 0.5, "delay": 0.1, "drone": 1},
        {"loss": 0.0, "edge": [2, 0]},
        {"cut": {"since": 0.0, "a": [0]}},
        {"clear": True},
    ]
    assert len(server.those("impair")) == 15, "every drone is told"


@virtual
async def test_a_new_cut_adds_to_earlier_cuts_and_the_receipt_says_what_is_in_force(
    clock,
):
    server, network = (
        Server(clock),
        Impairment(1, partitions=[NetworkPartition(5.0, 9.0, (1,), (2,))]),
    )

    async def execute(i, verb, arguments):
        if verb == "impair":
            network.update(arguments)
            return network.describe()

    server.execute = execute
    page = server.page()
    for drones in ([0], [2], [2]):
        page.asks.put_nowait({"ask": "impair", "cut": True, "drones": drones})
    await clock.sleep(0.5)
    receipt = server.desk.book.receipts[-1]
    assert receipt.words == "cut off, 2"
    assert receipt.answers[0] == (
        "done",
        "1 apart from 2, from 5 s after GO to 9 s; 0 apart from the others, from GO to the end; "
        "2 apart from the others, from GO to the end",
    )
    page.asks.put_nowait({"ask": "impair", "clear": True})
    await clock.sleep(0.5)
    assert server.desk.book.receipts[-1].answers[0] == ("done", "nothing: perfect")
    await server.end()


@served
async def test_a_goal_is_for_the_first_and_the_others_keep_their_distance(
    clock, server, page
):
    page.asks.put_nowait(
        {"ask": "go-to", "drones": [2, 0], "p": [1, 1, 1], "offset": [0, 0.5, 0]}
    )
    await clock.sleep(0.5)
    assert server.those("go-to") == [
        (2, "go-to", {"p": [1.0, 1.0, 1.0], "yaw": None}),
        (0, "go-to", {"p": [1.0, 1.5, 1.0], "yaw": None}),
    ]


@virtual
async def test_a_stop_comes_between_while_what_each_flies_is_made(clock):
    server, making = Server(clock), []
    page = server.page()

    async def aside(work, *arguments, **named):
        if work is operator.flight_messages:
            making.append(clock.now())
            await clock.sleep(3.0)
        return work(*arguments, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operator, "_run_in_thread", aside)
        page.asks.put_nowait({"ask": "draw", "strokes": [[[0, 0, 0], [1, 1, 0]]]})
        await clock.sleep(0.5)
        page.asks.put_nowait({"ask": "fly", "drones": [1]})
        await clock.sleep(0.5)
        assert [receipt.verb for receipt in server.desk.book.receipts] == ["fly"], (
            "it is told at once"
        )
        page.asks.put_nowait({"ask": "stop"})
        await clock.sleep(0.2)
        assert server.bus.stopped
        await clock.sleep(5.0)
        assert not server.those("fly")
        assert server.desk.book.receipts[0].answers == {
            1: (RECEIPT_KINDS.withdrawn, "by stop")
        }
        page.asks.put_nowait({"ask": "fly", "drones": [1, 2], "offset": [0, 50.0, 0]})
        await clock.sleep(4.0)
    assert not server.those("fly")
    kind, words = server.desk.book.receipts[-1].answers[1]
    assert (kind, len(making)) == (ANSWER_TEXTS.refused, 2)
    assert "path of drone 2" in words
    await server.end()


@virtual
async def test_what_was_planned_and_shown_is_flown(clock):
    server = Server(clock)
    page, other = server.page(), server.page()
    stroke = [[round(0.05 * k, 4), round(0.02 * k, 4), 0.0] for k in range(50)]
    page.asks.put_nowait({"ask": "draw", "strokes": [stroke], "height": 0.8})
    await clock.sleep(0.5)
    (plan,) = page.told("plan")
    assert plan["points"][-1] == [0.98, 0.0, 0.8]
    other.asks.put_nowait({"ask": "fly", "drones": [1]})
    page.asks.put_nowait({"ask": "fly", "drones": [1]})
    await clock.sleep(0.5)
    assert other.told("refused"), "the plan of another page"
    ((i, _, arguments),) = server.those("fly")
    assert i == 1
    assert abs(arguments["durations"].sum() - plan["duration"]) < 0.01
    page.asks.put_nowait({"ask": "draw", "strokes": [stroke], "height": 0.9})
    page.asks.put_nowait({"ask": "fly", "drones": [2]})
    await clock.sleep(0.5)
    assert len(server.those("fly")) == 1, "not what was drawn before"
    page.asks.put_nowait({"ask": "save", "strokes": [stroke], "kind": "svg"})
    await clock.sleep(0.2)
    (made,) = page.told("saved")
    assert made["kind"] == "svg"
    page.asks.put_nowait({"ask": "load", "name": "a.svg", "text": made["text"]})
    await clock.sleep(0.2)
    assert [row[1:] for row in page.told("strokes")[0][0]] == [
        row[1:] for row in stroke
    ]
    assert page.told("remarks") == [[]]
    page.asks.put_nowait(
        {
            "ask": "load",
            "name": "a.svg",
            "text": '<svg><path id="e"/><path d="M0 0h9"/></svg>',
        }
    )
    await clock.sleep(0.2)
    assert page.told("remarks")[-1] == [
        '<path id="e"> in line 1: left out: it has no size'
    ]
    await server.end()


@served
async def test_parameters_of_a_firmware_are_listed_read_and_set_with_a_receipt(
    clock, server, page
):
    for words in (
        {"ask": "list-parameters", "drone": 1},
        {"ask": "read-parameters", "drone": 1, "name": "led"},
        {"ask": "set-parameter", "drone": 1, "name": "led.bitmask", "value": 7},
        {"ask": "set-parameter", "drone": 1, "name": "led.bitmask", "value": 256},
        {"ask": "list-parameters", "drone": 2},
        {"ask": "list-parameters", "drone": 9},
    ):
        page.asks.put_nowait(words)
        await clock.sleep(0.5)
    assert page.told("parameters") == [
        {"drone": 1, "types": {"led.bitmask": ["uint8_t", True]}},
        {"drone": 1, "values": {"led.bitmask": 0}},
        {"drone": 1, "values": {"led.bitmask": 7}},
        {"drone": 2, "problem": "drone 2: it has no firmware here"},
    ]
    good, bad = server.desk.book.receipts
    assert (good.verb, good.words) == ("firmware_set", "led.bitmask = 7")
    assert good.answers == {1: (ANSWER_TEXTS.done, "led.bitmask = 7")}
    assert bad.answers == {1: (ANSWER_TEXTS.refused, "allowed: 0 to 255")}
    assert len(page.told("refused")) == 1, "there is no drone 9"


@served
async def test_no_parameter_of_a_recording_is_asked_for(clock, server, page):
    server.replays = True
    page.asks.put_nowait({"ask": "read-parameters", "drone": 0, "name": "led"})
    await clock.sleep(0.5)
    assert page.told("parameters") == [{"drone": 0, "problem": RECEIPT_TEXTS.replayed}]
    assert not server.those("firmware_get")


@served
async def test_a_page_gets_the_lines_of_the_firmware_apart_from_the_log(
    clock, server, page
):
    port = server.bus.ports[1]
    port.publish(DRONE_TOPICS.console, "drone 1: firmware: SYS: Crazyflie is up")
    await clock.sleep(0.5)
    (told,) = page.told("console")
    assert [(line["drone"], line["text"]) for line in told] == [
        (1, "firmware: SYS: Crazyflie is up")
    ]
    assert not any(
        "SYS" in line["text"] for lines in page.told("log") for line in lines
    )
