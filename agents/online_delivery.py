"""Pickup and delivery in flight: the team plans again when tasks or drones come and go.

Tasks appear and are cancelled. Drones are lost and join.

crazychoir run online_delivery --fast --loss 0.2
"""

from typing import Any

import msgspec
import numpy as np

from crazychoir.config.reader import read_table
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.delivery_checks import (
    require_flyable_features,
    require_servable_places,
    require_used_keys,
)
from crazychoir.guidance.delivery.delivery_options import Appearance, DeliveryOptions
from crazychoir.guidance.delivery.delivery_picture import draw_flown_ways
from crazychoir.guidance.delivery.online_delivery import (
    OnlineDeliveryOptions,
    OnlinePDVRPGuidance,
)
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.tasks.task_book import Fate, Task
from crazychoir.guidance.tasks.task_source import TaskEvent
from crazychoir.routing.instance.instance import Instance
from crazychoir.team.graph import describe_ids

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
ONLINE_FLIGHT_TABLE = {
    "takeoff_height": 0.4,
    "speed_limit": 1.5,
    "acceleration_limit": 3.0,
    "landing_speed": 0.6,
}
"""[flight] of this mission's own swarm."""
ROOM_SIDE = 5.0
"""m: side of the square in which the goods lie."""
DOCK_DISTANCE = 0.8
"""m: distance of the drones' homes from that square, on two of its sides."""
FINISHED_FATES = Fate.DELIVERED.value, Fate.CANCELLED.value
"""Fates of a task that needs no more work."""


def guidance(i: int, config: SwarmConfig) -> OnlinePDVRPGuidance:
    """Return the guidance of robot i, with its own part of the instance."""
    own = instance(config).local(i)
    return OnlinePDVRPGuidance(own, known(config), events(config), options(config))


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return ten drones along two sides of a room, each linked to the four nearest.

    The tasks are drawn from the seed.
    """
    n = 10 if drones is None else drones
    rows = [(k // 2, k % 2) for k in range(n)]
    gap = ROOM_SIDE / max(1, (n - 1) // 2)
    homes = [
        [
            round(gap * column, 3),
            -DOCK_DISTANCE if side == 0 else ROOM_SIDE + DOCK_DISTANCE,
            0.0,
        ]
        for column, side in rows
    ]
    return SwarmConfig.of(
        {
            "name": "online",
            "mission": "online_delivery",
            "drones": [{"id": i, "home": home} for i, home in enumerate(homes)],
            "graph": "k-regular:4" if n > 5 else "complete",
            "flight": ONLINE_FLIGHT_TABLE,
            "fence": {
                "min": [-2.0, -DOCK_DISTANCE - 1.0, 0.0],
                "max": [ROOM_SIDE + 2.0, ROOM_SIDE + DOCK_DISTANCE + 1.0, 3.0],
            },
            "lost_after": 2.0,
        }
    )


def given(config: SwarmConfig) -> DeliveryOptions:
    """Return [mission_options]. Raises ConfigError with the key that is wrong."""
    return read_table(
        config.mission_options,
        DeliveryOptions,
        f"swarm {config.name}",
        "mission_options",
    )


def instance(config: SwarmConfig) -> Instance:
    """Return the instance that the options name, or an instance drawn from the seed."""
    path = given(config).instance
    return Instance.load(path) if path is not None else drawn(config)


def drawn(config: SwarmConfig) -> Instance:
    """Return a random instance with `tasks` tasks in the square.

    Loads are 1 or 2, and capacities 2 to 4. Each robot may serve a task with probability 3/4, and
    at least one robot may serve each task.
    """
    draw = np.random.default_rng(config.seed)
    n = len(config.ids)
    m = given(config).tasks
    points = draw.uniform(0.0, ROOM_SIDE, size=(2 * m, 2))
    capacity = draw.integers(2, 4, size=n, endpoint=True)
    mask = draw.random((n, m)) < 0.75
    mask[draw.integers(n, size=m), np.arange(m)] = True
    return Instance.parse(
        {
            "home": [list(config.drone(i).home[:2]) for i in config.ids],
            "pickup": points[:m].round(2).tolist(),
            "delivery": points[m:].round(2).tolist(),
            "load": draw.integers(1, 2, size=m, endpoint=True).astype(float).tolist(),
            "capacity": capacity.astype(float).tolist(),
            "capability": mask.tolist(),
        },
        f"online_delivery, seed {config.seed}",
    )


def known(config: SwarmConfig) -> list[Task]:
    """Return the tasks of the instance: all robots know them at the start."""
    tasks = instance(config).tasks
    return [
        Task(
            j,
            0,
            False,
            _place(tasks.pickup[j]),
            _place(tasks.delivery[j]),
            float(tasks.load[j]),
        )
        for j in range(len(tasks))
    ]


def events(config: SwarmConfig) -> list[TaskEvent]:
    """Return the tasks that appear, numbered after those of the instance, and the cancellations."""
    tasks = {task.id: task for task in known(config)}
    found = []
    for row in _appearing(config):
        task = Task(
            len(tasks), 0, False, row.pickup, row.delivery, row.load, row.robots
        )
        tasks[task.id] = task
        found.append(TaskEvent(row.t, task, row.heard_by))
    for n, cancel in enumerate(given(config).cancel):
        if cancel.task not in tasks:
            where = f"swarm {config.name}: mission_options.cancel[{n}].task"
            do = "Correct the number; tasks that appear are numbered after those of the start, in their order."
            raise ConfigError(
                where,
                cancel.task,
                f"there are {describe_ids(tasks)}",
                do,
                "there is no such task",
            )
        gone = msgspec.structs.replace(tasks[cancel.task], cancelled=True)
        found.append(TaskEvent(cancel.t, gone, cancel.heard_by))
    return found


def _appearing(config: SwarmConfig) -> tuple[Appearance, ...]:
    """Return the appearances in `appear`.

    Without `appear` and without an instance they are `later` random tasks, each first known to
    three robots.
    """
    options = given(config)
    if "appear" in config.mission_options or options.instance is not None:
        return options.appear
    draw = np.random.default_rng([config.seed, 1])
    n = options.later
    times = draw.uniform(3.0, 20.0, size=(n, 1))
    points = draw.uniform(0.0, ROOM_SIDE, size=(n, 2, 2))
    hears = [
        draw.choice(config.ids, size=min(3, len(config.ids)), replace=False).tolist()
        for _ in range(n)
    ]
    return tuple(
        Appearance(
            t=float(t[0]),
            pickup=_place(p[0]),
            delivery=_place(p[1]),
            heard_by=tuple(who),
        )
        for t, p, who in zip(times, points, hears, strict=True)
    )


def options(config: SwarmConfig) -> OnlineDeliveryOptions:
    """Return the options that all robots have in common."""
    chosen = given(config)
    last = max((event.t for event in events(config)), default=0.0)
    return OnlineDeliveryOptions(
        DeliverySite(config, chosen.clearance, instance(config)),
        service_time=chosen.service_time,
        recover=chosen.recover,
        until=max(last, chosen.until),
        method=chosen.method,
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check that the drones stand where the instance says, and that each task can be served."""
    chosen = given(config)
    where = f"swarm {config.name}: mission_options"
    require_used_keys(config.mission_options, where)
    problem = instance(config)
    require_flyable_features(problem, f"{where}.instance")
    if config.ids != tuple(range(problem.robots)):
        raise ConfigError(
            f"swarm {config.name}: drones",
            list(config.ids),
            f"0 to {problem.robots - 1}",
        )
    if not config.graph().is_undirected:
        raise ConfigError(
            f"swarm {config.name}: graph", "a directed graph", "an undirected one"
        )
    for i, home in enumerate(problem.home):
        stands = np.array(config.drone(i).home[:2])
        if np.linalg.norm(stands - home[:2]) > 0.05:
            raise ConfigError(
                f"swarm {config.name}: drones[{i}].home",
                stands.tolist(),
                f"{home.tolist()}",
            )
    require_servable_places(
        options(config).site, known(config), _appearing(config), chosen, where
    )
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Report what has become of each task, and why a task was not served.

    The fates are those known to the drones that have completed the mission.
    """
    ended = {
        i: r for i, r in sorted(results.items()) if "tasks" in r and r.get("success")
    }
    stops = [stop for r in results.values() for stop in r.get("served", [])]
    delivered = sorted(stop["task"] for stop in stops if stop["kind"] == "delivery")
    first = next(iter(ended.values()), {})
    fates = first.get("tasks", {})
    why = first.get("unserved", {})
    count = {
        fate.value: sum(value[0] == fate.value for value in fates.values())
        for fate in Fate
    }
    undone = {
        j: _undone(fate, robot, why.get(j))
        for j, (fate, robot) in fates.items()
        if fate not in FINISHED_FATES
    }
    twice = [j for j in delivered if delivered.count(j) > 1]
    wrong = [f"task {j}: {text}" for j, text in undone.items()] + [
        f"task {j}: delivered twice" for j in {*twice}
    ]
    wrong += [
        f"drone {i} tells of other ends of the tasks"
        for i, r in ended.items()
        if r["tasks"] != fates
    ]
    return {
        "success": bool(fates) and not wrong,
        "reasons": {next(iter(ended)): "; ".join(wrong)} if wrong else {},
        "tasks": {
            "total": len(fates),
            **{name: number for name, number in count.items() if number},
        },
        "undone": undone,
        "twice": twice,
        "plannings": max(
            (len(r.get("plannings_s", [])) for r in results.values()), default=0
        ),
        "fallbacks": first.get("fallbacks", []),
        "longest_wait_s": max(
            (r.get("longest_wait_s", 0.0) for r in results.values()), default=0.0
        ),
    }


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the flown paths, the tasks and the lost drones."""
    told = [*known(config), *(event.task for event in events(config))]
    places = {
        "pickup": {task.id: task.pickup for task in told},
        "delivery": {task.id: task.delivery for task in told},
    }
    for result in results.values():
        for stop in result.get("served", []):  # also tasks that operators added
            places[stop["kind"]].setdefault(stop["task"], _place(stop["place"]))
    found = report(config, results)
    lost = [i for i in config.ids if not results.get(i, {}).get("success")]
    draw_flown_ways(
        path,
        {drone.id: _place(drone.home) for drone in config.drones},
        {
            i: np.array(r["way"], float)
            for i, r in sorted(results.items())
            if len(r.get("way", [])) > 1
        },
        places["pickup"],
        places["delivery"],
        [int(j) for j in found["undone"]],
        lost,
        ", ".join(f"{name}: {number}" for name, number in found["tasks"].items()),
    )


def _undone(fate: str, robot: int | None, why: str | None) -> str:
    if fate == Fate.LOST.value:
        return f"lost with drone {robot}, that had it aboard; with recover = true it would have been fetched"
    return why or fate


def _place(p: Any) -> tuple[float, float]:
    return float(p[0]), float(p[1])
