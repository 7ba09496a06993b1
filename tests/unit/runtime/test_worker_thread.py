"""A function that ends in a loop run is called where a loop runs already: in a notebook, a coroutine, a mission."""

import asyncio
import contextvars
import os
import signal
import threading
import time
from types import SimpleNamespace

import pytest
import uvloop

from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import Hung
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.launch.flight import fly_fast
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.rounds.mixing import team
from crazychoir.routing.instance.generate import random_instance
from crazychoir.runtime.clock import run_virtual, run_wall
from crazychoir.runtime.user_code_guard import HangWatch
from crazychoir.solve.simulate import SimulationInterrupted, simulate
from crazychoir.solve.solving import solve_here
from crazychoir.solve.team import solve_in_processes
from crazychoir.team.graph import ring

NOTE = contextvars.ContextVar("note", default="nothing")


def average():
    """The bytes of a short consensus at 30 % loss: its digest."""
    graph = ring(4)
    agents = team(graph, lambda i, weights: Consensus(i, [i, 0.5 * i**2], weights, 12))
    return simulate(agents, graph, loss=0.3, seed=5).of().tobytes()


def average_in_real_time():
    graph = ring(3)
    agents = team(graph, lambda i, weights: Consensus(i, [float(i)], weights, 3))
    return simulate(agents, graph, run=run_wall).of().tobytes()


class Rising(CFGuidance):
    """Takes off and lands."""

    async def mission(self):
        await self.take_off(0.3)
        await self.land()
        return {"note": NOTE.get()}


def flight():
    return fly_fast(
        default_swarm(2), SimpleNamespace(guidance=lambda i, config: Rising())
    )["digest"]


def plan():
    return solve_here(random_instance(2, 3, seed=1))["plan_digest"]


@pytest.fixture(autouse=True)
def handler_of_ctrl_c():
    """The handler that Python begins with, whatever other tests have left."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(
        signal.SIGINT, before if before is not None else signal.default_int_handler
    )


def inside(loop_factory, function):
    """The function's value inside a coroutine, twice in a row."""

    async def cell():
        return [function(), function()]

    with asyncio.Runner(loop_factory=loop_factory) as runner:
        return runner.run(cell())


@pytest.mark.parametrize(
    "loop_factory",
    [asyncio.new_event_loop, uvloop.new_event_loop],
    ids=["asyncio", "uvloop"],
)
@pytest.mark.parametrize(
    "function", [average, average_in_real_time, flight, plan], ids=lambda f: f.__name__
)
def test_a_call_inside_a_running_loop_gives_the_same_as_outside(loop_factory, function):
    outside = function()
    assert inside(loop_factory, function) == [outside, outside]


def test_a_call_inside_a_loop_of_another_thread_gives_the_same():
    found = []
    thread = threading.Thread(
        target=lambda: found.extend(inside(asyncio.new_event_loop, average))
    )
    thread.start()
    thread.join()
    assert found == [average()] * 2


def test_a_mission_may_simulate_and_solve_and_a_simulated_agent_may_too():
    seen = []

    class Planning(Rising):
        async def mission(self):
            seen.append(average())
            return await super().mission()

    class Nesting(Consensus):
        def step(self, heard):
            seen.append(average())
            super().step(heard)

    graph = ring(2)

    async def cell():
        fly_fast(
            default_swarm(1), SimpleNamespace(guidance=lambda i, config: Planning())
        )
        simulate(team(graph, lambda i, weights: Nesting(i, [1.0], weights, 1)), graph)

    asyncio.run(cell())
    assert seen == [average()] * 3


def test_solve_in_processes_works_inside_a_loop():
    async def cell():
        return solve_in_processes(random_instance(2, 2, seed=1), 1)["feasible"]

    assert asyncio.run(cell())


def test_errors_and_the_context_of_the_caller_pass():
    async def main(clock):
        raise ZeroDivisionError(NOTE.get())

    async def cell():
        NOTE.set("of the cell")
        run_virtual(main)

    with pytest.raises(ZeroDivisionError, match="of the cell"):
        asyncio.run(cell())


def endless(seen):
    """A simulation that never ends by itself."""
    graph = ring(3)
    agents = team(graph, lambda i, weights: Consensus(i, [float(i)], weights, None))

    def watch(agents):
        seen.append(threading.get_ident())
        time.sleep(0.002)  # so that it does not keep too much

    return simulate(agents, graph, watch=watch)


def ctrl_c_when(condition):
    """Send SIGINT to this process as soon as the condition holds."""

    def send():
        while not condition():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=send, daemon=True).start()


def has_ended(thread_name):
    return all(thread.name != thread_name for thread in threading.enumerate())


@pytest.mark.parametrize("handler", ["of asyncio.run", "of a kernel"])
def test_ctrl_c_ends_the_worker_and_gives_the_history_until_then(handler):
    seen, histories = [], []

    async def cell():
        if handler == "of a kernel":
            signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            endless(seen)
        except SimulationInterrupted as end:
            histories.append(end.history)
            raise

    ctrl_c_when(lambda: len(seen) > 9)
    with pytest.raises(KeyboardInterrupt):
        asyncio.run(cell())
    assert histories[0].rounds >= 2
    assert threading.get_ident() not in seen
    assert has_ended("event loop")


def test_ctrl_c_ends_a_step_that_computes_without_end():
    seen = []

    class Stuck(Consensus):
        def step(self, heard):
            while True:
                seen.append(0)
                time.sleep(0.01)

    async def cell():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        graph = ring(2)
        simulate(team(graph, lambda i, weights: Stuck(i, [1.0], weights, 3)), graph)

    ctrl_c_when(lambda: seen)
    with pytest.raises(KeyboardInterrupt):
        asyncio.run(cell())
    assert has_ended("event loop")


def test_ctrl_c_ends_a_simulation_inside_a_simulation():
    seen = []

    class Nesting(Consensus):
        def step(self, heard):
            endless(seen)

    async def cell():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        graph = ring(2)
        simulate(team(graph, lambda i, weights: Nesting(i, [1.0], weights, 3)), graph)

    ctrl_c_when(lambda: len(seen) > 3)
    with pytest.raises(KeyboardInterrupt):
        asyncio.run(cell())
    assert has_ended("event loop")


def test_a_watchdog_that_interrupts_the_waiting_code_ends_the_worker():
    async def cell():
        with HangWatch() as watch, watch.within(0.3, "a mission"):
            endless([])

    with pytest.raises(Hung):
        asyncio.run(cell())
    assert has_ended("event loop")


def test_real_time_in_a_thread_leaves_signals_alone():
    """The processes of a flight obey signals in the main thread; elsewhere Python allows no handler."""
    from crazychoir.runtime.worker_thread import add_signal_handler

    before = signal.getsignal(signal.SIGTERM)

    async def main(clock):
        add_signal_handler(signal.SIGTERM, print)
        return 7

    async def cell():
        return run_wall(main)

    assert asyncio.run(cell()) == 7
    assert signal.getsignal(signal.SIGTERM) is before
