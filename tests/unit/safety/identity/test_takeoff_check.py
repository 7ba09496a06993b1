"""A take-off, drawn: drones that tilt each its own way, and the bodies that cameras take for theirs."""

import math
from dataclasses import replace

import numpy as np
import pytest

from crazychoir.numerics.math3d import (
    quaternion_of_yaw,
    quaternion_product,
    rotation,
    rotation_exponential,
)
from crazychoir.safety.identity import takeoff_check
from crazychoir.safety.identity.takeoff_check import (
    TAKEOFF_WATCH,
    TILT_JUDGEMENT,
    TakeoffCheck,
    TiltTrack,
    compute_tilt,
)

IDS, HZ, SEEN = (0, 1, 2), 20, 50
BEGINS = 1.0
"""s at which they are told to fly."""


def wobble(i, swing, t):
    """How drone i is tilted at t s: level until BEGINS, then more and more."""
    phase = 2.0 * i + 2.0
    return (
        swing
        * max(t - BEGINS, 0.0)
        * complex(math.cos(7.0 * t + phase), math.sin((5.0 + i) * t + phase))
    )


class Flight:
    """Three drones that take off at the same time.

    body_of: by drone, the drone with the body that is taken for its own
    turned: by drone, rad by which its body is turned
    late: s that a drone's word takes
    said: by drone, what was found first, and when
    """

    def __init__(
        self,
        body_of=None,
        turned=None,
        swing=0.1,
        seconds=3.0,
        late=0.03,
        flying=IDS,
        noise=0.1,
        shared=0.0,
        seed=1,
    ):
        self.draw, self.noise = np.random.default_rng(seed), math.radians(noise)
        body_of, turned = body_of or {}, turned or {}
        self.own, self.bodies, self.ascents, self.said = (
            {i: TiltTrack() for i in IDS},
            {i: TiltTrack() for i in IDS},
            {},
            {},
        )

        def truth(i, t):
            common = shared * wobble(7, swing, t)
            return (
                (common + (1.0 - shared) * wobble(i, swing, t)) if i in flying else 0j
            )

        for k in range(round(100 * seconds)):
            t = k / 100
            if k % (100 // SEEN) == 0:
                for i, track in self.bodies.items():
                    j = body_of.get(i, i)
                    height = 0.2 * max(t - BEGINS - 0.2, 0.0) if j in flying else 0.0
                    track.flies = i in flying and t > BEGINS + 0.3
                    u = (
                        truth(j, t) * np.exp(-1j * turned.get(i, 0.0)) + 0.02
                    )  # mounted askew
                    track.add(t, u + self.error(), height)
            if k % (100 // HZ) == 0:
                for i in IDS:
                    self.tell(i, t, truth(i, t - late) + self.error(), i in flying)

    def error(self):
        return complex(*self.draw.normal(0.0, self.noise, 2))

    def tell(self, i, t, u, flies):
        self.own[i].add(t, u)
        if not flies or t < BEGINS:
            return
        if i not in self.ascents:
            self.ascents[i] = TakeoffCheck(i, t, self.own[i], self.bodies)
        found = self.ascents[i].judge(t, u, t > BEGINS + 0.1)
        if found:
            self.said.setdefault(i, (found, t - BEGINS))


def test_nothing_is_said_where_each_body_does_what_its_drone_does():
    flight = Flight()
    assert flight.said == {}
    assert len(flight.ascents) == len(IDS)


@pytest.mark.parametrize("late", [0.0, 0.02, 0.05])
def test_two_drones_with_exchanged_bodies_that_take_off_together_each_move_as_the_other_body(
    late,
):
    said = Flight(body_of={0: 1, 1: 0}, late=late).said
    assert set(said) == {0, 1}
    for i, (text, t) in said.items():
        assert text.startswith(
            f"it does not tilt as its body does, but as the body of drone {1 - i}"
        )
        assert t < 1.0


@pytest.mark.parametrize("degrees", [180, 90, -90, -135])
def test_a_body_that_is_put_on_the_wrong_way_round_is_named_with_its_angle(degrees):
    said = Flight(turned={1: math.radians(degrees)}).said
    assert set(said) == {1}
    text, t = said[1]
    angle = float(text.split("its own turned by ")[1].split()[0])
    assert abs((angle - degrees + 180) % 360 - 180) < 12
    assert t < 1.0


def test_a_slightly_turned_drone_may_fly():
    assert Flight(turned={0: math.radians(12)}).said == {}


def test_a_drone_that_flies_alone_with_the_body_of_another_is_found():
    said = Flight(body_of={0: 1, 1: 0}, flying=(0,)).said
    assert said[0][0] == "it does not tilt as its body does, but as the body of drone 1"
    said = Flight(body_of={0: 1, 1: 0}, flying=(0,), swing=0.0).said
    assert (
        said[0][0]
        == "it flies, its body stays on the floor, and that of drone 1, which does not fly, rises"
    )
    assert Flight(flying=(0,)).said == {}


def test_a_body_that_moves_by_itself_is_named():
    said = Flight(body_of={0: 5}, flying=(0, 1, 2, 5), swing=0.3).said
    assert said[0][0].startswith("it does not tilt as its body does")
    assert 1 not in said


def test_each_body_is_its_own_when_gusts_tilt_the_drones_together():
    assert all(
        Flight(shared=0.9, swing=0.3, seed=seed).said == {} for seed in range(20)
    )


def test_no_noise_of_cameras_is_called_a_motion():
    assert all(Flight(swing=0.0, noise=0.3, seed=seed).said == {} for seed in range(20))


def test_one_pose_whatever_it_shows_says_nothing():
    def flight(odd):
        bodies, own = {0: TiltTrack(), 1: TiltTrack()}, TiltTrack()
        ascent = None
        for k in range(60):
            t = 0.05 * k
            for i, track in bodies.items():
                track.add(t, complex(1.0 if i == 0 and k in odd else 0.0), 0.1 * t)
            own.add(t, 0j)
            ascent = ascent or (TakeoffCheck(0, t, own, bodies) if t > 1.0 else None)
            if ascent and (found := ascent.judge(t, 0j, True)):
                return found
        return ""

    assert flight((30,)) == ""
    assert (
        flight(range(30, 40))
        == "it does not tilt as its body does, but as the body of drone 1"
    )


def test_an_unseen_drone_is_not_judged():
    bodies, own = {0: TiltTrack(), 1: TiltTrack()}, TiltTrack()
    own.add(0.0, 0j)
    ascent = TakeoffCheck(0, 0.0, own, bodies)
    assert [ascent.judge(0.05 * k, complex(0.1 * k), True) for k in range(1, 40)] == [
        ""
    ] * 39


def test_it_ends_when_the_drone_has_moved_enough_or_at_last():
    calm = Flight(swing=0.0, seconds=BEGINS + 5.0).ascents[0]
    assert not calm.over
    assert (
        Flight(swing=0.0, seconds=BEGINS + TAKEOFF_WATCH.longest + 0.2).ascents[0].over
    )
    assert (
        Flight(swing=0.1, seconds=BEGINS + TAKEOFF_WATCH.shortest + 0.2).ascents[0].over
    )


def test_it_does_not_end_early_before_the_drone_has_moved_enough(monkeypatch):
    much = replace(TILT_JUDGEMENT, enough_cost=math.inf)
    monkeypatch.setattr(takeoff_check, "TILT_JUDGEMENT", much)
    seconds = BEGINS + TAKEOFF_WATCH.shortest + 0.2
    assert not Flight(swing=0.1, seconds=seconds).ascents[0].over


@pytest.mark.parametrize("psi", [0.0, 0.7, math.pi, -1.9])
def test_tilt_is_up_in_the_plane_of_the_body_and_turns_with_its_axes(psi):
    q = np.array(
        quaternion_product(
            tuple(quaternion_of_yaw(1.1)), rotation_exponential(0.2, -0.3, 0.0)
        )
    )
    up = rotation(q).T @ np.array([0.0, 0.0, 1.0])
    assert compute_tilt(q) == pytest.approx(complex(up[0], up[1]))
    turned = np.array(quaternion_product(tuple(q), tuple(quaternion_of_yaw(psi))))
    assert compute_tilt(turned) == pytest.approx(compute_tilt(q) * np.exp(-1j * psi))


def test_between_two_poses_a_track_is_between_them_and_after_the_last_it_holds_for_a_while():
    track = TiltTrack()
    for t, u in ((0.0, 0j), (0.02, 0.1 + 0j), (0.04, 0.3j), (0.9, 0j)):
        track.add(t, u)
    assert track.at(0.01) == pytest.approx(0.05)
    assert track.at(0.035) == pytest.approx(0.025 + 0.225j)
    assert np.isnan(track.at(0.5))
    assert track.at(0.95) == 0j
    assert np.isnan(track.at(1.1))
    assert np.isnan(track.at(-0.1))
