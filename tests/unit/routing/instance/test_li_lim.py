import json
import math

import pytest

from crazychoir.errors import InstanceError
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.plan import Route
from crazychoir.solve.solve_options import SolveOptions
from crazychoir.solve.solving import solve_here


@pytest.fixture
def path(repository):
    return repository / "tests" / "data" / "li_lim_small.txt"


def test_a_file_of_li_and_lim_is_a_fleet_at_one_depot(path):
    instance = Instance.load(path)
    assert instance.kinds() == [(0, 1, 2)]
    assert instance.tasks.pickup.tolist() == [[1, 9], [9, 9], [7, 2]]
    assert instance.tasks.delivery.tolist() == [[2, 6], [6, 8], [3, 1]]
    assert instance.tasks.load.tolist() == [4, 6, 5]
    assert instance.tasks.latest.tolist() == [20, 30, 25, 45, 50, 40]
    v = instance.local(2).vehicle
    assert (v.earliest[6], v.latest[7], v.capacity) == (0, 60, 10)
    assert v.duration[0, 3] == 2 + math.hypot(1, 3)


def test_it_is_read_back_from_json(path):
    instance = Instance.load(path)
    assert (
        Instance.parse(json.loads(json.dumps(instance.to_json()))).to_json()
        == instance.to_json()
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("4\t2\t6\t-4", "4\t2\t6\t-3", "customer 1: found delivery 4"),
        ("0\t4\n", "0\t5\n", "customer 1: found delivery 5"),
        ("3\t3\t1", "3\t3\tone", "line 5"),
        ("0\t5\t5", "0\t5", "line 2"),
        ("\n0\t5\t5", "\n7\t5\t5", "no customer 0"),
        (
            "0\t4\n",
            "0\t0\n",
            "customer 1: found a customer that is neither a pickup with a delivery, nor",
        ),
        (
            "3\t10\t1",
            "2.5\t10\t1",
            "line 1: found 2.5 vehicles; allowed: a whole number from 1 to 1000",
        ),
        ("3\t10\t1", "-3\t10\t1", "line 1: found -3 vehicles"),
        ("3\t10\t1", "99999999\t10\t1", r"line 1: found 1e\+08 vehicles"),
        ("3\t10\t1", "3\t10\t-1", "line 1: found capacity 10, speed -1"),
        ("3\t10\t1", "3\t-1\t1", "line 1: found capacity -1, speed 1"),
    ],
)
def test_what_is_wrong_is_named(path, tmp_path, old, new, said):
    bad = tmp_path / "bad.txt"
    bad.write_text(path.read_text().replace(old, new))
    with pytest.raises(InstanceError, match=said):
        Instance.load(bad)


def test_a_depot_alone_is_no_instance(path, tmp_path):
    alone = tmp_path / "alone.txt"
    alone.write_text("\n".join(path.read_text().splitlines()[:2]))
    with pytest.raises(
        InstanceError,
        match=r"alone\.txt: found the depot alone; allowed: at least one pickup",
    ):
        Instance.load(alone)


@pytest.mark.parametrize(
    ("name", "vehicles", "length"),
    [("lc101", 10, 828.94), ("lr101", 19, 1650.80), ("lrc101", 14, 1708.80)],
)
def test_best_known_solutions_cost_what_is_published(
    reference_data, name, vehicles, length
):
    folder = reference_data("lilim")
    instance = Instance.load(folder / f"{name}.txt")
    rows = [
        [int(float(w)) for w in line.split()]
        for line in (folder / f"{name}.txt").read_text().splitlines()[1:]
    ]
    node, m = {}, len(instance.tasks)
    for task, row in enumerate(r for r in rows if r and r[0] and r[8]):
        node[row[0]], node[row[8]] = task, m + task
    routes = []
    for line in (folder / f"{name}.sol").read_text().splitlines():
        if line.startswith("Route"):
            stops = [node[int(word)] for word in line.split(":")[1].split()]
            v = instance.local(len(routes)).vehicle
            routes.append(
                Route.from_nodes(
                    len(routes), stops, m, v.length(stops), v.finish(stops)
                )
            )
    plan = instance.plan(routes)
    assert check_plan(instance, plan) == []
    assert len(routes) == vehicles
    assert plan.values == (vehicles, pytest.approx(length, abs=0.01))
    assert plan.cost == pytest.approx(length, abs=0.01)
    assert instance.vehicle_weight > 2 * length


@pytest.mark.parametrize(
    ("name", "vehicles", "length"),
    [
        pytest.param("lr101", 19, 1650.80, marks=pytest.mark.slow),
        pytest.param("lrc101", 14, 1708.80, marks=pytest.mark.slow),
        pytest.param("lc101", 10, 828.94, marks=pytest.mark.slow),
    ],
)
def test_a_team_proves_the_best_known_solution_optimal(
    reference_data, name, vehicles, length
):
    instance = Instance.load(reference_data("lilim") / f"{name}.txt")
    found = solve_here(instance, SolveOptions(graph="k-regular:4", loss=0.1))
    assert len(found["routes"]) == vehicles
    assert sum(route["length"] for route in found["routes"]) == pytest.approx(
        length, abs=0.01
    )
    assert found["bound_exact"]
    assert found["bound_relaxation"] is None
    assert found["lower_bound"] == pytest.approx(found["cost"], rel=1e-9)
    assert found["vehicles_bound"] == vehicles
