"""The records of controllers: the control stage flies them as the same controllers in Python do."""

from dataclasses import replace

import numpy as np
import pytest

from crazychoir.config.tables import ControlTable
from crazychoir.control.attitude import AngleAttitudeCtrl, GeometryAttitudeCtrl
from crazychoir.control.choice import Controls, make_controls
from crazychoir.control.controller import HierarchicalController
from crazychoir.control.firmware import VelocityController
from crazychoir.control.gains import AGILE_GAINS, FORMATION_GAINS, STANDARD_GAINS
from crazychoir.control.handlers import AccelerationTraj, FullStateTraj, PositionTraj
from crazychoir.control.position import FlatnessAccelerationCtrl, FlatnessPositionCtrl
from crazychoir.control.rows import (
    INPUT_SIZE,
    CompiledControllerKind,
    make_control_rows,
)
from crazychoir.control.senders import FPQRSender, VelSender
from crazychoir.control.trim import Trim
from crazychoir.control.velocity import VelocityCtrlStrategy
from crazychoir.flight.batch import DRONE_ROW, Course, FlightControllerKind
from crazychoir.flight.stages import control_drones
from crazychoir.platforms import CRAZYFLIE_21, BodyEffects
from crazychoir.types import Acceleration, FullState, State, Velocity

PLATFORM = replace(CRAZYFLIE_21, effects=BodyEffects(speed_moment=(6e-4, 7e-4)))
HERE = State.at((0.0, 0.0, 1.0))
HOVER = FullState.at((0.0, 0.0, 1.0))
TICKS = 150
CROWD = 50
PLACE = 17
"""Place of the judged drone in the crowd."""


class Drone:
    """The controllers of one drone in Python, each part with a record of its own."""

    def __init__(self, sender, rate):
        attitude = AngleAttitudeCtrl if sender == "frpy" else GeometryAttitudeCtrl
        gains = make(sender, rate).gains
        self.trim = Trim()
        self.tracker = HierarchicalController(
            FlatnessPositionCtrl(gains, PLATFORM, self.trim),
            attitude(gains, PLATFORM),
            FPQRSender(),
            FullStateTraj(),
            rate,
        )
        self.follower = HierarchicalController(
            FlatnessAccelerationCtrl(FORMATION_GAINS, PLATFORM, self.trim),
            attitude(FORMATION_GAINS, PLATFORM),
            FPQRSender(),
            AccelerationTraj(),
        )
        for controller in (self.tracker, self.follower):
            controller.feed_forward.know_moment(PLATFORM, gains.thrust_delay)

    def command(self, state, reference, now):
        """Return the input and the acceleration of the controller that flies the reference."""
        is_follower = isinstance(reference, Acceleration)
        controller = self.follower if is_follower else self.tracker
        u = controller.command(state, reference, now).flat
        return u, controller.acceleration


class Crowd:
    """Drones as the control stage of a tick has them, with the records of their controllers."""

    def __init__(self, controls):
        self.controls = controls
        self.drones = np.zeros(len(controls), DRONE_ROW)
        self.drones["ticks"] = 1
        self.drones["course"] = Course.FOLLOW
        self.drones["sends_rows"] = 1
        self.drones["has_world_row"] = 1
        self.drones["learns_trim"] = 1

    def want(self, k, state, reference):
        """Let drone k in this state fly a reference."""
        drone = self.drones[k]
        drone["state"] = state.flat
        drone["age"] = state.age
        # The numbers that a follower does not read are 9.
        drone["wanted"] = 9.0
        if isinstance(reference, Acceleration):
            drone["controller"] = FlightControllerKind.FOLLOWER
            drone["wanted"][6:9] = reference.a
            drone["wanted"][12] = reference.yaw
        else:
            drone["controller"] = FlightControllerKind.TRACKER
            drone["wanted"] = reference.flat

    def fly(self, now):
        """Fly all drones, and return the rows with a command that is made or sent in Python."""
        found = np.full(len(self.drones), -1, np.int64)
        count = control_drones(self.drones, self.controls, now, found)
        return found[:count].tolist()

    def result(self, k):
        """Return the input of drone k, and the acceleration that it asks for."""
        drone = self.drones[k]
        return drone["command"][:INPUT_SIZE], drone["commanded"]


def make(sender="fpqr", rate=0.0, rows=None) -> Controls:
    return make_controls(
        ControlTable(sender=sender, position_rate=rate),
        PLATFORM,
        "motors",
        rows=rows,
    )


def draw_state(random) -> State:
    """A state near the reference or far from it; now and then not finite."""
    flat = random.normal(size=13) * random.choice([0.01, 1.0])
    flat[9] += 1.0
    flat[6:10] /= np.linalg.norm(flat[6:10])
    if random.random() < 0.05:
        flat[random.integers(13)] = random.choice([np.nan, np.inf])
    return State(flat, age=float(random.choice([0.0, 0.01, 0.3])))


def draw_reference(random):
    """A reference of either kind that may jump or be broken."""
    if random.random() < 0.5:
        a = random.normal(size=3)
        if random.random() < 0.1:
            a[1] = np.nan
        return Acceleration(a, float(random.normal()))
    return draw_full_state(random)


def draw_full_state(random) -> FullState:
    """A full state that may jump or be broken."""
    flat = random.normal(size=14) * random.choice([0.01, 0.5, 5.0])
    if random.random() < 0.1:
        flat[random.integers(14)] = np.nan
    return FullState(flat)


def as_bits(*arrays):
    return np.concatenate(arrays).tobytes()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("rate", [0.0, 50.0])
@pytest.mark.parametrize("sender", ["fpqr", "frpy"])
def test_a_drone_flies_alike_alone_among_others_and_in_python(sender, rate, seed):
    random = np.random.default_rng(seed)
    alone = Crowd(make_control_rows(1))
    crowd = Crowd(make_control_rows(CROWD))
    make(sender, rate, alone.controls)
    for k in range(CROWD):
        make(sender, rate, crowd.controls[k : k + 1])
    drone = Drone(sender, rate)
    learns = True
    now = 0.0
    for _ in range(TICKS):
        now += random.choice([0.0, 0.003, 0.01, 0.01, 0.01, 0.02, 1.5])
        if random.random() < 0.05:
            learns = not learns
        state = draw_state(random)
        reference = draw_reference(random)
        for k in range(CROWD):
            crowd.want(k, draw_state(random), draw_reference(random))
        for flown, k in ((alone, 0), (crowd, PLACE)):
            flown.want(k, state, reference)
            flown.drones[k]["learns_trim"] = learns
        if isinstance(reference, FullState):
            drone.trim.frozen = not learns

        expected = as_bits(*drone.command(state, reference, now), drone.trim.flat)
        assert alone.fly(now) == []
        assert crowd.fly(now) == []

        for flown, k in ((alone, 0), (crowd, PLACE)):
            trim = flown.controls[k]["trim"]["flat"]
            assert as_bits(*flown.result(k), trim) == expected
    assert drone.tracker.refused > 3
    assert drone.tracker.refused == alone.controls["tracker"]["refused"][0]
    assert drone.follower.refused == alone.controls["follower"]["refused"][0]
    assert drone.trim.flat.any()


@pytest.mark.parametrize("rate", [0.0, 50.0])
def test_the_command_of_a_controller_is_that_of_the_stage(rate):
    random = np.random.default_rng(4)
    controls = make(rate=rate)
    controls.trim.frozen = False
    alone = Crowd(make_control_rows())
    make(rate=rate, rows=alone.controls)
    for k in range(TICKS):
        state = draw_state(random)
        reference = draw_reference(random)
        is_follower = isinstance(reference, Acceleration)
        controller = controls.follower if is_follower else controls.tracker

        u = controller.command(state, reference, 0.01 * k).flat
        alone.want(0, state, reference)
        alone.fly(0.01 * k)

        assert as_bits(u, controller.acceleration) == as_bits(*alone.result(0))


@pytest.mark.parametrize("rate", [0.0, 50.0])
@pytest.mark.parametrize("part", ["tracker", "follower"])
def test_a_controller_without_a_reference_holds_alike_in_python(part, rate):
    random = np.random.default_rng(6)
    compiled = getattr(make(rate=rate), part)
    python = getattr(Drone("fpqr", rate), part)
    for k in range(TICKS):
        state = draw_state(random)
        reference = draw_full_state(random)
        if part == "follower":
            reference = Acceleration(reference.a, reference.yaw)
        if random.random() < 0.5:
            reference = None

        u = compiled.command(state, reference, 0.01 * k).flat
        expected = python.command(state, reference, 0.01 * k).flat

        assert as_bits(u, compiled.acceleration) == as_bits(
            expected, python.acceleration
        )
    assert compiled.rows["kind"][0] == CompiledControllerKind.FLATNESS
    assert python.rows["kind"][0] == CompiledControllerKind.BY_HAND


def test_velocities_in_compiled_code_are_those_of_python():
    random = np.random.default_rng(5)
    compiled = make("vel").tracker
    alone = Crowd(make_control_rows())
    make("vel", rows=alone.controls)
    python = VelocityController(VelocityCtrlStrategy(), VelSender(), FullStateTraj())
    for k in range(TICKS):
        state = draw_state(random)
        reference = draw_full_state(random)

        expected = python.command(state, reference, 0.01 * k).flat
        u = compiled.command(state, reference, 0.01 * k).flat
        alone.want(0, state, reference)
        assert alone.fly(0.01 * k) == []

        bits = as_bits(expected, python.acceleration)
        assert as_bits(u, compiled.acceleration) == bits
        assert as_bits(*alone.result(0)) == bits
    assert python.rows["kind"][0] == CompiledControllerKind.BY_HAND
    assert compiled.rows["kind"][0] == CompiledControllerKind.VELOCITY
    assert python.refused == compiled.refused > 5


def test_velocities_without_a_reference_are_those_of_python():
    random = np.random.default_rng(7)
    compiled = make("vel").tracker
    python = VelocityController(VelocityCtrlStrategy(), VelSender(), FullStateTraj())
    for k in range(TICKS):
        state = draw_state(random)
        reference = draw_full_state(random) if random.random() < 0.5 else None

        u = compiled.command(state, reference, 0.01 * k).flat
        expected = python.command(state, reference, 0.01 * k).flat

        assert as_bits(u, compiled.acceleration) == as_bits(
            expected, python.acceleration
        )


@pytest.mark.parametrize("rate", [0.0, 50.0])
def test_a_reference_of_another_kind_is_refused_alike_in_python(rate):
    controls = make(rate=rate)
    drone = Drone("fpqr", rate)
    for k, reference in enumerate([HOVER, Velocity(np.ones(3)), HOVER]):
        state = State.at((0.1 * k, 0.0, 1.0))
        expected = drone.tracker.command(state, reference, 0.01 * k).flat

        assert controls.tracker.command(state, reference, 0.01 * k).flat.tobytes() == (
            expected.tobytes()
        )
    assert controls.tracker.refused == drone.tracker.refused == 1


def test_a_drone_without_any_reference_rests_where_it_was_first():
    tracker = make().tracker
    tracker.command(HERE, None, 0.0)

    u = tracker.command(State.at((-1.0, 0.0, 1.0)), None, 0.1).flat

    assert u[2] > 0.1, "it pitches forward"


@pytest.mark.parametrize(
    ("ticks", "course"),
    [(0, Course.FOLLOW), (1, Course.NOTHING), (1, Course.IDLE)],
)
def test_the_controller_of_a_drone_that_does_not_fly_keeps_its_record(ticks, course):
    alone = Crowd(make_control_rows())
    make(rows=alone.controls)
    alone.want(0, HERE, HOVER)
    alone.fly(0.0)
    before = alone.controls.tobytes()

    alone.drones["ticks"] = ticks
    alone.drones["course"] = course
    alone.want(0, State.at((5.0, 0.0, 1.0)), HOVER)

    assert alone.fly(0.01) == []
    assert alone.controls.tobytes() == before
    is_idle = course == Course.IDLE
    assert alone.drones["is_computed"][0] == is_idle
    assert alone.drones["command"].any() != is_idle


@pytest.mark.parametrize("sender", ["xyz", "fullstate"])
def test_controllers_that_do_not_ship_compiled_are_called_by_hand(sender):
    alone = Crowd(make_control_rows())
    make(sender, rows=alone.controls)
    alone.want(0, HERE, HOVER)

    assert alone.fly(0.0) == [0]
    assert alone.controls["tracker"]["kind"][0] == CompiledControllerKind.BY_HAND
    assert alone.drones["is_computed"][0] == 0
    assert not alone.drones["command"].any()


def test_drones_with_a_controller_in_python_are_found():
    crowd = Crowd(make_control_rows(4))
    controls = [make(rows=crowd.controls[k : k + 1]) for k in range(4)]
    controls[1].tracker.traj_handler = PositionTraj()
    controls[2].follower.pos_strategy = FlatnessAccelerationCtrl(FORMATION_GAINS)
    for k in range(4):
        crowd.want(k, HERE, HOVER)

    assert crowd.fly(0.0) == [1]
    assert crowd.drones["is_computed"].tolist() == [1, 0, 1, 1]

    crowd.want(2, HERE, Acceleration(np.zeros(3)))
    assert crowd.fly(0.01) == [1, 2]


def test_drones_with_a_command_for_another_process_are_found():
    crowd = Crowd(make_control_rows(2))
    for k in range(2):
        make(rows=crowd.controls[k : k + 1])
        crowd.want(k, HERE, HOVER)
    crowd.drones["has_world_row"][1] = 0

    assert crowd.fly(0.0) == [1]
    assert crowd.drones["is_computed"].tolist() == [1, 1]


@pytest.mark.parametrize(
    ("part", "strategy"),
    [
        ("pos_strategy", FlatnessPositionCtrl(STANDARD_GAINS)),
        ("attitude_strategy", GeometryAttitudeCtrl(STANDARD_GAINS)),
        ("traj_handler", PositionTraj()),
    ],
)
def test_a_controller_with_an_exchanged_part_is_called_by_hand(part, strategy):
    controls = make()
    own = getattr(controls.tracker, part)

    setattr(controls.tracker, part, strategy)
    assert controls.rows["tracker"]["kind"][0] == CompiledControllerKind.BY_HAND

    setattr(controls.tracker, part, own)
    assert controls.rows["tracker"]["kind"][0] == CompiledControllerKind.FLATNESS


def test_a_controller_remembers_its_last_reference_when_a_part_is_exchanged():
    controls = make()
    controls.tracker.command(HERE, FullState.at((1.0, 2.0, 3.0)), 0.0)

    controls.tracker.traj_handler = PositionTraj()

    np.testing.assert_array_equal(controls.tracker.last[0:3], [1.0, 2.0, 3.0])


def test_strategies_of_another_record_are_not_flown_by_this_row():
    controls = make()
    other = make()

    controls.tracker.pos_strategy = other.tracker.pos_strategy

    assert controls.rows["tracker"]["kind"][0] == CompiledControllerKind.BY_HAND


def test_new_gains_act_in_the_row():
    rows = make_control_rows()
    controls = make(rows=rows)
    tracker_figures = rows["tracker"]["position"]["figures"][0]

    controls.retune(STANDARD_GAINS)
    controls.lead_by(AGILE_GAINS)

    np.testing.assert_array_equal(tracker_figures[:13], STANDARD_GAINS.position)
    np.testing.assert_array_equal(
        rows["follower"]["position"]["figures"][0, :13], AGILE_GAINS.position
    )
    np.testing.assert_array_equal(
        rows["follower"]["attitude"]["figures"][0, :3], AGILE_GAINS.kr
    )


def test_a_row_begins_anew_with_its_controls():
    alone = Crowd(make_control_rows())
    rows = alone.controls
    fresh = make(rows=rows).rows.tobytes()
    for k in range(5):
        alone.want(0, HERE, FullState.at((0.05, 0, 1)))
        alone.fly(0.01 * k)
    assert rows.tobytes() != fresh

    make(rows=rows)

    assert rows.tobytes() == fresh
