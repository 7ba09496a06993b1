import numpy as np
import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.view import CameraBlur, FrameFilter, RateLimit

LEVEL = np.array([1.0, 2.0, 0.5, 0.0, 0.0, 0.0, 1.0])


def frame(number, t, **bodies):
    return PoseFrame(number, t, bodies or {"cf0": LEVEL})


def swarm(**mocap):
    drones = [
        {"id": i, "home": [float(i), 0.0, 0.0], "uri": f"udp://127.0.0.1:{19850 + i}"}
        for i in range(2)
    ]
    return SwarmConfig.of({"name": "lab", "drones": drones, "mocap": mocap})


@pytest.mark.parametrize("rate", [100.0, 120.0, 340.0])
def test_at_most_so_many_frames_a_second_pass(rate):
    pace, jitter = RateLimit(100.0), np.random.default_rng(1).uniform(0.0, 0.002, 2000)
    passed = sum(pace.passes(k / rate + jitter[k]) for k in range(round(5.0 * rate)))
    assert 495 <= passed <= 501, (
        "frames of the rate itself all pass, although they jitter"
    )


def test_a_source_that_begins_anew_is_let_through():
    pace = RateLimit(100.0)
    assert pace.passes(1000.0)
    assert pace.passes(0.0)
    assert not pace.passes(0.0005)


def test_an_overtaken_frame_is_not_published_and_a_missing_one_is_counted():
    view = FrameFilter(1000.0)
    shown = [view.see(frame(number, 0.01 * number)) for number in (0, 1, 5, 4, 5, 6)]
    assert [one is not None for one in shown] == [True, True, True, False, False, True]
    assert (view.lost, view.late) == (3, 2)


def test_after_a_restart_of_its_server_nothing_counts_as_late_or_lost():
    view = FrameFilter(1000.0)
    times = [(7, 50.0), (8, 50.01), (0, 0.0), (1, 0.01), (0, 90.0)]
    assert all(view.see(frame(number, t)) for number, t in times)
    assert (view.lost, view.late) == (0, 0)


@pytest.mark.parametrize("t", [np.nan, np.inf, -1e300])
def test_a_frame_of_no_time_is_dropped_and_the_next_one_is_not(t):
    view = FrameFilter(100.0, CameraBlur(swarm()))
    assert [
        view.see(frame(k, at)) is not None for k, at in enumerate((0.0, t, 0.01))
    ] == [True, False, True]


@pytest.mark.parametrize(
    "bad", [np.full(7, np.nan), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])]
)
def test_what_is_no_pose_is_not_seen(bad):
    seen, _ = FrameFilter(100.0).see(frame(0, 0.0, cf0=LEVEL, cf1=bad))
    assert list(seen.bodies) == ["cf0"]


def test_virtual_poses_are_seen_as_simulated_cameras_see_them():
    view = FrameFilter(100.0, CameraBlur(swarm(noise=0.01, latency=0.02)))
    shown = [
        view.see(frame(k, 0.01 * k, cf0=LEVEL + 0.1 * k * np.eye(7)[0], wand=LEVEL))
        for k in range(50)
    ]
    assert [list(one.bodies) for one, _ in shown[:3]] == [
        ["wand"],
        ["wand"],
        ["wand", "cf0"],
    ], "they are 20 ms late"
    errors = [
        one.bodies["cf0"][0:3] - LEVEL[0:3] - [0.1 * (k - 2), 0, 0]
        for k, (one, _) in enumerate(shown)
        if k > 1
    ]
    assert np.std(errors) == pytest.approx(0.01, rel=0.3)
    assert {round(age, 9) for one, age in shown[2:]} == {0.02}
    assert all(np.array_equal(one.bodies["wand"], LEVEL) for one, _ in shown), (
        "a body of no drone is shown as it is"
    )


def test_a_server_that_was_started_again_is_seen_as_late_as_before():
    view = FrameFilter(100.0, CameraBlur(swarm(latency=0.02)))
    times = [0.01 * k for k in range(500)]
    shown = [view.see(frame(k, t)) for run in range(2) for k, t in enumerate(times)]
    assert ["cf0" in one.bodies for one, _ in shown] == [False] * 2 + [True] * 998


def test_what_the_server_does_not_show_is_not_seen_and_dropouts_come_on_top():
    view = FrameFilter(100.0, CameraBlur(swarm(dropout=0.25)))
    shown = [view.see(frame(k, 0.01 * k, cf1=LEVEL))[0].bodies for k in range(400)]
    assert not any("cf0" in bodies for bodies in shown)
    assert sum("cf1" in bodies for bodies in shown) == pytest.approx(300, abs=30)


@pytest.mark.parametrize("origin", [0.0, -3.5, 86_400.0, 1.76e9, -1.76e9, 4e9])
def test_frames_are_taken_whatever_their_times_count_from(origin):
    view = FrameFilter(100.0, CameraBlur(swarm(latency=0.02)))
    shown = [view.see(frame(k, origin + 0.01 * k)) for k in range(50)]
    assert all(one is not None for one in shown)
    assert ["cf0" in one.bodies for one, _ in shown] == [False] * 2 + [True] * 48
    assert (view.lost, view.late, view.timeless) == (0, 0, 0)


@pytest.mark.parametrize("t", [np.nan, -np.inf, 1.76e12, 1.76e18])
def test_a_time_that_is_none_in_seconds_is_counted_as_such(t):
    view = FrameFilter(100.0)
    assert view.see(frame(0, t)) is None
    assert (view.late, view.timeless) == (0, 1)


@pytest.mark.parametrize("jump", [-0.5, -30.0, -1.76e9, 0.5, 3600.0, 1.76e9])
def test_a_clock_that_is_set_interrupts_nothing(jump):
    view = FrameFilter(100.0, CameraBlur(swarm()))
    times = [100.0 + 0.01 * k + (jump if k >= 50 else 0.0) for k in range(150)]
    shown = [view.see(frame(k, t)) for k, t in enumerate(times)]
    assert all(one is not None for one in shown)
    assert (view.lost, view.late) == (0, 0)


def test_the_rate_is_limited_after_a_clock_was_set_back_as_before():
    pace = RateLimit(100.0)
    times = [0.001 * k for k in range(1000)]
    passed = [
        sum(pace.passes(t + shift) for t in times) for shift in (1.76e9, 0.0, -0.5)
    ]
    assert passed == pytest.approx([100, 100, 100], abs=1)
