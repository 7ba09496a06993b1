import math

import numpy as np
import pytest

from crazychoir.math3d import exponential, product, quaternion_of_yaw
from crazychoir.safety.tracking import Ascent, Standing, before_arming, in_the_air
from crazychoir.types import Pose

HOMES = {0: np.array([0.0, 0.0, 0.0]), 1: np.array([1.0, 0.0, 0.0]), 2: np.array([0.0, 1.0, 0.0])}


def at(p, yaw=0.0, tilt=0.0):
    q = product(tuple(quaternion_of_yaw(yaw)), exponential(tilt, 0.0, 0.0))
    return Pose(np.array([*p, *q]))


def standing(**changes):
    """Three drones at home, each as it says; changes: `own1`, `seen2`."""
    return {
        i: Standing(home, changes.get(f"own{i}", at(home)), changes.get(f"seen{i}", at(home + 0.004)))
        for i, home in HOMES.items()
    }


def said(drones, i=1):
    found = before_arming(i, drones)
    assert all(before_arming(j, drones) == [] for j in drones if j != i)
    return found


def test_nothing_is_said_where_all_agrees():
    assert said(standing()) == []
    assert said(standing(own1=at((1.03, 0.03, 0.0), yaw=math.radians(4.5)))) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"own1": None}, "it does not say where it is"),
        ({"seen1": None}, "the cameras do not see it"),
        ({"own1": at((1.06, 0, 0))}, "it takes itself to be 0.06 m from where it is seen, limit 0.05 m"),
        ({"own1": at((math.nan, 0, 0))}, "it takes itself to be nan m"),
        ({"own1": at((1, 0, 0), yaw=math.pi)}, "it looks 180 deg away from how it is seen, limit 5 deg"),
        ({"own1": at((1, 0, 0), yaw=-3.1), "seen1": at((1, 0, 0), yaw=3.05)}, "it looks 8 deg away"),
        ({"seen1": at((1, 0, 0), tilt=0.12)}, "it is seen tilted by 7 deg from what it says, limit 5 deg"),
    ],
)
def test_what_does_not_agree_keeps_it_on_the_ground(changes, words):
    (text,) = said(standing(**changes))
    assert text.startswith(words)


def test_exchanged_bodies_are_seen_by_where_they_stand_although_each_drone_believes_the_cameras():
    drones = standing(seen0=at(HOMES[1]), own0=at(HOMES[1]), seen1=at(HOMES[0]), own1=at(HOMES[0]))
    assert before_arming(0, drones) == [
        "its body is 0.00 m from the home of drone 1, 1.00 m from its own: exchanged with that of drone 1"
    ]
    assert "exchanged with that of drone 0" in before_arming(1, drones)[0]
    assert before_arming(2, drones) == []


def test_a_body_at_the_home_of_one_that_is_at_home_is_not_exchanged_with_it():
    (text,) = said(standing(seen1=at((0.1, 0.9, 0.0)), own1=at((0.1, 0.9, 0.0))))
    assert text == "its body is 0.14 m from the home of drone 2, 1.27 m from its own"


def test_who_need_not_stand_at_home_may_stand_anywhere():
    drones = {i: Standing(None, at(HOMES[1]), at(HOMES[1])) for i in HOMES}
    assert before_arming(0, drones) == []


def ascents(body_of=None, flying=(0, 1, 2), turned=None, seconds=2.0, swing=0.03, hz=10.0):
    """Drones that rise to 0.1 m within 1 s and swing a little, each its own way; body_of: whose body is seen of whom;
    turned: rad, of a body's axes about z.
    """
    body_of, turned = body_of or {}, turned or {}
    noise = np.random.default_rng(3)
    found = {i: Ascent() for i in HOMES}
    for k in range(round(seconds * hz)):
        t = k / hz
        tilts = {i: complex(*noise.normal(0.0, swing if i in flying else 0.0, 2)) for i in HOMES}
        for i, ascent in found.items():
            j = body_of.get(i, i)
            z = min(0.1 * t, 0.1) if j in flying else 0.0
            own, seen = (c + complex(*noise.normal(0.0, math.radians(0.2), 2)) for c in (tilts[i], tilts[j]))
            seen = seen * np.exp(-1j * turned.get(i, 0.0)) + 0.02  # mounted a little askew
            if j is not None:
                ascent.add(t, i in flying and t > 0.1, (own.real, own.imag), z, (seen.real, seen.imag))
    return found


def test_nothing_is_said_where_each_body_does_what_its_drone_does():
    rising = ascents()
    assert [in_the_air(i, rising) for i in rising] == [[], [], []]


def test_of_two_that_take_off_together_with_exchanged_bodies_each_moves_as_the_other_body():
    rising = ascents(body_of={0: 1, 1: 0})
    assert in_the_air(0, rising) == ["it tilts as the body of drone 1 does, not as its own: exchanged"]
    assert in_the_air(1, rising) == ["it tilts as the body of drone 0 does, not as its own: exchanged"]
    assert in_the_air(2, rising) == []


def test_of_one_that_takes_off_alone_the_other_body_rises():
    rising = ascents(body_of={0: 1, 1: 0}, flying=(0,))
    assert in_the_air(0, rising)[0] == (
        "it flies, its body stays, and that of drone 1, which does not fly, rises: exchanged"
    )
    assert in_the_air(1, rising) == ["it does not fly, and its body has risen by 0.10 m"]
    assert in_the_air(2, rising) == []


@pytest.mark.parametrize("degrees", [180, 90, -90, -135])
def test_a_body_that_is_put_on_the_wrong_way_round_is_named_with_its_angle(degrees):
    rising = ascents(turned={1: math.radians(degrees)})
    (text,) = in_the_air(1, rising)
    angle = float(text.split("turned by ")[1].split()[0])
    assert abs((angle - degrees + 180) % 360 - 180) < 10
    assert in_the_air(0, rising) == []


def test_a_body_that_moves_by_itself_is_named():
    rising = ascents()
    for k in range(20):
        rising[1]._seen[k] = complex(*np.random.default_rng(k).normal(0.0, 0.03, 2))
    assert in_the_air(1, rising)[0].startswith("its body does not tilt as it does (correlation 0.")


def test_too_little_motion_or_too_few_samples_say_nothing():
    assert in_the_air(0, ascents(body_of={0: 1, 1: 0}, swing=0.0)) == []
    assert in_the_air(0, ascents(body_of={0: 1, 1: 0}, hz=4.0)) == []


def test_a_body_that_is_not_seen_in_the_air_is_named():
    rising = ascents()
    blind = Ascent()
    for k in range(20):
        blind.add(k / 10, k > 1, (0.01 * (-1) ** k, 0.0), math.nan, (math.nan, math.nan))
    assert in_the_air(0, {**rising, 0: blind}) == [], "it may not have left the ground yet"
    for k in range(20, 28):
        blind.add(k / 10, True, (0.01 * (-1) ** k, 0.0), math.nan, (math.nan, math.nan))
    assert in_the_air(0, {**rising, 0: blind}) == ["it flies for 2.5 s, and its body is not seen"]
    assert in_the_air(0, {0: Ascent()}) == []


def test_of_two_that_tilt_together_each_body_is_its_own_drones():
    """As gusts, or the same take-off, make them."""
    draw, common = np.random.default_rng(5), np.random.default_rng(6).normal(0.0, 0.03, (20, 2))
    rising = {i: Ascent() for i in (0, 1)}
    for k in range(20):
        for ascent in rising.values():
            own = common[k] + draw.normal(0.0, 0.004, 2)
            ascent.add(k / 10, True, tuple(own), 0.005 * k, tuple(own + draw.normal(0.0, 0.002, 2)))
    assert abs(rising[0].likeness(rising[1])) > 0.95
    assert [in_the_air(i, rising) for i in rising] == [[], []]
