"""Calls into the event loop from other threads."""

import asyncio

from crazychoir.radio.link.loop_caller import LoopCaller, resolve_waiting


async def test_calls_from_a_thread_run_in_the_loop_until_it_is_closed() -> None:
    calls, seen = LoopCaller(asyncio.get_running_loop()), []
    await asyncio.to_thread(calls.call, seen.append, 1)
    calls.close()
    await asyncio.to_thread(calls.call, seen.append, 2)
    await asyncio.to_thread(calls.call_after_close, seen.append, 3)
    await asyncio.sleep(0)
    assert seen == [1, 3]


def test_a_call_into_a_loop_that_has_ended_is_dropped() -> None:
    loop = asyncio.new_event_loop()
    loop.close()
    calls = LoopCaller(loop)
    calls.call(print)
    calls.call_after_close(print)


async def test_a_future_that_was_cancelled_stays_cancelled() -> None:
    waiting = asyncio.get_running_loop().create_future()
    waiting.cancel()
    resolve_waiting(waiting)
    assert waiting.cancelled()
