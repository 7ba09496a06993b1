"""What a mission returns is checked once, and is the same for every reader."""

from types import SimpleNamespace

import pytest
from pilots import make_stand_in
from virtual_time import virtual

from crazychoir.agent.mission_runner import MISSION_TIMES, MissionRunner
from crazychoir.errors import Refused
from crazychoir.guidance.member import HELD_FLIGHT_PATIENCE
from crazychoir.safety.rules.modes import Mode


class Lands:
    """A pilot that is in the air until `down`, s; if `kept_up`, other drones keep it up until then."""

    mode = Mode.LAND
    port = SimpleNamespace(address=4)
    permission = SimpleNamespace(held=False)
    notes = SimpleNamespace(text="keeps clear of drone 2")

    def __init__(self, clock, down, kept_up):
        self.clock, self._down, self._kept_up, self.cut_at = clock, down, kept_up, None
        self.judge = make_stand_in({"touchdown.is_unreached": False})

    @property
    def airborne(self):
        return self.cut_at is None and self.clock.now() < self._down

    @property
    def follower(self):
        gave_way = self.clock.now() if self._kept_up else -1.0
        return make_stand_in({"clearance.gave_way": gave_way})

    def remaining(self):
        return 0.0

    def cut(self, reason):
        self.cut_at = self.clock.now()


@virtual
async def test_a_drone_kept_up_by_others_is_not_cut_while_a_battery_lasts(clock):
    pilot = Lands(clock, 3.0 * HELD_FLIGHT_PATIENCE, kept_up=True)
    await MissionRunner(SimpleNamespace(id=4, pilot=pilot), None, None)._down()
    assert pilot.cut_at is None
    assert clock.now() == pytest.approx(3.0 * HELD_FLIGHT_PATIENCE, abs=0.1)


@virtual
async def test_a_simulated_drone_kept_up_for_ever_is_cut_in_the_end(clock):
    pilot = Lands(clock, 9.0 * MISSION_TIMES.blocked_deadline, kept_up=True)
    await MissionRunner(SimpleNamespace(id=4, pilot=pilot), None, None)._down()
    late = HELD_FLIGHT_PATIENCE + MISSION_TIMES.landing_deadline + 1.0
    assert 0.0 <= pilot.cut_at - MISSION_TIMES.blocked_deadline < late


@virtual
async def test_a_drone_that_is_not_kept_up_and_does_not_come_down_is_cut(clock):
    pilot = Lands(clock, 3.0 * HELD_FLIGHT_PATIENCE, kept_up=False)
    await MissionRunner(SimpleNamespace(id=4, pilot=pilot), None, None)._down()
    assert pilot.cut_at == pytest.approx(MISSION_TIMES.landing_deadline, abs=0.1)


@virtual
async def test_a_drone_with_a_silent_radio_is_not_cut_when_it_is_reached_again(clock):
    pilot = Lands(clock, 3.0 * HELD_FLIGHT_PATIENCE, kept_up=False)
    pilot.judge.touchdown.is_unreached = True
    await MissionRunner(SimpleNamespace(id=4, pilot=pilot), None, None)._down()
    assert pilot.cut_at is None


@virtual
async def test_what_keeps_a_drone_from_flying_is_for_the_others_to_hear_too(clock):
    monitor = SimpleNamespace(silent=False)
    barrier = SimpleNamespace(monitor=monitor, refused="")
    port = SimpleNamespace(bus=SimpleNamespace(clock=clock))
    drone = SimpleNamespace(
        id=4,
        port=port,
        barrier=barrier,
        unfit=lambda: ["no such parameter", "battery at 3.1 V"],
    )
    config = SimpleNamespace(
        topology=SimpleNamespace(reached=(4,)),
        radio=SimpleNamespace(connect_deadline=10.0),
    )
    with pytest.raises(Refused, match="no such parameter; battery"):
        await MissionRunner(drone, config, None)._until_fit()
    assert clock.now() == pytest.approx(10.0 + MISSION_TIMES.readiness_time, abs=0.1)
    assert (barrier.refused, monitor.silent) == (
        "no such parameter; battery at 3.1 V",
        False,
    )


def stopped(cut_for):
    """A pilot with motors that were cut for the reason `cut_for`; if it is empty, they were not cut."""
    return make_stand_in(
        {
            "airborne": False,
            "mode": Mode.CUT,
            "permission.cut_for": cut_for,
            "notes.text": "",
            "notes.brought_down": "",
            "row.fence_ticks": 0,
            "follower.clearance.ticks": 0,
            "setup.period_ns": 10_000_000,
            "guard.latched": "",
        }
    )


@pytest.mark.parametrize("cut_for", ["emergency stop", ""])
def test_an_abort_after_an_emergency_stop_does_not_replace_its_reason(cut_for):
    @virtual
    async def check(clock):
        actor = MissionRunner(SimpleNamespace(id=4, pilot=stopped(cut_for)), None, None)
        actor.abort("Ctrl-C (SIGINT): landing")
        assert actor.over == (cut_for or "Ctrl-C (SIGINT): landing")

    check()


@virtual
async def test_what_has_broken_a_drone_is_said_once(clock):
    drone = SimpleNamespace(id=4, pilot=stopped(""), harm=lambda: "locked")
    actor = MissionRunner(drone, None, None)
    refused = "drone 4: refused: locked"
    assert actor._judged({"success": False, "reason": refused})["reason"] == refused
    assert (
        actor._judged({"success": False, "reason": "it fell"})["reason"]
        == "it fell; locked"
    )
    assert actor._judged({"success": False})["reason"] == "locked"
