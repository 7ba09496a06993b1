import asyncio

import pytest
from virtual_time import virtual

from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.shared_ticks import SharedTicks
from crazychoir.runtime.supervisor import Supervisor

RATE = 4.0  # Hz


class Counting(Actor):
    """Notes the times of its ticks; it fails at the third one."""

    name = "counting"
    restart = RESTART_ON_FAILURE

    def __init__(self, ticks, fails=False):
        self.ticks = ticks
        self.fails = fails
        self.times = []

    async def run(self):
        await self.ticks.serve(self.count)

    def count(self):
        self.times.append(self.ticks.clock.now())
        if self.fails and len(self.times) == 3:
            raise ValueError("the third tick")


@virtual
async def test_all_actors_are_called_in_the_order_in_which_they_began(clock):
    ticks = SharedTicks(clock, RATE)
    seen = []
    tasks = [
        asyncio.create_task(ticks.serve(lambda k=k: seen.append((clock.now(), k))))
        for k in range(3)
    ]
    await clock.sleep(0.6)
    for task in tasks:
        task.cancel()
    assert seen == [(when, k) for when in (0.25, 0.5) for k in range(3)]


@virtual
async def test_an_actor_that_begins_later_shares_the_ticks_of_the_others(clock):
    ticks = SharedTicks(clock, RATE)
    actors = [Counting(ticks), Counting(ticks)]
    first = asyncio.create_task(actors[0].run())
    await clock.sleep(0.3)
    second = asyncio.create_task(actors[1].run())
    await clock.sleep(0.5)
    first.cancel()
    second.cancel()
    assert actors[0].times == [0.25, 0.5, 0.75]
    assert actors[1].times == [0.5, 0.75]


@virtual
async def test_an_actor_that_fails_is_started_again_and_the_others_miss_no_tick(clock):
    ticks = SharedTicks(clock, RATE)
    steady = Counting(ticks)
    failing = Counting(ticks, fails=True)
    failures = []
    supervisor = Supervisor(
        clock,
        "drone 0",
        lambda actor, error, again: failures.append((str(error), again)),
    )
    running = asyncio.create_task(supervisor.run([failing, steady]))
    await clock.sleep(1.6)
    supervisor.stop()
    await running
    assert failures == [("the third tick", True)]
    assert failing.times == [0.25, 0.5, 0.75, 1.0, 1.25, 1.5]
    assert steady.times == failing.times


@virtual
async def test_ticks_that_are_missed_are_skipped(clock):
    ticks = SharedTicks(clock, RATE)
    seen = []

    def hang():
        seen.append(clock.now())
        if len(seen) == 1:
            clock._now_ns += 600_000_000

    running = asyncio.create_task(ticks.serve(hang))
    await clock.sleep(1.6)
    running.cancel()
    assert seen == pytest.approx([0.25, 1.0, 1.25, 1.5])


@virtual
async def test_no_alarm_is_left_when_no_actor_is_left(clock):
    ticks = SharedTicks(clock, RATE)
    running = asyncio.create_task(ticks.serve(lambda: None))
    await clock.sleep(0.1)
    running.cancel()
    await asyncio.wait([running])
    assert all(alarm.cancelled() for *_, alarm in clock._heap)
