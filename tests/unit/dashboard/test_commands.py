import asyncio

from desk_swarm import Swarm
from message_parts import deafen
from virtual_time import virtual

from crazychoir.bus.commands import (
    ANSWER_TEXTS,
    CommandServer,
)
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.dashboard.orders import ORDER_LIMITS
from crazychoir.dashboard.receipts import MOST_RECEIPTS, RECEIPT_KINDS, RECEIPT_TEXTS
from crazychoir.dashboard.stops import STOP_TIMEOUT
from crazychoir.errors import ConfigError, Refused


@virtual
async def test_a_receipt_tells_which_drones_acknowledged_finished_refused_or_are_silent(
    clock,
):
    swarm = Swarm(clock)
    receipt = swarm.desk.order("take-off", seconds=5.0)
    assert {kind for kind, _ in receipt.answers.values()} == {RECEIPT_KINDS.sent}
    await clock.sleep(0.2)
    assert receipt.answers == {
        0: (ANSWER_TEXTS.accepted, ""),
        1: (ANSWER_TEXTS.refused, "it is on the ground"),
        2: (RECEIPT_KINDS.sent, ""),
    }
    await clock.sleep(1.0)
    assert receipt.answers[0] == (ANSWER_TEXTS.done, "hovering")
    await clock.sleep(ORDER_LIMITS.acknowledge_timeout - 1.2 + 0.1)
    assert receipt.answers[2] == (RECEIPT_KINDS.sent, "no agent of it is there; resent")
    assert receipt.open
    await swarm.desk.settled(receipt)
    assert clock.now() >= 5.0
    assert receipt.answers[2][0] == RECEIPT_KINDS.silent
    assert not receipt.done()
    assert [(line.drone, line.level) for line in swarm.watch.after(0)] == [
        (1, "warning"),
        (2, "warning"),
    ]


@virtual
async def test_no_drone_obeys_in_a_replay_or_when_all_have_gone(clock):
    swarm = Swarm(clock)
    assert swarm.desk.ended() == ""
    swarm.replays = True
    assert swarm.desk.ended() == RECEIPT_TEXTS.replayed
    receipt = swarm.desk.order("land")
    assert receipt.answers == dict.fromkeys(
        range(3), (ANSWER_TEXTS.refused, RECEIPT_TEXTS.replayed)
    )
    assert swarm.desk.stop().answers[0][0] == RECEIPT_KINDS.sent, (
        "a stop is sent whatever is believed"
    )
    await clock.sleep(1.0)
    assert swarm.obeyed == []
    swarm.replays = False
    swarm.is_there = lambda i: False
    assert swarm.desk.ended() == RECEIPT_TEXTS.ended


@virtual
async def test_what_was_begun_and_refused_after_a_later_order_is_withdrawn_by_it(clock):
    swarm = Swarm(clock)

    async def until_held(verb, arguments):
        if verb == "fly":
            await clock.sleep(2.0)
            raise Refused("drone 0", "held")

    CommandServer(swarm.bus.ports[0], until_held, print)
    flying = swarm.desk.order("fly", [0])
    await clock.sleep(0.5)
    swarm.desk.order("hold", [0])
    assert (await swarm.desk.settled(flying)).answers == {
        0: (RECEIPT_KINDS.withdrawn, "by hold")
    }
    assert [line.text for line in swarm.watch.after(0)] == [], "it is no trouble"


@virtual
async def test_only_the_chosen_drones_are_asked_each_with_its_own_arguments(clock):
    swarm = Swarm(clock)
    receipt = swarm.desk.order(
        "go-to", [0], each=lambda i: {"p": [i, 1.0, 2.0]}, words="[0, 1, 2] m"
    )
    await swarm.desk.settled(receipt)
    assert swarm.obeyed == [("go-to", {"p": [0, 1.0, 2.0]})]
    assert receipt.done()
    assert (receipt.verb, receipt.words) == ("go-to", "[0, 1, 2] m")


@virtual
async def test_what_is_accepted_and_not_done_in_time_is_said(clock):
    swarm = Swarm(clock)
    receipt = swarm.desk.order("land", [0], seconds=0.5)
    await swarm.desk.settled(receipt)
    assert receipt.answers == {
        0: (RECEIPT_KINDS.unfinished, "accepted, not done within 0.5 s")
    }, "it may do it yet"
    assert [line.text for line in swarm.watch.after(0)] == [
        "land: unfinished: accepted, not done within 0.5 s"
    ]


@virtual
async def test_a_drone_that_is_not_ready_yet_is_asked_again(clock):
    swarm = Swarm(clock)
    execute = swarm.executor(0)

    async def later(verb, arguments):
        if clock.now() < 4.0:
            raise Refused(
                "drone 0", f"{ANSWER_TEXTS.not_ready}: waiting for the others"
            )
        return await execute(verb, arguments)

    CommandServer(swarm.bus.ports[0], later, print)
    receipt = await swarm.desk.settled(swarm.desk.order("take-off", [0]))
    assert receipt.answers == {0: (ANSWER_TEXTS.done, "hovering")}
    assert 5.0 <= clock.now() < 5.5
    CommandServer(swarm.bus.ports[0], swarm.executor(1), print)
    assert (await swarm.desk.settled(swarm.desk.order("take-off", [0]))).answers[0][
        0
    ] == ANSWER_TEXTS.refused
    assert clock.now() < 6.0


@virtual
async def test_a_stop_is_heard_by_all_that_are_there_and_the_silent_are_named(clock):
    swarm = Swarm(clock)
    receipt = swarm.desk.stop()
    await clock.sleep(0.2)
    assert swarm.stopped == [(0, True), (1, True)]
    assert receipt.answers == {
        0: (ANSWER_TEXTS.done, "motors off"),
        1: (ANSWER_TEXTS.done, "motors off"),
        2: (RECEIPT_KINDS.sent, ""),
    }
    assert swarm.bus.stopped
    await swarm.desk.settled(receipt)
    assert receipt.answers[2] == (
        RECEIPT_KINDS.silent,
        f"no acknowledgement within {STOP_TIMEOUT:g} s, still sent",
    )
    cleared = await swarm.desk.settled(swarm.desk.stop([0, 1], clear=True))
    assert cleared.done()
    assert not swarm.bus.stopped


@virtual
async def test_a_stop_of_one_drone_does_not_keep_the_others_on_the_ground(clock):
    swarm = Swarm(clock)
    await swarm.desk.settled(swarm.desk.stop([1]))
    assert swarm.stopped == [(1, True)]
    assert not swarm.bus.stopped


@virtual
async def test_a_stop_is_sent_until_it_is_heard_however_late(clock):
    swarm = Swarm(clock)
    hears = swarm.deaf(0)
    receipt = await swarm.desk.settled(swarm.desk.stop())
    await clock.sleep(300.0)
    assert receipt.answers[0] == (
        RECEIPT_KINDS.silent,
        f"no acknowledgement within {STOP_TIMEOUT:g} s, still sent",
    )
    version = swarm.desk.book.version
    hears()
    await clock.sleep(0.3)
    assert swarm.stopped == [(1, True), (0, True)]
    assert receipt.answers[0] == (ANSWER_TEXTS.done, "motors off")
    assert swarm.desk.book.after(version) == [receipt]
    swarm.desk.close()


@virtual
async def test_a_stop_ends_when_it_is_cleared_or_given_anew_and_one_of_some_leaves_that_of_the_swarm(
    clock,
):
    swarm = Swarm(clock)
    hears = swarm.deaf(0)
    first, second = swarm.desk.stop(), swarm.desk.stop()
    assert first.answers[0] == (RECEIPT_KINDS.withdrawn, "by emergency stop")
    alone = swarm.desk.stop([0])
    await clock.sleep(1.0)
    assert (second.answers[0], alone.answers[0]) == (
        (RECEIPT_KINDS.sent, ""),
        (RECEIPT_KINDS.sent, ""),
    )
    assert len(swarm.desk._stops.pending) == 2
    swarm.bus.stopped = False
    hears()
    await clock.sleep(1.0)
    assert second.answers[0] == alone.answers[0] == (ANSWER_TEXTS.done, "motors off")
    assert swarm.bus.stopped, "whichever came last"
    hears = swarm.deaf(1)
    third = swarm.desk.stop([1])
    cleared = swarm.desk.stop(clear=True)
    assert third.answers == {1: (RECEIPT_KINDS.withdrawn, "by clear stop")}
    await swarm.desk.settled(cleared)
    assert cleared.answers[0] == (ANSWER_TEXTS.done, "cleared")
    assert cleared.answers[1] == (
        RECEIPT_KINDS.silent,
        f"no acknowledgement within {STOP_TIMEOUT:g} s",
    )
    await clock.sleep(0.5)
    told = list(swarm.stopped)
    hears()
    await clock.sleep(1.0)
    assert swarm.stopped == told, "neither the stop nor the clear comes late"
    swarm.desk.close()


@virtual
async def test_a_stop_withdraws_whatever_would_move_its_drones(clock):
    swarm = Swarm(clock)
    hears = swarm.deaf(1)
    going = swarm.desk.order("go-to", [0, 1], each=lambda i: {"p": [0, 0, 1]})
    flying, worse = (
        swarm.desk.order("fly", [1], 500.0),
        swarm.desk.order("impair", [1], each=lambda i: {"loss": 0.1}),
    )
    await clock.sleep(0.2)
    assert going.answers == {
        0: (ANSWER_TEXTS.accepted, ""),
        1: (RECEIPT_KINDS.withdrawn, "by fly"),
    }
    lines = swarm.watch.count
    swarm.desk.stop([1])
    assert flying.answers == {1: (RECEIPT_KINDS.withdrawn, "by stop")}
    assert worse.answers == {1: (RECEIPT_KINDS.sent, "")}, "it moves nothing"
    swarm.desk.stop()
    assert going.answers[0] == (RECEIPT_KINDS.withdrawn, "by stop")
    assert swarm.watch.count == lines, "no trouble"
    hears()
    await clock.sleep(1.0)
    assert (1, True) in swarm.stopped
    assert swarm.desk._orders.pending == {}
    assert not going.open
    swarm.desk.close()


@virtual
async def test_what_is_ordered_later_counts_when_the_network_is_back(clock):
    swarm = Swarm(clock)
    hears = swarm.deaf(0)
    go, hold = swarm.desk.order("go", [0]), swarm.desk.order("hold", [0])
    assert go.answers == {0: (RECEIPT_KINDS.withdrawn, "by hold")}
    await clock.sleep(0.5)
    going = swarm.desk.order("go-to", [0], each=lambda i: {"p": [0, 0, 1]})
    assert hold.answers[0][0] == RECEIPT_KINDS.sent, (
        "a go-to does not withdraw the hold"
    )
    hears()
    await swarm.desk.settled(hold)
    await swarm.desk.settled(going)
    assert sorted(verb for verb, _ in swarm.obeyed) == ["go-to", "hold"]
    landing = swarm.desk.order("land", [0])
    await clock.sleep(0.2)
    swarm.desk.order("hold", [0])
    assert landing.answers == {0: (ANSWER_TEXTS.accepted, "")}, (
        "the drone itself reports the end of the landing"
    )
    swarm.desk.close()


@virtual
async def test_a_pending_repeat_is_withdrawn_when_something_else_is_ordered(clock):
    swarm, asked = Swarm(clock), []

    async def later(verb, arguments):
        asked.append(verb)
        if verb == "take-off":
            raise Refused(
                "drone 0", f"{ANSWER_TEXTS.not_ready}: waiting for the others"
            )

    CommandServer(swarm.bus.ports[0], later, print)
    receipt = swarm.desk.order("take-off", [0])
    await clock.sleep(1.0)
    await swarm.desk.settled(swarm.desk.order("land", [0]))
    assert receipt.answers == {0: (RECEIPT_KINDS.withdrawn, "by land")}
    await clock.sleep(5.0)
    assert asked[-1] == "land"


@virtual
async def test_a_take_off_that_a_hold_interrupted_is_not_asked_for_again(
    clock,
):
    swarm, asked = Swarm(clock), []

    async def later(verb, arguments):
        asked.append(verb)
        if verb == "take-off":
            await clock.sleep(0.3)
            raise Refused(
                "drone 0", f"{ANSWER_TEXTS.not_ready}: waiting for the others"
            )

    CommandServer(swarm.bus.ports[0], later, print)
    rising = swarm.desk.order("take-off", [0])
    await clock.sleep(0.1)
    assert rising.answers == {0: (ANSWER_TEXTS.accepted, "")}
    hears, lines = swarm.deaf(0), swarm.watch.count
    hears_answers = deafen(swarm.commander.port)
    await clock.sleep(1.0)
    holding = swarm.desk.order("hold", [0])
    assert rising.answers == {0: (ANSWER_TEXTS.accepted, "")}, (
        "it says by itself what comes of it"
    )
    await clock.sleep(1.0)
    hears_answers()
    hears()
    await swarm.desk.settled(holding)
    await swarm.desk.settled(rising)
    await clock.sleep(3.0)
    assert asked == ["take-off", "hold"]
    assert rising.answers == {0: (RECEIPT_KINDS.withdrawn, "by hold")}
    assert swarm.watch.count == lines, "no trouble"
    swarm.desk.close()


@virtual
async def test_changes_of_the_network_are_made_in_the_order_in_which_they_were_ordered(
    clock,
):
    swarm, told = Swarm(clock), []

    async def note(verb, arguments):
        told.append(arguments)

    CommandServer(swarm.bus.ports[0], note, print)
    hears = swarm.deaf(0)
    words = [{"cut": {"a": [0]}}, {"loss": 0.9}, {"clear": True}, {"loss": 0.1}]
    receipts = []
    for one in words:
        receipts.append(swarm.desk.order("impair", [0], each=lambda i, one=one: one))
        await clock.sleep(0.55)
    hears()
    for receipt in receipts:
        await swarm.desk.settled(receipt)
    assert told == words
    hears = swarm.deaf(0)
    late = [
        swarm.desk.order("impair", [0], each=lambda i, k=k: {"loss": k})
        for k in (0.2, 0.3)
    ]
    began = clock.now()
    await swarm.desk.settled(late[1])
    assert [receipt.answers[0][0] for receipt in late] == [
        RECEIPT_KINDS.silent,
        RECEIPT_KINDS.silent,
    ]
    assert clock.now() < began + 5.2, "each gets its time from when it was ordered"
    swarm.desk.close()


@virtual
async def test_a_stop_counts_while_what_was_ordered_before_is_still_prepared(clock):
    swarm = Swarm(clock)

    async def prepared():
        await clock.sleep(3.0)
        return {0: {"p": [0, 0, 1]}}

    def fly():
        told = asyncio.create_task(prepared())
        return swarm.desk.order(
            "fly", [0], 60.0, each=lambda i: told.result()[i], first=told
        )

    flying = fly()
    await clock.sleep(1.0)
    assert flying.answers == {0: (RECEIPT_KINDS.sent, "")}
    swarm.desk.stop()
    assert flying.answers == {0: (RECEIPT_KINDS.withdrawn, "by stop")}
    await clock.sleep(5.0)
    assert swarm.obeyed == []
    flying = fly()
    await swarm.desk.settled(flying)
    assert swarm.obeyed == [("fly", {"p": [0, 0, 1]})]
    swarm.desk.close()


@virtual
async def test_what_cannot_be_prepared_is_refused_with_the_reason(clock):
    swarm = Swarm(clock)
    errors = (
        (ConfigError("path", 7, "less"), "path: found 7; allowed: less."),
        (OSError("full"), "OSError: full"),
    )
    for error, why in errors:

        async def fails(error=error):
            raise error

        told = asyncio.create_task(fails())
        receipt = swarm.desk.order(
            "fly", [0, 1], 60.0, each=lambda i, told=told: told.result()[i], first=told
        )
        await swarm.desk.settled(receipt)
        for kind, words in receipt.answers.values():
            assert kind == ANSWER_TEXTS.refused
            assert why in words


@virtual
async def test_a_stop_that_is_said_again_is_not_taken_twice(clock):
    swarm = Swarm(clock)
    first = swarm.desk.stop(key="a")
    await clock.sleep(0.2)
    await swarm.desk.settled(swarm.desk.stop([0, 1], clear=True))
    assert swarm.desk.stop(key="a") is first
    assert not swarm.bus.stopped
    assert swarm.desk.stop(key="b") is not first
    assert swarm.desk.stop() is not swarm.desk.stop(), "without a key each is another"
    swarm.desk.close()


@virtual
async def test_a_page_is_told_what_has_changed_since_it_was_told_last(clock):
    swarm = Swarm(clock)
    first = swarm.desk.order("land", [0])
    await clock.sleep(0.2)
    told = swarm.desk.book.version
    assert swarm.desk.book.after(0) == [first]
    assert swarm.desk.book.after(told) == []
    second = swarm.desk.order("hold", [0])
    assert swarm.desk.book.after(told) == [second]
    await swarm.desk.settled(first)
    assert swarm.desk.book.after(told) == [first, second]
    for _ in range(MOST_RECEIPTS):
        swarm.desk.order("go", [0])
    assert len(swarm.desk.book.after(0)) == MOST_RECEIPTS
    stop = swarm.desk.stop([2])
    for _ in range(MOST_RECEIPTS):
        swarm.desk.order("go", [0])
    assert len(swarm.desk.book.after(0)) == MOST_RECEIPTS
    assert stop in swarm.desk.book.after(0), "it is still sent"
    swarm.desk.close()


@virtual
async def test_an_acceptance_is_told_once_however_often_the_drone_says_so(clock):
    swarm, told = Swarm(clock), []
    port = swarm.bus.ports[0]
    handle = port.handlers[MESSAGE_TOPICS.request.number]
    port.handlers[MESSAGE_TOPICS.request.number] = lambda message, age: (
        handle(message, age),
        handle(message, age),
    )
    await swarm.commander.request(0, "land", 5.0, lambda: told.append(clock.now()))
    assert len(told) == 1
