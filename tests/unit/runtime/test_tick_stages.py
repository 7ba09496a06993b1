"""Stages: all drones do the first thing before any drone does the second."""

import asyncio

import pytest
from virtual_time import virtual

from crazychoir.runtime.tick_stages import TickStages


@virtual
async def test_stages_come_one_after_the_other_in_whatever_order_they_were_added(clock):
    stages, done = TickStages(clock), []
    for drone in (1, 2):
        stages.act.append(lambda drone=drone: done.append(("act", drone)))
        stages.say.append(lambda drone=drone: done.append(("say", drone)))
        stages.due()
    await asyncio.sleep(0)
    assert done == [("say", 1), ("say", 2), ("act", 1), ("act", 2)]


@virtual
async def test_what_a_stage_adds_is_done_in_the_same_pass_and_once(clock):
    stages, done = TickStages(clock), []

    def say():
        done.append("say")
        stages.decide.append(lambda: done.append("decide"))

    stages.act.append(lambda: done.append("act"))
    stages.say.append(say)
    stages.run()
    assert done == ["say", "decide", "act"]
    await clock.sleep(0.01)
    assert done == ["say", "decide", "act"]


@virtual
async def test_what_is_added_to_a_stage_that_is_over_is_done_in_the_next_pass(clock):
    stages, done = TickStages(clock), []

    def act():
        stages.say.append(lambda: done.append(clock.now()))
        stages.due()

    stages.act.append(act)
    stages.due()
    await clock.sleep(0.01)
    assert done == [0.0]


@virtual
async def test_an_error_in_one_stage_does_not_skip_the_others_and_is_raised(clock):
    stages, done = TickStages(clock), []

    def fails(what):
        raise ValueError(what)

    stages.decide += [
        lambda: fails("first"),
        lambda: done.append("decide"),
        lambda: fails("second"),
    ]
    stages.act.append(lambda: done.append("act"))
    with pytest.raises(ValueError, match="first"):
        stages.run()
    assert done == ["decide", "act"]
    stages.run()
    assert done == ["decide", "act"]
