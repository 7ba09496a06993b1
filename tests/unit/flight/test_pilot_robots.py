"""The pilot of robots that do not fly: they stand where drones are on the ground, and stop where drones land."""

import numpy as np
import pytest
from pilots import make_pilot, tick
from robots import heading, world_of
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.tables import FlightTable
from crazychoir.control.robots import ROBOT_CONTROLS
from crazychoir.numerics.math3d import wrap_angle
from crazychoir.safety.rules.guard import Action, Fence
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.common.links import SimulatedLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.types import Acceleration, FullState, Goto, Pose, Velocity

TICK = 0.01
ROOM = Fence.box((-2.0, -2.0, 0.0), (2.0, 2.0, 2.0))
ALL = pytest.mark.parametrize(
    "uri",
    [WORLD_URIS.single_integrator, WORLD_URIS.double_integrator, WORLD_URIS.unicycle],
)


class Driven:
    """One robot, its pilot, and where it was."""

    def __init__(self, clock, uri, yaw=0.5):
        self.clock, self.bus, self.draw = clock, Bus(clock), np.random.default_rng(1)
        self.world, flight = (
            world_of(uri, [(0.3, -0.2, 0.0)], [yaw]),
            FlightTable(speed_limit=0.8),
        )
        kind, chosen = ROBOT_CONTROLS[uri]
        self.pilot = make_pilot(
            self.bus.port(0),
            self.world.link(0, kind),
            flight,
            ROOM,
            controls=chosen(flight),
        )
        self.track = []

    @property
    def state(self):
        return self.world.state(0)

    async def drive(self, seconds, each=lambda: None):
        for _ in range(round(seconds / TICK)):
            await self.clock.sleep(TICK)
            self.world.step()
            each()
            seen = self.state.flat[[0, 1, 2, 6, 7, 8, 9]]
            seen[:3] += 0.0005 * self.draw.standard_normal(3)
            tick(self.pilot, Pose(seen, 0.0))

            self.track.append(self.state.p)


async def ready(clock, uri, **options):
    robot = Driven(clock, uri, **options)
    await robot.drive(0.05)
    assert robot.pilot.take_off() == 0.0
    await robot.drive(0.2)
    assert robot.pilot.mode is Mode.HOVER
    return robot


@ALL
def test_it_neither_takes_off_nor_lands_and_needs_no_room_above_the_floor(uri):
    @virtual
    async def test(clock):
        robot = await ready(clock, uri)
        await robot.drive(1.0)
        assert robot.pilot.guard.latched == ""
        assert not robot.pilot.guard.acts, (
            "though it stands on the floor, and is seen a little below it"
        )
        assert robot.state.p == pytest.approx([0.3, -0.2, 0.0], abs=0.01)
        await robot.drive(robot.pilot.land() + 1.0)
        assert robot.pilot.mode is Mode.GROUND
        assert not robot.pilot.airborne
        assert robot.pilot.take_off() == 0.0
        assert robot.pilot.mode is Mode.HOVER, "and may drive again"

    test()


@ALL
def test_it_goes_where_it_is_sent(uri):
    @virtual
    async def test(clock):
        robot = await ready(clock, uri)
        await robot.drive(robot.pilot.go_to([-1.0, 0.8, 0.0], yaw=2.0) + 0.5)
        assert robot.pilot.gap([-1.0, 0.8, 0.0]) < 0.04
        if uri != WORLD_URIS.double_integrator:
            assert abs(wrap_angle(heading(robot.world) - 2.0)) < 0.05
        assert np.linalg.norm(robot.state.v) < 0.05

    test()


@ALL
@pytest.mark.parametrize("ends", ["land", "cut"])
def test_it_drives_a_velocity_and_stands_when_it_lands_or_is_cut(uri, ends):
    @virtual
    async def test(clock):
        robot = await ready(clock, uri)
        wanted = np.array([0.3, 0.4, 0.0])
        await robot.drive(2.0, lambda: robot.pilot.follow(Velocity(wanted)))
        assert robot.state.v == pytest.approx(wanted, abs=0.03)
        assert robot.pilot.mode is Mode.FOLLOW
        if ends == "land":
            await robot.drive(robot.pilot.land() + 1.0)
        else:
            robot.pilot.cut("emergency stop")
            await robot.drive(0.05)
        assert robot.pilot.mode is (Mode.GROUND if ends == "land" else Mode.CUT)
        assert np.linalg.norm(robot.state.v) == 0.0
        assert robot.pilot.follow(Velocity(wanted))
        before = robot.state.p
        await robot.drive(0.5)
        assert np.array_equal(robot.state.p, before), "and obeys no law any more"

    test()


@ALL
def test_it_comes_to_rest_inside_the_fence(uri):
    @virtual
    async def test(clock):
        robot = await ready(clock, uri)
        await robot.drive(
            12.0, lambda: robot.pilot.follow(Velocity(np.array([0.7, 0.0, 0.0])))
        )
        assert robot.pilot.guard.latched == ""
        assert max(p[0] for p in robot.track) < 2.0 + 0.2
        assert robot.track[-1][0] > 1.5, "it came there, braked, and tried again"
        assert Action.BRAKE.name in str(robot.pilot.notes._throttle._asked)

    test()


@ALL
def test_a_velocity_beyond_the_limits_is_limited_and_an_invalid_one_is_not_driven(uri):
    @virtual
    async def test(clock):
        robot = await ready(clock, uri)
        await robot.drive(
            1.0, lambda: robot.pilot.follow(Velocity(np.array([-5.0, 0.0, 0.0])))
        )
        assert 0.7 < np.linalg.norm(robot.state.v) < 0.83
        for wrong in (np.zeros(2), np.array([np.nan, 0.0, 0.0])):
            assert not robot.pilot.follow(Velocity(wrong))

    test()


@virtual
async def test_only_a_double_integrator_obeys_an_acceleration(clock):
    for uri in (WORLD_URIS.single_integrator, WORLD_URIS.unicycle):
        robot = await ready(clock, uri)
        assert not robot.pilot.follow(Acceleration(np.ones(3)))
        assert "Return a Velocity" in robot.pilot.notes.text
    robot = await ready(clock, WORLD_URIS.double_integrator)
    await robot.drive(
        0.5, lambda: robot.pilot.follow(Acceleration(np.array([1.0, 0.0, 0.0])))
    )
    assert robot.state.v == pytest.approx([0.5, 0.0, 0.0], abs=0.05)


@virtual
async def test_a_unicycle_follows_a_reference_that_moves(clock):
    robot = await ready(clock, WORLD_URIS.unicycle)
    at = {"t": 0.0}

    def follow():
        at["t"] += TICK
        p = (0.3 + 0.3 * at["t"], -0.2, 0.0)
        robot.pilot.follow(FullState.at(p, (0.3, 0.0, 0.0)))

    await robot.drive(4.0, follow)
    assert robot.state.p[:2] == pytest.approx([0.3 + 0.3 * at["t"], -0.2], abs=0.03)


@virtual
async def test_another_goal_is_driven_to_from_where_it_is(clock):
    robot = await ready(clock, WORLD_URIS.unicycle)
    await robot.drive(1.0, lambda: robot.pilot.follow(Goto(np.array([1.5, 0.0, 0.0]))))
    await robot.drive(
        12.0, lambda: robot.pilot.follow(Goto(np.array([-1.0, 0.5, 0.0])))
    )
    assert robot.pilot.gap([-1.0, 0.5, 0.0]) < 0.04
    assert np.abs(np.diff(np.array(robot.track), axis=0)).max() <= 0.8 * TICK + 1e-9
    robot.pilot.hold()
    await robot.drive(0.5)
    assert np.linalg.norm(robot.state.v) < 1e-3


@virtual
async def test_a_drone_flies_a_velocity_too(clock):
    robot = Driven(clock, WORLD_URIS.single_integrator)
    robot.world = CFIntegrator((0,), np.array([[0.3, -0.2, 0.0]]))
    robot.pilot = make_pilot(
        robot.bus.port(1),
        SimulatedLink(robot.world, 0),
        FlightTable(speed_limit=0.8),
        ROOM,
    )
    await robot.drive(0.05)
    await robot.drive(robot.pilot.take_off() + 0.5)
    wanted = np.array([0.3, -0.2, 0.1])
    await robot.drive(2.0, lambda: robot.pilot.follow(Velocity(wanted, yaw=0.3)))
    assert robot.state.v == pytest.approx(wanted, abs=0.03)
    assert heading(robot.world) == pytest.approx(0.3, abs=0.03)
    await robot.drive(1.0)
    assert np.linalg.norm(robot.state.v) < 0.05, "it brakes when no other comes"


@virtual
async def test_a_unicycle_that_is_stopped_on_its_way_stands_where_it_is_and_not_at_its_goal(
    clock,
):
    robot = await ready(clock, WORLD_URIS.unicycle)
    robot.pilot.go_to([1.8, -0.2, 0.0], yaw=0.0)
    await robot.drive(1.0)
    before = robot.state.p
    robot.pilot.hover()
    await robot.drive(4.0)
    assert robot.pilot.gap(before) < 0.4
    assert np.linalg.norm(robot.state.v) < 0.01
