"""The legs between all nodes of a robot, in blocks that robots share."""

import numpy as np
import pytest

from crazychoir.routing.instance.generate import random_instance
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.legs import Legs

WHOLE = np.arange(36.0).reshape(6, 6)


def test_blocks_hold_the_values_of_the_matrix():
    legs = Legs.of(WHOLE)
    assert np.array_equal(legs.whole, WHOLE)
    assert [[legs.at(v, w) for w in range(6)] for v in range(6)] == WHOLE.tolist()
    assert legs.most() == 35.0


def test_legs_of_a_few_stops_are_rows_and_columns_of_the_matrix():
    few = Legs.of(WHOLE).only(np.array([1, 3]))
    nodes = [1, 3, 4, 5]
    assert np.array_equal(few.whole, WHOLE[np.ix_(nodes, nodes)])


@pytest.mark.parametrize("speeds", [[1.0, 1.0, 1.0], [1.0, 2.0, 1.0]])
def test_robots_share_the_legs_between_stops(speeds):
    raw = random_instance(3, 5, seed=1).to_json() | {"speed": speeds}
    instance = Instance.parse(raw)
    vehicles = [instance.local(i).vehicle for i in range(3)]
    assert all(v.ways.between is vehicles[0].ways.between for v in vehicles)
    for v, speed in zip(vehicles, speeds, strict=True):
        is_shared = v.times.between is vehicles[0].times.between
        assert is_shared == (speed == speeds[0])


def test_bounds_and_lengths_need_no_matrix_of_a_robot():
    vehicle = random_instance(2, 5, seed=1).local(0).vehicle
    vehicle.length([0, 5])
    vehicle.finish([0, 5])
    assert vehicle.servable.size
    assert not any("whole" in vars(legs) for legs in (vehicle.ways, vehicle.times))


def test_what_robots_share_cannot_be_changed():
    tasks = random_instance(3, 5, seed=1).tasks
    shared = (tasks.stops, tasks.between, tasks.refusal, tasks.durations(2.0))
    for values in shared:
        with pytest.raises(ValueError, match="read-only"):
            values += 1.0
