"""Permission: which of guidance, operator and safety may move a drone, in each mode."""

import pytest

from crazychoir.flight.batch import Batch
from crazychoir.flight.permission import Permission
from crazychoir.safety.rules.modes import (
    GUIDED_MODES,
    MOTORS_OFF_MODES,
    Mode,
    ModeEvent,
    get_next_mode,
    get_refusal,
)


def make_permission(mode=Mode.HOVER, awaits_start=False):
    row = Batch(1).add()
    row.mode = mode
    return Permission(row, awaits_start)


@pytest.mark.parametrize("mode", Mode)
def test_the_motors_may_run_in_all_modes_but_two(mode):
    assert make_permission(mode).airborne is (mode not in MOTORS_OFF_MODES)


@pytest.mark.parametrize("event", ModeEvent)
@pytest.mark.parametrize("mode", Mode)
def test_modes_change_and_commands_are_refused_as_the_table_says(mode, event):
    permission = make_permission(mode)
    assert permission.refuses(event) == get_refusal(mode, event)
    permission.change(event)
    assert permission.mode is get_next_mode(mode, event)


@pytest.mark.parametrize("mode", Mode)
def test_guidance_moves_a_drone_that_is_neither_held_nor_waits(mode):
    permission = make_permission(mode)
    assert permission.obeys is (mode in GUIDED_MODES)
    permission.hold(True)
    assert permission.held
    assert not permission.obeys
    permission.hold(False)
    permission.awaits_start = True
    assert not permission.obeys


@pytest.mark.parametrize("mode", Mode)
def test_the_operator_flies_a_drone_while_its_mission_waits(mode):
    permission = make_permission(mode)
    assert not permission.steerable, "its mission flies it"
    permission.hold(True)
    assert permission.steerable is (mode in (Mode.HOVER, Mode.FOLLOW))
    permission.hold(False)
    permission.awaits_start = True
    assert permission.steerable is (mode in (Mode.HOVER, Mode.FOLLOW))
    permission.unguided = "its law has failed"
    assert not permission.steerable


def test_a_flight_belongs_to_the_operator_until_a_hold():
    permission = make_permission(awaits_start=True)
    assert not permission.may_fly(by_operator=False)
    assert permission.may_fly(by_operator=True)
    assert permission.commanded
    permission.hold(True)
    assert not permission.commanded
    assert permission.may_fly(by_operator=True)
    assert not permission.may_fly(by_operator=False)
    assert permission.commanded, "a refused flight changes nothing"


def test_the_start_hands_the_drone_to_its_mission():
    permission = make_permission(awaits_start=True)
    assert permission.may_fly(by_operator=True)
    permission.start()
    assert not permission.commanded
    assert permission.obeys
    assert not permission.may_fly(by_operator=True)


def test_a_robot_that_does_not_take_off_is_in_flight_at_once():
    permission = make_permission(Mode.GROUND)
    permission.skip_take_off()
    assert permission.mode is Mode.HOVER


def test_nothing_forbids_the_take_off_of_a_fit_drone():
    assert make_permission().explain_no_take_off(False, "", []) == ("", "")


def test_the_gravest_reason_against_a_take_off_is_named():
    permission = make_permission(Mode.GROUND)
    permission.hold(True)
    cases = [
        (False, "", [], "held", "let go"),
        (False, "", ["no link", "battery low"], "unfit", "no link; battery low:"),
        (False, "outside the fence", ["no link"], "again", "outside the fence: no"),
        (True, "outside the fence", ["no link"], "stop", "emergency stop in force"),
    ]
    for is_stopped, latched, problems, rule, text in cases:
        found = permission.explain_no_take_off(is_stopped, latched, problems)
        assert found[0] == rule
        assert text in found[1]


def test_motors_that_were_cut_stay_off_for_the_reason_of_the_cut():
    permission = make_permission(Mode.CUT)
    permission.cut_for = "it has tumbled"
    rule, why = permission.explain_no_take_off(False, "outside the fence", [])
    assert rule == "again"
    assert why.startswith("it has tumbled: no take-off until its agent")
