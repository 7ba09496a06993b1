import asyncio
import gc
import os
import threading
import time
import weakref

import pytest
from virtual_time import virtual

from crazychoir.errors import Deadlock, Livelock
from crazychoir.runtime import clock as clock_module
from crazychoir.runtime.clock import (
    NS_PER_SECOND,
    AlarmPriority,
    Timerfd,
    run_virtual,
    run_wall,
)
from crazychoir.runtime.mailbox import Latest
from crazychoir.runtime.shared_ticks import SharedTicks
from crazychoir.runtime.watchdog import Watchdog

MS = 1_000_000


@virtual
async def test_alarms_go_by_time_priority_drone_and_sequence(clock):
    wanted = [
        (1, AlarmPriority.TIMEOUT, 9),
        (2, AlarmPriority.WORLD, 5),
        (2, AlarmPriority.TICK, -1),
        (2, AlarmPriority.TICK, 3),
        (2, AlarmPriority.TICK, 4),
        (2, AlarmPriority.MESSAGE, 0),
        (3, AlarmPriority.WORLD, 0),
    ]
    seen = []
    for when, priority, drone in [wanted[k] for k in (3, 6, 0, 5, 4, 1, 2)]:
        clock.call_at(
            when * MS,
            seen.append,
            (when, priority, drone),
            priority=priority,
            drone=drone,
        )
    await clock.sleep(0.01)
    assert seen == wanted


@virtual
async def test_equal_alarms_go_in_the_order_of_their_making(clock):
    seen = []
    for k in range(20):
        clock.call_at(MS, seen.append, k)
    await clock.sleep(0.01)
    assert seen == list(range(20))


@virtual
async def test_what_an_alarm_sets_off_is_done_before_the_next_alarm_of_that_instant(
    clock,
):
    seen = []

    async def follow(name):
        await clock.sleep(0.001)
        seen.append(f"{name} wakes")
        await asyncio.gather(asyncio.create_task(step(name)))
        seen.append(f"{name} ends")

    async def step(name):
        seen.append(f"{name} steps")

    await asyncio.gather(follow("a"), follow("b"))
    assert seen == ["a wakes", "a steps", "a ends", "b wakes", "b steps", "b ends"]


@virtual
async def test_a_cancelled_alarm_neither_rings_nor_moves_the_clock(clock):
    seen = []
    clock.call_at(5 * MS, seen.append, "cancelled").cancel()
    await clock.sleep(0.001)
    assert (seen, clock.now_ns()) == ([], MS)


def test_an_hour_takes_no_time():
    async def main(clock):
        await clock.sleep(3600.0)
        return clock.now(), asyncio.get_running_loop().time()

    began = time.perf_counter()
    assert run_virtual(main) == (3600.0, 3600.0)
    assert time.perf_counter() - began < 1.0


def test_a_deadlock_names_each_task_and_what_it_waits_for():
    async def main(clock):
        box = Latest(clock, "drone 3 pose")
        clock.call_at(5 * MS, print, "a cancelled alarm moves no clock").cancel()
        await asyncio.create_task(box.get(), name="drone 3 pilot")

    with pytest.raises(Deadlock) as caught:
        run_virtual(main)
    text = str(caught.value)
    assert "at 0.000000000 s" in text
    assert "drone 3 pilot waits in mailbox.py:" in text
    assert "Mailbox._wait (drone 3 pose)" in text
    assert "test_a_deadlock_names_each_task_and_what_it_waits_for.<locals>.main" in text


def test_passes_without_time_are_a_livelock(monkeypatch):
    monkeypatch.setattr(clock_module, "LIVELOCK_PASSES", 1000)

    async def main(clock):
        await asyncio.create_task(spin(clock), name="drone 1 guidance")

    async def spin(clock):
        while True:
            await clock.sleep(0.0)

    with pytest.raises(
        Livelock, match=r"1000 loop passes at 0\.0.*drone 1 guidance waits in clock\.py"
    ):
        run_virtual(main)


def test_alarms_that_set_themselves_again_at_once_are_a_livelock(monkeypatch):
    monkeypatch.setattr(clock_module, "LIVELOCK_PASSES", 1000)

    async def main(clock):
        def again():
            clock.call_at(clock.now_ns(), again)

        again()
        await clock.sleep(1.0)

    with pytest.raises(Livelock):
        run_virtual(main)


def test_many_passes_with_time_are_no_livelock(monkeypatch):
    monkeypatch.setattr(clock_module, "LIVELOCK_PASSES", 100)

    async def main(clock):
        for _ in range(1000):
            await clock.sleep(1e-9)
        return clock.now_ns()

    assert run_virtual(main) == 1000


@virtual
async def test_executors_run_inline_in_virtual_time(clock):
    here = threading.get_ident()
    loop = asyncio.get_running_loop()
    assert await loop.run_in_executor(None, threading.get_ident) == here
    assert await asyncio.to_thread(threading.get_ident) == here
    assert await clock.compute(threading.get_ident) == here
    with pytest.raises(ZeroDivisionError):
        await asyncio.to_thread(lambda: 1 / 0)
    assert clock.now_ns() == 0


@virtual
async def test_timeouts_of_asyncio_are_in_virtual_time(clock):
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(1.5):
            await clock.sleep(2.0)
    assert clock.now() == 1.5
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(timeout=0.25, fut=asyncio.Event().wait())
    assert clock.now() == 1.75
    _, pending = await asyncio.wait(
        [asyncio.create_task(clock.sleep(9.0))], timeout=0.25
    )
    assert (len(pending), clock.now()) == (1, 2.0)


@virtual
async def test_what_is_done_at_the_very_deadline_is_in_time(clock):
    async with asyncio.timeout(0.5):
        await clock.sleep(0.5)
    assert clock.now() == 0.5


@virtual
async def test_ticks_are_on_a_grid_and_missed_ones_are_skipped(clock):
    await clock.sleep(0.5)
    ticks, seen = clock.ticks(100), []
    async for due in ticks:
        seen.append(((due - NS_PER_SECOND // 2) // MS, clock.now_ns() // MS - 500))
        if len(seen) == 2:
            await clock.sleep(0.035)
        if len(seen) == 5:
            break
    assert seen == [(10, 10), (20, 20), (50, 55), (60, 60), (70, 70)]
    assert ticks.missed == 2


@virtual
async def test_a_late_tick_comes_at_once_with_its_due_time(clock):
    ticks = clock.ticks(100)
    assert (await anext(ticks), clock.now_ns()) == (10 * MS, 10 * MS)
    await clock.sleep(0.013)
    assert (await anext(ticks), clock.now_ns(), ticks.missed) == (20 * MS, 23 * MS, 0)


def test_a_virtual_run_repeats():
    async def main(clock):
        seen = []

        async def actor(i):
            async for due in clock.ticks(50 + 25 * (i % 3), drone=i):
                seen.append((due, i))

        with pytest.raises(TimeoutError):
            await asyncio.wait_for(
                timeout=0.5, fut=asyncio.gather(*(actor(i) for i in (4, 2, 0, 3, 1)))
            )
        return seen

    first = run_virtual(main)
    assert first == run_virtual(main)
    assert first == sorted(first)
    assert len(first) > 100


def test_an_error_of_the_program_comes_out():
    async def main(clock):
        await clock.sleep(1.0)
        raise LookupError("mine")

    with pytest.raises(LookupError, match="mine"):
        run_virtual(main)


# Wall clock ---------------------------------------------------------------------------------------------------


def test_a_sleep_in_real_time_is_never_early():
    async def main(clock):
        async def one(seconds):
            wanted = time.monotonic_ns() + round(seconds * NS_PER_SECOND)
            await clock.sleep(seconds)
            late.append(time.monotonic_ns() - wanted)

        await asyncio.gather(*(one(0.0001 * k) for k in range(60)))
        for k in range(20):
            await one(0.00013 * k)

    late = []
    run_wall(main)
    assert len(late) == 80
    assert min(late) >= 0
    assert min(late) < MS // 2  # asyncio's own sleep is a millisecond late


def test_an_earlier_alarm_is_not_kept_waiting_by_a_later_one():
    async def main(clock):
        later = asyncio.create_task(clock.sleep(5.0))
        await clock.sleep(0.001)
        began = clock.now()
        await clock.sleep(0.005)
        later.cancel()
        return clock.now() - began

    assert 0.005 <= run_wall(main) < 1.0


def test_due_alarms_of_real_time_go_in_the_same_order_as_in_virtual_time(caplog):
    async def main(clock):
        seen, when = [], clock.now_ns()
        for priority, drone in [
            (AlarmPriority.TIMEOUT, 0),
            (AlarmPriority.TICK, 2),
            (AlarmPriority.TICK, 1),
            (AlarmPriority.WORLD, 7),
        ]:
            clock.call_at(
                when, seen.append, (priority, drone), priority=priority, drone=drone
            )
        clock.call_at(when, seen.append, "cancelled").cancel()
        await clock.sleep(0.002)
        return seen

    assert run_wall(main) == [
        (AlarmPriority.WORLD, 7),
        (AlarmPriority.TICK, 1),
        (AlarmPriority.TICK, 2),
        (AlarmPriority.TIMEOUT, 0),
    ]
    assert caplog.text == ""


def test_ticks_in_real_time():
    async def main(clock):
        ticks, seen = clock.ticks(500), []
        began = ticks.due_ns
        async for due in ticks:
            assert clock.now_ns() >= due
            seen.append(due - began)
            if len(seen) == 20:
                return seen, ticks.missed

    seen, missed = run_wall(main)
    assert all(due % (2 * MS) == 0 for due in seen)
    assert seen[-1] == (20 + missed) * 2 * MS


def test_aligned_ticks_are_due_together_whenever_they_began():
    async def main(clock):
        first = clock.ticks(100, aligned=True)
        await clock.sleep(0.0137)
        second = clock.ticks(50, aligned=True)
        await clock.sleep(0.0041)
        third = clock.ticks(20, aligned=True)
        return first, second, third, clock.now_ns()

    first, second, third, now_ns = run_wall(main)
    assert (second.due_ns - first.due_ns) % (10 * MS) == 0
    assert (third.due_ns - first.due_ns) % (10 * MS) == 0
    assert now_ns - 50 * MS < third.due_ns <= now_ns


def test_what_ticks_in_a_flight_wakes_the_process_once(monkeypatch):
    woken = 0
    set_timer = Timerfd.set

    def count(timer, when_ns):
        nonlocal woken
        woken += 1
        set_timer(timer, when_ns)

    async def main(clock):
        async def follow(hz):
            async for _ in clock.ticks(hz, aligned=True):
                pass

        works = [follow(100), follow(50), SharedTicks(clock, 20).serve(lambda: None)]
        for work in works:
            tasks.append(asyncio.create_task(work))
            await clock.sleep(0.0033)
        watchdog = Watchdog(clock)
        watchdog.start()
        try:
            before = woken
            await clock.sleep_until(clock.find_last_tick(100 * MS) + 400 * MS)
            return woken - before
        finally:
            watchdog.stop()
            for task in tasks:
                task.cancel()

    tasks = []
    monkeypatch.setattr(Timerfd, "set", count)
    assert run_wall(main) <= 43  # a hundred times a second, and a few for the start


@pytest.mark.parametrize("run", [run_wall, run_virtual])
def test_an_alarm_that_fails_does_not_stop_the_clock(run, caplog):
    async def main(clock):
        clock.call_at(clock.now_ns(), lambda: 1 / 0)
        clock.soon(lambda: [][0])
        await clock.sleep(0.002)
        return True

    assert run(main)
    assert "ZeroDivisionError" in caplog.text
    assert "IndexError" in caplog.text


def test_computing_in_real_time_is_in_a_thread_and_the_loop_goes_on():
    async def main(clock):
        ticks = 0
        event = threading.Event()
        computing = asyncio.create_task(
            clock.compute(lambda: (event.wait(5.0), threading.get_ident()))
        )
        async for _ in clock.ticks(1000):
            ticks += 1
            if ticks == 5:
                event.set()
                return await computing

    in_time, thread = run_wall(main)
    assert in_time
    assert thread != threading.get_ident()


def test_the_wall_clock_gives_its_descriptor_back():
    async def main(clock):
        await clock.sleep(0.001)

    run_wall(main)
    before = len(os.listdir("/proc/self/fd"))
    run_wall(main)
    assert len(os.listdir("/proc/self/fd")) == before


@virtual
async def test_a_task_that_waits_for_a_tick_can_be_cancelled_and_go_on_with_the_next(
    clock,
):
    seen = []

    async def tick():
        ticks = clock.ticks(10.0)
        try:
            seen.append(await anext(ticks))
            await anext(ticks)
        except asyncio.CancelledError:
            seen.append(clock.now_ns())
            seen.append(await anext(ticks))
            raise

    task = asyncio.create_task(tick())
    await clock.sleep(0.15)
    assert task.cancel()
    await clock.sleep(0.0)
    assert seen == [100 * MS, 150 * MS]
    await asyncio.wait([task])
    assert task.cancelled()
    assert seen == [100 * MS, 150 * MS, 300 * MS]
    assert not clock._heap


def test_alarms_that_are_late_again_and_again_leave_the_loop_to_others():
    async def main(clock):
        ends, passes = clock.now() + 0.1, 0

        def late():
            if clock.now() < ends:
                clock.call_at(1, late)

        late()
        while clock.now() < ends:
            await asyncio.sleep(0)
            passes += 1
        return passes

    assert run_wall(main) > 20


@virtual
async def test_a_task_that_sleeps_can_be_cancelled_at_once(clock):
    seen = []

    async def sleep():
        try:
            await clock.sleep(10.0)
        finally:
            seen.append(clock.now_ns())

    task = asyncio.create_task(sleep())
    await clock.sleep(0.15)
    assert task.cancel("why")
    await clock.sleep(1.0)
    assert task.cancelled()
    assert seen == [150 * MS]
    with pytest.raises(asyncio.CancelledError, match="why"):
        await task


@pytest.mark.parametrize("run", [run_wall, run_virtual])
def test_a_sleep_that_is_over_leaves_nothing_for_the_garbage_collector(run):
    async def main(clock):
        gc.collect()
        gc.disable()
        try:
            for _ in range(100):
                await clock.sleep(1e-6)
            return gc.collect()
        finally:
            gc.enable()

    assert run(main) < 100


@virtual
async def test_a_cancelled_alarm_keeps_nothing_alive(clock):
    class Large:
        pass

    large = Large()
    known = weakref.ref(large)
    alarm = clock.call_at(10**15, print, large)
    task = asyncio.create_task(_sleep_with(large, clock))
    await clock.sleep(0.1)
    alarm.cancel()
    task.cancel()
    await asyncio.wait([task])
    del large, task
    await clock.sleep(0.1)
    gc.collect()
    assert known() is None


async def _sleep_with(thing, clock):
    await clock.sleep(1e6)
    return thing


def test_after_the_exit_of_a_task_the_other_alarms_of_that_instant_still_run():
    seen = []

    async def leave(clock, due_ns):
        await clock.sleep_until(due_ns)
        raise SystemExit(3)

    async def main(clock):
        due_ns = clock.now_ns() + 5 * MS
        clock.call_at(due_ns, seen.append, "ran", priority=AlarmPriority.TIMEOUT)
        leaving = asyncio.create_task(leave(clock, due_ns))
        try:
            await clock.sleep(1.0)
        finally:
            await asyncio.wait([leaving])
            await asyncio.sleep(0.02)

    with pytest.raises(SystemExit):
        run_wall(main)
    assert seen == ["ran"]


@pytest.mark.real_time
def test_a_call_about_a_time_is_never_early_and_may_be_cancelled():
    async def main(clock):
        came = []
        due_ns = clock.now_ns() + 5_300_000
        clock.call_about(due_ns, lambda: came.append(clock.now_ns()))
        clock.call_about(due_ns, lambda: came.append(0)).cancel()
        await asyncio.sleep(0.1)
        return came, due_ns

    came, due_ns = run_wall(main)
    assert len(came) == 1
    assert came[0] >= due_ns
