import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st
from virtual_time import virtual

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import BlockingQueue, DropOldest, Latest


@virtual
async def test_latest_keeps_the_newest_value_and_counts_unread_ones(clock):
    box = Latest(clock)
    for k in range(5):
        box.put(k)
    assert await box.get() == 4
    assert (box.received, box.dropped, box.version) == (5, 4, 5)
    box.put(5)
    assert box.peek() == 5
    box.put(6)
    assert (await box.get(), box.dropped) == (6, 4)


@virtual
async def test_latest_waits_for_what_was_not_read(clock):
    box = Latest(clock)
    clock.call_at(10_000_000, box.put, "a")
    clock.call_at(30_000_000, box.put, "b")
    assert (await box.get(), clock.now()) == ("a", 0.01)
    assert box.peek() == "a"
    assert (await box.get(), clock.now()) == ("b", 0.03)


@virtual
async def test_latest_grows_old_and_is_stale_beyond_its_age(clock):
    box = Latest(clock, max_age=0.1)
    assert (box.age(), box.fresh(), box.stale) == (float("inf"), None, 0)
    box.put("a", age=0.04)
    assert box.age() == pytest.approx(0.04)
    await clock.sleep(0.06)
    assert (box.fresh(), box.stale) == ("a", 0)
    await clock.sleep(0.001)
    assert (box.fresh(), box.stale, box.peek()) == (None, 1, "a")
    assert box.age() == pytest.approx(0.101)
    value, age = box.fresh_with_age()
    assert (value, age, box.stale) == (None, pytest.approx(0.101), 2)


@virtual
async def test_a_stale_message_counts_as_dropped_when_it_is_replaced_unread(clock):
    box = Latest(clock, max_age=0.1)
    box.put("a", age=1.0)
    assert box.fresh() is None
    box.put("b")
    assert (box.fresh(), box.dropped) == ("b", 1)


@virtual
async def test_a_fresh_message_that_was_looked_at_is_not_dropped(clock):
    box = Latest(clock, max_age=0.1)
    for value in "abc":
        box.put(value)
        assert box.fresh() == value
    assert (box.dropped, box.stale) == (0, 0)


@virtual
async def test_a_message_that_was_overtaken_does_not_replace_the_newer_one(clock):
    box = Latest(clock)
    await clock.sleep(1.0)
    box.put("newer", age=0.01)
    box.put("older", age=0.03)
    assert (box.peek(), box.version, box.dropped) == ("newer", 1, 1)
    box.put("as old", age=0.01 + 1e-10)
    assert box.peek() == "as old"
    box.clear()
    box.put("older", age=0.5)
    assert box.peek() == "older"


@virtual
async def test_latest_forgets(clock):
    box = Latest(clock, max_age=1.0)
    box.put("a")
    box.clear()
    assert (box.peek(), box.fresh(), box.age()) == (None, None, float("inf"))
    reader = asyncio.create_task(box.get())
    await clock.sleep(0.01)
    assert not reader.done()
    box.put("b")
    assert await reader == "b"


@given(
    st.integers(1, 5),
    st.lists(st.sampled_from(["put", "take one", "take all", "clear"])),
)
def test_drop_oldest_is_a_bounded_queue(size, steps):
    async def main(clock):
        box, model, put, gone = DropOldest(clock, size=size), [], 0, 0
        for step in steps:
            match step:
                case "put":
                    box.put(put)
                    model.append(put)
                    put += 1
                    if len(model) > size:
                        model.pop(0)
                        gone += 1
                case "take one" if model:
                    assert await box.get() == model.pop(0)
                case "take all":
                    assert box.take() == model
                    model.clear()
                case "clear":
                    box.clear()
                    model.clear()
        assert (box.take(), box.received, box.dropped) == (model, put, gone)

    run_virtual(main)


@virtual
async def test_drop_oldest_waits_when_empty(clock):
    box = DropOldest(clock)
    clock.call_at(10_000_000, box.put, "a")
    assert (await box.get(), clock.now()) == ("a", 0.01)


@virtual
async def test_block_lets_its_sender_wait(clock):
    box, times = BlockingQueue(clock, size=2), []

    async def send():
        for k in range(4):
            await box.put_wait(k)
            times.append(clock.now())

    sender = asyncio.create_task(send())
    await clock.sleep(1.0)
    assert (times, box.received) == ([0.0, 0.0], 2)
    with pytest.raises(asyncio.QueueFull):
        box.put(9)
    assert [await box.get() for _ in range(2)] == [0, 1]
    await sender
    assert times == [0.0, 0.0, 1.0, 1.0]
    assert (box.received, await box.get()) == (4, 2)


@virtual
async def test_block_forgets_and_lets_waiting_senders_in(clock):
    box = BlockingQueue(clock, size=1)
    box.put("old")
    sender = asyncio.create_task(box.put_wait("new"))
    await clock.sleep(0.01)
    box.clear()
    assert await box.get() == "new"
    await sender


@virtual
async def test_a_cancelled_reader_does_not_take_the_next_message_with_it(clock):
    for box in (Latest(clock), DropOldest(clock)):
        reader = asyncio.create_task(box.get())
        await clock.sleep(0.01)
        reader.cancel()
        await asyncio.wait([reader])
        box.put("a")
        assert await box.get() == "a"


@virtual
async def test_the_table_says_which_mailbox_a_topic_has(clock):
    latest, queue = (
        DRONE_TOPICS.state.mailbox(clock, "drone 1 "),
        DRONE_TOPICS.log.mailbox(clock),
    )
    assert isinstance(latest, Latest)
    assert (latest.name, latest.max_age) == (
        "drone 1 state",
        DRONE_TOPICS.state.max_age,
    )
    assert isinstance(queue, DropOldest)
    for k in range(DRONE_TOPICS.log.queue + 1):
        queue.put(str(k))
    assert (queue.dropped, len(queue.take())) == (1, DRONE_TOPICS.log.queue)
