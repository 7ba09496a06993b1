"""The record of a plan: compiled code samples it as the plan itself does, to the bit."""

import math

import numpy as np
import pytest

from crazychoir.planning.piecewise import POLYNOMIAL_DEGREE, Piecewise
from crazychoir.planning.plan_row import (
    PLAN_ROW,
    WINDOW_PIECES,
    PlanKind,
    clear_plan,
    has_pieces,
    is_plan_over,
    load_pieces,
    sample_plan,
)

START = 3.7
"""Seconds on the clock when the plans begin."""
LONG_COUNT = 3 * WINDOW_PIECES + 2


def make_plan(count):
    """Return a plan of `count` pieces with coefficients without a pattern."""
    draw = np.random.default_rng(count)
    coefficients = draw.normal(size=(count, 4, POLYNOMIAL_DEGREE + 1))
    return Piecewise(coefficients, draw.uniform(0.2, 1.5, count))


def load(plan, t):
    """Return the record of a plan, loaded at t s after its start."""
    row = np.zeros(1, PLAN_ROW)[0]
    row["start"] = START
    load_pieces(row, plan, t)
    return row


def sample(row, now):
    out = np.full(14, math.nan)
    sample_plan(row, now, out)
    return out


def list_times(plan):
    """Return times in s on the clock: at and beside all knots, and between them."""
    knots = START + plan.knots
    between = np.linspace(START, START + plan.duration, 101)
    beside = [np.nextafter(knots, -math.inf), knots, np.nextafter(knots, math.inf)]
    return np.sort(np.concatenate([*beside, between])).tolist()


@pytest.mark.parametrize("count", [1, 2, WINDOW_PIECES])
def test_a_short_plan_is_loaded_once_and_sampled_as_the_plan_samples_itself(count):
    plan = make_plan(count)
    row = load(plan, 0.0)
    for now in list_times(plan):
        assert has_pieces(row, now)
        assert sample(row, now).tolist() == plan.sample(now - START).flat.tolist()


def test_a_long_plan_is_sampled_through_all_its_windows_as_the_plan_samples_itself():
    plan = make_plan(LONG_COUNT)
    row = load(plan, 0.0)
    loads = 0
    for now in list_times(plan):
        if not has_pieces(row, now):
            load_pieces(row, plan, now - START)
            loads += 1
        assert has_pieces(row, now)
        assert sample(row, now).tolist() == plan.sample(now - START).flat.tolist()
    assert loads == math.ceil(LONG_COUNT / WINDOW_PIECES) - 1


def test_a_long_plan_can_be_loaded_at_any_time():
    plan = make_plan(LONG_COUNT)
    for now in reversed(list_times(plan)):
        row = load(plan, now - START)
        assert has_pieces(row, now)
        assert sample(row, now).tolist() == plan.sample(now - START).flat.tolist()


def test_a_window_of_a_long_plan_does_not_hold_the_pieces_before_and_after_it():
    plan = make_plan(LONG_COUNT)
    row = load(plan, plan.knots[5])
    begin = START + plan.knots[5]
    end = START + plan.knots[5 + WINDOW_PIECES]
    assert not has_pieces(row, begin - 1e-9)
    assert has_pieces(row, begin + 1e-9)
    assert has_pieces(row, end - 1e-9)
    assert not has_pieces(row, end + 1e-9)


@pytest.mark.parametrize("count", [1, LONG_COUNT])
def test_before_its_start_the_plan_holds_its_first_state(count):
    plan = make_plan(count)
    row = load(plan, -2.0)
    assert has_pieces(row, START - 2.0)
    assert sample(row, START - 2.0).tolist() == plan.sample(0.0).flat.tolist()
    assert not is_plan_over(row, START - 2.0)


@pytest.mark.parametrize("count", [1, LONG_COUNT])
def test_at_its_end_the_plan_has_its_last_state_and_afterwards_it_stands(count):
    plan = make_plan(count)
    row = load(plan, 0.0)
    end = START + plan.duration
    at_end = end if end - START >= plan.duration else math.nextafter(end, math.inf)
    for now in (at_end, end + 1e-6, end + 100.0):
        assert has_pieces(row, now), "no piece is needed any more"
        assert is_plan_over(row, now)
        assert sample(row, now).tolist() == plan.sample(now - START).flat.tolist()
    assert not is_plan_over(row, end - 1e-6)


def test_a_record_without_a_plan_is_never_over():
    row = load(make_plan(1), 0.0)
    clear_plan(row)
    assert row["kind"] == PlanKind.NONE
    assert not is_plan_over(row, START + 100.0)


def test_a_plan_by_hand_is_what_the_pilot_has_written():
    row = load(make_plan(1), 0.0)
    row["kind"] = PlanKind.BY_HAND
    row["sampled"] = np.arange(14.0)
    assert sample(row, START + 0.1).tolist() == list(range(14))
    assert not is_plan_over(row, START + 100.0)
    row["is_over"] = 1
    assert is_plan_over(row, START)


def test_a_waiting_plan_stands_where_it_was_told_to():
    row = load(make_plan(1), 0.0)
    row["sampled"] = np.arange(14.0)
    row["is_waiting"] = 1
    assert sample(row, START + 0.1).tolist() == list(range(14))
