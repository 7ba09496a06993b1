import json

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance


def test_a_seed_is_an_instance():
    one, same, other = (random_instance(4, 6, seed).to_json() for seed in (1, 1, 2))
    assert one == same
    assert one != other


@pytest.mark.parametrize("seed", range(5))
def test_the_options_hold(seed):
    instance = random_instance(
        5,
        4,
        seed,
        InstanceShape(
            room=(4.0, 3.0, 2.0),
            spacing=0.5,
            margin=0.2,
            heights=(0.5, 1.0),
            loads=(2, 2),
            capacities=(2, 4),
            capable=0.3,
            route_length_limit=30.0,
        ),
    )
    goods = np.vstack([instance.tasks.pickup, instance.tasks.delivery])
    assert (instance.home[:, 2] == 0).all()
    assert (goods[:, 2] >= 0.5).all()
    assert (goods[:, 2] <= 1.0).all()
    for points in (instance.home, goods):
        assert (points[:, :2] >= 0.2).all()
        assert (points[:, :2] <= [3.8, 2.8]).all()
        gaps = np.linalg.norm(
            points[:, None, :2] - points[None, :, :2], axis=2
        ) + np.eye(len(points))
        assert gaps.min() >= 0.5
    assert set(instance.tasks.load) == {2.0}
    assert set(instance.capacity) <= {2.0, 3.0, 4.0}
    assert instance.capability.any(axis=0).all()
    assert not instance.capability.all()
    assert instance.route_length_limit == 30.0


def test_goods_lie_in_heaps_and_fields_are_added():
    instance = random_instance(
        3,
        40,
        2,
        InstanceShape(clusters=2, fields={"open_tours": True, "fixed_cost": 2.0}),
    )
    goods = np.vstack([instance.tasks.pickup, instance.tasks.delivery])
    near = np.linalg.norm(goods[:, None] - goods[None, :], axis=2) < 3.0
    assert (
        len({tuple(row) for row in near.tolist()}) < 20
    )  # of 80: most see the same goods near
    assert near.mean() > 0.45
    assert instance.open_tours
    assert instance.fixed_cost == 2.0


def test_a_room_that_is_too_small_is_refused():
    with pytest.raises(ConfigError, match="larger room"):
        random_instance(9, 2, 0, InstanceShape(room=(1.0, 1.0), spacing=0.8))


def test_the_demo_is_what_its_note_says(repository):
    path = repository / "agents" / "data" / "lab6.json"
    instance = Instance.load(path)
    options = {
        "spacing": 0.5,
        "margin": 0.3,
        "capable": 0.45,
        "route_length_limit": 6.5,
    }
    assert (
        instance.to_json()
        == random_instance(
            6, 10, 58, InstanceShape(room=(3, 3, 2), **options)
        ).to_json()
    )
    assert "seed=58" in json.loads(path.read_text())["note"]
    assert (instance.robots, len(instance.tasks)) == (6, 10)
    assert not instance.capability.all(axis=1).any()
