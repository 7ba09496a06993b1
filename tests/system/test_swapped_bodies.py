"""Drones with firmware, at motor level, take off with exchanged or turned bodies: found before they are at 0.1 m."""

import math

import numpy as np
import pytest

from crazychoir.math3d import product, quaternion_of_yaw
from crazychoir.mocap.calibration import angles
from crazychoir.mocap.simulated import SimulatedMocap
from crazychoir.platforms import platform
from crazychoir.safety.tracking import Ascent, in_the_air
from crazychoir.simulation.crazyflies import CrazyflieWorld
from crazychoir.types import Pose

pytestmark = pytest.mark.system
HOMES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
IDS, HZ, STANDS, SECONDS = (0, 1, 2), 10, 2.0, 3.0


class Flight:
    """Three drones stand, then all of `flying` climb to 0.1 m within 1 s; each is told the place of the body that is
    taken for its own. said: by drone, what was found first, and when, after the take-off, and how tilted it was.
    """

    def __init__(self, seed, body_of=None, turned=None, flying=IDS):
        self.world = CrazyflieWorld(
            IDS, HOMES, np.random.default_rng(seed).uniform(-3.0, 3.0, 3), platform("cf21"), seed=seed
        )
        self.cameras, self.body_of, self.turned = SimulatedMocap(IDS, seed), body_of or {}, turned or {}
        self.ascents, self.own, self.said = {i: Ascent() for i in IDS}, np.zeros((3, 2)), {}
        for k in range(round(100 * (STANDS + SECONDS))):
            self.step(k, flying)

    def step(self, k, flying):
        self.world.step()
        poses = self.seen(k)
        for i in IDS:
            self.world.onboard[i].external_position(poses[i].p)
            self.own[i] += 0.01 * self.world.onboard[i].gyro[:2]
        if k == 50:
            for i in IDS:
                self.world.onboard[i].arm()
        if k == round(100 * STANDS):
            for i in flying:
                self.world.onboard[i].take_off(0.1, 1.0)
        if k >= 100 * STANDS and k % (100 // HZ) == 0:
            self.judge(k / 100 - STANDS, poses)

    def seen(self, k):
        seen = self.cameras.sample(self.world.states, k)
        poses = {i: seen[self.body_of.get(i, i)] for i in IDS}
        for i, turn in self.turned.items():
            poses[i] = Pose(np.array([*poses[i].p, *product(tuple(poses[i].q), tuple(quaternion_of_yaw(turn)))]))
        return poses

    def judge(self, t, poses):
        for i in IDS:
            flies = bool(self.world.log(i, "sys.isFlying"))
            self.ascents[i].add(t, flies, tuple(self.own[i]), poses[i].p[2], angles(poses[i].q)[:2])
        for i in IDS:
            found = in_the_air(i, self.ascents)
            if found and i not in self.said:
                x, y = self.world.states[i, 6:8]
                self.said[i] = found[0], t, math.acos(1.0 - 2.0 * (x * x + y * y))


@pytest.mark.parametrize("seed", [1, 2])
def test_bodies_that_are_their_drones_are_let_fly(seed):
    flight = Flight(seed)
    assert flight.said == {}
    assert all(0.05 < z < 0.15 for z in flight.world.states[:, 2])


def check(flight, i, *words):
    text, t, tilt = flight.said[i]
    assert any(word in text for word in words), text
    assert t < 2.0
    assert tilt < math.radians(15.0)


@pytest.mark.parametrize("seed", [1, 2])
def test_two_that_take_off_together_with_exchanged_bodies_are_found(seed):
    flight = Flight(seed, body_of={0: 1, 1: 0})
    for i in (0, 1):
        check(flight, i, "exchanged")
    assert 2 not in flight.said


def test_one_that_takes_off_alone_with_the_body_of_another_is_found():
    flight = Flight(1, body_of={0: 1, 1: 0}, flying=(0,))
    check(flight, 0, "exchanged")
    check(flight, 1, "it does not fly, and its body has risen")
    assert 2 not in flight.said


def test_a_body_that_was_put_on_backwards_is_found():
    flight = Flight(1, turned={0: math.pi})
    check(flight, 0, "turned by")
    assert list(flight.said) == [0]


@pytest.mark.slow
def test_of_many_flights_none_is_stopped_for_nothing_and_nearly_all_that_must_be_are():
    """Of 60 each; who is turned by half moves as another body by chance, and is told so."""
    flights = [Flight(seed) for seed in range(60)]
    assert sum(len(flight.said) for flight in flights) == 0
    found = 0
    for seed in range(60):
        exchanged, turned = Flight(seed, body_of={0: 1, 1: 0}), Flight(seed, turned={0: math.pi})
        for flight, wrong in ((exchanged, (0, 1)), (turned, (0,))):
            assert set(flight.said) <= set(wrong)
            found += len(flight.said)
    assert found >= 0.93 * 180
