import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crazychoir.filters.command_history import compute_history_size
from crazychoir.filters.kalman import KalmanFilter
from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.row_filter import (
    estimate_by_hand,
    estimate_rows,
    read_state,
)
from crazychoir.filters.rows import FilterKind, FilterTable
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.flight.estimate import compute_rate_loops
from crazychoir.numerics.math3d import rotation_exponential
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose

PERIOD = 0.01
MOTION = CommandedMotion(PAPER_PLATFORM.flat, 0.0)
OUTPUTS = ("state", "age", "speed", "measured", "refused", "is_known")
HISTORY = compute_history_size(horizon=2.0, period=PERIOD)
DRONES = 50


def make_filter(kind, table=None):
    match kind:
        case 0:
            return VelocityFilter(horizon=2.0, period=PERIOD, table=table)
        case 1:
            return VelocityFilter(horizon=0.1, motion=MOTION, table=table)
        case 2:
            return KalmanFilter(horizon=2.0, period=PERIOD, table=table)
        case 3:
            return KalmanFilter(horizon=0.2, motion=MOTION, table=table)
    return KalmanFilter(
        horizon=2.0,
        period=PERIOD,
        motion=MOTION,
        loop=compute_rate_loops(PAPER_PLATFORM),
        table=table,
    )


class Cameras:
    """Poses of one drone: noisy, lost for a while, not readable, wrong, late, or repeated."""

    def __init__(self, seed):
        self.draw = np.random.default_rng(seed)
        self.ticks_without_pose = 0
        self.last = Pose(np.zeros(7))

    def look(self, t):
        if self.draw.random() < 0.02:
            self.ticks_without_pose = self.draw.integers(40)
        self.ticks_without_pose -= 1
        if self.ticks_without_pose > 0:
            return None
        if self.draw.random() < 0.03:
            return self.last
        place = [math.sin(t), math.cos(t), max(0.0, math.sin(3.0 * t))]
        turn = rotation_exponential(*(0.1 * self.draw.standard_normal(3)))
        flat = np.array([*place, *turn]) + 5e-4 * self.draw.standard_normal(7)
        match self.draw.integers(30):
            case 0:
                flat *= self.draw.choice([1.0, np.nan, np.inf], 7)
            case 1 | 2:
                flat[:3] += self.draw.uniform(-3.0, 3.0, 3)
            case 3:
                flat[3:] = self.draw.uniform(-2.0, 2.0, 4)
        self.last = Pose(flat, self.draw.choice([0.0, 0.003, 0.03, 0.5]))
        return self.last

    def command(self):
        if self.draw.random() < 0.1:
            return np.zeros(4)
        thrust = PAPER_PLATFORM.weight * self.draw.uniform(0.7, 1.3)
        return np.array([thrust, *self.draw.uniform(-3.0, 3.0, 3)])


def write_pose(row, pose):
    row["has_pose"] = pose is not None
    if pose is not None:
        row["pose"] = pose.flat
        row["pose_age"] = pose.age


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_drone_has_the_same_bits_alone_and_among_others(seed):
    table = FilterTable.allocate(DRONES, HISTORY)
    for r in range(DRONES):
        make_filter(r % 5, table.share_row(r))
    alone = [make_filter(r % 5) for r in range(DRONES)]
    cameras = [Cameras((seed, r)) for r in range(DRONES)]
    now = 0.0
    for _ in range(80):
        now += PERIOD * cameras[0].draw.choice([1.0, 1.03, 0.02, 5.0])
        for single, row, camera in zip(alone, table.rows, cameras, strict=True):
            pose = camera.look(now)
            write_pose(row, pose)
            row["command"] = single.commanded = camera.command()
            if pose is None:
                single.predict(now)
            else:
                single.update(pose, now)
        estimate_rows(table.rows, table.history, now)
        for name in OUTPUTS:
            each = np.array([single._row[name] for single in alone])
            np.testing.assert_array_equal(table.rows[name], each, name)
    assert table.rows["refused"].sum() > 0
    assert np.isfinite(table.rows["state"]).all()


def test_a_filter_that_is_made_again_clears_its_record_and_no_other():
    table = FilterTable.allocate(2, HISTORY)
    first = make_filter(4, table.share_row(0))
    second = make_filter(4, table.share_row(1))
    pose = Pose(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]))
    for f in (first, second):
        f.commanded = np.ones(4)
        f.update(pose, 1.0)
        f.update(pose, 1.01)
    again = make_filter(2, table.share_row(0))
    assert again.predict(1.02) is None
    assert (again.measured, again.refused, again.speed) == (-math.inf, 0, 0.0)
    assert not again.commanded.any()
    assert np.all(table.history[0, :, 0] == -math.inf)
    assert second.predict(1.02).age == pytest.approx(0.01)
    assert (table.history[1, :, 1] == 1.0).any()


def test_a_record_by_hand_is_skipped_and_then_written_by_its_own_filter():
    table = FilterTable.allocate(2, HISTORY)
    make_filter(2, table.share_row(1))
    own = VelocityFilter()
    row = table.rows[0]
    assert row["kind"] == FilterKind.BY_HAND
    pose = Pose(np.array([0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), 0.002)
    write_pose(row, pose)
    row["command"] = [1.0, 2.0, 3.0, 4.0]
    estimate_rows(table.rows, table.history, 1.0)
    assert not row["is_known"]
    estimate_by_hand(row, own, 1.0)
    np.testing.assert_array_equal(own.commanded, [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(read_state(row).flat, own.predict(1.0).flat)
    assert (row["measured"], row["refused"]) == (own.measured, 0)
    write_pose(row, None)
    estimate_by_hand(row, own, 1.5)
    assert row["age"] == pytest.approx(0.502)


@pytest.mark.parametrize("kind", range(5))
@pytest.mark.parametrize("age", [math.nan, math.inf, -math.inf])
def test_a_pose_without_a_finite_age_is_refused(kind, age):
    f = make_filter(kind)
    flat = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    assert f.update(Pose(flat, age), 0.0) is None
    f.update(Pose(flat), 0.01)
    for k in range(2, 12):
        state = f.update(Pose(flat, age), 0.01 * k)
        assert np.all(np.isfinite(state.flat))
        assert state.age == pytest.approx(0.01 * (k - 1))
    assert f.refused == 11


def test_a_command_is_copied_and_may_be_changed_in_place():
    f = make_filter(3)
    told = np.array([1.0, 2.0, 3.0, 4.0])
    f.commanded = told
    told[0] = 9.0
    np.testing.assert_array_equal(f.commanded, [1.0, 2.0, 3.0, 4.0])
    f.commanded[1] = 5.0
    np.testing.assert_array_equal(f.commanded, [1.0, 5.0, 3.0, 4.0])


def test_a_history_of_the_advised_size_gives_the_bits_of_a_long_one():
    """Poses are not readable for the whole horizon, then one is accepted after it; commands are new each tick."""
    advised = make_filter(4, FilterTable.allocate(1, HISTORY))
    long = make_filter(4, FilterTable.allocate(1, 4 * HISTORY))
    camera = Cameras(1)
    for k in range(700):
        is_seen = k % 220 < 30
        flat = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0 if is_seen else np.nan]
        command = camera.command()
        for f in (advised, long):
            f.commanded = command
            f.update(Pose(np.array(flat), 0.03), PERIOD * k)
        np.testing.assert_array_equal(advised._row["state"], long._row["state"])
    assert advised.refused > 400


@pytest.mark.parametrize(
    ("horizon", "rate", "size"),
    [(2.0, 100.0, 256), (2.0, 240.0, 640), (0.5, 100.0, 64), (2.0, 0.0, 512)],
)
def test_the_history_holds_the_commands_of_the_horizon_and_a_quarter_more(
    horizon, rate, size
):
    assert compute_history_size(horizon, 1.0 / rate if rate else 0.0) == size
