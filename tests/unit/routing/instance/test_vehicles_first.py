"""Where vehicles come first, a plan of fewer vehicles is better, however long it is."""

import math
from itertools import product

import numpy as np
import pytest

from crazychoir.errors import InstanceError
from crazychoir.routing.distributed.master import PartitionProblem, find_fewest_columns
from crazychoir.routing.distributed.member import (
    ColumnSettings,
    PriceSettings,
    ProofSettings,
    RoutingSettings,
    SearchSettings,
)
from crazychoir.routing.distributed.plain_loop import solve_in_loop
from crazychoir.routing.instance.checker import check_plan
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.pricing.arc_flow import solve_compact
from crazychoir.routing.pricing.route_table import RouteColumn, RouteTable
from crazychoir.routing.search.search import search_plan

SIDES = (-1, 1, -1, 1)
"""Where the goods are, west or east of the depot: one vehicle must go to and fro, as the windows open by turns."""
PATH = {0: [1], 1: [0, 2], 2: [1]}
LISTED = RoutingSettings()
SEARCHED = RoutingSettings(
    columns=ColumnSettings(most_listed=0),
    search=SearchSettings(steps=20_000),
    proof=ProofSettings(prove=True),
)
PRICED = RoutingSettings(prices=PriceSettings(rounds=8))


def to_and_fro(unit, speed=1):
    """A file of Li and Lim: one vehicle flies 16 units, two fly 4 together."""
    lines = ["3 10 " + str(speed), f"0 0 0 0 0 {100 * unit} 0 0 0"]
    count = len(SIDES)
    for number, side in enumerate(SIDES + SIDES):
        begin = (1 + 2 * number) * unit
        partner = (
            f"0 {number + count + 1}" if number < count else f"{number - count + 1} 0"
        )
        demand = 1 if number < count else -1
        lines.append(
            f"{number + 1} {side * unit} 0 {demand} {begin} {begin} 0 {partner}"
        )
    return "\n".join(lines)


def random_instance(seed, unit, objective=("vehicles", "total")):
    """Two to four tasks with windows, three robots: at one depot, or each at home elsewhere."""
    draw = np.random.default_rng(seed)
    tasks = int(draw.integers(2, 5))
    places = draw.uniform(-unit, unit, size=(2 * tasks, 2))
    opens = draw.uniform(0, 4 * unit, size=tasks)
    width = draw.uniform(0.5, 6) * unit
    homes = draw.uniform(-0.1, 0.1, size=(3, 2)) * unit * (seed % 2)
    return Instance.parse(
        {
            "home": homes.tolist(),
            "pickup": places[:tasks].tolist(),
            "delivery": places[tasks:].tolist(),
            "load": [1.0] * tasks,
            "capacity": [float(draw.integers(1, 3))] * 3,
            "time_windows": {
                "pickup": [[float(t), float(t + width)] for t in opens],
                "delivery": [[0.0, float(t + 3 * unit + width)] for t in opens],
            },
            "objective": list(objective),
        }
    )


def least(instance):
    """The fewest vehicles and the least total of these, over all ways to share the tasks out; None without a plan."""
    tables = [RouteTable(instance.local(i).vehicle) for i in range(3)]
    tasks = len(instance.tasks)
    found = []
    for share in product(range(3), repeat=tasks):
        sets = [[j for j in range(tasks) if share[j] == i] for i in range(3)]
        columns = [
            table.find(own) for table, own in zip(tables, sets, strict=True) if own
        ]
        if None not in columns:
            found.append((len(columns), sum(column.length for column in columns)))
    return min(found, default=None)


@pytest.mark.parametrize("unit", [1, 100, 99_999])
@pytest.mark.parametrize("settings", [LISTED, SEARCHED])
def test_one_vehicle_is_better_than_two_on_a_way_of_a_quarter(tmp_path, unit, settings):
    file = tmp_path / "to_and_fro.txt"
    file.write_text(to_and_fro(unit))
    instance = Instance.load(file)
    solution = solve_in_loop(instance, PATH, settings=settings)
    plan = instance.plan(solution.routes)
    assert check_plan(instance, plan) == []
    assert len(plan.routes) == 1
    assert solution.vehicles_bound == 1
    assert solution.cost == plan.cost == pytest.approx(16 * unit)
    assert solution.lower_bound <= solution.cost


@pytest.mark.parametrize("unit", [1.0, 30_000.0])
@pytest.mark.parametrize(
    ("method", "settings"),
    [("columns", LISTED), ("columns", SEARCHED), ("resource-columns", PRICED)],
)
def test_small_plans_are_optimal(unit, method, settings):
    compared = 0
    for seed in range(6):
        try:
            best = least(random_instance(seed, unit, ["total"]))
            instance = random_instance(seed, unit)
        except InstanceError:
            continue
        if best is None:
            continue
        solution = solve_in_loop(instance, PATH, method, settings)
        plan = instance.plan(solution.routes)
        assert check_plan(instance, plan) == []
        assert plan.values == (best[0], pytest.approx(best[1], rel=1e-6))
        assert solution.vehicles_bound <= best[0]
        if solution.lower_bound is not None:
            assert solution.lower_bound <= best[1] * (1 + 1e-9)
        compared += 1
    assert compared >= 3


def test_the_compact_model_counts_vehicles_first_too():
    instance = random_instance(1, 1.0)
    plan = solve_compact(instance)
    assert check_plan(instance, plan) == []
    vehicles, total = least(random_instance(1, 1.0, ["total"]))
    assert plan.values == (vehicles, pytest.approx(total))


@pytest.mark.parametrize("method", ["cbba", "auction"])
def test_baselines_take_the_same_instances(method):
    instance = random_instance(0, 30_000.0)
    plan = instance.plan(solve_in_loop(instance, PATH, method).routes)
    assert check_plan(instance, plan) == []


@pytest.mark.parametrize("unit", [0.0, 1.0, 1e5])
def test_the_weight_of_a_vehicle_is_more_than_twice_the_total_of_any_plan(unit):
    for seed in range(20):
        draw = np.random.default_rng(seed)
        tasks = int(draw.integers(1, 6))
        points = {"home": draw.uniform(-1, 1, (3, 2)) * unit}
        points |= {
            key: draw.uniform(-1, 1, (tasks, 2)) * unit
            for key in ("pickup", "delivery")
        }
        raw = {key: rows.tolist() for key, rows in points.items()} | {
            "load": [0.0] * tasks,
            "capacity": [1.0] * 3,
        }
        instance = Instance.parse(
            raw | {"objective": ["vehicles", "total"], "recharge": 9}
        )
        vehicle = instance.local(0).vehicle
        stops = [
            node
            for j in draw.permutation(tasks)
            for node in (j, tasks + j, 2 * tasks + 1)
        ][:-1]
        assert 2 * vehicle.length(stops) <= instance.vehicle_weight == vehicle.fixed


def test_the_fewest_columns_are_chosen_and_of_those_the_shortest():
    weight = 2.0**40
    columns = [
        (0, (0, 1), 900.0),
        (1, (0, 1), 800.0),
        (0, (0,), 1e-3),
        (1, (1,), 1e-3),
        (1, (0,), 1e-3),
    ]
    priced = [
        (robot, RouteColumn(weight + length, tasks)) for robot, tasks, length in columns
    ]
    found = find_fewest_columns(PartitionProblem(priced, 2), 0, 1000, weight, 0)
    assert found.routes == {1: (0, 1)}
    assert found.cost - weight == pytest.approx(800.0)
    assert found.bound - weight == pytest.approx(800.0)
    again = find_fewest_columns(
        PartitionProblem(priced, 2), 0, 1000, weight, 1, known={0: (0,), 1: (1,)}
    )
    assert again.cost == pytest.approx(found.cost)


def test_no_choice_of_columns_is_said_to_be_none():
    assert (
        find_fewest_columns(
            PartitionProblem([(0, RouteColumn(3.0, (0,)))], 2), 0, 100, 1.0, 0
        ).cost
        == math.inf
    )


def test_the_search_ends_with_the_vehicle_that_has_the_nearer_home():
    raw = {
        "home": [[90.0, 0.0], [0.0, 0.0]],
        "pickup": [[1.0, 0.0]],
        "delivery": [[2.0, 0.0]],
        "load": [1.0],
        "capacity": [1.0, 1.0],
        "objective": ["vehicles", "total"],
    }
    instance = Instance.parse(raw)
    team = [instance.local(i).vehicle for i in range(2)]
    found = search_plan(
        team, [[0, 1], []], np.array([math.inf]), 500, 0, objective=instance.objective
    )
    assert found.routes == [[], [0, 1]]


@pytest.mark.parametrize(
    ("beside", "said"),
    [
        ({"penalty": [1.0]}, "penalty: found the objective"),
        ({"fixed_cost": 1.0}, "fixed_cost: found 1 beside"),
    ],
)
def test_what_contradicts_the_count_of_vehicles_is_refused(beside, said):
    raw = {
        "home": [[0, 0]],
        "pickup": [[1, 0]],
        "delivery": [[2, 0]],
        "load": [1],
        "capacity": [1],
    }
    with pytest.raises(InstanceError, match=said):
        Instance.parse(raw | {"objective": ["vehicles", "total"]} | beside)
    assert Instance.parse(raw | beside).objective == ("total",)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("3 10 1", "3 2000001 1", "line 1: found capacity 2e[+]06"),
        (
            "3 10 1",
            "3 10 1e-9",
            "line 1: found .*speed 1e-09; allowed: .* or 0, which means 1",
        ),
        (
            "2 1 0 1 3 3",
            "2 1 0 1 3 2e8",
            "line 4: found due time 200000000; allowed: a number from 0 to 1e[+]07",
        ),
        (
            "2 1 0 1 3 3",
            "2 1 0 1 3 2",
            "line 4: found due time 2; allowed: at least 3, the ready time",
        ),
        (
            "2 1 0 1 3 3",
            "2 1e6 0 1 3 3",
            "line 4: found x 1000000; allowed: a number from -100000 to 100000",
        ),
        (
            "2 1 0 1 3 3",
            "2.5 1 0 1 3 3",
            "line 4: found customer 2.5; allowed: a whole number",
        ),
        (
            "2 1 0 1 3 3",
            "2 1 0 1 0 0",
            "customer 2 and its delivery 6: found .* at its pickup at 1 s",
        ),
        ("2 1 0 1 3 3", "2 1 0 -1 3 3", "line 4: found demand -1 of a pickup"),
    ],
)
def test_errors_name_the_line_of_the_file_and_no_key_that_it_does_not_have(
    tmp_path, old, new, said
):
    file = tmp_path / "bad.txt"
    text = to_and_fro(1)
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(InstanceError, match=said) as refusal:
        Instance.load(file)
    for key in (
        "fixed_cost",
        "time_windows",
        "capacity[",
        "load[",
        "pickup[",
        "route_length_limit",
    ):
        assert key not in str(refusal.value)


def test_a_speed_of_zero_means_that_times_are_lengths(tmp_path):
    one = tmp_path / "one.txt"
    none = tmp_path / "none.txt"
    one.write_text(to_and_fro(1, speed=1))
    none.write_text(to_and_fro(1, speed=0))
    assert Instance.load(none).to_json() == Instance.load(one).to_json()
