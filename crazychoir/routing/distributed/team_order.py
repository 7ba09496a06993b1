"""An order of robots and tasks that does not depend on their ids."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from crazychoir.routing.instance.instance import PUBLIC_FIELDS, LocalProblem, Tasks
from crazychoir.types import Ints


@dataclass(frozen=True)
class TeamOrder:
    """Robots and tasks ordered by what is known of them: places, loads, limits, times.

    A search that goes through robots and tasks in this order, and draws by ranks, finds the same
    plan whatever the ids are. Ids order only tasks with the same places, load, times and penalty,
    and identical robots.
    """

    robots: tuple[int, ...]
    """Ids of the robots, in order."""
    tasks: tuple[int, ...]
    """Tasks, in order."""
    robot_rank: dict[int, int]
    """Place of each robot in `robots`."""
    task_rank: dict[int, int]
    """Place of each task in `tasks`."""

    @classmethod
    def of(cls, problems: Mapping[int, LocalProblem]) -> "TeamOrder":
        """Return the order of a team.

        problems: the problem of each robot, by id, with the same tasks.
        """
        first = next(iter(problems.values()))
        tasks = _sort_tasks(first.tasks)
        robots = sorted(
            problems, key=lambda i: (_describe_robot(problems[i], tasks), i)
        )
        return cls(
            robots=tuple(robots),
            tasks=tuple(tasks.tolist()),
            robot_rank={i: rank for rank, i in enumerate(robots)},
            task_rank={j: rank for rank, j in enumerate(tasks.tolist())},
        )


def _sort_tasks(tasks: Tasks) -> Ints:
    m = len(tasks)
    table = np.column_stack(
        [
            tasks.pickup,
            tasks.delivery,
            tasks.load,
            tasks.service.reshape(2, m).T,
            tasks.earliest.reshape(2, m).T,
            tasks.latest.reshape(2, m).T,
            tasks.penalty,
            tasks.priority,
        ]
    )
    return np.asarray(np.lexsort(table.T[::-1]))


def _describe_robot(local: LocalProblem, tasks: Ints) -> list[list[float]]:
    """Return all fields of the robot as numbers; entries of tasks in the order of the tasks."""
    names = [f.name for f in fields(local) if f.name not in PUBLIC_FIELDS]
    values = {name: getattr(local, name) for name in names}
    if local.aboard is not None:
        values["aboard"] = local.aboard[tasks]
    if local.distance is not None:
        m = len(tasks)
        nodes = np.concatenate([tasks, m + tasks, [2 * m]])
        values["distance"] = local.distance[np.ix_(nodes, nodes)]
    values["capable"] = local.capable[tasks]
    return [
        [] if value is None else np.asarray(value, float).ravel().tolist()
        for value in values.values()
    ]
