"""The online mission: its parts, and what is refused before a drone flies."""

import json

import pytest
from matplotlib.figure import Figure

from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.delivery_picture import FAILURE_COLOUR
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.task_source import TaskEvent
from crazychoir.optimization.picture import PICTURE_STYLE

MISSION = load_mission("online_delivery")


def config(drones=10, seed=1, **options):
    return MISSION.swarm(drones).replace(seed=seed, mission_options=options)


@pytest.mark.parametrize("drones", [2, 3, 6, 10])
@pytest.mark.parametrize("seed", range(3))
def test_any_seed_gives_tasks_that_can_be_served_and_a_graph_that_bears_a_loss(
    drones, seed
):
    drawn = config(drones, seed)
    assert MISSION.check(drawn, False) == []
    assert len(MISSION.hooks.known(drawn)) == 15
    later = MISSION.hooks.events(drawn)
    assert [event.task.id for event in later] == [15, 16, 17, 18, 19]
    assert all(len(event.robots) == min(3, drones) for event in later)
    assert MISSION.hooks.options(drawn).until == max(event.t for event in later)
    assert drawn.graph().is_connected
    assert min(len(drawn.graph().neighbors(i)) for i in drawn.ids) >= min(4, drones - 1)


def test_the_seed_alone_decides():
    assert MISSION.hooks.known(config()) == MISSION.hooks.known(config())
    assert MISSION.hooks.known(config()) != MISSION.hooks.known(config(seed=2))


def test_tasks_appear_and_are_cancelled_as_the_file_says():
    new = {
        "t": 4.0,
        "pickup": [1.0, 1.5],
        "delivery": [2.0, 2.5],
        "load": 2.0,
        "robots": [3],
        "heard_by": [1, 2],
    }
    events = MISSION.hooks.events(
        config(appear=[new], cancel=[{"t": 5.0, "task": 15}, {"t": 6.0, "task": 0}])
    )
    first, gone, other = events
    assert first == TaskEvent(4.0, first.task, (1, 2))
    assert (
        first.task.pickup,
        first.task.delivery,
        first.task.load,
        first.task.robots,
    ) == ((1, 1.5), (2, 2.5), 2, (3,))
    assert gone.task.cancelled
    assert gone.task > first.task
    assert (other.task.id, other.robots) == (0, ())


def appear(**changes):
    """One task that appears, sound but for the changes."""
    return {
        "appear": [{"t": 1.0, "pickup": [0.0, 1.0], "delivery": [1.0, 1.0], **changes}]
    }


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"methd": 1}, "methd"),
        ({"method": "magic"}, "magic.*auction"),
        (
            {"appear": [{"t": 1.0, "pickup": [0.0, -0.7], "delivery": [1.0, 1.0]}]},
            "from the home of drone 0",
        ),
        ({"cancel": [{"t": 1.0, "task": 99}]}, "99"),
        ({"appear": [{"t": 1.0, "pickup": [0.0, 1.0]}]}, "delivery"),
        ({"appear": [{"t": 1.0, "pickup": "here", "delivery": [1.0, 1.0]}]}, "pickup"),
        (appear(t=-1.0), r"mission_options\.appear\[0\]\.t.*not negative"),
        (
            appear(weight=1),
            r"mission_options\.appear\[0\]\.weight = 1: there is no such key",
        ),
        (
            appear(load=-1),
            r"mission_options\.appear\[0\]\.load: found -1; allowed: a load",
        ),
        (
            appear(load=4.5),
            r"appear\[0\]\.load = 4.5: its load 4.5 is more than any drone can carry: 4",
        ),
        (
            appear(robots=[77]),
            r"appear\[0\]\.robots = \[77\]: there is no drone 77; this swarm has 0 to 9",
        ),
        (appear(robots=[-1]), r"mission_options\.appear\[0\]\.robots"),
        (
            appear(heard_by=[3, 10]),
            r"appear\[0\]\.heard_by = \[3, 10\]: there is no drone 10",
        ),
        (
            appear(pickup=[9.0, 0.0]),
            r"appear\[0\]\.pickup = \[9.0, 0.0\]: outside the fence, .*\[7, 6.8\]",
        ),
        (appear(delivery=[0.0, 7.0]), r"appear\[0\]\.delivery = .*outside the fence"),
        (
            appear(delivery=[0.0, -0.7]),
            r"appear\[0\]\.delivery = .*0.10 m from the home of drone 0",
        ),
        ({"cancel": [{"when": 1.0, "task": 0}]}, r"cancel\[0\]"),
        (
            {"cancel": [{"t": 1.0, "task": 0, "heard_by": [10]}]},
            r"cancel\[0\]\.heard_by = \[10\]",
        ),
        ({"cancel": 3}, r"mission_options\.cancel"),
        (
            {"tasks": -1},
            r"mission_options\.tasks: found -1; allowed: a number of tasks, 1 to",
        ),
        ({"tasks": 0}, r"mission_options\.tasks: found 0"),
        ({"tasks": 2.5}, r"mission_options\.tasks: found 2.5"),
        ({"tasks": 100_000}, r"mission_options\.tasks"),
        ({"appear": []} | {"later": 1}, "beside appear"),
        ({"later": -3}, r"mission_options\.later"),
        ({"later": 3, **appear()}, r"mission_options\.later = 3: beside appear"),
        ({"service_time": -1.0}, r"mission_options\.service_time: found -1"),
        ({"until": -1.0}, r"mission_options\.until"),
        ({"until": "late"}, r"mission_options\.until"),
        ({"recover": 1}, r"mission_options\.recover: found 1; allowed: true or false"),
        ({"clearance": 0.1}, r"mission_options\.clearance.*nearer, drones touch"),
        ({"clearance": -0.4}, r"mission_options\.clearance"),
        ({"instance": 3}, r"mission_options\.instance: found 3"),
        ({"instance": "no/such.json"}, "no/such.json"),
    ],
)
def test_impossible_options_are_refused_before_any_drone_flies(options, said):
    with pytest.raises(ConfigError, match=said):
        MISSION.check(config(**options), False)


@pytest.mark.parametrize("key", ["service_time", "until", "clearance"])
def test_no_number_is_not_a_number(key):
    with pytest.raises(ConfigError, match=f"mission_options.{key}"):
        config(**{key: float("nan")})


def test_drawn_tasks_that_no_drone_can_reach_are_refused_before_any_drone_flies():
    homes = [{"id": i, "home": [float(i), -0.8, 0.0]} for i in range(4)]
    small = MISSION.swarm(4).replace(
        fence={"min": [-1.0, -1.8, 0.0], "max": [4.5, 6.8, 3.0]}, drones=homes
    )
    with pytest.raises(
        ConfigError, match=r"mission_options.tasks = \d+: its .* is outside the fence"
    ):
        MISSION.check(small, False)
    few = [
        seed
        for seed in range(60)
        if fits(small.replace(seed=seed, mission_options={"tasks": 1, "later": 0}))
    ]
    assert few
    with pytest.raises(
        ConfigError, match=r"mission_options.later = \d+: its .* is outside the fence"
    ):
        MISSION.check(
            small.replace(seed=few[0], mission_options={"tasks": 1, "later": 40}), False
        )


def fits(config):
    try:
        MISSION.check(config, False)
    except ConfigError:
        return False
    return True


RAW = {
    "home": [[0.0, -0.8], [0.0, 5.8]],
    "pickup": [[1.0, 1.0]],
    "delivery": [[2.0, 2.0]],
    "load": [1.0],
    "capacity": [1.0, 1.0],
}


@pytest.mark.parametrize(
    ("more", "options", "said"),
    [
        ({}, {}, ""),
        ({}, {"tasks": 3}, r"mission_options\.tasks = 3: beside instance"),
        (
            {"pickup": [[99.0, 1.0]]},
            {},
            r"mission_options\.instance = 0: its pickup \[99, 1\] is outside the fence",
        ),
        (
            {"delivery": [[0.0, 5.5]]},
            {},
            r"mission_options\.instance = 0: its delivery .*from the home of drone 1",
        ),
        (
            {"end": [[1.0, 0.0], [1.0, 1.0]]},
            {},
            r"mission_options\.instance = .*it has end; robots in flight",
        ),
        ({"open_tours": True}, {}, "it has open_tours"),
        ({"service_time": 2.0}, {}, "it has service_time"),
        ({"release": [2.0]}, {}, "it has time_windows or release"),
        ({"penalty": [2.0]}, {}, "it has penalty"),
        ({"objective": "makespan"}, {}, "it has objective"),
        (
            {
                "distance": [
                    [0.0 if i == j else 9.0 for i in range(4)] for j in range(4)
                ]
            },
            {},
            "it has distance",
        ),
    ],
)
def test_an_instance_is_refused_that_would_be_flown_otherwise(
    tmp_path, more, options, said
):
    file = tmp_path / "instance.json"
    file.write_text(json.dumps(RAW | more))
    flown = config(2, instance=str(file), **options)
    if not said:
        assert MISSION.check(flown, False) == []
        return
    with pytest.raises(ConfigError, match=said):
        MISSION.check(flown, False)


def test_a_directed_graph_is_refused():
    with pytest.raises(ConfigError, match="undirected"):
        MISSION.check(config().replace(graph="ring", directed=True), False)


def result(served, fates, success=True):
    stops = [
        {"task": j, "kind": kind} for j in served for kind in ("pickup", "delivery")
    ]
    return {
        "success": success,
        "served": stops,
        "tasks": fates,
        "plannings_s": [0.1],
        "longest_wait_s": 0.5,
    }


@pytest.mark.parametrize(
    ("results", "success"),
    [
        ({0: ([1], {"1": ["delivered", 0]}), 1: ([], {"1": ["delivered", 0]})}, True),
        ({0: ([1], {"1": ["delivered", 0]}), 1: ([1], {"1": ["delivered", 0]})}, False),
        ({0: ([], {"1": ["open", None]}), 1: ([], {"1": ["open", None]})}, False),
        (
            {0: ([], {"1": ["cancelled", None]}), 1: ([], {"1": ["cancelled", None]})},
            True,
        ),
        ({0: ([1], {"1": ["delivered", 0]}), 1: ([], {"1": ["open", None]})}, False),
    ],
)
def test_a_run_succeeds_if_all_is_delivered_once_and_all_say_so(results, success):
    report = MISSION.report(
        config(2), {i: result(*told) for i, told in results.items()}
    )
    assert report["success"] == success
    assert bool(report["reasons"]) != success
    assert report["plannings"] == 1
    assert report["longest_wait_s"] == 0.5


def test_why_a_task_was_not_served_is_in_the_report():
    fates = {"0": ["delivered", 0], "1": ["open", None], "2": ["lost", 1]}
    results = {
        0: result([0], fates)
        | {"unserved": {"1": "its load 9 is more than any drone can carry: 4"}}
    }
    results[1] = {"success": False, "reason": "killed"}
    report = MISSION.report(config(2), results)
    assert not report["success"]
    assert report["undone"]["1"].startswith("its load 9 is more")
    assert "with drone 1" in report["undone"]["2"]
    (said,) = report["reasons"].values()
    assert "task 1: its load 9" in said
    assert "task 2: lost with drone 1" in said


def test_the_picture_shows_ways_tasks_and_lost_drones(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, path, **options: drawn.append(figure)
    )
    flown = config(3, tasks=2, appear=[], later=0)
    place = [1.0, 1.5]
    stops = [
        {"task": j, "kind": kind, "place": place}
        for j in (0, 900)
        for kind in ("pickup", "delivery")
    ]
    fates = {"0": ["delivered", 0], "1": ["lost", 1], "900": ["delivered", 0]}
    results = {
        0: {
            "success": True,
            "served": stops,
            "tasks": fates,
            "way": [[0.0, -0.8], place, [0.0, -0.8]],
        },
        1: {"success": False, "reason": "killed", "way": [[0.0, 5.8], [2.0, 3.0]]},
    }
    MISSION.picture(flown, results, str(tmp_path / "a.png"))
    axes = drawn[0].axes[0]
    labels = [line.get_label() for line in axes.lines]
    assert "robot 0: 5.02 m" in labels
    lost = {
        line.get_label(): line.get_xydata().tolist()
        for line in axes.lines
        if "lost" in line.get_label()
    }
    assert lost == {
        "lost: robot 1": [[2.0, 3.0]],
        "lost: robot 2": [list(flown.drone(2).home[:2])],
    }
    named = {
        text.get_text(): (text.get_color(), list(text.xy))
        for text in axes.texts
        if hasattr(text, "xy")
    }
    assert named["900"] == (PICTURE_STYLE.ink, place)
    assert named["1"][0] == FAILURE_COLOUR
    assert named["0"][0] == PICTURE_STYLE.ink
