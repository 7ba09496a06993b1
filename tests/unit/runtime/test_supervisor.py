import asyncio
import contextlib
import logging

import pytest
from virtual_time import virtual

from crazychoir.runtime.actor import (
    NEVER_RESTART,
    RESTART_ON_FAILURE,
    Actor,
    RestartPolicy,
)
from crazychoir.runtime.clock import run_virtual, run_wall
from crazychoir.runtime.supervisor import (
    CLEANING_DEADLINE,
    STOP_DEADLINE,
    Supervisor,
)


class Part(Actor):
    """Writes its life into `diary`; its run is `work`, or waiting for ever."""

    def __init__(
        self, clock, diary, name, work=None, restart=NEVER_RESTART, stopping=0.0
    ):
        self.clock, self.diary, self.name, self.work, self.restart = (
            clock,
            diary,
            name,
            work,
            restart,
        )
        self.stopping = stopping
        self.runs = 0

    async def run(self):
        self.runs += 1
        self.write("runs")
        try:
            await (self.work(self.runs) if self.work else asyncio.Event().wait())
        except asyncio.CancelledError:
            self.write("cancelled")
            raise

    def on_restart(self):
        self.write("restarts")

    async def on_stop(self):
        self.write("stopping")
        if self.stopping:
            await self.clock.sleep(self.stopping)
        self.write("stopped")

    def write(self, event):
        self.diary.append((round(self.clock.now(), 6), self.name, event))


def events(diary, *wanted):
    return [(name, event) for _, name, event in diary if event in wanted]


async def fail(run):
    raise ValueError(f"run {run}")


@virtual
async def test_children_stop_in_reverse_order_one_after_the_other(clock):
    diary, supervisor = [], Supervisor(clock, "drone 3")
    parts = [Part(clock, diary, name, stopping=0.5) for name in "abc"]
    clock.call_at(1_000_000_000, supervisor.stop)
    await supervisor.run(parts)
    assert diary[:3] == [(0.0, name, "runs") for name in "abc"]
    assert [entry for entry in diary if entry[2] in ("cancelled", "stopped")] == [
        (1.0, "c", "cancelled"),
        (1.5, "c", "stopped"),
        (1.5, "b", "cancelled"),
        (2.0, "b", "stopped"),
        (2.0, "a", "cancelled"),
        (2.5, "a", "stopped"),
    ]


@virtual
async def test_cancellation_from_outside_stops_in_order_too(clock):
    diary = []
    parts = [Part(clock, diary, name, stopping=0.5) for name in "abc"]
    running = asyncio.create_task(Supervisor(clock, "drone 3").run(parts))
    await clock.sleep(1.0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert events(diary, "stopped") == [
        ("c", "stopped"),
        ("b", "stopped"),
        ("a", "stopped"),
    ]
    assert clock.now() == 2.5


@virtual
async def test_a_second_cancellation_waits_no_longer(clock):
    diary = []
    parts = [Part(clock, diary, name, stopping=0.5) for name in "abc"]
    running = asyncio.create_task(Supervisor(clock, "drone 3").run(parts))
    await clock.sleep(1.0)
    running.cancel()
    await clock.sleep(0.1)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert clock.now() == pytest.approx(1.1)
    await clock.sleep(1.0)
    assert events(diary, "cancelled") == [
        ("c", "cancelled"),
        ("a", "cancelled"),
        ("b", "cancelled"),
    ]


@virtual
async def test_stopping_runs_even_for_what_was_never_started(clock):
    diary, supervisor = [], Supervisor(clock, "drone 3")
    supervisor.stop()
    await supervisor.run([Part(clock, diary, "a"), Part(clock, diary, "b")])
    assert events(diary, "stopped") == [("b", "stopped"), ("a", "stopped")]
    assert ("b", "runs") not in events(diary, "runs")


@virtual
async def test_it_ends_when_all_have_ended(clock):
    diary = []
    parts = [
        Part(clock, diary, name, work=lambda run, s=s: clock.sleep(s))
        for name, s in [("a", 1.0), ("b", 2.0)]
    ]
    await asyncio.wait_for(timeout=3.0, fut=Supervisor(clock, "drone 3").run(parts))
    assert [entry for entry in diary if entry[2] == "stopped"] == [
        (1.0, "a", "stopped"),
        (2.0, "b", "stopped"),
    ]
    await asyncio.wait_for(timeout=3.0, fut=Supervisor(clock, "drone 3").run([]))
    assert clock.now() == 2.0


@virtual
async def test_a_failing_actor_leaves_the_others_running(clock):
    diary, heard = [], []
    supervisor = Supervisor(clock, "drone 3", lambda *failure: heard.append(failure))
    guidance, pilot = Part(clock, diary, "guidance", fail), Part(clock, diary, "pilot")
    clock.call_at(5_000_000_000, supervisor.stop)
    await supervisor.run([guidance, pilot])
    [(actor, error, again)] = heard
    assert (actor, str(error), again) == (guidance, "run 1", False)
    assert (0.0, "guidance", "stopped") in diary
    assert (5.0, "pilot", "cancelled") in diary


def test_a_failure_is_logged_with_its_place(caplog):
    async def main(clock):
        await Supervisor(clock, "drone 3").run([Part(clock, [], "guidance", fail)])

    run_virtual(main)
    assert "drone 3 guidance failed: run 1" in caplog.text
    assert "in fail" in caplog.text


@virtual
async def test_restarts_back_off_and_are_bounded_in_a_window(clock):
    diary, heard = [], []
    supervisor = Supervisor(
        clock, "drone 3", lambda actor, error, again: heard.append(again)
    )
    part = Part(
        clock, diary, "a", fail, RestartPolicy(limit=3, window=10.0, backoff=0.1)
    )
    await supervisor.run([part])
    assert [when for when, _, event in diary if event == "runs"] == [0.0, 0.1, 0.3, 0.7]
    assert [when for when, _, event in diary if event == "restarts"] == [0.1, 0.3, 0.7]
    assert heard == [True, True, True, False]
    assert [event for _, _, event in diary][-2:] == ["stopping", "stopped"]
    assert len(events(diary, "stopping")) == 1


@virtual
async def test_failures_outside_the_window_are_forgotten(clock):
    async def fail_later(run):
        await clock.sleep(6.0)
        raise ValueError

    diary, supervisor = [], Supervisor(clock, "drone 3")
    clock.call_at(99_000_000_000, supervisor.stop)
    await supervisor.run(
        [
            Part(
                clock,
                diary,
                "a",
                fail_later,
                RestartPolicy(limit=2, window=10.0, backoff=0.5),
            )
        ]
    )
    starts = [when for when, _, event in diary if event == "runs"]
    assert starts[:4] == [
        0.0,
        6.5,
        13.5,
        20.5,
    ]  # of two failures within 10 s the second waits twice as long
    assert len(starts) == 15


@virtual
async def test_on_failure_is_a_restart_and_the_default_is_none(clock):
    async def fail_once(run):
        if run == 1:
            raise ValueError

    for restart, runs in [
        (RESTART_ON_FAILURE, 2),
        (NEVER_RESTART, 1),
        (Actor.restart, 1),
    ]:
        part = Part(clock, [], "a", fail_once, restart)
        await Supervisor(clock, "drone 3").run([part])
        assert part.runs == runs


@virtual
async def test_a_stop_during_the_backoff_is_heeded(clock):
    diary, supervisor = [], Supervisor(clock, "drone 3")
    clock.call_at(1_000_000_000, supervisor.stop)
    await supervisor.run(
        [
            Part(
                clock,
                diary,
                "a",
                fail,
                RestartPolicy(limit=3, window=99.0, backoff=50.0),
            )
        ]
    )
    assert (clock.now(), len(events(diary, "runs")), len(events(diary, "stopped"))) == (
        1.0,
        1,
        1,
    )


@virtual
async def test_an_actor_that_fails_while_it_is_stopped_is_not_started_again(clock):
    async def stumble(run):
        try:
            await clock.sleep(99.0)
        finally:
            raise ValueError("while leaving")

    diary, supervisor = [], Supervisor(clock, "drone 3")
    clock.call_at(1_000_000_000, supervisor.stop)
    await supervisor.run([Part(clock, diary, "a", stumble, RESTART_ON_FAILURE)])
    assert (clock.now(), events(diary, "runs", "restarts")) == (1.0, [("a", "runs")])


@virtual
async def test_a_cancellation_from_inside_is_a_failure_and_not_a_silent_end(clock):
    async def await_a_cancelled_future(run):
        future = asyncio.get_running_loop().create_future()
        future.cancel()
        await future

    heard = []
    supervisor = Supervisor(
        clock, "drone 3", lambda actor, error, again: heard.append((str(error), again))
    )
    await supervisor.run([Part(clock, [], "a", await_a_cancelled_future)])
    assert heard == [("cancelled from inside: CancelledError()", False)]


@virtual
async def test_errors_of_on_restart_and_of_the_listener_stay_inside(clock):
    class Clumsy(Part):
        def on_restart(self):
            raise KeyError("on_restart")

    def listener(actor, error, again):
        heard.append(type(error))
        raise LookupError("listener")

    diary, heard, supervisor = [], [], Supervisor(clock, "drone 3", listener)
    clumsy = Clumsy(clock, diary, "a", fail, RestartPolicy(limit=1))
    other = Part(clock, diary, "b")
    clock.call_at(1_000_000_000, supervisor.stop)
    await supervisor.run([clumsy, other])
    assert heard == [ValueError, KeyError]
    assert (1.0, "b", "cancelled") in diary


def test_on_stop_has_a_deadline_and_its_errors_do_not_stop_other_parts(caplog):
    class Faulty(Part):
        async def on_stop(self):
            raise ValueError("mine")

    async def main(clock):
        supervisor = Supervisor(clock, "drone 3")
        clock.call_at(1_000_000_000, supervisor.stop)
        slow = Part(clock, diary, "slow", stopping=99.0)
        await supervisor.run(
            [Part(clock, diary, "a"), Faulty(clock, diary, "faulty"), slow]
        )
        return clock.now()

    diary = []
    assert run_virtual(main) == 1.0 + STOP_DEADLINE
    assert ("a", "stopped") in events(diary, "stopped")
    assert "drone 3 slow: on_stop failed, or took more than 2 s" in caplog.text
    assert "TimeoutError" in caplog.text
    assert "ValueError: mine" in caplog.text


@pytest.mark.parametrize("slow_end", [0.0, 1.9])
def test_an_on_stop_that_took_too_long_cleans_up_before_the_next_one(caplog, slow_end):
    class Slow(Part):
        async def run(self):
            try:
                await asyncio.Event().wait()
            finally:
                await self.clock.sleep(slow_end)

        async def on_stop(self):
            try:
                await self.clock.sleep(99.0)
            finally:
                await self.clock.sleep(0.4)
                self.write("stopped")
                raise ValueError("mine")

    async def main(clock):
        supervisor = Supervisor(clock, "drone 3")
        clock.call_at(1_000_000_000, supervisor.stop)
        await supervisor.run([Part(clock, diary, "a"), Slow(clock, diary, "slow")])

    diary = []
    run_virtual(main)
    assert events(diary, "stopped") == [("slow", "stopped"), ("a", "stopped")]
    assert "ValueError: mine" in caplog.text
    assert "left behind" not in caplog.text


@virtual
async def test_an_on_stop_deaf_to_cancellation_is_left_behind(clock):
    class Deaf(Part):
        async def on_stop(self):
            while clock.now() < 30.0:
                with contextlib.suppress(asyncio.CancelledError):
                    await clock.sleep(1.0)

    diary, supervisor = [], Supervisor(clock, "drone 3")
    clock.call_at(1_000_000_000, supervisor.stop)
    await supervisor.run([Part(clock, diary, "a"), Deaf(clock, diary, "deaf")])
    assert clock.now() == 1.0 + STOP_DEADLINE + CLEANING_DEADLINE
    assert events(diary, "stopped") == [("a", "stopped")]
    await clock.sleep(30.0)


def test_an_actor_deaf_to_cancellation_is_named_and_left_behind(caplog):
    async def main(clock):
        async def deaf(run):
            while clock.now() < 20.0:
                try:
                    await clock.sleep(1.0)
                except asyncio.CancelledError:
                    continue

        supervisor = Supervisor(clock, "drone 3")
        clock.call_at(1_000_000_000, supervisor.stop)
        await supervisor.run(
            [Part(clock, diary, "a"), Part(clock, diary, "deaf", deaf)]
        )
        ended = clock.now()
        await clock.sleep(30.0)
        return ended

    diary = []
    assert run_virtual(main) == 1.0 + 2 * STOP_DEADLINE + CLEANING_DEADLINE
    assert events(diary, "stopped") == [("deaf", "stopped"), ("a", "stopped")]
    assert "drone 3 deaf: does not stop; left behind" in caplog.text


@virtual
async def test_a_stop_does_not_interrupt_an_on_stop_that_has_begun(clock):
    diary, supervisor = [], Supervisor(clock, "drone 3")
    done = Part(clock, diary, "done", work=lambda run: clock.sleep(1.0), stopping=1.0)
    clock.call_at(1_500_000_000, supervisor.stop)
    await supervisor.run([done, Part(clock, diary, "b")])
    assert [entry for entry in diary if entry[1] == "done"][-1] == (
        2.0,
        "done",
        "stopped",
    )
    assert clock.now() == 2.0


@virtual
async def test_only_cancellation_reaches_a_task_group_around_it(clock):
    diary = []
    async with asyncio.TaskGroup() as group:
        other = group.create_task(clock.sleep(3.0))
        supervisor = Supervisor(clock, "drone 3")
        await supervisor.run(
            [
                Part(clock, diary, "a", fail),
                Part(clock, diary, "b", fail, RESTART_ON_FAILURE),
            ]
        )
    assert not other.cancelled()
    assert clock.now() >= 3.0


def test_tasks_bear_the_names_of_supervisor_and_actor():
    async def main(clock):
        async def look(run):
            names.append(asyncio.current_task().get_name())

        await Supervisor(clock, "drone 3").run([Part(clock, [], "guidance", look)])

    names = []
    run_virtual(main)
    assert names == ["drone 3 guidance"]


def test_in_real_time(caplog):
    async def main(clock):
        def given_up(actor, error, again):
            if not again:
                clock.call_at(clock.now_ns(), supervisor.stop)

        supervisor = Supervisor(clock, "drone 3", given_up)
        await supervisor.run(
            [
                Part(clock, diary, "a"),
                Part(clock, diary, "b", fail, RestartPolicy(2, 9.0, 0.002)),
            ]
        )

    diary = []
    with caplog.at_level(logging.CRITICAL):
        run_wall(main)
    assert events(diary, "runs", "stopped") == [
        ("a", "runs"),
        ("b", "runs"),
        ("b", "runs"),
        ("b", "runs"),
        ("b", "stopped"),
        ("a", "stopped"),
    ]
