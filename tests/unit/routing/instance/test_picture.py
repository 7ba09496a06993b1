from dataclasses import replace

import numpy as np
import pytest

from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.picture import _describe_plan, _list_tours, draw_routes
from crazychoir.routing.instance.plan import Route, RoutePlan
from crazychoir.routing.pricing.arc_flow import solve_compact


@pytest.mark.parametrize("name", ["flat", "room"])
def test_a_plan_becomes_a_png(small, tmp_path, name):
    from matplotlib.image import imread

    instance, optimum = small(name)
    plan = solve_compact(instance)
    assert plan.cost == pytest.approx(optimum)
    draw_routes(instance, plan, tmp_path / "plan.png")
    draw_routes(instance, RoutePlan(()), tmp_path / "empty.png")
    drawn, empty = imread(tmp_path / "plan.png"), imread(tmp_path / "empty.png")
    assert drawn.shape[0] > 800
    assert (drawn[..., :3].min(axis=2) < 0.9).sum() > (
        empty[..., :3].min(axis=2) < 0.9
    ).sum()


def test_recharges_ends_and_open_tours_are_drawn_where_they_are():
    raw = {
        "home": [[0.0, 0.0]],
        "pickup": [[1.0, 0.0], [2.0, 0.0]],
        "delivery": [[1.0, 1.0], [2.0, 1.0]],
        "load": [1.0, 1.0],
        "capacity": [1.0],
    }
    route = Route.from_nodes(0, [0, 2, 5, 1, 3], 2, 1.0)
    ends = Instance.parse(raw | {"end": [[0.0, 3.0]], "recharge": 2})
    one, two = (tour.tolist() for tour in _list_tours(ends, route))
    assert (one, two) == (
        [[0, 0], [1, 0], [1, 1], [0, 3]],
        [[0, 3], [2, 0], [2, 1], [0, 3]],
    )
    free = Instance.parse(raw | {"open_tours": True})
    assert [
        tour.tolist() for tour in _list_tours(free, Route.from_nodes(0, [0, 2], 2, 2.0))
    ] == [[[0, 0], [1, 0], [1, 1]]]


def test_a_trip_is_a_line_of_its_own_with_a_label_of_its_own(monkeypatch, tmp_path):
    from matplotlib.axes import Axes

    raw = {
        "home": [[0.0, 0.0]],
        "pickup": [[1.0, 0.0], [2.0, 0.0]],
        "delivery": [[1.0, 1.0], [2.0, 1.0]],
        "load": [1.0, 1.0],
        "capacity": [1.0],
        "recharge": 2,
    }
    drawn, plot = [], Axes.plot

    def noted(axes, *points, **style):
        drawn.append(style)
        return plot(axes, *points, **style)

    monkeypatch.setattr(Axes, "plot", noted)
    for instance in (
        Instance.parse(raw),
        Instance.parse(raw | {"release": [0.0, 2.5]}),
    ):
        draw_routes(
            instance,
            instance.plan([Route.from_nodes(0, [0, 2, 5, 1, 3], 2, 8.65)]),
            tmp_path / "plan.png",
        )
    trips = [style for style in drawn if style.get("label", "").startswith("robot 0")]
    assert [style["label"] for style in trips] == [
        "robot 0, trip 1: 3.41 m, tasks 0",
        "robot 0, trip 2: 5.24 m, tasks 1",
        "robot 0, trip 1: 3.41 m, until 3.41 s, tasks 0",
        "robot 0, trip 2: 5.24 m, until 8.65 s, tasks 1",
    ]
    assert len({style["color"] for style in trips}) == 1
    assert trips[0]["linestyle"] != trips[1]["linestyle"]


def test_the_title_names_what_is_refused_and_the_last_to_be_done(small, tmp_path):
    instance, _ = small("flat")
    late = replace(
        instance,
        objective=("makespan", "total"),
        tasks=replace(instance.tasks, penalty=np.zeros(4)),
    )
    plan = late.plan([Route.from_nodes(0, [0, 4], 4, 7.5, 8.25)])
    draw_routes(late, plan, tmp_path / "plan.png")
    assert (
        _describe_plan(late, plan)
        == f"1 of {instance.robots} robots fly 7.50 m until 8.25 s; refused: 1, 2, 3"
    )


def test_matplotlib_is_imported_only_to_draw():
    import subprocess
    import sys

    modules = (
        "crazychoir.routing.instance.picture, crazychoir.routing.distributed.plain_loop"
    )
    code = f"import {modules}, sys; sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
