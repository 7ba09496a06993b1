"""The planner on board against 32-bit and 64-bit evaluations of the same polynomials written here."""

import math

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.firmware.planning import PLANNER_STATES
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.onboard import Onboard

F = np.float32
PLACE = (0.4, -0.3, 0.0)


@pytest.fixture
def onboard():
    drone = Onboard(CRAZYFLIE_21)
    drone.place(PLACE, 0.5)
    run(drone, 200)
    return drone


def run(onboard, ms):
    """The drone stands held at its place; only the planner moves."""
    p, q = np.array(PLACE), np.array([0, 0, math.sin(0.25), math.cos(0.25)])
    for _ in range(ms // 10):
        onboard.external_pose(p, q)
        loop.run(onboard.rows, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.80665)


def target(onboard, *names):
    names = names or ("x", "y", "z")
    return np.array([float(onboard.record["wanted"][name]) for name in names])


def samples(onboard, ms):
    """[(t of the planner, p, v, a, yaw)] of each 10 ms."""
    out, begin = [], float(onboard.record["planner"]["begin"])
    for _ in range(ms // 10):
        run(onboard, 10)
        t = float(
            F(
                onboard.record["tick"] // 10 * 10
                - 10
                + (10 if onboard.record["tick"] % 10 else 0)
            )
            * F(1e-3)
        )
        row = target(onboard, "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "yaw")
        out.append((t - begin, row[0:3], row[3:6], row[6:9], math.radians(row[9])))
    return out


def rest_to_rest(d, t, duration, kind):
    """35 s^4 - 84 s^5 + 70 s^6 - 20 s^7 as the coefficients of the firmware, evaluated in `kind`."""
    c = [
        0,
        0,
        0,
        0,
        35 * d / duration**4,
        -84 * d / duration**5,
        70 * d / duration**6,
        -20 * d / duration**7,
    ]
    value = kind(0)
    for a in c[::-1]:
        value = value * kind(t) + kind(a)
    return float(value)


def test_a_take_off_is_the_polynomial_in_32_and_64_bits(onboard):
    assert onboard.planner.take_off(1.2, 2.5) == 0
    for t, p, _, _, yaw in samples(onboard, 2490):
        assert p[:2] == pytest.approx(PLACE[:2], abs=1e-6)
        assert p[2] == pytest.approx(rest_to_rest(1.2, t, 2.5, F), abs=1e-6)
        assert p[2] == pytest.approx(rest_to_rest(1.2, t, 2.5, float), abs=2e-4)
        assert yaw == pytest.approx(0.5, abs=1e-6)
    run(onboard, 100)
    assert target(onboard)[2] == pytest.approx(1.2, abs=1e-5)
    assert target(onboard, "vz", "az") == pytest.approx([0, 0])


def test_after_ten_minutes_the_clock_of_32_bits_shows(onboard):
    onboard.record["tick"] += 600_000
    onboard.record["since"] += 600_000
    onboard.planner.take_off(1.2, 2.5)
    begin = onboard.record["tick"]
    worst = 0.0
    for k in range(240):
        run(onboard, 10)
        t = (onboard.record["tick"] - 10 - begin) * 1e-3
        worst = max(worst, abs(target(onboard)[2] - rest_to_rest(1.2, t, 2.5, float)))
        assert k < 240
    assert 1e-7 < worst < 2e-4


def test_velocity_and_acceleration_are_the_derivatives(onboard):
    onboard.planner.take_off(1.0, 2.0)
    rows = samples(onboard, 1500)
    z, v, a = (np.array([row[k][2] for row in rows]) for k in (1, 2, 3))
    assert np.gradient(z, 0.01)[1:-1] == pytest.approx(v[1:-1], abs=2e-3)
    assert np.gradient(v, 0.01)[1:-1] == pytest.approx(a[1:-1], abs=2e-2)


def test_refusals_of_take_off_and_landing(onboard):
    assert onboard.planner.land(0.0, 2.0) == 0, (
        "a drone that was sent set-points lands from idle"
    )
    onboard.planner.stop()
    assert onboard.planner.take_off(1.0, 2.0) == 0
    assert onboard.planner.take_off(1.0, 2.0) == 1
    run(onboard, 2100)
    assert onboard.planner.take_off(1.0, 2.0) == 1
    assert onboard.planner.land(0.0, 2.0) == 0
    assert onboard.planner.land(0.0, 2.0) == 1
    run(onboard, 2100)
    assert onboard.record["planner"]["state"] == 0
    assert target(onboard, "mode_z", "thrust") == pytest.approx([0, 0])
    assert onboard.planner.take_off(1.0, 2.0) == 0


def test_speeds_of_take_off_and_landing_are_parameters(onboard):
    onboard.set("hlCommander.vtoff", 0.25)
    onboard.planner.take_off(1.0)
    assert onboard.record["planner"]["piece"][32] == pytest.approx(4.0, abs=1e-4)


def risen(onboard):
    onboard.planner.take_off(1.0, 1.0)
    run(onboard, 1100)
    return onboard


def test_go_to_goes_on_smoothly_from_a_moving_set_point(onboard):
    risen(onboard).planner.go_to((1.4, -0.3, 1.0), 0.5, 2.0)
    run(onboard, 1000)
    before = target(onboard, "x", "vx", "ax")
    onboard.planner.go_to((0.4, 0.7, 1.5), 0.5, 2.0)
    run(onboard, 10)
    after = target(onboard, "x", "vx", "ax")
    assert after == pytest.approx(
        before + np.array([0.01 * before[1], 0.01 * before[2], 0]), abs=0.08
    )
    run(onboard, 2100)
    assert target(onboard) == pytest.approx([0.4, 0.7, 1.5], abs=1e-4)


def test_a_relative_go_to_adds_place_and_heading(onboard):
    risen(onboard).planner.go_to((0.1, 0.2, 0.3), 0.4, 1.0, relative=True)
    run(onboard, 1100)
    assert target(onboard) == pytest.approx([0.5, -0.1, 1.3], abs=1e-4)
    assert math.radians(target(onboard, "yaw")[0]) == pytest.approx(0.9, abs=1e-4)


def test_a_linear_go_to_has_one_velocity(onboard):
    risen(onboard).planner.go_to((1.4, -0.3, 1.0), 0.5, 2.0, linear=True)
    for t, p, v, _, _ in samples(onboard, 1900):
        assert v[0] == pytest.approx(0.5, abs=1e-4)
        assert p[0] == pytest.approx(0.4 + 0.5 * t, abs=1e-4)


def test_no_duration_is_a_jump(onboard):
    risen(onboard).planner.go_to((1.4, -0.3, 1.0), 0.5, 0.0)
    run(onboard, 10)
    assert target(onboard) == pytest.approx([1.4, -0.3, 1.0], abs=1e-5)


@pytest.mark.parametrize(
    ("goal", "reached"),
    [(-2.9, 2 * math.pi - 2.9), (-1.0, -1.0), (4.5, 4.5 - 2 * math.pi)],
)
def test_yaw_turns_the_short_way(onboard, goal, reached):
    risen(onboard).planner.go_to((0.4, -0.3, 1.0), goal, 1.0)
    run(onboard, 500)
    assert math.radians(target(onboard, "yaw")[0]) == pytest.approx(
        (0.5 + reached) / 2, abs=0.1
    )


def test_stop_cuts_the_motors(onboard):
    risen(onboard).planner.stop()
    run(onboard, 20)
    assert np.all(onboard.record["motors"] == 0.0)


def pieces(*rows):
    """Piece rows of {axis: coefficients} and durations."""
    out = np.zeros((len(rows), 33))
    for row, (axes, duration) in zip(out, rows, strict=True):
        for axis, c in axes.items():
            row[8 * axis : 8 * axis + len(c)] = c
        row[32] = duration
    return out


RAMP = pieces(
    ({0: [1.0, 0.5], 2: [1.0], 3: [0.1]}, 1.0),
    ({0: [1.5, 0.5, 0.2], 2: [1.0], 3: [0.1, 0.3]}, 2.0),
)


def target_of_ramp(t):
    """The place (2,) m of RAMP in its own coordinates."""
    return np.array([1 + 0.5 * t + 0.2 * max(t - 1.0, 0.0) ** 2, 0.0])


def test_a_trajectory_runs_through_its_pieces_and_holds_its_end(onboard):
    onboard.trajectories.upload(3, RAMP)
    assert risen(onboard).planner.start_trajectory(3) == 0
    for t, p, v, a, yaw in samples(onboard, 2900):
        u = t - 1.0
        assert p[0] == pytest.approx(
            1 + 0.5 * t + (0.2 * u * u if u > 0 else 0), abs=1e-5
        )
        assert v[0] == pytest.approx(0.5 + (0.4 * u if u > 0 else 0), abs=1e-4)
        if abs(u) > 1e-3:  # between the pieces
            assert a[0] == pytest.approx(0.4 if u > 0 else 0, abs=1e-4)
        assert yaw == pytest.approx(0.1 + (0.3 * u if u > 0 else 0), abs=1e-5)
    run(onboard, 500)
    assert target(onboard, "x", "vx", "ax") == pytest.approx([3.3, 0, 0], abs=1e-5)


def test_a_time_scale_slows_and_a_reversed_one_returns(onboard):
    onboard.trajectories.upload(0, RAMP)
    risen(onboard).planner.start_trajectory(0, timescale=2.0)
    for t, p, v, a, _ in samples(onboard, 5900):
        s = t / 2
        u = max(s - 1.0, 0.0)
        assert p[0] == pytest.approx(1 + 0.5 * s + 0.2 * u * u, abs=1e-5)
        assert v[0] == pytest.approx((0.5 + 0.4 * u) / 2, abs=1e-4)
        if abs(s - 1.0) > 1e-3:  # between the pieces
            assert a[0] == pytest.approx(0.4 / 4 if u > 0 else 0, abs=1e-4)
    onboard.planner.start_trajectory(0, reverse=True)
    for t, p, v, _, _ in samples(onboard, 2900):
        s = 3.0 - t
        u = max(s - 1.0, 0.0)
        assert p[0] == pytest.approx(1 + 0.5 * s + 0.2 * u * u, abs=1e-5)
        assert v[0] == pytest.approx(-(0.5 + 0.4 * u), abs=1e-4)


def test_a_relative_trajectory_starts_here(onboard):
    onboard.trajectories.upload(0, RAMP)
    risen(onboard).planner.start_trajectory(0, relative=True)
    run(onboard, 1010)
    assert target(onboard) == pytest.approx([0.9, -0.3, 1.0], abs=1e-4)
    assert math.radians(target(onboard, "yaw")[0]) == pytest.approx(0.1, abs=1e-5)


def test_a_trajectory_with_relative_yaw_turns_about_its_own_origin(onboard):
    """As in the firmware, the trajectory jumps if it does not begin at its origin."""
    onboard.trajectories.upload(0, RAMP)
    risen(onboard).planner.go_to((0.4, -0.3, 1.0), 0.5, 0.0)
    run(onboard, 10)
    onboard.planner.start_trajectory(0, relative=True, relative_yaw=True)
    run(onboard, 1010)
    begin, end = target_of_ramp(0.0), target_of_ramp(1.0)
    c, s = math.cos(0.4), math.sin(0.4)  # from 0.1 rad of the ramp to 0.5 rad
    turned = np.array([[c, -s], [s, c]]) @ end
    assert target(onboard)[:2] == pytest.approx(
        np.array([0.4, -0.3]) - begin + turned, abs=1e-4
    )
    assert math.radians(target(onboard, "yaw")[0]) == pytest.approx(0.5, abs=1e-5)


def test_relative_yaw_counts_for_relative_trajectories_alone(onboard):
    onboard.trajectories.upload(0, RAMP)
    risen(onboard).planner.start_trajectory(0, relative_yaw=True)
    run(onboard, 1010)
    assert target(onboard)[:2] == pytest.approx(target_of_ramp(1.0), abs=1e-4)
    assert math.radians(target(onboard, "yaw")[0]) == pytest.approx(0.1, abs=1e-5)


def test_slots_memory_and_their_codes(onboard):
    assert onboard.planner.start_trajectory(5) == 0
    assert onboard.record["planner"]["state"] == PLANNER_STATES.idle
    onboard.trajectories.upload(0, RAMP)
    onboard.trajectories.upload(1, RAMP)
    assert onboard.record["planner"]["offset"][1] == 66
    onboard.trajectories.memory[0:132] = np.frombuffer(
        RAMP[1].astype(np.float32).tobytes(), np.uint8
    )
    assert onboard.trajectories.define_trajectory(30, 0, 1) == 0
    assert onboard.planner.start_trajectory(30) == 0
    run(onboard, 20)
    assert target(onboard)[0] == pytest.approx(1.505, abs=0.01)
    assert onboard.trajectories.define_trajectory(31, 0, 1) == 8


@pytest.mark.parametrize("where", [(2, 1), (0, 32), (4000, 1), (0, 0)])
def test_a_trajectory_outside_of_the_memory_is_accepted_and_never_flown(onboard, where):
    """The firmware answers 0 to both (crtp_commander_high_level.c)."""
    before = target(risen(onboard))
    assert onboard.trajectories.define_trajectory(0, *where) == 0
    assert onboard.planner.start_trajectory(0) == 0
    still_flown(onboard, before)


@pytest.mark.parametrize(
    "begin",
    [
        lambda planner: planner.go_to((math.nan, 0.0, 1.0), 0.5, 2.0),
        lambda planner: planner.go_to((3e38, 0.0, 1.0), 0.5, 2.0),
        lambda planner: planner.go_to((1e300, 0.0, 1.0), 0.5, 0.0),
        lambda planner: planner.go_to((0.0, 0.0, 1.0), 0.5, math.nan),
        lambda planner: planner.go_to((0.0, 0.0, 1.0), 0.5, 1e30),
        lambda planner: planner.land(math.nan, 1.0),
        lambda planner: planner.land(0.0, math.inf),
        lambda planner: planner.spiral(math.nan, 0.5, 0.5, 0.0, 2.0),
        lambda planner: planner.start_trajectory(0, math.nan),
        lambda planner: planner.start_trajectory(0, 0.0),
    ],
)
def test_numbers_that_are_not_finite_are_accepted_and_disable_the_planner(
    onboard, begin
):
    """The firmware: answer 0; its set-points end, it levels out and is locked."""
    onboard.trajectories.upload(0, RAMP)
    assert begin(risen(onboard).planner) == 0
    assert onboard.record["planner"]["state"] == PLANNER_STATES.disabled
    run(onboard, 700)
    assert onboard.state == "warning: level out"
    assert onboard.info & SUPERVISOR_BITS.plan_disabled
    run(onboard, 1500)
    assert onboard.state == "locked"


@pytest.mark.parametrize(
    ("axes", "duration"),
    [
        ({0: [1.0, math.nan]}, 1.0),
        ({1: [1.0, math.inf]}, 1.0),
        ({0: [1.0, 1.0]}, math.nan),
        ({0: [1.0, 1.0]}, math.inf),
    ],
)
def test_a_trajectory_with_a_number_that_is_not_finite_disables_the_planner(
    onboard, axes, duration
):
    words = pieces((axes, duration)).astype(np.float32)
    onboard.trajectories.memory[0:132] = np.frombuffer(words.tobytes(), np.uint8)
    assert onboard.trajectories.define_trajectory(0, 0, 1) == 0
    assert risen(onboard).planner.start_trajectory(0) == 0
    assert onboard.record["planner"]["state"] == PLANNER_STATES.disabled


def test_a_take_off_without_a_height_disables_the_planner_until_it_is_stopped(onboard):
    """The firmware: 0, then 1 for each take-off."""
    assert onboard.planner.take_off(math.nan, 1.0) == 0
    assert onboard.planner.take_off(1.0, 1.0) == 1
    onboard.planner.stop()
    assert onboard.planner.take_off(1.0, 1.0) == 0


@pytest.mark.parametrize(
    ("slot", "rows", "words"),
    [
        (31, RAMP, "trajectory: slot: found 31; allowed: 0 to 30"),
        (0, np.zeros((2, 32)), r"trajectory 0: shape: found \(2, 32\)"),
        (0, np.zeros((0, 33)), "shape"),
        (0, np.zeros((1, 33)), "durations above 0 s"),
        (
            0,
            np.tile(RAMP, (16, 1)),
            "32 pieces; allowed: at most 31 in all slots, 31 are free",
        ),
    ],
)
def test_a_wrong_upload_says_what_is_allowed(onboard, slot, rows, words):
    with pytest.raises(ConfigError, match=words):
        onboard.trajectories.upload(slot, rows)


def test_31_pieces_fit(onboard):
    onboard.trajectories.upload(0, np.tile(RAMP[0], (31, 1)))
    assert risen(onboard).planner.start_trajectory(0) == 0


@pytest.mark.parametrize(("clockwise", "side"), [(False, 1.0), (True, -1.0)])
def test_a_spiral_ends_on_its_radius_at_its_angle(onboard, clockwise, side):
    risen(onboard)
    assert (
        onboard.planner.spiral(math.pi / 2, 0.5, 0.7, 0.2, 3.0, clockwise=clockwise)
        == 0
    )
    run(onboard, 20)
    start = target(onboard, "vx", "vy")
    run(onboard, 3100)
    x, y, z = target(onboard)
    centre = np.array(PLACE[:2]) + 0.5 * side * np.array(
        [-math.sin(0.5), math.cos(0.5)]
    )
    assert math.hypot(x - centre[0], y - centre[1]) == pytest.approx(0.7, abs=1e-3)
    assert z == pytest.approx(1.2, abs=1e-4)
    assert math.radians(target(onboard, "yaw")[0]) == pytest.approx(
        0.5 + side * math.pi / 2, abs=1e-4
    )
    nose = np.array([math.cos(0.5), math.sin(0.5)])
    assert start @ nose == pytest.approx(
        0.5 * math.pi / 2 / 3, rel=0.1
    )  # forward, along the circle


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("sideways", [False, True])
@pytest.mark.parametrize("angle", [1.2, -1.2, 9.0])
def test_a_spiral_turns_about_the_firmwares_point(onboard, sideways, clockwise, angle):
    """The sense alone chooses the point: +1 clockwise, -1 the other way round.

    sideways: p + sense r0 (cos yaw, sin yaw), else p + sense r0 (sin yaw, -cos yaw);
    the heading turns by -sense angle, at most by a turn.
    """
    risen(onboard)
    flags = {"sideways": sideways, "clockwise": clockwise}
    assert onboard.planner.spiral(angle, 0.5, 0.7, 0.0, 3.0, **flags) == 0
    run(onboard, 3100)
    sense = 1.0 if clockwise else -1.0
    nose = np.array([math.cos(0.5), math.sin(0.5)])
    right = np.array([math.sin(0.5), -math.cos(0.5)])
    centre = np.array(PLACE[:2]) + sense * 0.5 * (nose if sideways else right)
    turn = -sense * min(angle, 2 * math.pi)
    c, s = math.cos(turn), math.sin(turn)
    out = np.array([[c, -s], [s, c]]) @ (np.array(PLACE[:2]) - centre) / 0.5
    assert target(onboard)[:2] == pytest.approx(centre + 0.7 * out, abs=1e-3)
    yaw = math.radians(target(onboard, "yaw")[0])
    assert math.remainder(yaw - 0.5 - turn, 2 * math.pi) == pytest.approx(0, abs=1e-4)


def test_a_negative_radius_is_none(onboard):
    risen(onboard)
    assert onboard.planner.spiral(1.0, -0.5, -0.7, 0.0, 3.0) == 0
    run(onboard, 3100)
    assert target(onboard)[:2] == pytest.approx(PLACE[:2], abs=1e-4)


LONG, SHORT = (2e5, 1e7), (1e-16, 1e-7, 5e-4)


def still_flown(onboard, before):
    """The plan of before goes on, and all that is asked for is a number."""
    run(onboard, 100)
    assert target(onboard) == pytest.approx(before, abs=1e-3)
    assert all(
        math.isfinite(onboard.log(f"ctrltarget.{name}"))
        for name in ("x", "vx", "ax", "z", "yaw")
    )
    assert np.all(np.isfinite(onboard.record["motors"]))


@pytest.mark.parametrize("duration", LONG)
def test_a_plan_of_a_wild_duration_is_refused_and_the_last_one_goes_on(
    onboard, duration
):
    assert onboard.planner.take_off(1.0, duration) == 1
    before = target(risen(onboard))
    assert onboard.planner.go_to((1.4, -0.3, 1.0), 0.5, duration) == 1
    assert onboard.planner.go_to((1.4, -0.3, 1.0), 0.5, duration, linear=True) == 1
    assert onboard.planner.land(0.0, duration) == 1
    assert onboard.planner.spiral(1.0, 0.5, 0.5, 0.0, duration) == 1
    still_flown(onboard, before)
    assert onboard.planner.land(0.0, 1.0) == 0


@pytest.mark.parametrize("duration", SHORT)
def test_a_plan_of_no_duration_is_at_its_end_at_once(onboard, duration):
    assert onboard.planner.take_off(1.0, duration) == 0
    assert onboard.planner.go_to((1.4, -0.3, 1.0), 0.5, duration, linear=True) == 0
    still_flown(onboard, [1.4, -0.3, 1.0])
    assert onboard.planner.land(0.0, duration) == 0
    run(onboard, 20)
    assert onboard.record["planner"]["state"] == 0


@pytest.mark.parametrize("far", [1e18, 1e20])
def test_a_plan_beyond_all_bounds_is_refused(onboard, far):
    before = target(risen(onboard))
    assert onboard.planner.go_to((far, 0.0, 1.0), 0.5, 2.0) == 1
    assert onboard.planner.go_to((far, 0.0, 1.0), 0.5, 0.0) == 1
    assert onboard.planner.land(far, 2.0) == 1
    assert onboard.planner.spiral(1.0, far, 0.5, 0.0, 2.0) == 1
    still_flown(onboard, before)


@pytest.mark.parametrize(
    ("axes", "duration", "timescale"),
    [
        ({2: [1e30]}, 1.0, 1.0),
        ({0: [1.0, 1.0]}, -1.0, 1.0),
        ({0: [1.0, 1.0]}, 1e30, 1e-28),
        ({0: [1.0, 1.0]}, 1.0, 1e-30),
        ({0: [1.0, 1.0]}, 1.0, 1e30),
        ({0: [0.0, 0.0, 0.0, 1e12]}, 1.0, 1e-2),
    ],
)
def test_an_uploaded_trajectory_that_cannot_be_flown_is_refused(
    onboard, axes, duration, timescale
):
    words = pieces((axes, duration)).astype(np.float32)
    onboard.trajectories.memory[0:132] = np.frombuffer(words.tobytes(), np.uint8)
    assert onboard.trajectories.define_trajectory(0, 0, 1) == 0
    before = target(risen(onboard))
    assert onboard.planner.start_trajectory(0, timescale) == 1
    still_flown(onboard, before)
