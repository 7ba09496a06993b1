"""A forgotten `await` is named with its call; and no reason is ever empty."""

import asyncio
import inspect
from types import SimpleNamespace

import pytest
from pilots import make_stand_in

from crazychoir.agent.agent import Agent
from crazychoir.agent.mission_result import result_of_failure, result_of_operator_end
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import (
    AgentFailed,
    CrazyChoirError,
    Refused,
    error_text,
    reason_or,
)
from crazychoir.guidance.awaited_call import (
    MOST_REMEMBERED_CALLS,
    GuidanceCall,
    UnawaitedCalls,
    describe_forgotten_calls,
)
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.member import UNNOTED_REASONS, Interrupted, describe_state
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.runtime.clock import run_virtual
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import FullState

BRISK = {
    "takeoff_height": 0.3,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
}
PATH = PointToPoint(FullState.at([0.0, 0.0, 0.3]), [0.5, 0.0, 0.3], 0.0, 3.0)
CALLS = {
    "take_off": (0.3,),
    "go_to": ([0.1, 0.0, 0.3],),
    "fly": (PATH,),
    "land": (),
    "sleep": (0.1,),
    "rendezvous": (),
    "wait_for_start": (),
    "optimize": (SimpleNamespace(done=True),),
    "send": (1,),
    "receive": (),
    "asynchronous_receive": (),
    "neighbors_exchange": (1,),
}
"""Every verb of the mission API that is awaited, and what it is given."""


class Does(CFGuidance):
    """A mission that is one coroutine function of the test."""

    def __init__(self, does):
        self.does = does

    async def helper(self):
        """A coroutine function of a user."""
        return 7

    async def mission(self):
        return await self.does(self)

    async def added(self, x):
        """A coroutine function of a user with an argument."""
        return 7 + x


def result_of(does, drones=1, meanwhile=None):
    async def main(clock):
        mission = SimpleNamespace(guidance=lambda i, config: Does(does))
        agent = Agent(
            clock,
            default_swarm(drones).replace(flight=BRISK),
            mission,
            tuple(range(drones)),
        )
        if meanwhile is not None:
            meanwhile(agent, clock)
        async with asyncio.timeout(300.0):
            return (await agent.run())[0]

    return run_virtual(main)


def test_every_coroutine_function_of_the_mission_api_is_among_those_tried():
    public = {name for name in dir(CFGuidance) if not name.startswith("_")}
    functions = {
        name: inspect.unwrap(getattr(CFGuidance, name))
        for name in public
        if callable(getattr(CFGuidance, name))
    }
    coroutines = {
        name
        for name, function in functions.items()
        if inspect.iscoroutinefunction(function)
    }
    assert coroutines - {"mission", "asked"} == {*CALLS}


@pytest.mark.parametrize("verb", [*CALLS, "helper"])
@pytest.mark.parametrize("flies", [False, True])
def test_a_forgotten_await_is_named_with_its_line(verb, flies):
    async def forgets(guidance):
        if flies:
            await guidance.take_off()
        getattr(guidance, verb)(*CALLS.get(verb, ()))
        line.append(inspect.currentframe().f_lineno - 1)
        await guidance.sleep(0.1)
        if flies:
            await guidance.land()

    line = []
    result = result_of(forgets)
    assert not result["success"]
    words = f"{__file__}:{line[0]}: self.{verb}(...) was called without await, so it did nothing: write `await self.{verb}"  # noqa: E501
    assert words in result["reason"]


def test_a_take_off_without_await_is_the_reason_of_what_fails_after_it():
    async def forgets(guidance):
        guidance.take_off(0.3)
        await guidance.go_to([0.1, 0.0, 0.3])

    reason = result_of(forgets)["reason"]
    assert "self.take_off(...) was called without await" in reason
    assert "drone 0: on ground: it has not taken off" in reason


def test_a_call_that_is_kept_and_never_awaited_is_named_too():
    async def keeps(guidance):
        await guidance.take_off()
        guidance.kept = guidance.land()

    assert "self.land(...) was called without await" in result_of(keeps)["reason"]


def test_whatever_awaits_or_ends_a_call_on_purpose_is_no_mistake():
    async def careful(guidance):
        await guidance.take_off()
        await asyncio.gather(guidance.sleep(0.1), guidance.helper())
        await asyncio.wait_for(guidance.sleep(0.1), 1.0)
        task = asyncio.create_task(guidance.sleep(60.0))
        future = asyncio.ensure_future(guidance.helper())
        async with asyncio.TaskGroup() as group:
            group.create_task(guidance.sleep(0.1))
        begun_late = asyncio.create_task(guidance.sleep(60.0))
        begun_late.cancel()
        guidance.sleep(1.0).close()
        assert await future == 7
        task.cancel()
        await guidance.land()

    assert result_of(careful) == {"success": True}


async def one():
    return 1


def test_a_guidance_call_counts_as_a_coroutine():
    calls = UnawaitedCalls()
    call = GuidanceCall(one(), "one", "a.py:3", calls)
    assert asyncio.iscoroutine(call)
    assert "one at a.py:3" in repr(call)
    assert len(calls.waiting) == 1
    assert asyncio.run(call) == 1
    assert not calls.waiting


def test_a_wrong_argument_is_an_error_of_the_line_that_gives_it():
    async def wrong(guidance):
        await guidance.sleep()

    assert "TypeError" in result_of(wrong)["reason"]


def test_calls_that_an_error_leaves_over_are_not_forgotten():
    async def fails(guidance):
        legs = [guidance.take_off(), guidance.sleep(0.1), guidance.land()]
        for leg in legs:
            await leg
            raise ValueError("out of paint")

    reason = result_of(fails)["reason"]
    assert "out of paint" in reason
    assert "without await" not in reason


async def waits_by_a_list(guidance):
    legs = [guidance.take_off(), guidance.sleep(30.0), guidance.land()]
    for leg in legs:
        await leg


ON_ONE_LINE = """
async def waits_on_one_line(guidance):
    for leg in (guidance.take_off(), guidance.sleep(30.0), guidance.land()): await leg
"""
"""A program that the formatter would lay out on two lines."""


def waits_on_one_line(guidance):
    program = compile(ON_ONE_LINE, __file__, "exec")
    found = {}
    exec(program, found)  # noqa: S102
    return found["waits_on_one_line"](guidance)


@pytest.mark.parametrize("waits", [waits_by_a_list, waits_on_one_line])
def test_operator_landing_that_leaves_calls_over_is_no_failure(waits):
    def land(agent, clock):
        def abort():
            agent.drones[0].pilot.land("landed on command")
            agent.runners[0].abort("landed on command", by_operator=True)

        clock.call_at(8_000_000_000, abort)

    result = result_of(waits, meanwhile=land)
    assert result["success"], result
    assert result["ended"] == "landed on command"


def test_error_is_named_before_calls_without_await():
    async def fails(guidance):
        guidance.sleep(0.1)
        raise ValueError("out of paint")

    reason = result_of(fails)["reason"]
    assert reason.index("out of paint") < reason.index("without await")


def test_few_of_many_forgotten_calls_are_kept():
    async def forgets(guidance):
        for _ in range(300):
            guidance.sleep(0.1)
        calls = guidance.__dict__["_unawaited"]
        assert len(calls.waiting) == 0
        assert len(calls.dropped) == 1

    assert result_of(forgets)["reason"].count("without await") == 1
    guidance = Does(None)
    calls = guidance.__dict__["_unawaited"] = UnawaitedCalls()
    for k in range(3 * MOST_REMEMBERED_CALLS):
        calls.throw_away((f"a.py:{k}", "sleep"), f"a.py:{k}")
    assert len(calls.dropped) == MOST_REMEMBERED_CALLS
    assert (
        f"and {2 * MOST_REMEMBERED_CALLS} more calls without await"
        in describe_forgotten_calls(guidance, False)
    )


def test_coroutine_function_takes_its_guidance_by_name():
    async def named(guidance):
        assert await type(guidance).added(self=guidance, x=1) == 8

    assert result_of(named) == {"success": True}


@pytest.mark.skipif(
    not hasattr(inspect, "markcoroutinefunction"), reason="Python 3.12 or newer"
)
def test_verbs_are_coroutine_functions_for_inspect():
    guidance = Does(None)
    for verb in (guidance.go_to, guidance.send, guidance.added):
        assert inspect.iscoroutinefunction(verb)


# Reasons -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "empty", ["", " ", "\n", None, "drone 0: on ground: ", "drone 0:"]
)
def test_no_outcome_and_no_error_has_an_empty_reason(empty):
    outcomes = [
        result_of_failure(empty)["reason"],
        reason_or(empty, "it is not known"),
        str(Refused("drone 0", empty)),
    ]
    outcomes += [
        Refused("drone 0", empty).reason,
        AgentFailed(1, empty).reason,
        str(AgentFailed(1, empty)),
    ]
    outcomes += [
        str(Interrupted(empty or "")),
        str(CrazyChoirError(empty or "")),
        str(CrazyChoirError()),
    ]
    for text in outcomes:
        assert text.strip()
        assert not text.strip().endswith(":"), text


def test_a_reason_that_is_there_stays_as_it_is():
    assert result_of_failure("lost")["reason"] == "lost"
    assert str(Interrupted("drone 0: landing")) == "drone 0: landing"
    assert result_of_operator_end("landed on command")["reason"] == "landed on command"


@pytest.mark.parametrize("mode", Mode)
def test_what_a_drone_does_has_a_reason_in_every_mode(mode):
    pilot = make_stand_in({"mode": mode, "notes.text": ""})
    assert describe_state(pilot) == f"{mode.value}: {UNNOTED_REASONS[mode]}"
    pilot.notes.text = "pose"
    assert describe_state(pilot) == f"{mode.value}: pose"


def test_a_mission_that_raises_an_error_without_words_has_a_reason():
    async def says_nothing(guidance):
        raise CrazyChoirError

    async def fails(guidance):
        return {"success": False, "reason": ""}

    for does in (says_nothing, fails):
        assert len(result_of(does)["reason"]) > 10


def test_an_error_with_a_text_that_fails_is_named():
    class Broken(ValueError):
        def __str__(self):
            raise RuntimeError("no text")

    assert error_text(Broken()) == "Broken: its text cannot be written"


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (TimeoutError(), "TimeoutError: a time limit has passed"),
        (asyncio.CancelledError(), "CancelledError: it was cancelled"),
        (AssertionError(), "AssertionError: an assert does not hold"),
        (ValueError(), "ValueError: raised without a text"),
        (ValueError("out of paint"), "ValueError: out of paint"),
    ],
)
def test_error_without_words_says_what_it_means(error, words):
    assert error_text(error).startswith(words)


def test_mission_that_runs_into_its_own_time_limit_says_so():
    async def hurries(guidance):
        async with asyncio.timeout(0.2):
            await guidance.sleep(5.0)

    reason = result_of(hurries)["reason"]
    assert "TimeoutError: a time limit has passed, as of asyncio.timeout" in reason
