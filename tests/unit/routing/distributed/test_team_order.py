"""Plans do not depend on the order of robots and tasks in the instance file."""

import numpy as np
import pytest

from crazychoir.routing.distributed.clusters import Neighbors, list_usual_passes
from crazychoir.routing.distributed.member import RoutingSettings, SearchSettings
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.distributed.team_order import TeamOrder
from crazychoir.routing.instance.generate import InstanceShape, random_instance
from crazychoir.routing.instance.instance import Instance

ROBOT_FIELDS = ("home", "capacity", "capability")
TASK_FIELDS = ("pickup", "delivery", "load")
QUICK = RoutingSettings(search=SearchSettings(steps=8_000, still_passes=2))


def relabel(instance, robots, tasks):
    """The instance with its robots and tasks in another order."""
    raw = instance.to_json()
    raw |= {name: [raw[name][i] for i in robots] for name in ROBOT_FIELDS}
    raw |= {name: [raw[name][j] for j in tasks] for name in TASK_FIELDS}
    raw["capability"] = [[row[j] for j in tasks] for row in raw["capability"]]
    return Instance.parse(raw)


def labellings(instance, count):
    draw = np.random.default_rng(1)
    n = instance.robots
    m = len(instance.tasks)
    for _ in range(count):
        yield draw.permutation(n).tolist(), draw.permutation(m).tolist()


@pytest.mark.parametrize(("seed", "capable"), [(0, 1.0), (1, 0.7), (2, 1.0)])
def test_every_labelling_gets_the_same_cost(graph, seed, capable):
    shape = InstanceShape(capacities=(3, 7), capable=capable)
    instance = random_instance(2 + seed, 14, seed, shape)
    costs = {
        solve_in_loop(
            relabel(instance, *order), graph("ring", instance.robots), settings=QUICK
        ).cost
        for order in labellings(instance, 3)
    }
    assert max(costs) == pytest.approx(min(costs), abs=1e-9)


def test_the_order_of_a_team_is_that_of_its_data():
    instance = random_instance(5, 9, 2, InstanceShape(capable=0.8))
    order = TeamOrder.of({i: instance.local(i) for i in range(5)})
    for robots, tasks in labellings(instance, 4):
        other = relabel(instance, robots, tasks)
        found = TeamOrder.of({i: other.local(i) for i in range(5)})
        assert tuple(robots[i] for i in found.robots) == order.robots
        assert tuple(tasks[j] for j in found.tasks) == order.tasks


def test_the_two_longest_routes_can_meet_in_a_cluster():
    instance = random_instance(4, 40, 1)
    robots = {i: instance.local(i) for i in range(4)}
    near = Neighbors(robots, TeamOrder.of(robots))
    routes = {
        0: [v for j in range(20) for v in (j, 40 + j)],
        1: [v for j in range(20, 40) for v in (j, 40 + j)],
    }
    for k in range(6):
        clusters = near.draw(routes, (25, 10), 1, [k])
        assert [len(c.robots) for c in clusters] == [4]


def test_a_small_team_with_long_routes_is_one_cluster_in_every_pass():
    settings = SearchSettings()
    instance = random_instance(6, 66, 1)
    robots = {i: instance.local(i) for i in range(6)}
    near = Neighbors(robots, TeamOrder.of(robots))
    routes = {i: [v for j in range(i, 66, 6) for v in (j, 66 + j)] for i in range(6)}
    passes = list(list_usual_passes(settings, 6, 66, diameter=3))
    for one in passes:
        (cluster,) = near.draw(routes, one.cluster, one.leaders, [one.number])
        assert len(cluster.robots) == 6
        assert len(cluster.tasks) == 66
    assert sum(one.steps for one in passes) == settings.steps
    assert passes[0].steps > passes[1].steps
    assert passes[0].options.first_temperature > passes[1].options.first_temperature


@pytest.mark.parametrize(("robots", "tasks"), [(7, 66), (6, 60)])
def test_other_teams_share_the_steps_equally(robots, tasks):
    settings = SearchSettings()
    passes = list(list_usual_passes(settings, robots, tasks, diameter=3))
    assert len(passes) >= settings.least_passes
    assert len({one.steps for one in passes}) == 1
