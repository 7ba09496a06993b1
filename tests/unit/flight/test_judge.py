"""The judge of a drone: in which ticks it decides."""

from types import SimpleNamespace

import pytest
from pilots import make_pilot
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import FlightTable
from crazychoir.flight.flight_limits import TOUCHDOWN_LIMITS
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import State

FENCE = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))


def make(clock, reach="no"):
    """Return a pilot of a drone in the air, with a link on which nothing arrives."""
    link = SimpleNamespace(send=lambda command: None, cut=lambda: None)
    pilot = make_pilot(Bus(clock).port(0), link, FlightTable(), FENCE, reach=reach)
    pilot.row.mode = Mode.HOVER
    put(pilot, (0.0, 0.0, 1.0))
    return pilot


def put(pilot, p, age=0.0):
    """Let the drone be seen at p, (3,) m, `age` s ago."""
    pilot.row.drone["is_known"] = 1
    pilot.row.drone["number"] += 1
    pilot.row.drone["state"] = State.at(p).flat
    pilot.row.drone["age"] = age


@pytest.mark.parametrize(("reach", "watches"), [("no", 0), ("seen", 1), ("own", 1)])
def test_a_drone_behind_a_radio_is_judged_in_each_tick(reach, watches):
    @virtual
    async def check(clock):
        assert make(clock, reach).row.drone["is_by_hand"] == watches

    check()


@virtual
async def test_a_drone_that_others_fly_is_judged_in_each_tick_until_it_is_seen(clock):
    pilot = make(clock)
    pilot.take_over()
    assert pilot.row.drone["is_by_hand"] == 1
    put(pilot, (0.0, 0.0, 1.0), age=1.0)
    pilot.judge.decide(pilot.state, 1.0)
    assert pilot.row.drone["is_by_hand"] == 1, "the state is old"
    put(pilot, (0.0, 0.0, 1.0))
    pilot.judge.decide(pilot.state, 1.0)
    assert pilot.row.drone["is_by_hand"] == 0
    assert not pilot.permission.takes_over


@virtual
async def test_a_landing_at_home_ends_the_way_there(clock):
    pilot = make(clock)
    pilot.go_home((1.0, 0.0, 0.0), 2.0)
    assert pilot.mode is Mode.RETURN
    now = 0.0
    for p in ((0.0, 0.0, 2.0), (1.0, 0.0, 2.0)):
        now += pilot.flights.remaining(now) + 0.01
        put(pilot, pilot.flights.sample(now).p)
        pilot.judge.decide(pilot.state, now)
        assert pilot.mode is Mode.RETURN
        assert pilot.flights.plan.goal == pytest.approx(p)
    now += pilot.flights.remaining(now) + 0.01
    put(pilot, pilot.flights.sample(now).p)
    pilot.judge.decide(pilot.state, now)
    assert pilot.mode is Mode.LAND
    assert pilot.notes.text == "home: landing"


@virtual
async def test_a_landing_drone_that_others_keep_just_above_the_ground_stops_there(
    clock,
):
    pilot = make(clock)
    is_down = pilot.judge.touchdown.is_down
    low = TOUCHDOWN_LIMITS.kept_up_height - 0.01
    soon = TOUCHDOWN_LIMITS.kept_up_time - 0.1
    pilot.row.mode = Mode.LAND

    def is_down_at(height, now, age=0.0, gave_way=0.0, speed=0.2):
        put(pilot, (0.0, 0.0, height), age)
        pilot.row.drone["state"][3] = speed
        pilot.row.drone["gave_way"] = now - gave_way
        return is_down(pilot.state, now)

    assert not is_down_at(low, 1.0)
    assert not is_down_at(low + 0.1, 1.0 + soon), "it was lifted"
    assert not is_down_at(low, 20.0)
    assert not is_down_at(low, 20.0 + soon)
    assert not is_down_at(low, 20.2 + soon, age=1.0), "where it is, is not seen"
    assert not is_down_at(low, 20.3 + soon, speed=0.9), "it still flies"
    assert is_down_at(low, 20.4 + soon)
    assert "others keep it 0.14 m above the ground" in pilot.notes.text
    assert not is_down_at(low, 60.0, gave_way=9.0), "nothing is in its way"
    assert not is_down_at(low, 60.0 + 2.0 * soon, gave_way=9.0)
