"""The pilot with a simulated drone beneath it, tick by tick, in virtual time."""

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.local import Bus
from crazychoir.safety.guard import Fence
from crazychoir.safety.pilot import GIVE_UP_HOVER, Mode, Pilot
from crazychoir.simulation.integrator import CFIntegrator
from crazychoir.simulation.owner import SimulatedLink
from crazychoir.swarm.tables import Flight
from crazychoir.types import Acceleration, FullState, Goto, Pose

TICK = 0.01


class Flown:
    """One drone, its pilot, and what both did: positions, references, modes, notes."""

    def __init__(self, clock, fence=((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))):
        self.clock = clock
        self.bus = Bus(clock)
        self.world = CFIntegrator((0,), np.zeros((1, 3)), np.zeros(1))
        self.pilot = Pilot(self.bus.port(0), SimulatedLink(self.world, 0), Flight(), Fence.box(*fence))
        self.track, self.references = [], []

    @property
    def p(self):
        """The truth."""
        return self.world.state(0).p

    async def fly(self, seconds, *, poses=True, each=lambda: None):
        """Let it fly; `each` is called before every tick."""
        for _ in range(round(seconds / TICK)):
            await self.clock.sleep(TICK)
            for _ in range(round(TICK / self.world.dt)):
                self.world.step()
            each()
            truth = self.world.state(0)
            self.pilot.tick(Pose(truth.flat[[0, 1, 2, 6, 7, 8, 9]], 0.0) if poses else None)
            self.track.append(truth.p)
            self.references.append(self.pilot._last)

    async def hovering(self):
        """Take off and wait until it hovers."""
        await self.fly(0.05)
        await self.fly(self.pilot.take_off() + 0.5)
        assert self.pilot.mode is Mode.HOVER


@virtual
async def test_it_takes_off_hovers_and_lands_with_its_motors_off(clock):
    drone = Flown(clock)
    await drone.hovering()
    assert drone.p == pytest.approx([0.0, 0.0, Flight().takeoff_height], abs=0.02)
    await drone.fly(drone.pilot.land() + 1.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.p[2] == pytest.approx(0.0, abs=1e-6)
    assert not drone.pilot.airborne
    assert drone.pilot.take_off() > 0.0, "and may rise again"


@virtual
async def test_before_the_first_pose_nothing_moves(clock):
    drone = Flown(clock)
    await drone.fly(1.0, poses=False)
    assert drone.pilot.take_off() == 0.0
    assert drone.pilot.land() == 0.0
    await drone.fly(3.0, poses=False)
    assert (drone.pilot.mode, drone.pilot.state) == (Mode.GROUND, None)
    assert drone.p == pytest.approx(np.zeros(3))


@virtual
async def test_go_to_arrives_and_stays_inside_the_fence(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(drone.pilot.go_to([0.8, -0.5, 1.2]) + 0.5)
    assert drone.p == pytest.approx([0.8, -0.5, 1.2], abs=0.03)
    await drone.fly(drone.pilot.go_to([9.0, 0.0, 1.0]) + 0.5)
    assert drone.p == pytest.approx([3.0, 0.0, 1.0], abs=0.05)
    assert drone.pilot.airborne


@virtual
async def test_it_follows_accelerations_full_states_and_goals(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(1.0, each=lambda: drone.pilot.follow(Acceleration([0.3, 0.0, 0.0])))
    assert drone.pilot.mode is Mode.FOLLOW
    assert 0.03 < drone.p[0] < 0.2
    place = np.array([0.2, 0.1, 1.1])
    await drone.fly(3.0, each=lambda: drone.pilot.follow(FullState.at(place)))
    assert drone.p == pytest.approx(place, abs=0.02)
    drone.pilot.follow(Goto([-0.3, 0.0, 1.0]))
    await drone.fly(4.0)
    assert drone.p == pytest.approx([-0.3, 0.0, 1.0], abs=0.03)


@virtual
async def test_a_reference_that_is_not_renewed_ends_in_hovering_then_in_landing(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(1.0, each=lambda: drone.pilot.follow(Acceleration([0.3, 0.0, 0.0])))
    await drone.fly(3.0)
    at_rest = drone.world.state(0)
    assert np.linalg.norm(at_rest.v) < 0.05
    assert at_rest.p[2] == pytest.approx(1.0, abs=0.05)
    assert "reference" in drone.pilot.note
    await drone.fly(9.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.p[2] == pytest.approx(0.0, abs=1e-6)


@virtual
async def test_a_reference_that_is_not_finite_counts_as_none(clock):
    drone = Flown(clock)
    await drone.hovering()
    for bad in (Acceleration([np.nan, 0.0, 0.0]), FullState.at([np.inf, 0.0, 1.0])):
        await drone.fly(0.5, each=lambda bad=bad: drone.pilot.follow(bad))
        assert np.linalg.norm(drone.p - [0.0, 0.0, 1.0]) < 0.05
        assert np.isfinite(drone.world.state(0).flat).all()
        assert "not flown" in drone.pilot.note
    await drone.fly(0.2, each=lambda: drone.pilot.follow(Goto([np.nan, 0.0, 1.0])))
    assert np.linalg.norm(drone.p - [0.0, 0.0, 1.0]) < 0.05


@virtual
async def test_a_short_gap_in_the_poses_is_braked_through(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.go_to([2.0, 0.0, 1.0])
    await drone.fly(2.2)
    speed = np.linalg.norm(drone.world.state(0).v)
    assert speed > 0.3
    await drone.fly(0.45, poses=False)
    assert "pose" in drone.pilot.note
    assert np.linalg.norm(drone.world.state(0).v) < speed
    await drone.fly(2.0)
    assert drone.pilot.mode is Mode.HOVER
    assert np.linalg.norm(drone.world.state(0).v) < 0.02
    assert drone.p[0] < 1.9


@virtual
async def test_a_long_gap_lands_it_and_a_longer_one_cuts_the_motors(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(0.8, poses=False)
    assert drone.pilot.mode is Mode.LAND
    await drone.fly(1.5, poses=False)
    assert drone.pilot.mode is Mode.CUT
    await drone.fly(2.0)
    assert drone.p[2] == pytest.approx(0.0, abs=1e-6)
    assert drone.pilot.take_off() == 0.0
    assert drone.pilot.note.endswith("motors cut, for good: no take-off until its agent is started again")


@virtual
async def test_whoever_leaves_the_fence_brakes_then_lands_then_falls(clock):
    drone = Flown(clock, fence=((-0.5, -0.5, -0.2), (0.5, 0.5, 2.0)))
    await drone.hovering()
    first, notes = {}, []

    def push():
        if drone.pilot.mode in (Mode.HOVER, Mode.FOLLOW):
            drone.pilot.follow(Acceleration([2.0, 0.0, 0.0]))
        first.setdefault(drone.pilot.mode, drone.p[0])
        notes.append(drone.pilot.note)

    await drone.fly(4.0, each=push)
    assert list(first) == [Mode.FOLLOW, Mode.LAND, Mode.CUT], "too fast to be stopped by anything less"
    assert first[Mode.LAND] == pytest.approx(0.75, abs=0.03)
    assert first[Mode.CUT] == pytest.approx(1.0, abs=0.03)
    assert next(note for note in notes if note) == "0.00 m outside the fence, limit 0.00 m: braking"


@virtual
async def test_when_guidance_has_failed_it_hovers_then_lands(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(0.5, each=lambda: drone.pilot.follow(Acceleration([0.2, 0.0, 0.0])))
    drone.pilot.guidance_failed("no idea")
    await drone.fly(GIVE_UP_HOVER - 0.1)
    assert drone.pilot.mode is Mode.HOVER
    assert drone.p[2] == pytest.approx(1.0, abs=0.05)
    await drone.fly(9.0)
    assert drone.pilot.mode is Mode.GROUND


@virtual
async def test_a_cut_stops_the_motors_for_good(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.cut("that is enough")
    await drone.fly(0.2)
    assert drone.p[2] < 0.95
    await drone.fly(2.0, each=lambda: drone.pilot.follow(Acceleration([0.0, 0.0, 5.0])))
    assert drone.pilot.mode is Mode.CUT
    assert drone.p[2] == pytest.approx(0.0, abs=1e-6)
    assert drone.pilot.note == "that is enough"


@virtual
async def test_the_reference_never_jumps_when_the_mode_changes(clock):
    drone = Flown(clock)
    await drone.hovering()
    goals = ([1.0, 0.0, 1.0], [0.0, 1.0, 1.5], [-1.0, 0.0, 0.8])
    for goal in goals:
        drone.pilot.go_to(goal)
        await drone.fly(0.9)
    drone.pilot.hover()
    await drone.fly(0.3)
    drone.pilot.go_to([0.0, 0.0, 1.0])
    await drone.fly(0.7)
    drone.pilot.land()
    await drone.fly(7.0)
    flown = [r for r in drone.references if r is not None]
    steps = np.diff([r.p for r in flown], axis=0)
    assert np.abs(steps).max() < 1.6 * TICK, "m a tick, at 1 m/s and under way"
    accelerations = np.diff([r.v for r in flown], axis=0) / TICK
    assert np.abs(accelerations).max() < 6.0
    assert drone.pilot.mode is Mode.GROUND


@virtual
async def test_after_a_law_the_plan_begins_at_the_drone_with_its_speed(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(1.0, each=lambda: drone.pilot.follow(Acceleration([0.5, 0.0, 0.0])))
    state = drone.pilot.state
    drone.pilot.hover()
    assert drone.pilot._last.p == pytest.approx(state.p)
    assert drone.pilot._last.v == pytest.approx(state.v)
    await drone.fly(3.0)
    assert np.linalg.norm(drone.world.state(0).v) < 0.02


@virtual
async def test_poses_that_are_not_numbers_are_no_poses(clock):
    drone = Flown(clock)
    await drone.hovering()
    for _ in range(round(2.5 / TICK)):
        await clock.sleep(TICK)
        drone.pilot.tick(Pose(np.full(7, np.nan), 0.0))
    assert drone.pilot.mode is Mode.CUT, "as if the cameras saw nothing for 2 s"


@virtual
async def test_references_of_another_shape_or_kind_are_not_flown(clock):
    drone = Flown(clock)
    await drone.hovering()
    for bad in (FullState(np.zeros(13)), Acceleration(np.zeros(2)), drone.pilot.state, None):
        await drone.fly(0.2, each=lambda bad=bad: drone.pilot.follow(bad))
        assert "not flown" in drone.pilot.note
    assert drone.pilot.mode is Mode.HOVER


@virtual
async def test_a_held_drone_follows_nothing_until_it_is_let_go(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.hold()
    away = FullState.at([1.0, 0.0, 1.0])
    await drone.fly(1.0, each=lambda: drone.pilot.follow(away))
    assert np.linalg.norm(drone.p - [0.0, 0.0, 1.0]) < 0.05
    drone.pilot.hold(on=False)
    await drone.fly(2.0, each=lambda: drone.pilot.follow(away))
    assert np.linalg.norm(drone.p - [1.0, 0.0, 1.0]) < 0.1


@virtual
async def test_a_drone_at_rest_after_its_descent_has_landed_whatever_height_the_cameras_say(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.limits = Flight(ground=-0.3)
    await drone.fly(drone.pilot.land() + 4.0)
    assert drone.pilot.mode is Mode.GROUND


# Limits of references -----------------------------------------------------------------------------------------------


def fastest(drone, since):
    """Largest speed m/s and acceleration m/s2 on the way, from the truth."""
    v = np.diff(drone.track[since:], axis=0) / TICK
    a = np.diff(v, axis=0) / TICK
    return np.linalg.norm(v, axis=1).max(), np.linalg.norm(a, axis=1).max()


@virtual
async def test_a_reference_far_away_that_comes_back_after_braking_is_flown_to_within_the_limits(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(1.0, each=lambda: drone.pilot.follow(FullState.at([0.0, 0.0, 1.0])))
    await drone.fly(1.5)
    assert "braking" in drone.pilot.note
    since = len(drone.track)
    await drone.fly(6.0, each=lambda: drone.pilot.follow(FullState.at([2.5, 1.5, 1.0])))
    speed, acceleration = fastest(drone, since)
    assert drone.p == pytest.approx([2.5, 1.5, 1.0], abs=0.02)
    assert 0.8 * Flight().speed_limit < speed < 1.05 * Flight().speed_limit
    assert acceleration < 1.2 * Flight().acceleration_limit


@virtual
async def test_a_full_state_that_runs_away_is_followed_within_the_limits(clock):
    drone = Flown(clock)
    await drone.hovering()
    since, t0 = len(drone.track), clock.now()

    def away():
        t = clock.now() - t0
        drone.pilot.follow(FullState.at([2.0 * t**2, 0.0, 1.0], [4.0 * t, 0.0, 0.0], [4.0, 0.0, 0.0]))

    await drone.fly(1.3, each=away)
    speed, acceleration = fastest(drone, since)
    assert 1.5 * Flight().speed_limit < speed < 2.05 * Flight().speed_limit
    assert Flight().acceleration_limit < acceleration < 2.1 * Flight().acceleration_limit


@virtual
async def test_an_acceleration_beyond_the_limit_is_cut_to_it(clock):
    drone = Flown(clock)
    await drone.hovering()
    since = len(drone.track)
    await drone.fly(1.5, each=lambda: drone.pilot.follow(Acceleration([5.0, 5.0, 0.0])))
    _, acceleration = fastest(drone, since)
    assert acceleration == pytest.approx(Flight().acceleration_limit, rel=0.15)
    assert drone.p[0] == pytest.approx(drone.p[1], abs=0.01), "its direction stays"


# For good -----------------------------------------------------------------------------------------------------------


@virtual
async def test_who_had_to_land_for_the_fence_does_not_rise_again(clock):
    drone = Flown(clock, fence=((-0.5, -0.5, -0.2), (0.5, 0.5, 2.0)))
    await drone.hovering()
    drone.pilot.limits = Flight(landing_speed=1.0)

    def push():
        if drone.pilot.mode is not Mode.LAND:
            drone.pilot.follow(Acceleration([0.7, 0.0, 0.0]))

    await drone.fly(2.0, each=push)
    await drone.fly(4.0)
    assert drone.pilot.mode is Mode.GROUND, drone.pilot.note
    assert drone.pilot.take_off() == 0.0
    assert "m outside the fence, limit 0.25 m: landing, for good: no take-off until" in drone.pilot.note
    await drone.fly(1.0)
    assert drone.p[2] == pytest.approx(0.0, abs=1e-6)


@virtual
async def test_an_emergency_stop_that_is_cleared_does_not_start_motors_that_it_cut(clock):
    flying, waiting = Flown(clock), Flown(clock)
    await waiting.fly(0.1)
    await flying.hovering()
    for drone in (flying, waiting):
        drone.bus.stopped = True
    flying.pilot.cut("emergency stop")
    assert waiting.pilot.take_off() == 0.0
    assert "stop --clear" in waiting.pilot.note
    for drone in (flying, waiting):
        drone.bus.stopped = False
    assert flying.pilot.take_off() == 0.0
    assert flying.pilot.note == "emergency stop: no take-off until its agent is started again"
    assert waiting.pilot.take_off() > 0.0, "its agent was started after the stop, its motors were never cut"


@virtual
async def test_a_height_of_zero_is_a_height(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    assert drone.pilot.take_off(0.0) < drone.pilot.limits.takeoff_height
    await drone.fly(3.0)
    assert drone.p[2] < 0.02
