"""The stage that flies all drones of a process, beside the same controllers called in Python."""

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
    ControllerChoice,
    ControllerKind,
    control_rows,
    make_control_rows,
)
from crazychoir.control.senders import FPQRSender, VelSender
from crazychoir.control.trim import Trim
from crazychoir.control.velocity import VelocityCtrlStrategy
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.types import Acceleration, FullState, State, Velocity

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
            FlatnessPositionCtrl(gains, CRAZYFLIE_21, self.trim),
            attitude(gains, CRAZYFLIE_21),
            FPQRSender(),
            FullStateTraj(),
            rate,
        )
        self.follower = HierarchicalController(
            FlatnessAccelerationCtrl(FORMATION_GAINS, CRAZYFLIE_21, self.trim),
            attitude(FORMATION_GAINS, CRAZYFLIE_21),
            FPQRSender(),
            AccelerationTraj(),
        )

    def command(self, choice, state, reference, now):
        """Return the input and the acceleration of the chosen controller."""
        is_tracker = choice in (
            ControllerChoice.TRACKER,
            ControllerChoice.HOLDING_TRACKER,
        )
        controller = self.tracker if is_tracker else self.follower
        u = controller.command(state, reference, now).flat
        return u, controller.acceleration


def make(sender="fpqr", rate=0.0, rows=None) -> Controls:
    return make_controls(
        ControlTable(sender=sender, position_rate=rate),
        CRAZYFLIE_21,
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
    """A reference of either kind that may jump or be broken, or none."""
    if random.random() < 0.1:
        return None
    if random.random() < 0.5:
        a = random.normal(size=3)
        if random.random() < 0.1:
            a[1] = np.nan
        return Acceleration(a, float(random.normal()))
    flat = random.normal(size=14) * random.choice([0.01, 0.5, 5.0])
    if random.random() < 0.1:
        flat[random.integers(14)] = np.nan
    return FullState(flat)


def draw_choice(random, reference) -> ControllerChoice:
    if isinstance(reference, FullState):
        return ControllerChoice.TRACKER
    if isinstance(reference, Acceleration):
        return ControllerChoice.FOLLOWER
    return random.choice(
        [ControllerChoice.HOLDING_TRACKER, ControllerChoice.HOLDING_FOLLOWER]
    )


def write_reference(reference) -> np.ndarray:
    """The row (14,) of a reference; the numbers that its controller does not read are 9."""
    row = np.full(14, 9.0)
    if isinstance(reference, FullState):
        row[:] = reference.flat
    if isinstance(reference, Acceleration):
        row[6:9] = reference.a
        row[12] = reference.yaw
    return row


def draw_crowd(random):
    """States, references and choices of other drones."""
    states = [draw_state(random).flat for _ in range(CROWD)]
    references = [draw_reference(random) for _ in range(CROWD)]
    choices = [draw_choice(random, reference) for reference in references]
    return (
        np.array(states),
        np.array([write_reference(reference) for reference in references]),
        np.array(choices, dtype=np.int64),
    )


def fly_rows(rows, state, reference, choice, now):
    """Fly one row by the stage, and return how many rows it leaves."""
    return control_rows(
        rows,
        state.flat[None],
        np.array([state.age]),
        write_reference(reference)[None],
        np.array([choice], dtype=np.int64),
        now,
    )


def as_bits(*arrays):
    return np.concatenate(arrays).tobytes()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("rate", [0.0, 50.0])
@pytest.mark.parametrize("sender", ["fpqr", "frpy"])
def test_a_row_flies_alike_alone_among_others_and_in_python(sender, rate, seed):
    random = np.random.default_rng(seed)
    alone = make_control_rows(1)
    crowd = make_control_rows(CROWD)
    controls = [make(sender, rate, alone)]
    controls += [make(sender, rate, crowd[k : k + 1]) for k in range(CROWD)]
    drone = Drone(sender, rate)
    now = 0.0
    for _ in range(TICKS):
        now += random.choice([0.0, 0.003, 0.01, 0.01, 0.01, 0.02, 1.5])
        if random.random() < 0.05:
            for trim in (drone.trim, *(each.trim for each in controls)):
                trim.frozen = not trim.frozen
        state = draw_state(random)
        reference = draw_reference(random)
        choice = draw_choice(random, reference)
        states, references, choices = draw_crowd(random)
        states[PLACE] = state.flat
        references[PLACE] = write_reference(reference)
        choices[PLACE] = choice
        ages = np.full(CROWD, state.age)

        expected = as_bits(
            *drone.command(choice, state, reference, now), drone.trim.flat
        )
        fly_rows(alone, state, reference, choice, now)
        control_rows(crowd, states, ages, references, choices, now)

        for row in (alone[0], crowd[PLACE]):
            assert expected == as_bits(
                row["u"][:INPUT_SIZE], row["acceleration"], row["trim"]["flat"]
            )
    assert drone.tracker.refused > 5
    assert drone.tracker.refused == alone["tracker"]["refused"][0]
    assert drone.follower.refused == alone["follower"]["refused"][0]
    assert drone.trim.flat.any()


@pytest.mark.parametrize("rate", [0.0, 50.0])
def test_the_command_of_a_controller_is_that_of_its_row(rate):
    random = np.random.default_rng(4)
    controls = make(rate=rate)
    rows = make_control_rows()
    make(rate=rate, rows=rows)
    for k in range(TICKS):
        state = draw_state(random)
        reference = draw_reference(random)
        choice = draw_choice(random, reference)
        is_tracker = choice in (1, 3)
        controller = controls.tracker if is_tracker else controls.follower

        u = controller.command(state, reference, 0.01 * k).flat
        fly_rows(rows, state, reference, choice, 0.01 * k)

        assert as_bits(u, controller.acceleration) == as_bits(
            rows["u"][0, :INPUT_SIZE], rows["acceleration"][0]
        )


def test_velocities_of_a_row_are_those_of_python():
    random = np.random.default_rng(5)
    rows = make_control_rows()
    make("vel", rows=rows)
    python = VelocityController(VelocityCtrlStrategy(), VelSender(), FullStateTraj())
    for k in range(TICKS):
        state = draw_state(random)
        reference = draw_reference(random)
        if isinstance(reference, Acceleration):
            reference = None
        choice = (
            ControllerChoice.HOLDING_TRACKER
            if reference is None
            else ControllerChoice.TRACKER
        )

        u = python.command(state, reference, 0.01 * k).flat
        assert fly_rows(rows, state, reference, choice, 0.01 * k) == 0

        assert as_bits(u, python.acceleration) == as_bits(
            rows["u"][0, :INPUT_SIZE], rows["acceleration"][0]
        )
    assert python.rows["kind"][0] == ControllerKind.BY_HAND
    assert python.refused == rows["tracker"]["refused"][0] > 5


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
    rows = make_control_rows()
    make(rows=rows)
    fly_rows(rows, HERE, None, ControllerChoice.HOLDING_TRACKER, 0.0)

    fly_rows(
        rows, State.at((-1.0, 0.0, 1.0)), None, ControllerChoice.HOLDING_TRACKER, 0.1
    )

    assert rows["u"][0, 2] > 0.1, "it pitches forward"


def test_a_drone_without_a_controller_keeps_its_row():
    rows = make_control_rows()
    make(rows=rows)
    fly_rows(rows, HERE, HOVER, ControllerChoice.TRACKER, 0.0)
    before = rows.tobytes()

    fly_rows(rows, State.at((5.0, 0.0, 1.0)), HOVER, ControllerChoice.NONE, 0.01)

    assert rows.tobytes() == before


@pytest.mark.parametrize("sender", ["xyz", "fullstate"])
def test_controllers_that_do_not_ship_compiled_are_called_by_hand(sender):
    rows = make_control_rows()
    make(sender, rows=rows)

    left = fly_rows(rows, HERE, HOVER, ControllerChoice.TRACKER, 0.0)

    assert rows["tracker"]["kind"][0] == ControllerKind.BY_HAND
    assert (left, rows["is_left"][0]) == (1, 1)
    assert not rows["u"].any()


def test_a_row_that_is_flown_or_rests_is_not_left():
    rows = make_control_rows()
    make("xyz", rows=rows)
    fly_rows(rows, HERE, HOVER, ControllerChoice.TRACKER, 0.0)

    assert fly_rows(rows, HERE, HOVER, ControllerChoice.NONE, 0.0) == 0

    make(rows=rows)
    assert fly_rows(rows, HERE, HOVER, ControllerChoice.TRACKER, 0.0) == 0
    assert rows["is_left"][0] == 0


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
    assert controls.rows["tracker"]["kind"][0] == ControllerKind.BY_HAND

    setattr(controls.tracker, part, own)
    assert controls.rows["tracker"]["kind"][0] == ControllerKind.FLATNESS


def test_a_controller_remembers_its_last_reference_when_a_part_is_exchanged():
    controls = make()
    controls.tracker.command(HERE, FullState.at((1.0, 2.0, 3.0)), 0.0)

    controls.tracker.traj_handler = PositionTraj()

    np.testing.assert_array_equal(controls.tracker.last[0:3], [1.0, 2.0, 3.0])


def test_strategies_of_another_record_are_not_flown_by_this_row():
    controls = make()
    other = make()

    controls.tracker.pos_strategy = other.tracker.pos_strategy

    assert controls.rows["tracker"]["kind"][0] == ControllerKind.BY_HAND


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
    rows = make_control_rows()
    fresh = make(rows=rows).rows.tobytes()
    controls = make(rows=rows)
    controls.trim.frozen = False
    for k in range(5):
        fly_rows(rows, HERE, FullState.at((0.05, 0, 1)), 1, 0.01 * k)
    assert rows.tobytes() != fresh

    make(rows=rows)

    assert rows.tobytes() == fresh
