"""The compiled stages of a tick: for which drones nothing happens, and what these fly."""

import math

import numpy as np
import pytest

from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.filters.rows import FilterKind
from crazychoir.flight.batch import (
    Batch,
    Course,
    FlightControllerKind,
)
from crazychoir.flight.clearance import CLEARANCE_TIMES, PLAN_DEVIATION
from crazychoir.flight.flight_limits import SEEN_AGE, TOUCHDOWN_LIMITS
from crazychoir.flight.point_flights import PointFlights
from crazychoir.flight.setup import FlightSetup
from crazychoir.flight.stages import (
    _evade,
    estimate_drones,
    find_rows_to_judge,
    follow_rows,
)
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.plan_row import WINDOW_PIECES, PlanKind
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.rules.guard import Action
from crazychoir.safety.rules.limits import ReferenceLimits
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Acceleration, FullState, State, Velocity

SETUP = FlightSetup()
LIMITS = ReferenceLimits(SETUP.limits, STANDARD_GAINS)
NOW = 10.0
NOW_NS = round(NOW * NS_PER_SECOND)
PLACE = FullState.at((0.5, -0.5, 1.0))
GOAL = np.array([1.0, 0.5, 1.5])
FLIGHT_TIME = 20.0


class Flying:
    """A drone of a batch that flies in a mode, on its plan and without any trouble."""

    def __init__(self, batch, mode=Mode.HOVER):
        self.row = batch.add(batch.count)
        self.guard = SETUP.make_guard(self.row)
        self.flights = PointFlights(
            SETUP.limits, SETUP.fence, SETUP.a_max, self.row.plan
        )
        self.row.mode = mode
        self.drone["ticks"] = 1
        self.drone["ticked_ns"] = NOW_NS
        self.drone["is_known"] = 1
        self.drone["gains"] = LIMITS.gains
        self.drone["limits"] = LIMITS.figures
        self.flights.go_to(PLACE, GOAL, 0.0, FLIGHT_TIME, NOW - 2.0)
        self.put(self.flights.sample(NOW).p)

    @property
    def drone(self):
        return self.row.drone

    def put(self, p):
        """Let it stand still at p, (3,) m."""
        self.drone["state"] = State.at(p).flat


def make_drones(count=1, mode=Mode.HOVER):
    batch = Batch(count)
    return batch, [Flying(batch, mode) for _ in range(count)]


def make_drone(mode=Mode.HOVER):
    batch, (drone,) = make_drones(1, mode)
    return batch, drone


def find(batch, now=NOW):
    """Return the indices of the drones for which Python must decide."""
    found = np.full(len(batch.drones), -1, np.int64)
    count = find_rows_to_judge(
        batch.drones, batch.plans, batch.guards, now, np.empty(14), found
    )
    return found[:count].tolist()


def is_judged(batch, now=NOW):
    """Return whether Python must decide for the only drone, which otherwise flies on."""
    judged = find(batch, now)
    course = batch.drones["course"][0]
    assert course == (Course.NOTHING if judged else Course.FOLLOW)
    return judged == [0]


# The estimate --------------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 150.0])
def test_an_acceleration_that_others_would_refuse_counts_as_unknown(wrong):
    batch, drone = make_drone()
    rows = batch.filters.rows
    rows["kind"] = FilterKind.BY_HAND
    rows["is_known"] = 1
    for commanded, expected in (((0.1, 0.2, wrong), 0.0), ((0.1, 0.2, 0.3), 0.3)):
        drone.drone["commanded"] = commanded
        estimate_drones(
            batch.drones,
            batch.plans,
            rows,
            batch.filters.history,
            NOW_NS,
            NOW,
            np.empty(13),
            np.empty(14),
        )
        assert drone.drone["acceleration"][2] == expected


# A quiet drone -------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [Mode.TAKEOFF, Mode.HOVER, Mode.FOLLOW, Mode.RETURN])
def test_a_drone_on_its_way_is_not_judged(mode):
    batch, _ = make_drone(mode)
    assert not is_judged(batch)


def test_a_drone_high_in_its_descent_is_not_judged():
    batch, drone = make_drone(Mode.LAND)
    drone.put((0.5, -0.5, TOUCHDOWN_LIMITS.floor_height + 0.01))
    assert not is_judged(batch)


def test_a_drone_that_hovers_where_its_plan_has_ended_is_not_judged():
    batch, drone = make_drone(Mode.HOVER)
    drone.put(GOAL)
    assert not is_judged(batch, NOW + 2.0 * FLIGHT_TIME)


@pytest.mark.parametrize("kind", [Acceleration, Velocity, FullState])
def test_a_drone_with_a_fresh_reference_needs_no_plan(kind):
    batch, drone = make_drone(Mode.FOLLOW)
    follow(drone, kind)
    drone.flights.clear()
    assert not is_judged(batch)


def follow(drone, kind, age=0.0):
    """Let guidance give the drone a reference, `age` s ago."""
    reference = PLACE if kind is FullState else kind(np.array([0.1, 0.2, 0.3]), 0.4)
    drone.row.set_reference(reference, NOW_NS - round(age * NS_PER_SECOND))


@pytest.mark.parametrize("mode", [Mode.GROUND, Mode.CUT])
def test_a_drone_with_its_motors_off_is_idle_whatever_else_happens(mode):
    batch, drone = make_drone(mode)
    drone.drone["age"] = 100.0
    drone.drone["cut_off_since"] = 1.0
    drone.row.obeyed = Action.CUT
    assert find(batch) == []
    assert drone.drone["course"] == Course.IDLE
    assert drone.drone["cut_off_since"] == math.inf


def test_a_drone_that_does_not_tick_keeps_its_course():
    batch, drone = make_drone()
    drone.drone["ticks"] = 0
    drone.drone["course"] = Course.READY
    drone.drone["age"] = 100.0
    assert find(batch) == []
    assert drone.drone["course"] == Course.READY


def test_the_controller_of_the_last_tick_is_forgotten():
    batch, drone = make_drone()
    drone.drone["controller"] = FlightControllerKind.FOLLOWER
    find(batch)
    assert drone.drone["controller"] == FlightControllerKind.NONE


# Reasons for a judgement ---------------------------------------------------------------------


@pytest.mark.parametrize("mode", [Mode.GROUND, Mode.HOVER, Mode.CUT])
def test_a_drone_by_hand_is_judged_in_each_tick(mode):
    batch, drone = make_drone(mode)
    drone.drone["is_by_hand"] = 1
    assert is_judged(batch)


@pytest.mark.parametrize("action", [Action.BRAKE, Action.LAND])
def test_a_drone_that_obeys_the_safety_table_is_judged(action):
    batch, drone = make_drone()
    drone.row.obeyed = action
    assert is_judged(batch)


@pytest.mark.parametrize(
    ("field", "quiet", "loud"),
    [
        ("age", 0.1, 0.1000001),
        ("age", 0.0, math.nan),
    ],
)
def test_a_drone_without_a_new_pose_is_judged(field, quiet, loud):
    batch, drone = make_drone()
    for value, judged in ((quiet, False), (loud, True)):
        drone.drone[field] = value
        assert is_judged(batch) is judged, value


def test_a_drone_outside_its_fence_is_judged():
    batch, drone = make_drone()
    for x, judged in ((2.99, False), (3.01, True)):
        drone.put((x, 0.0, 1.0))
        assert is_judged(batch) is judged, x


@pytest.mark.parametrize(
    ("mode", "judged"), [(Mode.HOVER, True), (Mode.TAKEOFF, False)]
)
def test_below_the_fence_a_drone_is_judged_unless_it_takes_off(mode, judged):
    batch, drone = make_drone(mode)
    drone.put((0.0, 0.0, -0.05))
    assert is_judged(batch) is judged


def test_a_drone_that_follows_a_reference_out_of_the_fence_is_judged_before_it_is_there():
    batch, drone = make_drone(Mode.FOLLOW)
    follow(drone, Acceleration)
    drone.drone["state"] = State.at((2.5, 0.0, 1.0), (0.5, 0.0, 0.0)).flat
    assert not is_judged(batch)
    drone.drone["state"] = State.at((2.9, 0.0, 1.0), (2.0, 0.0, 0.0)).flat
    assert is_judged(batch)
    drone.row.set_reference(None)
    assert not is_judged(batch), "its plan ends inside"


@pytest.mark.parametrize("k", range(13))
def test_a_state_that_is_not_finite_is_judged(k):
    batch, drone = make_drone()
    drone.drone["state"][k] = math.nan
    assert is_judged(batch)


@pytest.mark.parametrize(("age", "judged"), [(0.3, False), (0.31, True)])
def test_an_old_reference_is_judged(age, judged):
    batch, drone = make_drone(Mode.FOLLOW)
    follow(drone, Acceleration, age)
    assert is_judged(batch) is judged


def test_trouble_that_the_radio_reports_is_judged():
    batch, drone = make_drone()
    drone.guard.tell("link", 0.4)
    assert not is_judged(batch)
    drone.guard.tell("link", 0.6)
    assert is_judged(batch)


def test_a_rule_that_has_not_settled_is_judged():
    batch, drone = make_drone()
    drone.guard.check(NOW, State.at(GOAL), 0.2)
    assert is_judged(batch)
    drone.guard.excuse("pose")
    assert not is_judged(batch)


@pytest.mark.parametrize("mode", [Mode.TAKEOFF, Mode.FOLLOW, Mode.RETURN])
def test_a_plan_that_is_over_is_judged_if_something_follows_it(mode):
    batch, drone = make_drone(mode)
    drone.put(GOAL)
    end = drone.flights.start + FLIGHT_TIME
    assert not is_judged(batch, end - 1e-6)
    assert is_judged(batch, end + 1e-6)


def test_a_descent_is_judged_when_it_may_be_over():
    batch, drone = make_drone(Mode.LAND)
    assert not is_judged(batch)
    drone.put((0.5, -0.5, TOUCHDOWN_LIMITS.floor_height - 0.01))
    assert is_judged(batch), "the drone is low"
    drone.put(GOAL)
    drone.drone["age"] = SEEN_AGE + 0.001
    assert is_judged(batch), "the drone is not seen"
    drone.drone["age"] = 0.0
    assert is_judged(batch, NOW + FLIGHT_TIME), "the plan is over"


def test_a_drone_without_a_plan_is_judged():
    batch, drone = make_drone()
    drone.flights.clear()
    assert is_judged(batch)


def test_a_plan_by_hand_is_judged_in_each_tick():
    batch, drone = make_drone()
    drone.row.plan["kind"] = PlanKind.BY_HAND
    assert is_judged(batch)


def test_a_long_plan_is_judged_when_its_window_is_over():
    batch, drone = make_drone(Mode.FOLLOW)
    count = WINDOW_PIECES + 1
    coefficients = np.zeros((count, 4, 8))
    coefficients[:, 2, 0] = 1.0
    drone.flights.fly(Piecewise(coefficients, np.ones(count)), NOW)
    drone.put((0.0, 0.0, 1.0))
    assert not is_judged(batch, NOW + WINDOW_PIECES - 1e-6)
    later = NOW + WINDOW_PIECES + 1e-6
    assert is_judged(batch, later)
    drone.flights.load(later)
    assert not is_judged(batch, later)


@pytest.mark.parametrize(
    ("mode", "limit"),
    [
        (Mode.HOVER, PLAN_DEVIATION.waiting_distance),
        (Mode.FOLLOW, PLAN_DEVIATION.waiting_distance),
        (Mode.LAND, PLAN_DEVIATION.landing_distance),
    ],
)
def test_a_drone_that_was_pushed_far_off_its_plan_is_judged(mode, limit):
    batch, drone = make_drone(mode)
    planned = drone.flights.sample(NOW).p
    for far, judged in ((0.99 * limit, False), (1.01 * limit, True)):
        drone.put(planned + np.array([0.0, far, 0.0]))
        drone.drone["is_aside"] = 1
        assert is_judged(batch) is judged, far
        drone.drone["is_aside"] = 0
        assert not is_judged(batch), "no other drone has pushed it"


def test_a_drone_that_hears_too_few_for_too_long_is_judged():
    batch, drone = make_drone()
    for since, judged in ((1e-3, False), (0.0, True)):
        drone.drone["cut_off_since"] = NOW - CLEARANCE_TIMES.cut_off_timeout + since
        assert is_judged(batch) is judged


# The fence -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("is_beyond", "is_held", "seconds", "ticks"),
    [(1, 0, 30.0, 1), (0, 0, 30.0, 0), (1, 1, 30.0, 0), (1, 0, 0.0, 0)],
)
def test_ticks_count_at_the_fence_after_a_flight_to_a_place_beyond_it(
    is_beyond, is_held, seconds, ticks
):
    batch, drone = make_drone()
    drone.drone["is_beyond"] = is_beyond
    drone.drone["is_held"] = is_held
    assert not is_judged(batch, NOW + seconds)
    assert drone.row.fence_ticks == ticks


# What a drone flies --------------------------------------------------------------------------


def fly(batch, now=NOW):
    """Do the stages up to `follow`."""
    judged = find(batch, now)
    follow_rows(batch.drones, batch.plans, now, np.empty(14))
    return judged


def test_an_acceleration_goes_to_the_follower_as_it_is():
    batch, drone = make_drone(Mode.FOLLOW)
    follow(drone, Acceleration)
    fly(batch)
    assert drone.drone["controller"] == FlightControllerKind.FOLLOWER
    assert drone.drone["wanted"][6:9].tolist() == [0.1, 0.2, 0.3]
    assert drone.drone["wanted"][12] == 0.4
    assert np.count_nonzero(drone.drone["wanted"]) == 4
    assert drone.row.flown is None
    assert drone.flights.plan is None, "the next plan begins at the drone"


def test_a_velocity_is_flown_from_where_the_drone_is():
    batch, drone = make_drone(Mode.FOLLOW)
    follow(drone, Velocity)
    drone.put((1.0, 1.5, 1.25))
    fly(batch)
    expected = FullState.at((1.0, 1.5, 1.25), (0.1, 0.2, 0.3), yaw=0.4)
    assert drone.drone["controller"] == FlightControllerKind.TRACKER
    assert drone.drone["wanted"].tolist() == expected.flat.tolist()


@pytest.mark.parametrize(("far", "is_exact"), [(0.05, True), (50.0, False)])
def test_a_full_state_is_cut_to_the_limits_and_the_trim_learns_from_exact_ones(
    far, is_exact
):
    batch, drone = make_drone(Mode.FOLLOW)
    wanted = FullState.at((far, 0.0, 1.0))
    drone.row.set_reference(wanted, NOW_NS)
    drone.put((0.0, 0.0, 1.0))
    fly(batch)
    cut = LIMITS.full_state(wanted, drone.row.state)
    assert (cut is wanted) is is_exact
    assert drone.row.flown.flat.tolist() == cut.flat.tolist()
    assert bool(drone.drone["learns_trim"]) is is_exact


@pytest.mark.parametrize(("age", "learns"), [(SEEN_AGE, 1), (SEEN_AGE + 0.01, 0)])
def test_the_trim_learns_from_a_plan_while_the_drone_is_seen(age, learns):
    batch, drone = make_drone()
    find(batch)
    drone.drone["age"] = age
    follow_rows(batch.drones, batch.plans, NOW, np.empty(14))
    expected = drone.flights.sample(NOW).flat.tolist()
    assert drone.drone["controller"] == FlightControllerKind.TRACKER
    assert drone.drone["wanted"].tolist() == expected
    assert drone.row.flown.flat.tolist() == expected
    assert drone.drone["learns_trim"] == learns


@pytest.mark.parametrize(("lift_off", "learns"), [(0.5, 1), (5.0, 0)])
def test_the_trim_learns_nothing_on_the_floor(lift_off, learns):
    batch, drone = make_drone(Mode.TAKEOFF)
    drone.drone["lift_off_height"] = lift_off
    fly(batch)
    assert drone.drone["learns_trim"] == learns


def test_a_plan_that_waits_is_flown_where_it_stands_for_one_tick():
    batch, drone = make_drone()
    drone.flights.stand(PLACE)
    fly(batch)
    assert drone.row.flown.flat.tolist() == PLACE.flat.tolist()
    fly(batch)
    assert drone.row.flown.flat.tolist() == drone.flights.sample(NOW).flat.tolist()


@pytest.mark.parametrize(
    ("far", "since", "is_aside"),
    [
        (0.4, 0.0, 1),
        (0.4, PLAN_DEVIATION.gentle_return_time + 0.01, 0),
        (0.9 * PLAN_DEVIATION.back_distance, 0.0, 0),
    ],
)
def test_a_drone_comes_back_to_its_plan_gently_for_a_while(far, since, is_aside):
    batch, drone = make_drone()
    planned = drone.flights.sample(NOW)
    drone.put(planned.p + np.array([0.0, far, 0.0]))
    drone.drone["is_aside"] = 1
    drone.drone["gave_way"] = NOW - since
    assert fly(batch) == []
    cut = LIMITS.full_state(planned, drone.row.state)
    assert drone.row.flown.flat.tolist() == cut.flat.tolist()
    assert drone.drone["is_aside"] == is_aside


def test_a_drone_that_the_judge_commands_is_left_alone():
    batch, drone = make_drone()
    drone.row.fly(PLACE)
    follow_rows(batch.drones, batch.plans, NOW, np.empty(14))
    assert drone.drone["wanted"].tolist() == PLACE.flat.tolist()


@pytest.mark.parametrize("is_on_plan", [True, False])
def test_an_evasion_flies_the_safe_acceleration_from_where_the_drone_is(is_on_plan):
    batch, drone = make_drone()
    fly(batch)
    drone.drone["state"] = State.at((1.0, 2.0, 0.5), (0.1, 0.2, 0.3)).flat
    safe = np.array([0.5, 0.6, 0.7])
    for _ in range(2):
        _evade(drone.drone, safe, 4, is_on_plan, NOW)
    expected = FullState.at((1.0, 2.0, 0.5), (0.1, 0.2, 0.3), safe)
    assert drone.drone["wanted"].tolist() == expected.flat.tolist()
    assert drone.drone["controller"] == FlightControllerKind.TRACKER
    assert drone.drone["learns_trim"] == 0
    assert drone.drone["evades"] == 1
    assert drone.drone["evades_drone"] == 4
    assert drone.drone["gave_way"] == NOW
    assert drone.drone["evasion_ticks"] == 2
    assert bool(drone.drone["is_aside"]) is is_on_plan


# Many drones ---------------------------------------------------------------------------------


def scatter(drones, seed):
    """Bring the drones into all kinds of situations."""
    draw = np.random.default_rng(seed)
    kinds = [None, Acceleration, Velocity, FullState]
    for drone in drones:
        drone.row.mode = draw.choice(list(Mode))
        record = drone.drone
        planned = drone.flights.sample(NOW)
        drone.put(planned.p + draw.normal(0.0, 0.2, 3))
        record["state"][3:6] = draw.normal(0.0, 0.3, 3)
        record["age"] = draw.choice([0.0, 0.05, 0.105, 0.2])
        record["is_aside"] = draw.integers(2)
        record["gave_way"] = NOW - draw.uniform(0.0, 4.0)
        record["is_beyond"] = draw.integers(2)
        record["lift_off_height"] = draw.uniform(0.0, 2.0)
        kind = draw.choice(kinds)
        if kind is not None:
            follow(drone, kind, draw.uniform(0.0, 0.35))
        if draw.random() < 0.1:
            drone.row.obeyed = Action.BRAKE
        if draw.random() < 0.1:
            drone.flights.clear()
        if draw.random() < 0.1:
            record["ticks"] = 0


def test_a_drone_among_twenty_gets_the_bits_of_a_drone_alone():
    outcomes = set()
    for seed in range(20):
        batch, drones = make_drones(20)
        scatter(drones, seed)
        copies = batch.drones.copy(), batch.plans.copy(), batch.guards.copy()
        judged = fly(batch)
        for k in range(20):
            rows, plans, guards = (part[k : k + 1].copy() for part in copies)
            found = np.zeros(1, np.int64)
            count = find_rows_to_judge(rows, plans, guards, NOW, np.empty(14), found)
            follow_rows(rows, plans, NOW, np.empty(14))
            assert rows.tobytes() == batch.drones[k : k + 1].tobytes(), (seed, k)
            assert plans.tobytes() == batch.plans[k : k + 1].tobytes(), (seed, k)
            assert (count == 1) is (k in judged), (seed, k)
            outcomes.add((count, int(rows["course"][0])))
    assert {(0, Course.IDLE), (0, Course.FOLLOW), (1, Course.NOTHING)} <= outcomes
