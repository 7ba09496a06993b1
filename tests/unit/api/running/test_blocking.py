"""Asynchronous objects for programs without an event loop."""

import asyncio
from contextlib import asynccontextmanager

import pytest

from crazychoir.api.running.blocking import BlockingVerb, LoopThread


class Counter:
    def __init__(self):
        self.count = 0
        self.is_left = False

    async def add(self, n: int = 1) -> int:
        """Add n, and return the sum."""
        await asyncio.sleep(0.0)
        self.count += n
        return self.count


class BlockingCounter:
    def __init__(self, thread):
        self.thread = thread
        self.counterpart = thread.value

    add = BlockingVerb(Counter.add)


def make_thread(counter):
    @asynccontextmanager
    async def enter():
        yield counter
        counter.is_left = True

    return LoopThread(enter)


def test_method_waits_for_its_coroutine_and_keeps_its_documentation():
    thread = make_thread(Counter())
    counter = BlockingCounter(thread)
    assert counter.add() == 1
    assert counter.add(n=4) == 5
    assert BlockingCounter.add.__doc__ == "Add n, and return the sum."
    thread.close()
    assert thread.value.is_left


async def test_method_works_inside_an_event_loop():
    thread = make_thread(Counter())
    assert BlockingCounter(thread).add(2) == 2
    thread.close()


def test_closed_thread_says_so():
    thread = make_thread(Counter())
    thread.close()
    thread.close()
    with pytest.raises(RuntimeError, match="the connection to the swarm is closed"):
        BlockingCounter(thread).add()


def test_error_of_the_context_reaches_the_caller():
    @asynccontextmanager
    async def enter():
        raise ConnectionError("no drone is there")
        yield

    with pytest.raises(ConnectionError, match="no drone is there"):
        LoopThread(enter)
