import numpy as np
import pytest

from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.watch import TrackingWatch

NAMES = {0: "cf0", 1: "cf1"}


def watched(seconds, bodies, rate=100.0, hz=100.0, live=True, gap=(0.0, 0.0)):
    """What is said while frames come; bodies(k): those in frame k; without frames in the gap, from s to s."""
    watch, said, k = TrackingWatch(NAMES, rate, live), [], 0
    for tick in range(round(4.0 * seconds)):
        while k / hz < 0.25 * (tick + 1):
            if not gap[0] <= k / hz < gap[1]:
                watch.note(PoseFrame(k, k / hz, bodies(k)), k / hz)
            k += 1
        said += [(0.25 * (tick + 1), text) for text in watch.look(0.25 * (tick + 1))]
    return watch, said


def moving(k, *names):
    return {name: np.array([0.001 * k, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]) for name in names}


def test_nothing_is_said_while_all_is_well():
    watch, said = watched(10.0, lambda k: moving(k, "cf0", "cf1"))
    assert said == []
    assert watch.mean_rate == pytest.approx(100.0, rel=0.02)
    assert watch.sights["cf1"].rate == pytest.approx(100.0, rel=0.02)


def test_slow_cameras_are_named_with_both_rates():
    _, said = watched(4.0, lambda k: moving(k, "cf0", "cf1"), hz=48.0)
    assert "frames come at 48 Hz; the drones count on [mocap] rate = 100" in said[0][1]


def test_a_gap_in_the_frames_and_one_of_a_body_are_said_with_their_length():
    _, said = watched(3.0, lambda k: moving(k, "cf0", "cf1"), gap=(1.0, 1.1))
    assert [text for _, text in said] == ["no frame for 0.110 s, more than 0.05 s"], (
        "no body is to blame"
    )
    _, said = watched(
        3.0, lambda k: moving(k, "cf0") if 100 <= k < 105 else moving(k, "cf0", "cf1")
    )
    assert [text for _, text in said] == [
        "body 'cf1' of drone 1 was not seen for 0.060 s"
    ]


def test_gaps_that_come_again_and_again_are_said_with_their_number_and_short_ones_are_not():
    def said_of(gap):
        watch, said, t = TrackingWatch(NAMES, 100.0, True), [], 0.0
        for k in range(160):
            t += gap if k % 10 == 0 else 0.01
            watch.note(PoseFrame(k, t, moving(k, "cf0", "cf1")), t)
            said += (
                [text for text in watch.look(t) if text.startswith("no frame")]
                if k % 20 == 19
                else []
            )
        return said

    assert said_of(0.045) == []
    first = "no frame for 0.090 s, more than 0.05 s"
    assert said_of(0.09) == [first, f"{first}; 6 such gaps"]


def test_a_body_that_is_missing_now_and_then_is_said_with_its_share():
    _, said = watched(
        8.0, lambda k: moving(k, "cf0", "cf1") if k % 10 else moving(k, "cf0")
    )
    assert {text for _, text in said} == {
        "body 'cf1' of drone 1 is missing in 10 % of the frames"
    }
    assert [t for t, _ in said] == [2.0, 3.0, 5.0]
    assert (
        watched(
            8.0,
            lambda k: moving(k, "cf0", "cf1") if k % 10 else moving(k, "cf0"),
            live=False,
        )[1]
        == []
    )


def test_a_body_that_is_never_seen_is_named_with_the_name_that_may_be_meant():
    _, said = watched(3.0, lambda k: moving(k, "cf0", "CF_1"))
    assert said[0][1] == (
        "body 'cf1' of drone 1 was never seen. Seen are 'CF_1', 'cf0'. Did you mean body = \"CF_1\"?"
    )
    assert any(
        text.startswith(
            "bodies of no drone are seen: 'CF_1'. The swarm file has 'cf0', 'cf1'"
        )
        for _, text in said
    )


def test_a_body_that_is_lost_is_said_ever_more_rarely():
    watch, said = watched(
        20.0, lambda k: moving(k, "cf0") if k > 100 else moving(k, "cf0", "cf1")
    )
    times = [t for t, text in said if "is not seen for" in text]
    assert times == [1.75, 2.75, 4.75, 8.75, 16.75]
    assert watch.sights["cf1"].dropped == 2000 - 101


def test_a_body_that_shows_the_very_same_digits_is_as_old_as_they_are():
    still = moving(0, "cf1")
    watch, said = watched(
        2.0, lambda k: moving(k, "cf0") | (still if k >= 50 else moving(k, "cf1"))
    )
    assert said[0][1].startswith(
        "body 'cf1' of drone 1 shows the very same pose for 0.8 s"
    )
    assert watch.age("cf1", 2.0) == pytest.approx(1.5)
    assert watch.age("cf0", 1.99) == 0.0


def test_a_system_that_hands_out_what_it_had_is_as_fast_as_what_is_new():
    """As VRPN, asked 100 times a second for what a tracker measures 25 times."""
    watch, said = watched(4.0, lambda k: moving(k, "cf0") | moving(k // 4, "cf1"))
    assert watch.sights["cf1"].rate == pytest.approx(25.0, rel=0.05)
    assert watch.sights["cf1"].dropped == 0
    assert any(
        text == "body 'cf1' of drone 1 was not seen for 0.040 s" for _, text in said
    )
    _, said = watched(4.0, lambda k: moving(k, "cf0") | moving(k // 2, "cf1"))
    assert {text for _, text in said} == {
        "body 'cf1' of drone 1 is measured at 50 Hz, shown at 100 Hz"
    }


def test_simulated_bodies_may_stand_still():
    watch, said = watched(2.0, lambda k: moving(0, "cf0", "cf1"), live=False)
    assert said == []
    assert watch.age("cf1", 2.0) == 0.0


def test_the_watch_says_nothing_while_the_source_gives_no_frames():
    watch, _ = watched(2.0, lambda k: moving(k, "cf0", "cf1"))
    assert watch.look(9.0) == []
    assert TrackingWatch(NAMES, 100.0, True).look(9.0) == []
