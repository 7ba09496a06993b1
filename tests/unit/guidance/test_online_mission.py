"""The online mission: what it is made of, and what is refused before anybody flies."""

import math

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load
from crazychoir.guidance.task_source import Event

MISSION = load("online_delivery")


def config(drones=10, seed=1, **options):
    return MISSION.swarm(drones).replace(seed=seed, mission_options=options)


@pytest.mark.parametrize("drones", [2, 3, 6, 10])
@pytest.mark.parametrize("seed", range(3))
def test_any_seed_gives_tasks_that_can_be_served_and_a_graph_that_bears_a_loss(drones, seed):
    drawn = config(drones, seed)
    assert MISSION.check(drawn, False) == []
    assert len(MISSION.known(drawn)) == 15
    later = MISSION.events(drawn)
    assert [event.task.id for event in later] == [15, 16, 17, 18, 19]
    assert all(len(event.robots) == min(3, drones) for event in later)
    assert MISSION.options(drawn).until == max(event.t for event in later)
    assert drawn.graph().is_connected
    assert min(len(drawn.graph().neighbors(i)) for i in drawn.ids) >= min(4, drones - 1)


def test_the_seed_alone_decides():
    assert MISSION.known(config()) == MISSION.known(config())
    assert MISSION.known(config()) != MISSION.known(config(seed=2))


def test_tasks_appear_and_are_cancelled_as_the_file_says():
    new = {"t": 4.0, "pickup": [1.0, 1.5], "delivery": [2.0, 2.5], "load": 2.0, "robots": [3], "heard_by": [1, 2]}
    events = MISSION.events(config(appear=[new], cancel=[{"t": 5.0, "task": 15}, {"t": 6.0, "task": 0}]))
    first, gone, other = events
    assert first == Event(4.0, first.task, (1, 2))
    assert (first.task.pickup, first.task.delivery, first.task.load, first.task.robots) == ((1, 1.5), (2, 2.5), 2, (3,))
    assert gone.task.cancelled
    assert gone.task > first.task
    assert (other.task.id, other.robots) == (0, ())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"methd": 1}, "methd"),
        ({"method": "magic"}, "magic.*auction"),
        ({"level_spacing": 0.5}, "levels of the drones"),
        ({"appear": [{"t": 1.0, "pickup": [0.0, -0.7], "delivery": [1.0, 1.0]}]}, "from the home of drone 0"),
        ({"cancel": [{"t": 1.0, "task": 99}]}, "99"),
        ({"appear": [{"t": 1.0, "pickup": [0.0, 1.0]}]}, "delivery"),
        ({"appear": [{"t": 1.0, "pickup": "here", "delivery": [1.0, 1.0]}]}, "pickup"),
        ({"appear": [{"t": -1.0, "pickup": [0.0, 1.0], "delivery": [1.0, 1.0]}]}, r"appear.*>= 0"),
        ({"cancel": [{"when": 1.0, "task": 0}]}, "when"),
        ({"cancel": 3}, "cancel"),
    ],
)
def test_what_cannot_be_is_refused_before_anybody_flies(options, said):
    with pytest.raises(ConfigError, match=said):
        MISSION.check(config(**options), False)


def test_a_directed_graph_is_refused():
    with pytest.raises(ConfigError, match="undirected"):
        MISSION.check(config().replace(graph="ring", directed=True), False)


def result(served, fates, success=True):
    stops = [{"task": j, "kind": kind} for j in served for kind in ("pickup", "delivery")]
    return {"success": success, "served": stops, "tasks": fates, "plannings_s": [0.1], "longest_wait_s": 0.5}


@pytest.mark.parametrize(
    ("results", "success"),
    [
        ({0: ([1], {"1": ["delivered", 0]}), 1: ([], {"1": ["delivered", 0]})}, True),
        ({0: ([1], {"1": ["delivered", 0]}), 1: ([1], {"1": ["delivered", 0]})}, False),
        ({0: ([], {"1": ["open", None]}), 1: ([], {"1": ["open", None]})}, False),
        ({0: ([], {"1": ["cancelled", None]}), 1: ([], {"1": ["cancelled", None]})}, True),
        ({0: ([1], {"1": ["delivered", 0]}), 1: ([], {"1": ["open", None]})}, False),
    ],
)
def test_a_run_succeeds_if_all_is_delivered_once_and_all_say_so(results, success):
    report = MISSION.report(config(2), {i: result(*told) for i, told in results.items()})
    assert report["success"] == success
    assert report["plannings"] == 1
    assert report["longest_wait_s"] == 0.5


def test_levels_leave_room_between_drones():
    heights = sorted(MISSION.options(config()).levels.values())
    assert np.diff(heights).min() == pytest.approx(0.2)
    assert heights[0] == 0.4
    assert math.isclose(heights[-1], 2.2)
