"""Flights of a mission: how long it waits for their end, for its operator, and until a drone stands still."""

from types import SimpleNamespace

import pytest
from pilots import make_stand_in
from virtual_time import virtual

from crazychoir.guidance.flights import (
    FLIGHT_LIMITS,
    SETTLING_LIMITS,
    require_running,
    wait_for_command,
    wait_until_ready,
    wait_until_settled,
    wait_while,
)
from crazychoir.guidance.member import FLIGHT_LOOK_INTERVAL, Interrupted
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import State

NS_PER_SECOND = 10**9


def flying(clock, **changes):
    """The member of drone 3; its pilot hovers at the origin unless it is changed."""
    pilot = make_stand_in(
        {
            "mode": Mode.HOVER,
            "state": State.at((0.0, 0.0, 1.0)),
            "airborne": True,
            "remaining": lambda: 0.0,
            "notes.text": "",
            "flights.waited": 0.0,
            "permission.commanded": False,
            "permission.held": False,
            "body.list_problems": list,
        }
    )
    vars(pilot).update(changes)
    announced = []
    return SimpleNamespace(
        id=3,
        clock=clock,
        pilot=pilot,
        ended="",
        gate="",
        report=dict,
        announced=announced,
        announce=lambda: announced.append(clock.now()),
    )


def later(clock, seconds, change):
    clock.call_at(clock.now_ns() + round(seconds * NS_PER_SECOND), change)


def test_a_mission_that_is_over_does_not_fly():
    require_running(SimpleNamespace(id=3, ended=""))
    with pytest.raises(Interrupted, match="drone 3: its mission has ended: landed"):
        require_running(SimpleNamespace(id=3, ended="landed"))


@virtual
async def test_a_flight_takes_its_time_and_that_of_its_hindrances(clock):
    member = flying(clock)
    await wait_while(member, 2.0, Mode.FOLLOW)
    assert clock.now() == pytest.approx(2.0, abs=1e-6)

    def hinder():
        member.pilot.flights.waited += 3.0

    later(clock, 1.0, hinder)
    await wait_while(member, 2.0, Mode.FOLLOW)
    assert clock.now() == pytest.approx(7.0, abs=1e-6)


@virtual
async def test_a_flight_ends_with_the_reason_for_which_the_pilot_lands(clock):
    member = flying(clock)

    def land():
        member.pilot.mode = Mode.LAND
        member.pilot.notes.text = "battery low"

    later(clock, 1.0, land)
    with pytest.raises(Interrupted, match="drone 3: landing: battery low"):
        await wait_while(member, 5.0, Mode.FOLLOW)
    assert clock.now() < 1.0 + 2 * FLIGHT_LOOK_INTERVAL


@virtual
async def test_a_command_is_waited_for_with_a_status_that_says_so(clock):
    member = flying(clock)
    own = member.report
    waits = [True]
    seen = []
    later(clock, 2.0, lambda: seen.append((member.gate, member.report()["task"])))
    later(clock, 3.0, waits.clear)
    await wait_for_command(member, "start", 60.0, lambda: bool(waits))
    assert member.announced == [0.0]
    assert seen == [("start", "waits for its operator: start, or lands in 58 s")]
    assert (member.gate, member.report) == ("", own)
    assert clock.now() == pytest.approx(3.0, abs=2 * FLIGHT_LOOK_INTERVAL)


@virtual
async def test_a_command_that_does_not_come_ends_the_mission(clock):
    member = flying(clock, airborne=False)
    with pytest.raises(Interrupted, match="no take-off by its operator within 5 s"):
        await wait_for_command(member, "take-off", 5.0, lambda: True)
    assert member.gate == ""


@virtual
async def test_a_drone_has_settled_when_it_stands_still_at_its_goal(clock):
    member = flying(clock)
    moving = State.at((0.5, 0.0, 1.0))
    still = member.pilot.state
    member.pilot.state = moving
    later(clock, 1.0, lambda: setattr(member.pilot, "state", still))
    await wait_until_settled(member, still.p)
    settled = 1.0 + SETTLING_LIMITS.settled_time
    assert clock.now() == pytest.approx(settled, abs=2 * FLIGHT_LOOK_INTERVAL)


@virtual
async def test_a_drone_that_does_not_settle_flies_on(clock):
    member = flying(clock)
    await wait_until_settled(member, member.pilot.state.p + 1.0)
    patience = SETTLING_LIMITS.patience
    assert clock.now() == pytest.approx(patience, abs=2 * FLIGHT_LOOK_INTERVAL)


@virtual
async def test_a_drone_waits_on_the_ground_for_its_pose_and_until_it_is_fit(clock):
    problems = ["no pose"]
    member = flying(clock, state=None)
    member.pilot.body.list_problems = lambda: problems
    later(clock, 2.0, lambda: setattr(member.pilot, "state", State.at((0, 0, 0))))
    later(clock, 4.0, problems.clear)
    await wait_until_ready(member)
    assert clock.now() == pytest.approx(4.0, abs=2 * FLIGHT_LOOK_INTERVAL)


@virtual
async def test_an_unfit_drone_is_left_to_the_pilot_after_a_while(clock):
    member = flying(clock)
    member.pilot.body.list_problems = lambda: ["no pose"]
    await wait_until_ready(member)
    assert clock.now() == pytest.approx(FLIGHT_LIMITS.unfit_time, abs=0.1)


@virtual
async def test_a_drone_without_a_pose_does_not_take_off(clock):
    with pytest.raises(Interrupted, match="drone 3: no pose within 300 s"):
        await wait_until_ready(flying(clock, state=None))
