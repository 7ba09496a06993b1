import numpy as np
import pytest

from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.errors import ConfigError
from crazychoir.safety.rules.guard import (
    ALL_WELL,
    SAFETY_TABLE,
    Action,
    Fence,
    Guard,
    SafetyRule,
    Throttle,
)
from crazychoir.types import State

HERE = State.at((0.0, 0.0, 1.0))


def test_all_is_well():
    assert Guard().check(0.0, HERE, 0.01, 0.02) is ALL_WELL
    assert Guard().check(0.0, HERE, 0.01, None) is ALL_WELL


@pytest.mark.parametrize(
    ("age", "action"),
    [
        (0.10, Action.NOMINAL),
        (0.11, Action.BRAKE),
        (0.6, Action.LAND),
        (2.1, Action.CUT),
        (np.nan, Action.CUT),
    ],
)
def test_an_old_pose_brakes_then_lands_then_cuts(age, action):
    assert Guard().check(0.0, HERE, age, 0.0).action == action


@pytest.mark.parametrize(
    ("age", "action"), [(0.3, Action.NOMINAL), (0.31, Action.BRAKE), (5.1, Action.LAND)]
)
def test_an_old_reference_hovers_then_lands(age, action):
    assert Guard().check(0.0, HERE, 0.0, age).action == action


@pytest.mark.parametrize(
    ("x", "action"),
    [
        (3.0, Action.NOMINAL),
        (3.1, Action.BRAKE),
        (-3.3, Action.LAND),
        (3.6, Action.CUT),
    ],
)
def test_the_fence(x, action):
    assert Guard().check(0.0, State.at((x, 0.0, 1.0)), 0.0, 0.0).action == action


def test_a_state_that_is_not_finite_and_no_state_at_all_cut():
    broken = State(np.array([0.0, 0.0, 1.0, *[np.nan] * 10]))
    assert Guard().check(0.0, broken, 0.0, 0.0).action == Action.CUT
    assert Guard().check(0.0, None, np.inf, None).action == Action.CUT


def test_the_reason_names_what_was_found_the_limit_and_what_is_done():
    assert (
        Guard().check(0.0, HERE, 0.31, 0.0).reason
        == "pose 0.31 s old, limit 0.10 s: braking"
    )
    assert (
        "outside the fence"
        in Guard().check(0.0, State.at((0, 0, 2.6)), 0.0, 0.0).reason
    )


def test_the_worst_action_wins():
    verdict = Guard().check(0.0, State.at((3.1, 0.0, 1.0)), 0.6, 0.4)
    assert verdict.action == Action.LAND
    assert verdict.reason.startswith("pose")


def test_recovery_waits_until_all_has_been_calm_for_a_while():
    guard = Guard()
    actions = []
    for k in range(200):
        age = (
            0.2 if k < 10 else (0.08 if k < 60 else 0.01)
        )  # below the limit but not yet below `clear` until tick 60
        actions.append(guard.check(0.01 * k, HERE, age, 0.0).action)
    assert set(actions[:110]) == {Action.BRAKE}
    assert set(actions[111:]) == {Action.NOMINAL}


def test_a_relapse_starts_the_wait_anew():
    guard = Guard()
    guard.check(0.0, HERE, 0.2, 0.0)
    guard.check(0.1, HERE, 0.0, 0.0)
    guard.check(0.4, HERE, 0.2, 0.0)
    assert guard.check(0.7, HERE, 0.0, 0.0).action == Action.BRAKE
    assert guard.check(1.1, HERE, 0.0, 0.0).action == Action.BRAKE
    assert guard.check(1.3, HERE, 0.0, 0.0).action == Action.NOMINAL


@pytest.mark.parametrize(
    ("x", "v", "action"),
    [
        (2.4, 1.0, Action.NOMINAL),
        (2.5, 1.0, Action.BRAKE),
        (2.5, 0.9, Action.NOMINAL),
        (1.0, 2.0, Action.BRAKE),
        (-2.5, -1.0, Action.BRAKE),
        (2.9, -1.0, Action.NOMINAL),
        (3.2, -2.0, Action.BRAKE),
        (3.3, -2.0, Action.LAND),
    ],
)
def test_it_brakes_before_the_fence_at_the_distance_in_which_it_stops(x, v, action):
    """p + (15/16 |v| / a_max + 0.1 s) v, a_max = 2 m/s2; what is outside counts as it is, however it comes back."""
    assert (
        Guard().check(0.0, State.at((x, 0.0, 1.0), (v, 0.0, 0.0)), 0.0, 0.0).action
        == action
    )


def test_the_distance_grows_as_the_acceleration_shrinks_and_a_plan_of_its_own_needs_none():
    state = State.at((2.005, 0.0, 1.0), (1.0, 0.0, 0.0))
    assert Guard(a_max=2.0).check(0.0, state, 0.0, 0.0) is ALL_WELL
    verdict = Guard(a_max=0.5).check(0.0, state, 0.0, 0.0)
    assert (
        verdict.reason
        == "comes to rest 0.98 m outside the fence, limit 0.00 m: braking"
    )
    assert Guard(a_max=0.5).check(0.0, state, 0.0, None) is ALL_WELL


def test_it_brakes_before_the_floor_of_its_fence_and_takes_off_and_lands_through_it():
    guard = Guard(Fence.box((-3.0, -3.0, 0.5), (3.0, 3.0, 2.5)), ground=0.3)
    falling = State.at((0.0, 0.0, 0.9), (0.0, 0.0, -1.0))
    assert guard.check(0.0, falling, 0.0, 0.0).reason.startswith(
        "comes to rest 0.17 m outside the fence"
    )
    for z, action in (
        (0.49, Action.NOMINAL),
        (0.11, Action.NOMINAL),
        (0.05, Action.BRAKE),
        (-0.2, Action.LAND),
    ):
        guard = Guard(Fence.box((-3.0, -3.0, 0.5), (3.0, 3.0, 2.5)), ground=0.3)
        assert (
            guard.check(0.0, State.at((0.0, 0.0, z)), 0.0, None, True).action == action
        )
    assert guard.latched.startswith("0.30 m outside the fence, limit 0.25 m"), (
        "0.2 m below the ground"
    )


def test_a_reason_keeps_the_value_for_which_the_rule_acted():
    guard = Guard()
    guard.check(0.0, HERE, 0.0, 5.1)
    assert (
        guard.check(0.01, HERE, 0.0, 5.2).reason
        == "reference 5.20 s old, limit 5.00 s: landing"
    )
    assert (
        guard.check(0.5, HERE, 0.0, None).reason
        == "reference 5.20 s old, limit 5.00 s: landing"
    )


def test_a_measure_that_counts_no_more_is_excused_unless_it_is_latched():
    guard = Guard(
        table=(*SAFETY_TABLE, SafetyRule("reference", 9.0, Action.LAND, latched=True))
    )
    guard.check(0.0, HERE, 0.2, 0.4)
    guard.excuse("reference")
    assert guard.acts
    assert guard.check(0.0, HERE, 0.0, None).reason.startswith("pose")
    guard.excuse("pose")
    assert not guard.acts
    guard.check(0.0, HERE, 0.0, 9.1)
    guard.excuse("reference")
    assert guard.check(0.0, HERE, 0.0, None).action == Action.LAND


def test_a_latched_rule_acts_for_good_and_says_why_it_began():
    guard = Guard()
    assert guard.latched == ""
    guard.check(0.0, State.at((3.3, 0.0, 1.0)), 0.0, 0.0)
    guard.check(0.1, State.at((4.0, 0.0, 1.0)), 0.0, 0.0)
    verdict = guard.check(99.0, HERE, 0.0, 0.0)
    assert verdict.action == Action.CUT
    assert (
        verdict.reason
        == "0.50 m outside the limit area, in the keep-out zone: motors cut, for good"
    )
    assert guard.latched == "0.30 m outside the fence, limit 0.25 m: landing, for good"


@pytest.mark.parametrize(
    "limit",
    [None, Fence.box((-4.0, -4.0, -1.0), (4.0, 4.0, 3.2))],
    ids=["default", "given"],
)
@pytest.mark.parametrize("side", range(5), ids=["-x", "-y", "x", "y", "z"])
def test_beyond_the_limit_area_motors_are_cut_at_once(limit, side):
    area = Fence.box((-3.5, -3.5, -0.7), (3.5, 3.5, 3.0)) if limit is None else limit
    corners = [*area.low[:2], *area.high]
    for beyond, action in ((-0.001, Action.LAND), (0.001, Action.CUT)):
        p = np.array([0.0, 0.0, 1.0])
        p[side if side < 2 else side - 2] = corners[side] + (
            beyond if side > 1 else -beyond
        )
        verdict = Guard(limit=limit).check(0.0, State.at(p), 0.0, 0.0)
        assert verdict.action == action, "the fence lands it, the limit area cuts"
    assert verdict.measure == "limit area"


def test_a_limit_area_does_not_cut_a_landing_below_the_floor_of_the_fence():
    guard = Guard(
        Fence.box((-3.0, -3.0, 0.0), (3.0, 3.0, 2.5)),
        limit=Fence.box((-4.0, -4.0, 0.0), (4.0, 4.0, 3.0)),
    )
    assert (
        guard.check(0.0, State.at((0.0, 0.0, -0.1)), 0.0, None, True).action
        == Action.NOMINAL
    )


def test_a_rule_that_is_not_latched_is_forgotten():
    guard = Guard()
    guard.check(0.0, State.at((3.1, 0.0, 1.0)), 0.6, 0.0)
    for k in range(3):
        guard.check(1.0 + k, HERE, 0.0, 0.0)
    assert guard.check(9.0, HERE, 0.0, 0.0) is ALL_WELL
    assert guard.latched == ""


def test_the_table_is_data():
    strict = Guard(
        table=(*SAFETY_TABLE, SafetyRule("reference", 0.05, Action.CUT, latched=True))
    )
    assert strict.check(0.0, HERE, 0.0, 0.06).action == Action.CUT
    with pytest.raises(ConfigError, match="measure"):
        Guard(table=(SafetyRule("humidity", 1.0, Action.LAND),))


def test_outside_is_the_distance_over_the_nearest_side_passed():
    fence = Fence.box((-1, -2, 0), (1, 2, 3))
    assert fence.outside(0.0, 0.0, 1.5) == pytest.approx(-1.0)
    assert fence.outside(1.25, 0.0, 1.5) == pytest.approx(0.25)
    assert fence.outside(0.0, 0.0, -0.5) == pytest.approx(0.5)
    np.testing.assert_allclose(
        fence.nearest(np.array([5.0, 0.0, 1.0])), [0.9, 0.0, 1.0]
    )
    with pytest.raises(ConfigError, match="corners"):
        Fence.box((0, 0, 0), (1, -1, 1))


def test_a_reason_is_said_at_once_then_ever_more_rarely():
    say = Throttle()
    said = [k for k in range(10_000) if say.due(0.01 * k, "pose")]
    assert said == [0, 100, 300, 700, 1500, 3100, 6100, 9100], (
        "ever more rarely, but not never"
    )
    assert say.due(0.5, "fence")
    assert not say.due(100.0, "pose")
    assert say.due(131.0, "pose"), "it was over, and begins anew"
    assert [k for k in range(1, 4) if say.due(131.0 + k, "pose")] == [1, 3]


def test_what_can_just_stop_inside_is_not_said_to_be_outside():
    reason = (
        Guard(Fence.box((-1, -1, 0), (1, 1, 2)))
        .check(0.0, State.at((1.001, 0, 1)), 0.0, 0.0)
        .reason
    )
    assert reason == "can just come to rest inside the fence: braking"


def test_a_swarm_file_is_refused_if_its_poses_would_always_be_too_old():
    assert (
        min(rule.limit for rule in SAFETY_TABLE if rule.measure == "pose")
        == SWARM_LIMITS.oldest_pose
    )


def test_what_is_told_with_a_reason_says_it():
    guard = Guard()
    state = State.at((0.0, 0.0, 1.0))
    guard.tell("astray", 1.0, "it tilts otherwise")
    assert guard.check(0.0, state, 0.0).action is Action.LAND
    guard.tell("astray", 2.0, "it tilts otherwise")
    verdict = guard.check(0.1, state, 0.0)
    assert (verdict.action, verdict.reason) == (
        Action.CUT,
        "it tilts otherwise: motors cut, for good",
    )
    guard.tell("astray", 0.0)
    assert guard.check(9.0, state, 0.0) == verdict


def test_what_acted_in_one_flight_is_forgotten_in_the_next_unless_it_is_latched():
    guard = Guard()
    assert guard.check(0.0, HERE, 0.6, 0.0).action is Action.LAND
    guard.forget()
    assert guard.check(60.0, HERE, 0.01, 0.0) is ALL_WELL
    guard.tell("empty", 0.1)
    assert guard.check(60.0, HERE, 0.01, 0.0).action is Action.LAND
    guard.tell("empty", -1.0)
    guard.forget()
    assert guard.check(120.0, HERE, 0.01, 0.0).action is Action.LAND


def test_a_landing_by_firmware_is_cut_later_and_only_in_this_flight():
    guard = Guard()
    guard.bear_unseen(3.0)
    assert guard.check(0.0, HERE, 2.9, 0.0).action is Action.LAND
    guard.forget()
    guard.bear_unseen(1.0)
    assert guard.check(1.0, HERE, 1.9, 0.0).action is Action.LAND, "never sooner"
    guard.forget()
    assert guard.check(2.0, HERE, 2.9, 0.0).action is Action.CUT
