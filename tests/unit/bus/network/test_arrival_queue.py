"""When the event loop reads what has arrived, and how long in one pass."""

import asyncio

import pytest
from link_parts import HeldClock

from crazychoir.bus.network.arrival_queue import FRAME_READING, ArrivalQueue
from crazychoir.bus.network.link_counters import LinkCounters


class Reading:
    """A queue, and the keys that were read from it; each takes some time."""

    def __init__(self, reading_ns=0):
        self.clock = HeldClock()
        self.counters = LinkCounters()
        self.queue = ArrivalQueue(self.counters, self.clock.now_ns)
        self.reading_ns = reading_ns
        self.read = []

    def take(self, key, data, arrived_ns):
        self.read.append(key)
        self.clock.ns += self.reading_ns

    def add(self, count):
        for k in range(count):
            self.queue.add(self.take, str(k), b"")

    def drain(self):
        """Read for one pass, and return how many were read."""
        before = len(self.read)
        self.queue._drain()
        return len(self.read) - before


@pytest.fixture
async def made():
    """Make a reading; at the end, its queue is emptied."""
    readings = []

    def make(reading_ns=0):
        readings.append(Reading(reading_ns))
        return readings[-1]

    yield make
    for reading in readings:
        reading.queue._waiting.clear()


async def test_arrivals_are_read_in_their_order(made):
    reading = made()
    reading.add(3)
    assert reading.read == []
    await asyncio.sleep(0)
    assert reading.read == ["0", "1", "2"]


async def test_frames_that_take_long_leave_the_loop_to_the_others(made):
    reading = made(FRAME_READING.least_slice_ns)
    reading.add(5)
    reading.drain()
    assert reading.read == ["0", "1"], (
        "the slice ends by its time, before its limit of frames"
    )
    assert FRAME_READING.slice_frames > 5


async def test_a_queue_that_is_behind_is_read_for_as_long_as_other_work_takes(made):
    reading = made(FRAME_READING.least_slice_ns // 2)
    reading.add(200)
    counts = []
    for others_ns in (
        0,
        0,
        5 * FRAME_READING.least_slice_ns,
        1000 * FRAME_READING.least_slice_ns,
    ):
        reading.clock.ns += others_ns
        counts.append(reading.drain())
    assert counts == [
        3,
        3,
        11,
        2 * FRAME_READING.longest_slice_ns // FRAME_READING.least_slice_ns + 1,
    ]


async def test_a_queue_that_was_read_to_its_end_is_not_behind_even_long_after(made):
    reading = made(FRAME_READING.least_slice_ns // 2)
    reading.add(1)
    reading.drain()
    reading.clock.ns += 1000 * FRAME_READING.least_slice_ns
    reading.add(10)
    assert reading.drain() == 3


async def test_the_oldest_arrivals_are_dropped_if_the_loop_hangs(made):
    reading = made()
    reading.add(FRAME_READING.backlog + 2)
    assert reading.counters.overflowed == 2
    reading.drain()
    assert reading.read[0] == "2"


async def test_handlers_that_fail_again_and_again_fill_no_disk(made, caplog):
    reading = made()

    def fails(key, data, arrived_ns):
        raise ValueError(key)

    for _ in range(1000):
        reading.queue.add(fails, "k", b"")
    while reading.queue._waiting:
        reading.drain()
    assert reading.counters.failed == 1000
    assert caplog.text.count("was not taken") == 10


def test_what_arrives_after_the_end_of_the_loop_is_forgotten():
    async def make():
        return Reading()

    reading = asyncio.run(make())
    reading.add(1)
    assert not reading.queue._waiting
