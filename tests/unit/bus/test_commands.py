import asyncio
import math
from functools import partial

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus import commands
from crazychoir.bus.codec import decode, encode
from crazychoir.bus.commands import (
    ANSWER_TEXTS,
    Answer,
    Commander,
    CommandServer,
)
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import Refused


class Swarm:
    """An operator and the command servers of some drones; what they were told is in `done` and `stops`."""

    def __init__(self, clock, *ids, execute=None):
        self.clock = clock
        self.bus = Bus(clock)
        self.operator = Commander(self.bus.port(PORT_ADDRESSES.first_observer, 0xF1))
        self.done, self.stops = [], []
        self.execute = execute or self.note
        self.servers = {i: self.serve(i) for i in ids}

    def serve(self, i):
        return CommandServer(
            self.bus.port(i), self.execute, lambda on: self.stops.append((i, on))
        )

    async def note(self, verb, arguments):
        self.done.append((verb, arguments))
        return len(self.done)


def losing(port, lose):
    """Lose what arrives at a port where `lose(topic, payload, number)` is true; returns all that came."""
    came = []

    def lossy(handle, message, age):
        topic, payload = message.topic.number, message.payload
        came.append((topic, payload))
        if not lose(topic, payload, message.number):
            handle(message, age)

    for topic, handle in port.handlers.items():
        port.handlers[topic] = partial(lossy, handle)
    return came


def ask(server, body, number=1, channel="f1", age=0.0):
    server.port.bus.deliver(
        Message(
            MESSAGE_TOPICS.request, PORT_ADDRESSES.first_observer, body, number, channel
        ),
        (server.port.address,),
        age,
    )


@virtual
async def test_a_request_is_done_and_answered(clock):
    swarm = Swarm(clock, 1, 2)
    answer = await swarm.operator.request(2, "go", height=1.5, path=[1, 2])
    assert answer == Answer(2, ANSWER_TEXTS.done, 1)
    assert swarm.done == [("go", {"height": 1.5, "path": [1, 2]})]
    assert clock.now() == 0.0


@virtual
async def test_a_request_is_accepted_at_once_and_done_later(clock):
    async def slowly(verb, arguments):
        await clock.sleep(2.0)
        return "there"

    swarm = Swarm(clock, 1, execute=slowly)
    came = losing(swarm.operator.port, lambda *message: False)
    assert await swarm.operator.request(1, "go") == Answer(
        1, ANSWER_TEXTS.done, "there"
    )
    kinds = [decode(payload)[0] for _, payload in came]
    assert kinds[0] == ANSWER_TEXTS.accepted
    assert kinds.count(ANSWER_TEXTS.done) == 1
    assert clock.now() == 2.0


@virtual
async def test_refusals_carry_their_reason(clock):
    async def refuse(verb, arguments):
        if verb == "fly":
            raise Refused("drone 1", "battery low")
        raise KeyError("height")

    swarm = Swarm(clock, 1, execute=refuse)
    assert await swarm.operator.request(1, "fly") == Answer(
        1, ANSWER_TEXTS.refused, "battery low"
    )
    assert await swarm.operator.request(1, "go") == Answer(
        1, ANSWER_TEXTS.refused, "KeyError: 'height'"
    )


@virtual
async def test_a_result_that_cannot_travel_is_a_refusal(clock):
    async def strange(verb, arguments):
        return object()

    answer = await Swarm(clock, 1, execute=strange).operator.request(1, "go")
    assert answer.kind == ANSWER_TEXTS.refused
    assert "CodecError" in answer.detail


@virtual
async def test_a_request_to_an_absent_drone_times_out_and_names_drone_and_verb(clock):
    swarm = Swarm(clock, 1)
    with pytest.raises(TimeoutError, match=r"drone 9: no answer to 'land' within 2 s"):
        await swarm.operator.request(9, "land", deadline=2.0)
    assert clock.now() == 2.0
    assert swarm.bus.unroutable == 20
    assert swarm.operator._waiting == {}


@virtual
async def test_a_cancelled_request_is_forgotten(clock):
    swarm = Swarm(clock)
    request = asyncio.create_task(swarm.operator.request(9, "land"))
    await clock.sleep(0.25)
    request.cancel()
    with pytest.raises(asyncio.CancelledError):
        await request
    assert swarm.operator._waiting == {}


@virtual
async def test_under_loss_requests_are_resent_and_executed_once(clock):
    swarm, draws = Swarm(clock, 1, 2, 3), np.random.default_rng(4)
    for port in swarm.bus.ports.values():
        losing(port, lambda *message: draws.random() < 0.5)
    wanted = []
    for k in range(60):
        answer = await swarm.operator.request(1 + k % 3, "step", deadline=10.0, k=k)
        wanted.append(("step", {"k": k}))
        assert (answer.kind, answer.detail) == (ANSWER_TEXTS.done, k + 1)
    assert swarm.done == wanted
    assert clock.now() > 3.0


@virtual
async def test_a_repeat_while_it_runs_is_accepted_and_not_started_again(clock):
    async def slowly(verb, arguments):
        begun.append(verb)
        await clock.sleep(1.0)

    begun, swarm = [], Swarm(clock, 1, execute=slowly)
    server = swarm.servers[1]
    for number in range(2):
        ask(server, encode(["go", {}, 5.0]), number)
    await clock.sleep(0.5)
    for number in range(100, 101 + commands.REQUEST_RULES.remembered_answers):
        ask(server, encode(["late", {}, -1.0]), number)
    ask(server, encode(["go", {}, 5.0]), 0)
    await clock.sleep(2.0)
    assert begun == ["go", "go"]
    assert server._running == {}
    assert len(server._answers) <= commands.REQUEST_RULES.remembered_answers


@virtual
async def test_equal_numbers_of_other_issuers_and_lives_are_other_requests(clock):
    swarm = Swarm(clock, 1)
    for channel in ("f1", "f2"):
        for _ in range(2):
            ask(swarm.servers[1], encode(["go", {}, 1.0]), 1, channel)
    swarm.servers[1].port.bus.deliver(
        Message(
            MESSAGE_TOPICS.request,
            PORT_ADDRESSES.first_observer + 1,
            encode(["go", {}, 1.0]),
            1,
            "f1",
        ),
        (swarm.servers[1].port.address,),
        0.0,
    )
    await clock.sleep(0.1)
    assert len(swarm.done) == 3


@virtual
async def test_a_request_past_its_deadline_is_refused(clock):
    swarm = Swarm(clock, 1)
    came = losing(swarm.operator.port, lambda *message: False)
    ask(swarm.servers[1], encode(["go", {}, 0.5]), 1, age=0.6)
    ask(swarm.servers[1], encode(["go", {}, 0.5]), 2, age=0.4)
    await clock.sleep(0.1)
    assert [decode(payload) for _, payload in came] == [
        [ANSWER_TEXTS.refused, "the deadline has passed"],
        [ANSWER_TEXTS.accepted, None],
        [ANSWER_TEXTS.done, 1],
    ]
    assert swarm.done == [("go", {})]


@virtual
async def test_a_resent_request_says_how_much_time_remains(clock):
    swarm = Swarm(clock, 1)
    came = losing(swarm.bus.ports[1], lambda *message: True)
    with pytest.raises(TimeoutError):
        await swarm.operator.request(1, "go", deadline=0.25)
    assert [decode(payload)[2] for _, payload in came] == pytest.approx(
        [0.25, 0.15, 0.05]
    )


@virtual
async def test_a_replay_is_not_done_again_after_its_answer_was_forgotten(clock):
    swarm = Swarm(clock, 1)
    server = swarm.servers[1]
    came = losing(swarm.operator.port, lambda *message: False)
    for number in range(1, 2 * commands.REQUEST_RULES.remembered_answers):
        ask(server, encode(["go", {}, 5.0]), number)
        await clock.sleep(0.01)
    done = len(swarm.done)
    came.clear()
    ask(server, encode(["go", {}, 5.0]), 1)
    await clock.sleep(0.1)
    assert len(swarm.done) == done
    assert [decode(payload) for _, payload in came] == [
        [ANSWER_TEXTS.refused, "it is older than what was asked since"]
    ]
    ask(server, encode(["go", {}, 5.0]), 1, "f2")
    await clock.sleep(0.1)
    assert len(swarm.done) == done + 1, "of another life of the operator"
    for life in range(2 * commands.REQUEST_RULES.remembered_answers):
        ask(server, encode(["late", {}, -1.0]), 1, f"{life:x}")
    assert len(server._forgotten) <= commands.REQUEST_RULES.remembered_answers


@virtual
async def test_malformed_requests_and_answers_are_counted(clock):
    swarm = Swarm(clock, 1)
    bodies = [
        b"",
        b"\xff",
        encode(3),
        encode(["go"]),
        encode([1, {}, 1.0]),
        encode(["go", 3, 1.0]),
    ]
    for number, body in enumerate([*bodies, encode(["go", {}, "soon"])]):
        ask(swarm.servers[1], body, number)
    await clock.sleep(0.1)
    assert (swarm.done, swarm.servers[1].port.counters.malformed) == ([], 7)
    for body in (b"\xff", encode(3), encode([1, 2, 3])):
        swarm.operator.port.bus.deliver(
            Message(MESSAGE_TOPICS.answer, 1, body, 1, "f1"),
            (swarm.operator.port.address,),
            0.0,
        )
    assert swarm.operator.port.counters.malformed == 3


@virtual
async def test_answers_to_a_former_life_of_the_operator_are_not_taken(clock):
    swarm = Swarm(clock)
    request = asyncio.create_task(swarm.operator.request(1, "go", deadline=1.0))
    await clock.sleep(0.1)
    swarm.operator.port.bus.deliver(
        Message(MESSAGE_TOPICS.answer, 1, encode([ANSWER_TEXTS.done, "old"]), 1, "f0"),
        (swarm.operator.port.address,),
        0.0,
    )
    swarm.operator.port.bus.deliver(
        Message(MESSAGE_TOPICS.answer, 1, encode([ANSWER_TEXTS.done, "now"]), 1, "f1"),
        (swarm.operator.port.address,),
        0.0,
    )
    assert await request == Answer(1, ANSWER_TEXTS.done, "now")


@virtual
async def test_an_answer_from_another_drone_is_ignored(clock):
    swarm = Swarm(clock)
    request = asyncio.create_task(swarm.operator.request(1, "land", deadline=1.0))
    await clock.sleep(0.1)
    for kind in (ANSWER_TEXTS.accepted, ANSWER_TEXTS.done, ANSWER_TEXTS.refused):
        swarm.operator.port.bus.deliver(
            Message(MESSAGE_TOPICS.answer, 2, encode([kind, None]), 1, "f1"),
            (swarm.operator.port.address,),
            0.0,
        )
    with pytest.raises(TimeoutError, match="drone 1: no answer to 'land'"):
        await request


# Emergency stop -----------------------------------------------------------------------------------------------


@virtual
async def test_everybody_stops_and_a_clear_undoes_it(clock):
    swarm = Swarm(clock, 1, 2, 3)
    assert await swarm.operator.emergency_stop([1, 2, 3]) == []
    assert swarm.stops == [(1, True), (2, True), (3, True)]
    assert swarm.bus.stopped
    assert await swarm.operator.emergency_stop([1, 2, 3], clear=True) == []
    assert swarm.stops[3:] == [(1, False), (2, False), (3, False)]
    assert not swarm.bus.stopped


@virtual
async def test_a_stop_is_resent_until_all_have_acknowledged_and_carried_out_once(clock):
    swarm, draws = Swarm(clock, 1, 2, 3), np.random.default_rng(2)
    for port in swarm.bus.ports.values():
        losing(port, lambda *message: draws.random() < 0.7)
    assert await swarm.operator.emergency_stop([1, 2, 3]) == []
    assert sorted(swarm.stops) == [(1, True), (2, True), (3, True)]
    assert clock.now() > 0.2
    assert swarm.operator._acknowledged == {}


@virtual
async def test_only_drones_that_did_not_answer_are_asked_again(clock):
    swarm = Swarm(clock, 1, 2)
    first = losing(swarm.bus.ports[1], lambda *message: False)
    second = losing(swarm.bus.ports[2], lambda *message: clock.now() < 1.0)
    await swarm.operator.emergency_stop([1, 2])
    assert (len(first), len(second)) == (1, 11)


@virtual
async def test_drones_that_do_not_acknowledge_are_returned(clock):
    swarm = Swarm(clock, 1, 2)
    losing(swarm.bus.ports[2], lambda *message: True)
    assert await swarm.operator.emergency_stop([1, 2, 9], deadline=3.0) == [2, 9]
    assert 3.0 <= clock.now() <= 3.2
    assert swarm.operator._acknowledged == {}


@virtual
async def test_a_stop_persists_over_a_restart(clock):
    swarm = Swarm(clock, 1)
    await swarm.operator.emergency_stop([1])
    swarm.bus.close(1)
    swarm.serve(1)
    assert swarm.bus.stopped


@virtual
async def test_a_late_repeat_of_a_clear_does_not_undo_a_later_stop(clock):
    swarm = Swarm(clock, 1)
    for number, clear in [(1, False), (2, True), (3, False), (2, True), (1, False)]:
        swarm.servers[1].port.bus.deliver(
            Message(
                MESSAGE_TOPICS.emergency_stop,
                PORT_ADDRESSES.first_observer,
                encode(clear),
                number,
                "f1",
            ),
            (swarm.servers[1].port.address,),
            0.0,
        )
    assert swarm.bus.stopped
    assert swarm.stops == [(1, True), (1, False), (1, True)]


@virtual
async def test_a_clear_that_comes_after_a_newer_stop_does_not_count_nor_a_stop_after_a_newer_clear(
    clock,
):
    swarm = Swarm(clock, 1)
    came = losing(swarm.operator.port, lambda *message: False)
    said = {
        "stop": encode(False),
        "alone": encode(commands.STOP_ALONE),
        "clear": encode(True),
    }

    def hear(number, what, channel="f1"):
        swarm.servers[1].port.bus.deliver(
            Message(
                MESSAGE_TOPICS.emergency_stop,
                PORT_ADDRESSES.first_observer,
                said[what],
                number,
                channel,
            ),
            (swarm.servers[1].port.address,),
            0.0,
        )

    hear(3, "stop")
    hear(2, "clear")
    assert (swarm.bus.stopped, swarm.stops) == (True, [(1, True)])
    hear(5, "clear")
    hear(4, "stop")
    assert (swarm.bus.stopped, swarm.stops) == (False, [(1, True), (1, False)])
    hear(7, "alone")
    hear(6, "stop")
    assert (swarm.bus.stopped, len(swarm.stops)) == (True, 4), (
        "one of the swarm counts after one of its own"
    )
    hear(1, "clear", "f2")
    assert not swarm.bus.stopped, "another life of the operator"
    assert len(came) == 7, "all are acknowledged"
    for life in range(2 * commands.REQUEST_RULES.remembered_answers):
        hear(1, "stop", f"{life:x}")
    assert len(swarm.servers[1]._newest) == commands.REQUEST_RULES.remembered_answers


@virtual
async def test_a_drone_removed_from_the_targets_of_a_stop_is_no_longer_told(clock):
    swarm, targets = Swarm(clock, 1), [1, 2, 3]
    stopping = asyncio.create_task(
        swarm.operator.emergency_stop(targets, deadline=math.inf)
    )
    await clock.sleep(100.0)
    assert not stopping.done()
    targets.remove(2)
    targets.remove(3)
    assert await stopping == []


@virtual
async def test_a_stop_that_cannot_be_read_is_a_stop(clock):
    swarm = Swarm(clock, 1)
    for number, payload in enumerate([b"\xff", encode(1), encode("clear")]):
        swarm.bus.stopped = False
        swarm.servers[1].port.bus.deliver(
            Message(
                MESSAGE_TOPICS.emergency_stop,
                PORT_ADDRESSES.first_observer,
                payload,
                number,
                "f1",
            ),
            (swarm.servers[1].port.address,),
            0.0,
        )
        assert swarm.bus.stopped
    assert swarm.stops == [(1, True)] * 3
