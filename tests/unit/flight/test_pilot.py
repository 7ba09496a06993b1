"""The pilot with a simulated drone beneath it, tick by tick, in virtual time."""

import asyncio
import itertools
import re

import numpy as np
import pytest
from pilots import make_pilot, tick
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.tables import CollisionTable, ControlTable, FlightTable
from crazychoir.control.choice import make_controls
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.errors import ConfigError
from crazychoir.flight.clearance import CLEARANCE_TIMES
from crazychoir.flight.flight_limits import TOUCHDOWN_LIMITS
from crazychoir.flight.follower import RISE_DELAY
from crazychoir.flight.pilot import GIVE_UP_HOVER
from crazychoir.flight.stages import _evade
from crazychoir.flight.tick import FlightTick
from crazychoir.planning.point_to_point import STOP_DISTANCE, plan_stop
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import Call, DropOldest
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.safety.rules.guard import (
    FENCE_INSET,
    RADIO_SAFETY_TABLE,
    SAFETY_TABLE,
    Action,
    Fence,
    SafetyVerdict,
)
from crazychoir.safety.rules.limits import ReferenceLimits
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.common.links import SimulatedLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator, InputLags
from crazychoir.types import XYZ, Acceleration, FullState, Goto, Pose, State

TICK = 0.01


class Flown:
    """One drone, its pilot, and what both did: positions, references, modes, notes."""

    def __init__(
        self,
        clock,
        fence=((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5)),
        plant=None,
        noise=0.0,
        reached="no",
    ):
        self.clock = clock
        self.bus = Bus(clock)
        self.world = CFIntegrator((0,), np.zeros((1, 3)), np.zeros(1), **(plant or {}))
        self.draw, self.noise = np.random.default_rng(5), noise
        self.pilot = make_pilot(
            self.bus.port(0),
            SimulatedLink(self.world, 0),
            FlightTable(),
            Fence.box(*fence),
            reach=reached,
        )
        self.track, self.references = [], []

    @property
    def p(self):
        """The truth."""
        return self.world.state(0).p

    async def fly(
        self,
        seconds,
        *,
        poses=True,
        each=lambda: None,
        drift=lambda: 0.0,
        sinks=lambda z: z,
    ):
        """Let it fly; `each` is called before every tick; drift: m along x by which the cameras see it elsewhere;
        sinks: the height that they see.
        """
        for _ in range(round(seconds / TICK)):
            await self.clock.sleep(TICK)
            for _ in range(round(TICK / self.world.dt)):
                self.world.step()
            each()
            truth = self.world.state(0)
            seen = truth.flat[[0, 1, 2, 6, 7, 8, 9]]
            seen[0] += drift()
            seen[2] = sinks(seen[2])
            seen += self.noise * self.draw.standard_normal(7)
            pose = Pose(seen, 0.0) if poses else None
            tick(self.pilot, self.pilot.stages.receive_pose(pose, 0.0))
            self.track.append(truth.p)
            self.references.append(self.pilot.row.flown)

    async def hovering(self):
        """Take off and wait until it hovers."""
        await self.fly(0.05)
        await self.fly(self.pilot.take_off() + 0.5)
        assert self.pilot.mode is Mode.HOVER


class Told:
    """A link that keeps the plans for its firmware to itself."""

    def __init__(self, link):
        self.link, self.cut, self.plans = link, link.cut, []

    def send(self, command):
        """Set-points go on."""
        if isinstance(command, XYZ):
            self.plans.append(command)
        else:
            self.link.send(command)


@virtual
async def test_it_takes_off_hovers_and_lands_with_its_motors_off(clock):
    drone = Flown(clock)
    await drone.hovering()
    assert drone.p == pytest.approx([0.0, 0.0, FlightTable().takeoff_height], abs=0.02)
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
async def test_it_remembers_why_the_safety_table_has_landed_it_and_no_landing_that_was_asked_for(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.land("enough")
    await drone.fly(0.6, poses=False)
    await drone.fly(8.0)
    assert (drone.pilot.mode, drone.pilot.notes.brought_down) == (Mode.GROUND, "")
    await drone.hovering()
    await drone.fly(0.6, poses=False)
    await drone.fly(8.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.pilot.notes.brought_down == "pose 0.51 s old, limit 0.50 s: landing"


@virtual
async def test_a_reference_that_is_not_renewed_ends_in_hovering_then_in_landing(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(1.0, each=lambda: drone.pilot.follow(Acceleration([0.3, 0.0, 0.0])))
    await drone.fly(3.0)
    at_rest = drone.world.state(0)
    assert np.linalg.norm(at_rest.v) < 0.05
    assert at_rest.p[2] == pytest.approx(1.0, abs=0.05)
    assert "reference" in drone.pilot.notes.text
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
        assert "not flown" in drone.pilot.notes.text
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
    assert "pose" in drone.pilot.notes.text
    assert np.linalg.norm(drone.world.state(0).v) < speed
    await drone.fly(2.0)
    assert drone.pilot.mode is Mode.HOVER
    assert np.linalg.norm(drone.world.state(0).v) < 0.02
    assert drone.p[0] < 1.9


@virtual
async def test_a_take_off_that_a_short_gap_in_the_poses_brakes_goes_on(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    drone.pilot.take_off(duration=2.0)
    await drone.fly(0.3)
    await drone.fly(0.15, poses=False)
    assert "pose" in drone.pilot.notes.text
    await drone.fly(0.4)
    assert drone.pilot.mode is Mode.TAKEOFF, "it waits until the poses have come long"
    assert drone.p[2] < 0.2
    await drone.fly(2.5)
    assert drone.pilot.mode is Mode.HOVER
    height = FlightTable().takeoff_height
    assert drone.p[2] == pytest.approx(height, abs=0.02)


@virtual
async def test_a_take_off_that_is_braked_again_and_again_ends_where_the_drone_is(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    drone.pilot.take_off(duration=2.0)
    for _ in range(round(RISE_DELAY / 0.3) - 1):
        await drone.fly(0.15)
        await drone.fly(0.15, poses=False)
    assert drone.pilot.mode is Mode.TAKEOFF
    for _ in range(3):
        await drone.fly(0.15)
        await drone.fly(0.15, poses=False)
    assert drone.pilot.mode is Mode.HOVER


@virtual
async def test_a_take_off_that_has_waited_for_other_drones_goes_on_after_a_brake(
    clock,
):
    drone = Flown(clock)
    await drone.fly(0.05)
    drone.pilot.take_off(duration=2.0)
    await drone.fly(0.1)
    drone.pilot.flights.wait(2.0 * RISE_DELAY)
    await drone.fly(2.0 * RISE_DELAY)
    await drone.fly(0.15, poses=False)
    await drone.fly(3.5)
    assert drone.pilot.mode is Mode.HOVER
    assert drone.p[2] == pytest.approx(FlightTable().takeoff_height, abs=0.02)


@virtual
async def test_a_take_off_that_was_braked_keeps_its_own_height_and_its_time(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    drone.pilot.take_off(height=0.5, duration=6.0)
    await drone.fly(1.0)
    await drone.fly(0.15, poses=False)
    await drone.fly(3.0)
    assert drone.pilot.mode is Mode.TAKEOFF, "5 s of it were left"
    await drone.fly(4.0)
    assert drone.pilot.mode is Mode.HOVER
    assert drone.p[2] == pytest.approx(0.5, abs=0.02)


@virtual
async def test_brakes_of_an_earlier_take_off_do_not_count(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    for _ in range(2):
        assert drone.pilot.take_off(duration=6.0) > 0.0, drone.pilot.notes.text
        for _ in range(4):
            await drone.fly(0.7)
            await drone.fly(0.15, poses=False)
        assert drone.pilot.mode is Mode.TAKEOFF
        await drone.fly(8.0)
        height = FlightTable().takeoff_height
        assert drone.p[2] == pytest.approx(height, abs=0.02)
        await drone.fly(drone.pilot.land() + 1.0)
        assert drone.pilot.mode is Mode.GROUND


@virtual
async def test_a_take_off_from_outside_the_fence_rises_where_it_was_braked_inside(
    clock,
):
    edge = -0.03
    drone = Flown(clock, fence=((-3.0, -3.0, -0.2), (edge, 3.0, 2.5)))
    await drone.fly(0.05)
    drone.pilot.take_off(duration=2.0)
    await drone.fly(7.0)
    assert drone.pilot.mode is Mode.HOVER
    assert drone.pilot.judge.braked == 1
    assert drone.p[0] < edge


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
    assert drone.pilot.notes.text.endswith(
        "motors cut, for good: no take-off until its agent is started again"
    )


@virtual
async def test_a_drone_carried_beyond_the_limit_area_is_cut_within_a_tick(clock):
    drone = Flown(clock, fence=((-0.5, -0.5, -0.2), (0.5, 0.5, 2.0)))
    await drone.hovering()
    crossed = []

    def look():
        drone.world.states[0, 3] += 0.3  # m/s a tick: by 3 g
        crossed.append((drone.p[0] > 1.0, drone.pilot.mode is Mode.CUT))

    await drone.fly(0.4, each=look)
    before = sum(not out for out, _ in crossed)
    assert 5 < before < len(crossed) - 5
    assert not any(cut for _, cut in crossed[: before + 1]), "looked at before the tick"
    assert all(cut for _, cut in crossed[before + 2 :])
    assert drone.world._alive[0] == 0.0


@virtual
async def test_a_drone_that_leaves_the_fence_brakes_then_lands_then_is_cut(clock):
    drone = Flown(clock, fence=((-0.5, -0.5, -0.2), (0.5, 0.5, 2.0)))
    await drone.hovering()
    first, notes, t0 = {}, [], clock.now()

    def look():
        first.setdefault(drone.pilot.mode, clock.now() - t0)
        notes.append(drone.pilot.notes.text)

    await drone.fly(
        2.0, each=look, drift=lambda: 6.0 * (clock.now() - t0)
    )  # something carries it away
    assert list(first) == [Mode.HOVER, Mode.LAND, Mode.CUT]
    said = [note.split(" m outside")[1] for note in dict.fromkeys(notes) if note]
    assert [text.partition(",")[2] for text in dict.fromkeys(said)] == [
        " limit 0.00 m: braking",
        " limit 0.25 m: landing, for good",
        " in the keep-out zone: motors cut, for good",
    ]


async def led_out(clock, reference):
    """References of `reference(t)`, t s since the first, that lead a drone out of the fence at x = 3 m for 8 s."""
    drone = Flown(clock)
    await drone.hovering()
    t0, actions = clock.now(), set()

    def out():
        drone.pilot.follow(reference(clock.now() - t0))
        actions.add(drone.pilot.row.obeyed)

    await drone.fly(8.0, each=out)
    assert actions == {Action.NOMINAL, Action.BRAKE}
    assert 2.7 < max(p[0] for p in drone.track) < 3.2
    assert drone.pilot.mode is Mode.FOLLOW
    assert drone.pilot.notes.text.endswith(
        ("m outside the fence, limit 0.00 m: braking", "inside the fence: braking")
    )
    assert 100 < drone.pilot.row.fence_ticks < 700, "ticks of 8 s in which it was held"
    return drone


@virtual
async def test_a_flight_to_a_place_outside_ends_at_the_fence_and_says_for_how_long_it_was_there(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    seconds = drone.pilot.go_to([9.0, 0.0, 1.0])
    assert (
        drone.pilot.notes.text
        == "[9.0, 0.0, 1.0] is outside the fence: flies to [3.0, 0.0, 1.0]"
    )
    await drone.fly(seconds + 2.0)
    assert drone.pilot.row.fence_ticks * TICK == pytest.approx(2.0, abs=0.1)
    await drone.fly(drone.pilot.go_to([2.9, 0.0, 1.0]) + 1.0)
    assert drone.pilot.row.fence_ticks * TICK == pytest.approx(2.0, abs=0.1), (
        "inside it is not held"
    )


def test_what_brakes_again_and_again_is_said_rarely_and_counted_at_the_end(caplog):
    async def scene(clock):
        drone = await led_out(
            clock, lambda t: FullState.at([t, 0.0, 1.0], [1.0, 0.0, 0.0])
        )
        drone.bus.subscribe(
            DRONE_TOPICS.log, 0, 0, heard := DropOldest(clock, "log", 9)
        )
        await drone.fly(
            60.0, each=lambda: drone.pilot.follow(FullState.at([9.0, 0.0, 1.0]))
        )
        drone.pilot.land()
        await drone.fly(10.0)
        assert drone.pilot.mode is Mode.GROUND
        return drone.pilot.notes.text, heard.take()

    note, heard = run_virtual(scene)
    said = [
        message
        for message in caplog.messages
        if "inside the fence" in message or "outside the fence" in message
    ]
    assert 3 <= len(said) <= 8, "over a minute of it"
    assert int(re.search(r"braked it (\d+) times in this flight", note)[1]) > len(said)
    assert heard == [f"drone 0: {note}"], "and is in the result of the run"


@pytest.mark.parametrize(
    "rule",
    dict.fromkeys((*SAFETY_TABLE, *RADIO_SAFETY_TABLE)),
    ids=lambda rule: f"{rule.measure} {rule.limit:g}",
)
def test_a_safety_landing_or_cut_is_reported_as_grave(rule):
    """Every rule of the safety tables; what it is asked to do by others is not."""

    async def scene(clock):
        drone = Flown(clock)
        await drone.hovering()
        drone.pilot.judge.obey(
            SafetyVerdict(rule.action, "why", rule.measure), clock.now()
        )
        said = drone.pilot.notes.text, drone.pilot.notes.is_grave
        drone.pilot.notes.say("other", "it is all right")
        return said, drone.pilot.notes.is_grave

    assert run_virtual(scene) == (
        ("why", rule.action in (Action.LAND, Action.CUT)),
        False,
    )


@virtual
async def test_a_landing_on_command_is_not_grave_and_a_cut_is(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.land("landing on command")
    assert (drone.pilot.notes.text, drone.pilot.notes.is_grave) == (
        "landing on command",
        False,
    )
    drone.pilot.cut("emergency stop")
    assert (drone.pilot.notes.text, drone.pilot.notes.is_grave) == (
        "emergency stop",
        True,
    )


def test_a_line_names_its_drone_once_and_says_what_one_on_the_ground_does(caplog):
    async def scene(clock):
        drone = Flown(clock)
        await drone.hovering()
        await drone.fly(drone.pilot.land("drone 0: lost") + 1.0)
        drone.pilot.guidance_failed("no idea")

    run_virtual(scene)
    assert caplog.messages == [
        "drone 0: lost",
        "drone 0: guidance failed (no idea): stays on the ground",
    ]


@virtual
async def test_a_path_out_of_the_fence_at_the_speed_limit_ends_in_hovering_at_the_fence(
    clock,
):
    await led_out(clock, lambda t: FullState.at([t, 0.0, 1.0], [1.0, 0.0, 0.0]))


@virtual
async def test_a_place_outside_the_fence_ends_in_hovering_at_the_fence(clock):
    await led_out(clock, lambda t: FullState.at([9.0, 0.0, 1.0]))


@virtual
async def test_an_acceleration_out_of_the_fence_ends_in_hovering_at_the_fence(clock):
    await led_out(clock, lambda t: Acceleration([2.0, 0.0, 0.0]))


@pytest.mark.parametrize("aside", [True, False])
def test_a_hover_may_be_asked_for_in_each_step_even_after_being_pushed_aside(aside):
    @virtual
    async def case(clock):
        drone = Flown(clock)
        await drone.hovering()
        await drone.fly(
            0.5, each=lambda: drone.pilot.follow(Acceleration([1.5, 0.0, 0.0]))
        )

        def hover():
            drone.pilot.follower.clearance.aside = aside
            drone.pilot.hover()

        await drone.fly(1.5, each=hover)
        assert np.linalg.norm(drone.pilot.state.v) < 0.05
        assert drone.p[0] < 0.6

    case()


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
async def test_when_guidance_has_failed_before_the_take_off_it_stays_on_the_ground(
    clock,
):
    drone = Flown(clock)
    drone.pilot.guidance_failed("no idea")
    assert drone.pilot.notes.text == "guidance failed (no idea): stays on the ground"
    await drone.fly(GIVE_UP_HOVER + 1.0)
    assert drone.pilot.mode is Mode.GROUND
    assert "landing" not in drone.pilot.notes.text


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
    assert drone.pilot.notes.text == "that is enough"


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
    assert drone.pilot.row.flown.p == pytest.approx(state.p)
    assert drone.pilot.row.flown.v == pytest.approx(state.v)
    await drone.fly(3.0)
    assert np.linalg.norm(drone.world.state(0).v) < 0.02


@virtual
async def test_poses_that_are_not_numbers_are_no_poses(clock):
    drone = Flown(clock)
    await drone.hovering()
    for _ in range(round(2.5 / TICK)):
        await clock.sleep(TICK)
        tick(drone.pilot, Pose(np.full(7, np.nan), 0.0))
    assert drone.pilot.mode is Mode.CUT, "as if the cameras saw nothing for 2 s"


@virtual
async def test_references_of_another_shape_or_kind_are_not_flown(clock):
    drone = Flown(clock)
    await drone.hovering()
    for bad in (
        FullState(np.zeros(13)),
        Acceleration(np.zeros(2)),
        drone.pilot.state,
        None,
    ):
        await drone.fly(0.2, each=lambda bad=bad: drone.pilot.follow(bad))
        assert "not flown" in drone.pilot.notes.text
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
async def test_a_held_drone_lands_for_its_operator_and_for_safety_but_not_for_guidance(
    clock,
):
    for why in ("landing on command", "pose"):
        drone = Flown(clock)
        await drone.hovering()
        drone.pilot.hold()
        assert drone.pilot.land() == 0.0
        await drone.fly(0.5)
        assert drone.pilot.mode is Mode.HOVER
        if why == "pose":
            await drone.fly(0.8, poses=False)
        else:
            assert drone.pilot.land(why) > 0.0
        assert drone.pilot.mode is Mode.LAND
        assert why in drone.pilot.notes.text


@virtual
async def test_a_drone_at_rest_after_its_descent_has_landed_whatever_height_the_cameras_say(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    object.__setattr__(drone.pilot.setup, "limits", FlightTable(ground=-0.3))
    drone.pilot.land()
    await drone.fly(drone.pilot.remaining() + TOUCHDOWN_LIMITS.overdue_time - 0.1)
    assert drone.pilot.mode is Mode.LAND
    await drone.fly(0.2)
    assert drone.pilot.mode is Mode.GROUND


# Limits of references -----------------------------------------------------------------------------------------------


def fastest(drone, since):
    """Largest speed m/s and acceleration m/s2 on the way, from the truth."""
    v = np.diff(drone.track[since:], axis=0) / TICK
    a = np.diff(v, axis=0) / TICK
    return np.linalg.norm(v, axis=1).max(), np.linalg.norm(a, axis=1).max()


@virtual
async def test_a_reference_far_away_that_comes_back_after_braking_is_flown_to_within_the_limits(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(1.0, each=lambda: drone.pilot.follow(FullState.at([0.0, 0.0, 1.0])))
    await drone.fly(1.5)
    assert "braking" in drone.pilot.notes.text
    since = len(drone.track)
    await drone.fly(6.0, each=lambda: drone.pilot.follow(FullState.at([2.5, 1.5, 1.0])))
    speed, acceleration = fastest(drone, since)
    assert drone.p == pytest.approx([2.5, 1.5, 1.0], abs=0.02)
    assert 0.8 * FlightTable().speed_limit < speed < 1.05 * FlightTable().speed_limit
    assert acceleration < 1.2 * FlightTable().acceleration_limit


@virtual
async def test_a_full_state_that_runs_away_is_followed_within_the_limits(clock):
    drone = Flown(clock)
    await drone.hovering()
    since, t0 = len(drone.track), clock.now()

    def away():
        t = clock.now() - t0
        drone.pilot.follow(
            FullState.at([2.0 * t**2, 0.0, 1.0], [4.0 * t, 0.0, 0.0], [4.0, 0.0, 0.0])
        )

    await drone.fly(1.3, each=away)
    speed, acceleration = fastest(drone, since)
    assert 1.5 * FlightTable().speed_limit < speed < 2.05 * FlightTable().speed_limit
    assert (
        FlightTable().acceleration_limit
        < acceleration
        < 2.1 * FlightTable().acceleration_limit
    )


@virtual
async def test_an_acceleration_beyond_the_limit_is_cut_to_it(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.follower.limits = ReferenceLimits(
        FlightTable(speed_limit=20.0), STANDARD_GAINS
    )
    since = len(drone.track)
    await drone.fly(1.5, each=lambda: drone.pilot.follow(Acceleration([5.0, 5.0, 0.0])))
    _, acceleration = fastest(drone, since)
    assert acceleration == pytest.approx(FlightTable().acceleration_limit, rel=0.15)
    assert drone.p[0] == pytest.approx(drone.p[1], abs=0.01), "its direction stays"


@virtual
async def test_its_state_tells_what_it_has_commanded_after_the_limits(clock):
    drone, told = Flown(clock), []
    drone.bus.subscribe(
        DRONE_TOPICS.state,
        0,
        0,
        Call(clock, lambda state, age: told.append(state.a.tolist())),
    )
    await drone.fly(0.05)
    assert told[-1] == [0.0, 0.0, 0.0], "on the ground"
    await drone.fly(drone.pilot.take_off() + 0.5)
    wanted = [0.8, -0.4, 0.0]
    await drone.fly(
        0.2, each=lambda: drone.pilot.follow(Acceleration(np.array(wanted)))
    )
    assert told[-1] == pytest.approx(wanted, abs=1e-9)
    await drone.fly(
        0.1, each=lambda: drone.pilot.follow(Acceleration(np.array([40.0, 0.0, 0.0])))
    )
    assert told[-1] == pytest.approx(
        [FlightTable().acceleration_limit, 0.0, 0.0], abs=1e-9
    )
    drone.pilot.hover()
    await drone.fly(0.2)
    assert told[-1][0] < -0.2, "it brakes"
    drone.pilot.cut("test")
    await drone.fly(0.02)
    assert told[-1] == [0.0, 0.0, 0.0]


@virtual
async def test_references_are_cut_by_the_gains_that_fly(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.follower.set_parameter("control.kp", [5.0, 5.0, 9.0])
    far = FullState.at((2.0, 0.0, 1.0))
    cut = drone.pilot.follower.limits.full_state(far, drone.pilot.state)
    pull = 5.0 * (cut.p[0] - drone.pilot.state.p[0])
    assert pull == pytest.approx(FlightTable().acceleration_limit, rel=0.05)


async def accelerated(clock, period):
    """Wants 2 m/s2 for 6 s, in every `period`-th tick."""
    drone = Flown(clock, fence=((-3.0, -3.0, 0.0), (30.0, 3.0, 2.5)))
    await drone.hovering()
    since, ticks = len(drone.track), iter(range(10**6))

    def wanted():
        return next(ticks) % period or drone.pilot.follow(Acceleration([2.0, 0.0, 0.0]))

    await drone.fly(6.0, each=wanted)
    speed, _ = fastest(drone, since)
    assert 0.95 * FlightTable().speed_limit < speed < 1.2 * FlightTable().speed_limit
    assert drone.p[0] > 4.0
    assert drone.p[2] == pytest.approx(1.0, abs=0.1)


@virtual
async def test_an_acceleration_that_goes_on_leads_to_the_speed_limit_and_no_further(
    clock,
):
    for period in (1, 25):
        await accelerated(clock, period)


# The floor ----------------------------------------------------------------------------------------------------------


DOWNWARDS = (
    Acceleration([0.0, 0.0, -2.0]),
    Acceleration([1.0, 0.0, -1.0]),
    FullState.at((0.0, 0.0, -3.0), (0.0, 0.0, -1.0)),
    Goto((0.0, 0.0, -3.0)),
)


async def led_down(clock, reference):
    """Follows a reference towards the floor for 4 s."""
    drone = Flown(clock, fence=((-3.0, -3.0, -1.0), (9.0, 3.0, 2.5)))
    await drone.hovering()
    await drone.fly(4.0, each=lambda: drone.pilot.follow(reference))
    assert drone.world.impact[0] < 0.05
    assert drone.pilot.airborne


@virtual
async def test_what_leads_into_the_floor_is_stopped_above_it(clock):
    for reference in DOWNWARDS:
        await led_down(clock, reference)


@virtual
async def test_the_fence_has_its_floor_where_that_is_above_the_ground(clock):
    drone = Flown(clock, fence=((-3.0, -3.0, 0.5), (3.0, 3.0, 2.5)))
    await drone.hovering()
    since = len(drone.track)
    await drone.fly(
        4.0, each=lambda: drone.pilot.follow(Acceleration([0.0, 0.0, -1.0]))
    )
    assert 0.45 < min(p[2] for p in drone.track[since:]) < 0.6
    await drone.fly(drone.pilot.go_to([0.0, 0.0, 0.0]) + 1.0)
    assert 0.48 < drone.p[2] < 0.62
    await drone.fly(drone.pilot.land() + 1.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.world.impact[0] < 1.0
    assert not drone.pilot.guard.latched


@virtual
async def test_a_fall_is_stopped_with_what_the_motors_can(clock):
    drone = Flown(clock)
    limits, fence = (
        FlightTable(speed_limit=3.0, acceleration_limit=20.0),
        Fence.box((-3.0, -3.0, 0.0), (3.0, 3.0, 4.5)),
    )
    drone.pilot = make_pilot(
        drone.bus.port(1), SimulatedLink(drone.world, 0), limits, fence
    )
    await drone.fly(0.05)
    await drone.fly(drone.pilot.take_off(4.0) + 0.5)
    since = len(drone.track)
    await drone.fly(
        3.0, each=lambda: drone.pilot.follow(Acceleration([0.0, 0.0, -9.0]))
    )
    speed, _ = fastest(drone, since)
    assert speed > 2.5
    assert drone.world.impact[0] < 0.5


@virtual
async def test_a_drone_that_brakes_at_the_fence_stops_first_and_then_goes_inside(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    t0, plans = clock.now(), []

    def out():
        t = clock.now() - t0
        drone.pilot.follow(FullState.at([0.5 * t, 0.0, 1.0], [0.5, 0.0, 0.0]))
        if drone.pilot.row.obeyed is Action.BRAKE:
            plans.append(drone.pilot.flights.plan)

    await drone.fly(6.5, each=out)
    way = [plans[0].sample(t) for t in np.linspace(0.0, plans[0].duration, 100)]
    assert max(flown.p[0] for flown in way) <= plan_stop(way[0], 2.0).goal[0] + 1e-9
    assert way[-1].p[0] == pytest.approx(3.0 - FENCE_INSET)


# Without cameras ----------------------------------------------------------------------------------------------------


def tilt(drone):
    """Degrees from upright, the truth."""
    x, y, *_ = drone.world.state(0).q
    return np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x**2 + y**2), -1.0, 1.0)))


LIVELY = {
    "hovering": None,
    "a FullState": lambda t: FullState.at(
        (np.sin(t), 0.0, 1.0), (np.cos(t), 0.0, 0.0), (-np.sin(t), 0.0, 0.0)
    ),
    "an Acceleration": lambda t: Acceleration(
        [1.5 * np.sin(2.5 * t), 1.5 * np.cos(2.5 * t), 0.0]
    ),
}
PLANTS = (
    {},
    {"lags": InputLags(rates=0.03, delay=0.02)},
    {"lags": InputLags(rates=0.086)},
)


async def unseen(clock, reference, plant):
    """Loses its poses for 1.9 s while it follows `reference(t)`."""
    drone = Flown(clock, plant=plant, noise=0.0005)
    await drone.hovering()
    t0, lean = clock.now(), []

    def fly():
        if reference is not None:
            drone.pilot.follow(reference(clock.now() - t0))

    await drone.fly(2.3, each=fly)
    await drone.fly(1.9, poses=False, each=lambda: (fly(), lean.append(tilt(drone))))
    assert drone.pilot.mode is Mode.LAND
    assert max(lean) < 20.0
    assert max(lean[120:]) < 5.0
    assert drone.p[2] > 0.3
    assert np.linalg.norm(drone.world.state(0).v[:2]) < 0.25
    assert np.linalg.norm(drone.pilot.state.p - drone.p) < 0.25
    await drone.fly(drone.pilot.remaining() + 1.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.world.impact[0] < 1.0


@virtual
async def test_a_drone_that_is_not_seen_comes_to_rest_level_and_lands(clock):
    for what, plant in itertools.product(LIVELY, PLANTS):
        await unseen(clock, LIVELY[what], plant)


async def unseen_take_off(clock, after):
    """Loses its poses for 1.5 s, `after` s of its take-off."""
    drone = Flown(
        clock, plant={"lags": InputLags(rates=0.03, delay=0.02)}, noise=0.0005
    )
    await drone.fly(0.05)
    drone.pilot.take_off()
    await drone.fly(after)
    lean = []
    await drone.fly(1.5, poses=False, each=lambda: lean.append(tilt(drone)))
    assert max(lean) < 10.0
    assert drone.p[2] < 1.2
    await drone.fly(drone.pilot.remaining() + 1.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.world.impact[0] < 1.0
    assert not drone.pilot.guard.latched


@virtual
async def test_a_take_off_that_is_not_seen_ends_in_a_soft_landing(clock):
    for after in (0.2, 0.6, 1.2):
        await unseen_take_off(clock, after)


@virtual
async def test_a_drone_on_the_ground_stands_there_while_it_is_not_seen(clock):
    drone = Flown(clock, noise=0.0005)
    await drone.fly(0.5)
    for _ in range(30):
        await drone.fly(0.1, poses=False)
        assert np.linalg.norm(drone.pilot.state.p) < 0.005
    assert drone.pilot.state.v == pytest.approx(np.zeros(3))
    assert drone.pilot.take_off() > 0.0


# Goals again and again ----------------------------------------------------------------------------------------------


async def gone_to(clock, duration):
    """Wants the same place in every tick, then another."""
    drone = Flown(clock)
    await drone.hovering()
    place, plans = np.array([1.0, 0.5, 1.2]), set()

    def again():
        drone.pilot.follow(Goto(place, 0.3, duration))
        plans.add(id(drone.pilot.flights.plan))

    await drone.fly(1.5, each=again)
    assert drone.p[0] > 0.1
    await drone.fly(3.0, each=again)
    assert drone.p == pytest.approx(place, abs=0.03)
    assert len(plans) == 1
    place[:] = (0.0, 0.0, 1.0)
    await drone.fly(5.0, each=again)
    assert drone.p == pytest.approx(place, abs=0.03), "the same array, another place"


@virtual
async def test_a_goto_in_every_step_is_one_flight(clock):
    for duration in (0.0, 4.0):
        await gone_to(clock, duration)


@virtual
async def test_a_goto_that_moves_is_flown_after(clock):
    drone = Flown(clock)
    await drone.hovering()
    t0 = clock.now()
    await drone.fly(
        4.0, each=lambda: drone.pilot.follow(Goto([0.3 * (clock.now() - t0), 0.0, 1.0]))
    )
    assert drone.p[0] > 0.4
    here = Goto([1.2, 0.0, 1.0])
    await drone.fly(4.0, each=lambda: drone.pilot.follow(here))
    assert drone.p == pytest.approx(here.p, abs=0.03)


@virtual
async def test_a_repeated_goto_is_flown_anew_after_something_else(clock):
    drone = Flown(clock)
    await drone.hovering()
    goal = Goto([1.0, 0.0, 1.0])
    drone.pilot.follow(goal)
    await drone.fly(1.0)
    for otherwise in (
        drone.pilot.hover,
        lambda: drone.pilot.follow(Acceleration([-1.0, 0.0, 0.0])),
    ):
        otherwise()
        await drone.fly(0.2)
        otherwise()
        drone.pilot.follow(goal)
        await drone.fly(4.0)
        assert drone.p == pytest.approx(goal.p, abs=0.03)


# For good -----------------------------------------------------------------------------------------------------------


@virtual
async def test_a_drone_that_had_to_land_for_the_fence_returns_inside_and_stays_down(
    clock,
):
    drone = Flown(clock, fence=((-0.5, -0.5, -0.2), (0.5, 0.5, 2.0)))
    await drone.hovering()
    t0 = clock.now()
    await drone.fly(
        0.8, drift=lambda: min(4.0 * (clock.now() - t0), 0.9)
    )  # the cameras are moved
    assert drone.pilot.mode is Mode.LAND
    await drone.fly(drone.pilot.remaining() + 1.0, drift=lambda: 0.9)
    assert drone.pilot.mode is Mode.GROUND, drone.pilot.notes.text
    assert drone.p[0] + 0.9 < 0.45
    assert drone.pilot.take_off() == 0.0
    assert (
        "m outside the fence, limit 0.25 m: landing, for good: no take-off until"
        in drone.pilot.notes.text
    )
    await drone.fly(1.0)
    assert drone.p[2] == pytest.approx(0.0, abs=1e-6)


@virtual
async def test_an_emergency_stop_that_is_cleared_does_not_start_motors_that_it_cut(
    clock,
):
    flying, waiting = Flown(clock), Flown(clock)
    await waiting.fly(0.1)
    await flying.hovering()
    for drone in (flying, waiting):
        drone.bus.stopped = True
    flying.pilot.cut("emergency stop")
    assert waiting.pilot.take_off() == 0.0
    assert "stop --clear" in waiting.pilot.notes.text
    for drone in (flying, waiting):
        drone.bus.stopped = False
    assert flying.pilot.take_off() == 0.0
    assert (
        flying.pilot.notes.text
        == "emergency stop: no take-off until its agent is started again"
    )
    assert waiting.pilot.take_off() > 0.0, (
        "its agent was started after the stop, its motors were never cut"
    )


@virtual
async def test_a_height_of_zero_is_a_height_and_flown_as_low_as_the_fence_allows(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    assert drone.pilot.take_off(0.0) < drone.pilot.setup.limits.takeoff_height
    await drone.fly(3.0)
    assert drone.p[2] == pytest.approx(FENCE_INSET, abs=0.01)


@virtual
async def test_a_take_off_ends_inside_the_fence_and_needs_a_number(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    for bad in (np.nan, np.inf):
        assert drone.pilot.take_off(bad) == 0.0
        assert drone.pilot.mode is Mode.GROUND
    await drone.fly(drone.pilot.take_off(9.0) + 1.0)
    assert drone.pilot.mode is Mode.HOVER
    assert drone.p[2] == pytest.approx(2.4, abs=0.02)
    assert drone.pilot.notes.text == "a take-off to inf m: not flown"


@virtual
async def test_a_place_that_is_none_changes_nothing(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.follow(Acceleration([0.1, 0.0, 0.0]))
    with pytest.raises(ConfigError, match="goal"):
        drone.pilot.go_to([np.nan, 0.0, 1.0])
    assert drone.pilot.mode is Mode.FOLLOW


# Coming to rest -----------------------------------------------------------------------------------------------------


@virtual
async def test_a_landing_under_way_stops_at_once_and_takes_the_time_that_it_promised(
    clock,
):
    drone, height = Flown(clock), 2.0
    await drone.hovering()
    await drone.fly(drone.pilot.go_to([0.0, 0.0, height]) + 0.5)
    t0 = clock.now()
    await drone.fly(
        1.5,
        each=lambda: drone.pilot.follow(
            FullState.at([clock.now() - t0, 0.0, height], [1.0, 0, 0])
        ),
    )
    here, speed, since = drone.p[0], drone.world.state(0).v[0], len(drone.track)
    seconds, t0 = drone.pilot.land(), clock.now()
    while drone.pilot.airborne:
        await drone.fly(0.01)
    assert clock.now() - t0 == pytest.approx(seconds, abs=0.2)
    assert (
        max(p[0] for p in drone.track[since:]) - here
        < STOP_DISTANCE * speed**2 / 2.0 + 0.05
    )
    assert drone.p[0] - here > 0.3
    assert drone.pilot.mode is Mode.GROUND


@virtual
async def test_a_landing_during_the_take_off_rises_no_further_than_its_stop(clock):
    drone = Flown(clock, fence=((-3.0, -3.0, -0.2), (3.0, 3.0, 4.0)))
    await drone.fly(0.05)
    drone.pilot.take_off(3.0)
    await drone.fly(3.2)
    z, speed = drone.p[2], drone.world.state(0).v[2]
    assert speed > 0.8
    drone.pilot.land()
    await drone.fly(20.0)
    assert max(p[2] for p in drone.track) < z + 0.6
    assert drone.pilot.mode is Mode.GROUND


@virtual
async def test_a_landing_near_the_fence_stays_inside(clock):
    drone = Flown(clock)
    await drone.hovering()
    t0 = clock.now()
    path = lambda: FullState.at([clock.now() - t0, 0.0, 1.0], [1.0, 0.0, 0.0])  # noqa: E731
    await drone.fly(2.4, each=lambda: drone.pilot.follow(path()))
    drone.pilot.land("landing on command")
    await drone.fly(11.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.pilot.notes.text == "landing on command"
    assert max(p[0] for p in drone.track) < 3.0


@virtual
async def test_a_landing_outside_the_fence_comes_down_inside(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.flights.fence = Fence.box((-3.0, 0.2, -0.2), (-0.1, 3.0, 2.5))
    await drone.fly(drone.pilot.land() + 0.5)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.p == pytest.approx([-0.2, 0.3, 0.0], abs=0.02)


@virtual
async def test_hovering_ends_a_flight_under_way_and_leaves_one_at_rest_alone(clock):
    drone = Flown(clock)
    await drone.hovering()
    plan = drone.pilot.flights.plan
    drone.pilot.hover()
    assert drone.pilot.flights.plan is plan
    drone.pilot.go_to([2.5, 0.0, 1.0])
    await drone.fly(2.0)
    here = drone.p[0]
    drone.pilot.hold()
    await drone.fly(4.0)
    assert drone.p[0] - here < 0.6
    assert np.linalg.norm(drone.world.state(0).v) < 0.02
    assert drone.pilot.mode is Mode.HOVER


@virtual
async def test_after_guidance_has_failed_in_a_flight_it_hovers(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.go_to([2.5, 0.0, 1.0])
    await drone.fly(2.0)
    here = drone.p[0]
    drone.pilot.guidance_failed("no idea")
    await drone.fly(GIVE_UP_HOVER - 0.1)
    assert drone.p[0] - here < 0.6
    assert np.linalg.norm(drone.world.state(0).v) < 0.02


@virtual
async def test_after_guidance_has_failed_in_a_flight_on_command_it_hovers_too_and_lands(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.hold()
    drone.pilot.go_to([2.5, 0.0, 1.0], commanded=True)
    await drone.fly(2.0)
    here = drone.p[0]
    drone.pilot.guidance_failed("no idea")
    assert drone.pilot.go_to([2.5, 0.0, 1.0], commanded=True) == 0.0
    await drone.fly(GIVE_UP_HOVER - 0.1)
    assert drone.p[0] - here < 0.6
    assert np.linalg.norm(drone.world.state(0).v) < 0.02
    await drone.fly(9.0)
    assert drone.pilot.mode is Mode.GROUND


@virtual
async def test_a_held_drone_stays_on_the_ground(clock):
    drone = Flown(clock)
    await drone.fly(0.05)
    drone.pilot.hold()
    assert drone.pilot.take_off() == 0.0
    assert drone.pilot.mode is Mode.GROUND
    drone.pilot.hold(on=False)
    assert drone.pilot.take_off() > 0.0


@virtual
async def test_no_flight_begins_while_the_safety_table_brakes(clock):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(0.2, poses=False)
    plan = drone.pilot.flights.plan
    assert drone.pilot.go_to([2.0, 0.0, 1.0]) == 0.0
    drone.pilot.follow(Goto([2.0, 0.0, 1.0]))
    assert drone.pilot.flights.plan is plan
    await drone.fly(1.0)
    assert drone.pilot.go_to([2.0, 0.0, 1.0]) > 0.0


@virtual
async def test_a_flight_may_begin_where_references_were_missing_and_a_lost_pose_still_brakes_it(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.follow(Acceleration([0.0, 0.0, 0.0]))
    await drone.fly(1.0)
    assert drone.pilot.row.obeyed is Action.BRAKE
    assert drone.pilot.go_to([2.0, 0.0, 1.0]) > 0.0
    plan = drone.pilot.flights.plan
    await drone.fly(0.2)
    assert drone.pilot.flights.plan is plan
    await drone.fly(0.2, poses=False)
    assert drone.pilot.flights.plan is not plan


@virtual
async def test_a_pose_that_is_lost_in_the_first_tick_of_a_flight_brakes_it(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.follow(Acceleration([0.0, 0.0, 0.0]))
    await drone.fly(1.0)
    await drone.fly(0.05, poses=False)
    await clock.sleep(0.04)
    assert drone.pilot.go_to([2.0, 0.0, 1.0]) > 0.0
    plan = drone.pilot.flights.plan
    await clock.sleep(0.05)
    tick(drone.pilot, None)
    assert drone.pilot.flights.plan is not plan


@virtual
async def test_a_jerk_that_nothing_bears_out_does_not_overturn_it(clock):
    drone = Flown(clock)
    await drone.hovering()
    place, lean = drone.p.copy(), []

    def shake():
        drone.pilot.follow(FullState.at(place, j=[80.0, 0.0, 0.0], yaw_rate=1e4))
        x, y, *_ = drone.world.state(0).q
        lean.append(np.degrees(np.arccos(1.0 - 2.0 * (x**2 + y**2))))

    await drone.fly(1.5, each=shake)
    assert max(lean) < 20.0
    assert drone.p[2] == pytest.approx(1.0, abs=0.1)
    assert abs(drone.world.state(0).w[2]) < 2.0


# Ticks that fail ----------------------------------------------------------------------------------------------------


class Frail:
    """A link that raises if `fails` says so for a command; other commands are kept in `sent`: (s, command)."""

    def __init__(self, link, clock):
        self.link, self.clock = link, clock
        self.fails, self.sent = lambda command: False, []

    def send(self, command):
        if self.fails(command):
            raise OSError("one failed write")
        self.sent.append((self.clock.now(), command))
        self.link.send(command)

    def cut(self):
        self.link.cut()


class Supervised(Flown):
    """Its poses come over the bus, and a supervisor starts its pilot again."""

    def __init__(self, clock):
        super().__init__(clock)
        self.link = self.pilot.body.link = Frail(self.pilot.body.link, clock)
        self.bus.subscribe(DRONE_TOPICS.pose, 0, 0, Call(clock, self.pilot.see))
        self.failures, self.given_up = [], False
        self.life = asyncio.ensure_future(
            Supervisor(clock, "drone 0", self.failed).run([self.pilot])
        )

    def failed(self, actor, error, again):
        self.failures.append(error)
        self.given_up = not again

    async def fly(self, seconds):
        """Let it fly."""
        for _ in range(round(seconds / TICK)):
            await self.clock.sleep(TICK)
            for _ in range(round(TICK / self.world.dt)):
                self.world.step()
            truth = self.world.state(0)
            self.pilot.port.publish(
                DRONE_TOPICS.pose, Pose(truth.flat[[0, 1, 2, 6, 7, 8, 9]], 0.0)
            )
            self.pilot.tick.run()
            self.track.append(truth.p)

    async def land(self, height):
        """Until it lands and is lower than `height` m."""
        self.pilot.land()
        while self.p[2] > height:
            await self.fly(TICK)

    async def end(self):
        """No task is left."""
        self.life.cancel()
        await asyncio.gather(self.life, return_exceptions=True)


def once():
    """True the first time."""
    turns = iter([True])
    return lambda *_: next(turns, False)


@virtual
async def test_no_state_comes_from_the_future_though_a_pose_comes_early(clock):
    """The filter takes an early pose to be measured a little later. Others would refuse such a state."""
    drone, ages = Flown(clock), []
    batch = drone.pilot.tick.batch
    await drone.hovering()
    for wait in (1.0, 0.85, 1.15, 0.9):
        await clock.sleep(wait * TICK)
        pose = Pose(drone.world.state(0).flat[[0, 1, 2, 6, 7, 8, 9]], 0.0)
        tick(drone.pilot, drone.pilot.stages.receive_pose(pose, 0.0))
        ages.append(float(batch.filters.rows[0]["age"]))
        assert drone.pilot.state.age >= 0.0
    assert min(ages) < -0.001


@virtual
async def test_a_pose_with_an_age_of_nan_is_accepted_as_current(clock):
    drone = Supervised(clock)
    await drone.hovering()
    truth = drone.world.state(0)
    drone.pilot.port.publish(
        DRONE_TOPICS.pose, Pose(truth.flat[[0, 1, 2, 6, 7, 8, 9]], np.nan)
    )
    drone.pilot.tick.run()
    await drone.fly(0.5)
    assert (drone.failures, drone.pilot.mode) == ([], Mode.HOVER)
    await drone.end()


@virtual
async def test_a_failed_tick_while_landing_lands_it_softly(clock):
    drone = Supervised(clock)
    await drone.hovering()
    await drone.land(0.6)
    drone.link.fails = once()
    since = len(drone.track)
    while drone.pilot.airborne:
        await drone.fly(TICK)
    assert len(drone.failures) == 1
    assert drone.p[2] < 0.05
    assert np.diff([p[2] for p in drone.track[since:]]).min() / TICK > -0.6
    assert drone.pilot.mode is Mode.GROUND
    await drone.end()


@virtual
async def test_at_rest_without_a_landing_that_is_over_is_not_down(clock):
    drone = Flown(clock)
    await drone.hovering()
    drone.pilot.row.mode = Mode.LAND
    await drone.fly(4.0)
    assert drone.pilot.mode is Mode.LAND
    assert drone.p[2] == pytest.approx(1.0, abs=0.05)


@virtual
async def test_after_a_failed_tick_the_drone_is_steadied_and_commanded_again_at_the_next_pose(
    clock,
):
    drone = Supervised(clock)
    await drone.hovering()
    drone.pilot.go_to([2.0, 0.0, 1.0])
    await drone.fly(1.5)
    drone.link.fails = once()
    failed_at, count = clock.now(), len(drone.link.sent)
    await drone.fly(0.05)
    times, commands = zip(*drone.link.sent[count:], strict=True)
    assert times[0] == pytest.approx(failed_at + TICK)
    np.testing.assert_array_equal(
        commands[0].flat, [PAPER_PLATFORM.weight, 0.0, 0.0, 0.0]
    )
    assert np.diff(times) == pytest.approx(TICK)
    assert drone.pilot.mode is Mode.HOVER
    await drone.fly(2.0)
    assert np.linalg.norm(drone.world.state(0).v) < 0.05
    await drone.end()


@virtual
async def test_a_link_that_fails_for_a_third_of_a_second_is_survived_and_one_for_good_is_given_up(
    clock,
):
    drone = Supervised(clock)
    await drone.hovering()
    start = clock.now()
    drone.link.fails = lambda command: clock.now() < start + 0.35
    await drone.fly(2.0)
    assert len(drone.failures) == pytest.approx(35, abs=1)
    assert drone.pilot.mode is Mode.HOVER
    assert np.linalg.norm(drone.world.state(0).v) < 0.05
    drone.link.fails = lambda command: True
    await drone.fly(0.3)
    assert drone.given_up
    assert "no command reaches the drone" in drone.pilot.notes.text
    await drone.end()


@virtual
async def test_a_failed_tick_is_hidden_from_the_pose_source_but_a_process_exit_is_not(
    clock,
):
    drone = Supervised(clock)
    await drone.hovering()
    for error in (
        asyncio.CancelledError("a job of somebody"),
        StopIteration(),
        GeneratorExit(),
        KeyError("x"),
    ):
        raised = once()

        def fails(command, raised=raised, error=error):
            if raised():
                raise error
            return False

        drone.link.fails, before = fails, len(drone.failures)
        await drone.fly(0.5)
        assert len(drone.failures) == before + 1, error
        assert type(error).__name__ in repr(drone.failures[-1])
    assert drone.pilot.mode is Mode.HOVER
    for error in (KeyboardInterrupt, SystemExit):
        drone.link.fails = lambda command, error=error: (_ for _ in ()).throw(error)
        drone.pilot.see(None)
        with pytest.raises(error):
            drone.pilot.tick.run()
    await drone.end()


@virtual
async def test_a_drone_that_landed_for_silence_flies_again_when_it_hears_the_others(
    clock,
):
    drone, others = Flown(clock), (1, 2)
    for j in others:
        drone.bus.port(j)
    rules = AirspaceRules(CollisionTable(), 1.0, 0.0)
    airspace = Airspace(drone.bus, (0, *others), rules)
    traffic = Neighbours(airspace, 0, keeps_all=True)
    room = Fence.box((-3.0, -3.0, 0.0), (3.0, 3.0, 2.5))
    flight_tick = FlightTick(drone.bus)
    flight_tick.airspace = airspace
    row = flight_tick.batch.add(0)
    drone.pilot = make_pilot(
        drone.bus.ports[0],
        SimulatedLink(drone.world, 0),
        FlightTable(takeoff_height=0.3),
        room,
        collision=CollisionFilter(
            CollisionTable(), traffic, room, 2.0, 1.0, 0.0, row.avoid
        ),
        shared=flight_tick,
        row=row,
    )

    def heard():
        for j in others:
            traffic.hear((j, State.at((2.0, 6.0 - 4.0 * j, 1.0))), 0.0)

    await drone.fly(0.05, each=heard)
    await drone.fly(drone.pilot.take_off() + 0.5, each=heard)
    assert drone.pilot.mode is Mode.HOVER
    await drone.fly(NEIGHBOUR_AGES.silent + CLEARANCE_TIMES.cut_off_timeout + 2.0)
    assert drone.pilot.mode is Mode.GROUND
    assert "hears no more than half" in drone.pilot.notes.text
    await drone.fly(1.0, each=heard)
    await drone.fly(drone.pilot.take_off() + 0.5, each=heard)
    assert drone.pilot.mode is Mode.HOVER
    assert drone.p[2] == pytest.approx(0.3, abs=0.02)


@virtual
async def test_a_body_that_is_seen_outside_is_cut_though_it_may_be_another_and_one_inside_is_not(
    clock,
):
    for far, seconds, cut in ((2.0, 0.4, False), (9.0, 0.15, False), (9.0, 0.3, True)):
        drone = Flown(clock, reached="seen")
        await drone.hovering()
        await drone.fly(seconds, drift=lambda far=far: far)
        assert (drone.pilot.mode is Mode.CUT) is cut, (far, seconds)
        assert drone.p == pytest.approx([0.0, 0.0, 1.0], abs=0.2), (
            "a pose that jumps does not move the drone"
        )
    assert "seen 5.50 m outside the limit area: motors cut" in drone.pilot.notes.text
    drone = Flown(clock, reached="seen")
    await drone.hovering()
    await drone.fly(0.3, poses=False)
    await drone.fly(0.02, drift=lambda: 9.0)
    assert drone.pilot.airborne, "one frame after a gap does not count"


@virtual
async def test_a_drone_that_has_come_down_by_itself_does_not_push_the_floor(clock):
    for silent, why in ((0.1, ""), (1.5, "its radio is silent for 1.50 s, and it is ")):
        drone = Flown(clock, reached="seen")
        await drone.hovering()
        drone.pilot.guard.tell("link", silent)
        began = clock.now()
        await drone.fly(
            1.9, sinks=lambda z, began=began: max(0.0, 1.0 - (clock.now() - began))
        )
        assert drone.pilot.airborne
        await drone.fly(0.3, sinks=lambda z: 0.0)
        assert drone.pilot.mode is Mode.GROUND
        assert (
            drone.pilot.notes.brought_down
            == f"{why}seen on the floor, where it should fly: landing"
        )


@virtual
async def test_a_drone_landing_for_another_reason_is_landed_by_its_firmware_when_unseen(
    clock,
):
    for measure in ("pose", "battery"):
        drone = Flown(clock, reached="seen")
        await drone.hovering()
        drone.pilot.body.link = link = Told(drone.pilot.body.link)
        if measure == "battery":
            drone.pilot.guard.tell("empty", 0.1)
            await drone.fly(0.1)
            assert not link.plans
        await drone.fly(0.7, poses=False)
        assert {plan.verb for plan in link.plans} == {"land"}, measure


@virtual
async def test_a_body_that_stays_on_the_floor_is_another_ones_unless_motors_stand_or_others_keep_it_down(
    clock,
):
    flights = (
        (True, None, Mode.CUT),
        (False, None, Mode.TAKEOFF),
        (True, 0.0, Mode.TAKEOFF),
        (True, 3.0, Mode.CUT),
    )
    for turns, evasion, mode in flights:
        drone = Flown(clock, reached="seen")
        drone.pilot.body.turning = turns
        await drone.fly(0.05)
        assert drone.pilot.take_off() > 1.5

        def evade(record=drone.pilot.row.drone, evasion=evasion):
            """Another drone has let it fly with this vertical acceleration."""
            if evasion is not None:
                safe = np.array([0.5, 0.0, evasion])
                _evade(record, safe, 1, True, clock.now())

        await drone.fly(1.5, sinks=lambda z: 0.0, each=evade)
        assert drone.pilot.mode is mode


class Deaf:
    """A planner on board that hears nothing, or everything: it is where it has been told to go."""

    def __init__(self, p):
        self.p, self.hears, self.sent = np.array(p), True, []

    def send(self, command):
        self.sent.append(command)
        if self.hears and command.verb == "line":
            self.p = command.flat[0:3].copy()

    def cut(self):
        raise AssertionError("cut in the air")


@virtual
async def test_a_landing_that_is_not_heard_begins_anew_where_the_drone_is_seen(clock):
    bus, link = Bus(clock), Deaf([0.0, 0.0, 0.02])
    fence = Fence.box((-3.0, -3.0, 0.0), (3.0, 3.0, 2.5))
    pilot = make_pilot(
        bus.port(0),
        link,
        FlightTable(),
        fence,
        controls=make_controls(ControlTable(sender="xyz")),
        reach="seen",
    )

    async def fly(seconds, silent=None, far=0.0):
        began = clock.now()
        while clock.now() - began < seconds and pilot.mode is not Mode.CUT:
            await clock.sleep(TICK)
            pilot.guard.tell(
                "link", 0.05 if silent is None else silent + clock.now() - began
            )
            tick(pilot, Pose(np.array([*link.p, 0.0, 0.0, 0.0, 1.0]), 0.0))
            far = max(far, link.p[2] - link.sent[-1].flat[2])
        return far

    await fly(0.1)
    await fly(pilot.take_off(1.0) + 0.5)
    link.hears, height = False, link.p[2]
    far = await fly(40.0, silent=0.0)
    assert far < 0.15, "the first line that it hears leads no further down"
    assert (pilot.mode, pilot.judge.touchdown.is_unreached, pilot.remaining()) == (
        Mode.LAND,
        True,
        0.0,
    ), "its mission need not wait"
    assert link.p[2] == height > 0.9
    link.hears = True
    await fly(0.2)
    assert link.p[2] > height - 0.15
    await fly(12.0)
    assert pilot.mode is Mode.GROUND
    assert link.p[2] < 0.06
    assert "its radio is silent for 4.0" in pilot.guard.latched


@virtual
async def test_a_landing_that_is_heard_though_nothing_is_answered_comes_down(clock):
    drone = Flown(clock, reached="seen")
    await drone.hovering()
    drone.pilot.setup.controls.sender.kind = "xyz"
    drone.pilot.guard.tell("link", 5.0)
    await drone.fly(20.0)
    assert drone.pilot.mode is Mode.GROUND
    assert drone.p[2] < 0.05


@virtual
async def test_the_next_flight_is_not_landed_for_a_pose_that_the_last_landing_lost(
    clock,
):
    drone = Flown(clock)
    await drone.hovering()
    await drone.fly(drone.pilot.land() - 0.7)
    await drone.fly(0.6, poses=False)
    assert drone.pilot.guard.acts
    await drone.fly(3.0)
    assert drone.pilot.mode is Mode.GROUND
    assert not drone.pilot.guard.acts
    await drone.fly(drone.pilot.take_off() + 0.5)
    assert drone.pilot.mode is Mode.HOVER


@virtual
async def test_a_landing_drone_is_handed_to_its_firmware_when_its_body_is_not_its_own(
    clock,
):
    drone = Flown(clock, reached="seen")
    await drone.hovering()
    drone.pilot.body.link = link = Told(drone.pilot.body.link)
    drone.pilot.guard.tell("empty", 0.1)
    await drone.fly(0.1)
    assert drone.pilot.mode is Mode.LAND
    assert not link.plans
    drone.pilot.body.astray = "is another's"
    await drone.fly(0.05)
    assert [plan.verb for plan in link.plans] == ["land"]
    await drone.fly(1.0)
    assert 4 <= len(link.plans) <= 7, (
        "said again, that its owner does not take its agent for gone"
    )


@virtual
async def test_late_frames_do_not_hide_a_body_outside_and_a_gap_does(clock):
    for pause, cut in ((0.02, True), (0.12, False)):
        drone = Flown(clock, reached="seen")
        pilot = drone.pilot
        await drone.hovering()
        pilot.body.link = Told(pilot.body.link)
        for _ in range(5):
            await drone.fly(0.05, drift=lambda: 9.0)
            for _ in range(round(pause / TICK)):
                await clock.sleep(TICK)
                pilot.see(None)
        assert (pilot.guard.told("gone") > 0.0) is cut, pause


@virtual
async def test_an_unseen_high_drone_has_the_time_that_its_landing_takes(clock):
    for height, seconds in ((1.0, 20.0), (8.0, 25.5)):
        drone = Flown(
            clock, fence=((-3.0, -3.0, -0.2), (3.0, 3.0, 10.0)), reached="seen"
        )
        await drone.fly(0.05)
        await drone.fly(drone.pilot.take_off(height) + 0.5)
        drone.pilot.body.link = Told(drone.pilot.body.link)
        await drone.fly(0.6, poses=False)
        (limit,) = (
            rule.limit
            for rule in drone.pilot.guard.table
            if rule.measure == "pose" and rule.latched
        )
        assert limit == pytest.approx(seconds, abs=0.5)


def test_a_repeated_warning_is_said_once(caplog):
    @virtual
    async def check(clock):
        drone = Flown(clock)
        await drone.hovering()
        await drone.fly(0.6, poses=False)

    check()
    said = [text for text in caplog.messages if "landing" in text]
    assert said == ["drone 0: pose 0.51 s old, limit 0.50 s: landing"]
