"""The tasks of the online mission: tasks at the start, tasks that appear later, and cancellations."""

import msgspec
import numpy as np

from crazychoir.config.reader import read_table
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.online_setup import Appearance, DeliveryOptions
from crazychoir.guidance.tasks.task_book import Task
from crazychoir.guidance.tasks.task_source import TaskEvent
from crazychoir.guidance.tasks.team_mission import project_to_plane
from crazychoir.routing.instance.instance import Instance
from crazychoir.team.graph import describe_ids

ROOM_SIDE = 5.0
"""m: side of the square in which the goods lie."""


def read_options(config: SwarmConfig) -> DeliveryOptions:
    """Return [mission_options]. Raises ConfigError with the key that is wrong."""
    where = f"swarm {config.name}"
    return read_table(config.mission_options, DeliveryOptions, where, "mission_options")


def get_instance(config: SwarmConfig) -> Instance:
    """Return the instance that the options name, or an instance drawn from the seed."""
    path = read_options(config).instance
    return Instance.load(path) if path is not None else draw_instance(config)


def draw_instance(config: SwarmConfig) -> Instance:
    """Return a random instance with `tasks` tasks in the square.

    Loads are 1 or 2, and capacities 2 to 4. Each robot may serve a task with probability 3/4, and
    at least one robot may serve each task.
    """
    draw = np.random.default_rng(config.seed)
    n = len(config.ids)
    m = read_options(config).tasks
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


def list_known_tasks(config: SwarmConfig) -> list[Task]:
    """Return the tasks of the instance: all robots know them at the start."""
    tasks = get_instance(config).tasks
    return [
        Task(
            j,
            0,
            False,
            project_to_plane(tasks.pickup[j]),
            project_to_plane(tasks.delivery[j]),
            float(tasks.load[j]),
        )
        for j in range(len(tasks))
    ]


def list_events(config: SwarmConfig) -> list[TaskEvent]:
    """Return the tasks that appear, numbered after those of the instance, and the cancellations."""
    tasks = {task.id: task for task in list_known_tasks(config)}
    found = []
    for row in list_appearances(config):
        task = Task(
            len(tasks), 0, False, row.pickup, row.delivery, row.load, row.robots
        )
        tasks[task.id] = task
        found.append(TaskEvent(row.t, task, row.heard_by))
    for n, cancel in enumerate(read_options(config).cancel):
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


def list_appearances(config: SwarmConfig) -> tuple[Appearance, ...]:
    """Return the appearances in `appear`.

    Without `appear` and without an instance they are `later` random tasks, each first known to
    three robots.
    """
    options = read_options(config)
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
            pickup=project_to_plane(p[0]),
            delivery=project_to_plane(p[1]),
            heard_by=tuple(drones),
        )
        for t, p, drones in zip(times, points, hears, strict=True)
    )
