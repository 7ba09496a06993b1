"""A law that fails while it is flown ends alone, and only once."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest
from pilots import make_stand_in
from virtual_time import virtual

from crazychoir.filters.velocity import VelocityFilter
from crazychoir.guidance.member import Interrupted
from crazychoir.guidance.running_law import RunningLaw
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Acceleration, State


def running_law(clock, follow=lambda reference: True):
    """Return the law of drone 2, which hears drones 5 and 7."""
    pilot = make_stand_in(
        {
            "mode": Mode.FOLLOW,
            "notes.text": "landing: reference too old",
            "follower.explain_unflown": lambda reference: "too large",
            "follow": follow,
            "row.index": 0,
            "setup.period_ns": 10_000_000,
            "stages.filter": VelocityFilter(),
        }
    )
    mocap = SimpleNamespace(rate=100.0)
    config = SimpleNamespace(mocap=mocap)
    member = SimpleNamespace(
        id=2, clock=clock, pilot=pilot, config=config, watchdog=None
    )
    law = SimpleNamespace(rate=50.0, paired=False)
    return RunningLaw(law, member, (5, 7))


@virtual
async def test_the_first_error_ends_the_law(clock):
    law = running_law(clock)
    assert not law.fail(ValueError("before it runs"))
    ended = law.start(clock.now_ns())
    assert law.rows["is_running"] == 1
    assert law.fail(ValueError("first"))
    assert not law.fail(ValueError("second"))
    assert law.rows["is_running"] == 0
    with pytest.raises(ValueError, match="first"):
        await ended


@virtual
async def test_an_error_of_the_pilot_ends_the_law(clock):
    def follow(reference):
        raise RuntimeError("no pilot")

    law = running_law(clock, follow)
    ended = law.start(clock.now_ns())
    law.fly(Acceleration(np.zeros(3)))
    with pytest.raises(RuntimeError, match="no pilot"):
        await ended


@virtual
async def test_the_end_of_its_time_ends_the_law(clock):
    law = running_law(clock)
    ended = law.start(clock.now_ns())
    law.end()
    await asyncio.wait_for(ended, 1.0)
    assert law.rows["is_running"] == 0
    assert law.rows["period_ns"] == 20_000_000


@virtual
async def test_a_law_that_moves_to_another_table_keeps_what_it_heard(clock):
    law = running_law(clock)
    law.hearings[1].put(State.at((1.0, 2.0, 3.0)))
    rows = np.zeros(3, law.rows.dtype)
    edges = np.zeros(4, law.edges.dtype)
    law.move_to(rows[1:2], edges[2:4])
    law.tally.count(None)
    edges["unheard"][2] = 4
    assert edges["version"].tolist() == [0, 0, 0, 1]
    assert rows["drone"].tolist() == [0, 2, 0]
    assert rows["tally"]["hovered"].tolist() == [0, 1, 0]
    assert law.unheard == {5: 4, 7: 0}


@virtual
async def test_it_says_when_it_last_heard_a_neighbour(clock):
    law = running_law(clock)
    assert law.find_heard_ns(7) is None
    await clock.sleep(1.0)
    law.hearings[1].put(State.at((1.0, 2.0, 3.0)), 0.25)
    assert law.find_heard_ns(7) == clock.now_ns() - 250_000_000
    assert law.find_heard_ns(5) is None
    assert law.find_heard_ns(3) is None, "it is no neighbour"


@virtual
async def test_a_law_that_is_stopped_says_why_its_references_were_not_flown(clock):
    law = running_law(clock, follow=lambda reference: False)
    law.law.step = lambda me, heard: None
    ended = law.start(clock.now_ns())
    law.rows["tally"]["steps"] = 3
    law.fly(Acceleration(np.full(3, np.nan)))
    law.stop()
    with pytest.raises(Interrupted, match=r"no usable reference in 1 of 3 steps.*nan"):
        await ended


class OfTeam:
    """A law with a step for a team beside its own."""

    rate = 50.0
    paired = False

    @classmethod
    def for_team(cls, laws, neighbors):
        return lambda team: None

    def step(self, me, heard):
        return None


@virtual
async def test_a_refused_reference_names_the_function_that_gave_it(clock):
    law = running_law(clock, follow=lambda reference: False)
    law.law = OfTeam()
    law.fly(Acceleration(np.full(3, np.nan)))
    assert "OfTeam.for_team" in law.tally.refusal
