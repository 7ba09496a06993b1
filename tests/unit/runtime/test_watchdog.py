import asyncio
import dataclasses
import signal
import subprocess
import sys
import threading
import time
from itertools import pairwise

import pytest

from crazychoir.errors import Hung
from crazychoir.runtime import watchdog as watchdog_module
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_wall
from crazychoir.runtime.watchdog import InterruptGuard, Stall, Watchdog

pytestmark = pytest.mark.real_time


@pytest.fixture
def quick(monkeypatch):
    """The watchdog of these tests has less patience."""
    monkeypatch.setattr(
        watchdog_module,
        "WATCHDOG_TIMES",
        dataclasses.replace(
            watchdog_module.WATCHDOG_TIMES,
            report_delay=0.05,
            hand_over_delay=0.10,
            interrupt_limit=0.20,
        ),
    )


def watched(work, on_stall=lambda stall: None):
    """Run `work(watchdog)` as the guidance of drone 3; returns the watchdog."""

    async def main(clock):
        dog = Watchdog(clock, on_stall)
        dog.start()
        await clock.sleep(0.05)
        try:
            await asyncio.create_task(work(dog), name="drone 3 guidance")
            await clock.sleep(0.05)
        finally:
            dog.stop()
        return dog

    return run_wall(main)


def keep_the_loop(seconds):
    ends = time.perf_counter() + seconds
    while time.perf_counter() < ends:
        pass


def forever():
    while True:
        pass


def test_a_blocked_loop_is_reported_with_actor_and_place():
    async def work(dog):
        keep_the_loop(0.7)

    stalls = []
    dog = watched(work, stalls.append)
    assert dog.stalls == 1
    assert [stall.actor for stall in stalls] == ["drone 3 guidance"] * 2
    assert all(
        "test_watchdog.py" in stall.place and "keep_the_loop" in stall.place
        for stall in stalls
    )
    assert 0.1 <= stalls[0].seconds < 0.3 <= stalls[1].seconds < 0.6
    assert 0.3 <= dog.worst < 1.0


def test_each_stall_counts_and_a_short_one_does_not():
    async def work(dog):
        for seconds in (0.03, 0.2, 0.03, 0.2):
            keep_the_loop(seconds)
            await dog.clock.sleep(0.06)

    assert watched(work).stalls == 2


def test_a_long_stall_is_reported_whenever_it_has_doubled(quick):
    async def work(dog):
        keep_the_loop(0.7)

    stalls = []
    watched(work, stalls.append)
    assert 3 <= len(stalls) <= 5
    seconds = [stall.seconds for stall in stalls]
    assert all(
        late >= limit for late, limit in zip(seconds, (0.05, 0.1, 0.2), strict=False)
    )
    assert all(later >= 2 * late for late, later in pairwise(seconds[2:]))


def test_a_stall_reads_well():
    assert str(Stall(0.314, "drone 3 guidance", "mine.py:7 step")) == (
        "drone 3 guidance keeps the event loop for 0.31 s, in mine.py:7 step"
    )


def test_a_stall_without_an_actor_says_that_the_machine_may_be_busy():
    assert str(Stall(0.124, "", "clock.py:7 _fire")) == (
        "the event loop was not served for 0.12 s (machine busy?), at clock.py:7 _fire"
    )


def unserved(*seconds):
    """What is reported while the loop is kept, so often and so long, by no task: an alarm of the clock does it."""

    async def main(clock):
        dog = Watchdog(clock, stalls.append)
        dog.start()
        for each in seconds:
            await clock.sleep(0.1)
            clock.call_at(clock.now_ns(), keep_the_loop, each)
        await clock.sleep(0.1)
        dog.stop()
        return dog.stalls

    stalls = []
    assert run_wall(main) == len(seconds), "each is counted"
    return stalls


def test_an_unattributed_short_stall_is_reported_only_once_in_a_while(monkeypatch):
    stalls = unserved(0.2, 0.2, 0.2)
    assert [stall.actor for stall in stalls] == [""]
    assert "keep_the_loop" in stalls[0].place
    monkeypatch.setattr(
        watchdog_module,
        "WATCHDOG_TIMES",
        dataclasses.replace(watchdog_module.WATCHDOG_TIMES, quiet_time=0.0),
    )
    assert len(unserved(0.2, 0.2, 0.2)) == 3


def test_a_long_unattributed_stall_is_reported_each_time():
    stalls = unserved(0.2, 0.5, 0.5)
    assert [
        stall.seconds >= watchdog_module.WATCHDOG_TIMES.hand_over_delay
        for stall in stalls
    ] == [
        False,
        True,
        True,
    ]


def test_an_actor_that_blocks_the_loop_briefly_is_counted_and_named_now_and_then(
    monkeypatch,
):
    async def work(dog):
        for seconds in (0.15, 0.15, 0.15, 0.5):
            keep_the_loop(seconds)
            await dog.clock.sleep(0.06)

    stalls = []
    dog = watched(work, stalls.append)
    assert dog.stalls == 4, "each is counted"
    assert [stall.actor for stall in stalls] == ["drone 3 guidance"] * 2
    short, long = stalls
    assert (
        short.more,
        long.seconds >= watchdog_module.WATCHDOG_TIMES.hand_over_delay,
    ) == (0, True)
    assert str(long).endswith("(2 more since it was said last)")
    monkeypatch.setattr(
        watchdog_module,
        "WATCHDOG_TIMES",
        dataclasses.replace(watchdog_module.WATCHDOG_TIMES, quiet_time=0.0),
    )
    stalls.clear()
    watched(work, stalls.append)
    assert len(stalls) == 5


def test_a_listener_that_fails_does_not_end_the_watch(quick, caplog):
    async def work(dog):
        keep_the_loop(0.2)
        await dog.clock.sleep(0.1)
        keep_the_loop(0.2)

    assert watched(work, lambda stall: 1 / 0).stalls == 2
    assert "ZeroDivisionError" in caplog.text


def test_guarded_code_that_does_not_end_is_interrupted(quick):
    async def work(dog):
        began = time.perf_counter()
        with pytest.raises(Hung), dog.guard("drone 3 guidance"):
            forever()
        lasted.append(time.perf_counter() - began)

    lasted = []
    watched(work)
    assert 0.2 <= lasted[0] < 1.0


def test_guarded_code_that_swallows_its_interruption_gets_it_again(quick):
    async def work(dog):
        with pytest.raises(Hung), dog.guard("drone 3 guidance"):
            stubborn()

    def stubborn():
        for _ in range(2):
            try:
                forever()
            except Hung as hung:
                swallowed.append(hung)
        forever()

    swallowed = []
    watched(work)
    assert len(swallowed) == 2


def test_unguarded_code_is_never_interrupted(quick):
    async def work(dog):
        keep_the_loop(0.3)
        with dog.guard("drone 3 guidance"):
            pass
        keep_the_loop(0.3)

    assert watched(work).stalls == 1


def test_a_guarded_section_is_not_blamed_for_an_earlier_stall(quick):
    async def work(dog):
        keep_the_loop(0.3)
        with dog.guard("drone 3 guidance"):
            keep_the_loop(0.1)

    assert watched(work).stalls == 1


def test_a_guard_left_over_an_await_is_void(quick):
    async def work(dog):
        with dog.guard("drone 3 guidance"):
            await dog.clock.sleep(0.06)
            keep_the_loop(0.3)

    assert watched(work).stalls == 1


CHILD = """
import asyncio, dataclasses, time
from crazychoir.runtime import watchdog
from crazychoir.runtime.clock import run_wall

watchdog.WATCHDOG_TIMES = dataclasses.replace(
    watchdog.WATCHDOG_TIMES, interrupt_limit=1.5, frozen_gap=0.5, give_up_delay=1.6
)

def burn(seconds):
    ends = time.process_time() + seconds
    while time.process_time() < ends:
        pass

async def main(clock):
    dog = watchdog.Watchdog(clock)
    dog.start()
    print("ready", flush=True)
    with dog.guard("drone 3 guidance"):
        burn(0.4)
    {then}
    dog.stop()

run_wall(main)
print("done", flush=True)
"""


def child(then=""):
    program = [sys.executable, "-c", CHILD.format(then=then)]
    process = subprocess.Popen(
        program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    return process


def test_a_process_that_stood_still_is_not_to_blame():
    with child() as process:
        time.sleep(0.1)
        process.send_signal(signal.SIGSTOP)
        time.sleep(1.8)
        process.send_signal(signal.SIGCONT)
        out, err = process.communicate(timeout=30)
    assert (out, process.returncode) == ("done\n", 0), err


def test_a_process_with_a_loop_that_hangs_for_good_ends_itself_and_says_where():
    with child(then="burn(99.0)") as process:
        out, err = process.communicate(timeout=30)
    assert (out, process.returncode) == ("", watchdog_module.EXIT_CODE)
    assert "in burn" in err


def test_the_thread_ends():
    async def work(dog):
        threads.append(dog._thread)

    threads = []
    watched(work)
    threads[0].join(1.0)
    assert not threads[0].is_alive()


class Stopwatch(Clock):
    def now_ns(self):
        return time.monotonic_ns()


def test_hung_never_lands_outside_the_guard(monkeypatch):
    """Another thread interrupts whenever it may; the regions are so short that it often comes too late."""
    monkeypatch.setattr(
        watchdog_module,
        "WATCHDOG_TIMES",
        dataclasses.replace(watchdog_module.WATCHDOG_TIMES, interrupt_limit=5e-5),
    )
    guard, here, ending = (
        InterruptGuard(Stopwatch()),
        threading.get_ident(),
        threading.Event(),
    )

    def interrupt():
        while not ending.is_set():
            guard.interrupt(here)

    inside = outside = passes = 0
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    ends = time.monotonic_ns() + 20 * NS_PER_SECOND
    while inside < 300 and time.monotonic_ns() < ends:
        try:
            try:
                with guard:
                    for _ in range(passes % 60 * 40):
                        pass
            except Hung:
                inside += 1
            guard.since_ns = 0  # as the next beat of the loop does
            for _ in range(60):
                pass
            passes += 1
        except Hung:
            outside += 1
    ending.set()
    thread.join()
    sys.setswitchinterval(interval)
    assert outside == 0
    assert inside > 100, "enough for one to have landed outside"
    assert passes > inside
