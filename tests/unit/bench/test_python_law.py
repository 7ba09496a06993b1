import numpy as np
import pytest

from crazychoir.bench.python_law import PythonBearingLaw
from crazychoir.bench.swarms import build_lattice
from crazychoir.guidance.formation.bearing import NORMALISED_LAW
from crazychoir.types import State

LATTICE = build_lattice(9)
CENTRE = 4
NEIGHBORS = (0, 1, 2, 3, 5, 6, 7, 8)


def state(place, v=(0.0, 0.0, 0.0), a=(0.0, 0.0, 0.0)):
    flat = np.zeros(13)
    flat[0:3] = place
    flat[3:6] = v
    flat[9] = 1.0
    return State(flat, a=np.array(a))


@pytest.fixture
def law():
    return PythonBearingLaw(CENTRE, LATTICE.places, NEIGHBORS)


def hear_neighbors(a=(0.0, 0.0, 0.0)):
    return {j: state(LATTICE.places[j], a=a) for j in NEIGHBORS}


def test_a_displaced_drone_is_pulled_back_to_its_place(law):
    off = np.array([0.1, -0.2, 0.05])
    me = state(np.add(LATTICE.places[CENTRE], off))
    found = law.step(me, hear_neighbors()).a
    assert np.allclose(found, -NORMALISED_LAW.kp * off)


def test_a_moving_drone_is_slowed_down(law):
    v = np.array([0.3, 0.1, -0.2])
    me = state(LATTICE.places[CENTRE], v=v)
    found = law.step(me, hear_neighbors()).a
    assert np.allclose(found, -NORMALISED_LAW.kv * v)


def test_a_drone_accelerates_as_its_neighbours_do(law):
    a = np.array([0.5, -0.4, 0.3])
    found = law.step(state(LATTICE.places[CENTRE]), hear_neighbors(a)).a
    assert np.allclose(found, a)


def test_a_drone_hovers_if_it_does_not_hear_all_neighbours(law):
    heard = hear_neighbors()
    del heard[3]
    assert law.step(state(LATTICE.places[CENTRE]), heard) is None
