"""What the task assignment needs beside its guidance: options, tasks, swarm, checks, report, picture."""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir.config.drone_room import shared_room
from crazychoir.config.reader import read_table
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Probability, SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_pictures import draw_ways
from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.tasks.assignment_report import (
    compute_gap,
    join_generation,
    list_rows,
)
from crazychoir.guidance.tasks.task_book import Task

SIX_ROBOT_EDGES = [[0, 3], [1, 4], [2, 5], [3, 5], [4, 5]]
"""The communication graph of six robots, as in the original."""
SIX_ROBOT_HOMES = [
    [1.0, 1.0],
    [0.0, 1.5],
    [-1.0, 1.0],
    [-1.0, -1.0],
    [0.0, -1.5],
    [1.0, -1.0],
]
"""(2,) m each: the homes of six robots."""
TASK_SQUARE_REACH = 3.0
"""m: tasks lie in the square from -TASK_SQUARE_REACH to TASK_SQUARE_REACH."""
NO_ROBOTS = (1 << 62,)
"""`robots` of a task that no robot may do: an id that does not exist."""
EQUAL_COST_DIFFERENCE = 1e-9
"""m: tolerance between the team's cost of a table and the cost of a central solver.

The two sums are rounded differently.
"""
Times = Annotated[
    int, Meta(ge=1, le=1000, description="a number of times, 1 to 1000", examples=[8])
]


class AssignmentOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    generations: Times = 8
    """How often the table is filled up."""
    chance: Probability = 0.5
    """Probability that a robot may do a task."""


class AssignmentHooks:
    """The hooks of a mission in which robots share a table of tasks."""

    def given(self, config: SwarmConfig) -> AssignmentOptions:
        """Return [mission_options]. Raises ConfigError with the key that is wrong."""
        where = f"swarm {config.name}"
        return read_table(
            config.mission_options, AssignmentOptions, where, "mission_options"
        )

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return a swarm of six robots around the origin, in the graph of the original.

        Its first table of tasks is that of seed 4. Other numbers of robots stand on a circle, in a
        ring.
        """
        n = 6 if drones is None else drones
        angles = 2.0 * np.pi * np.arange(n) / n
        circle = max(1.5, 0.1 * n) * np.column_stack([np.cos(angles), np.sin(angles)])
        homes = SIX_ROBOT_HOMES if n == 6 else circle.round(3).tolist()
        links: dict[str, Any] = (
            {"edges": SIX_ROBOT_EDGES} if n == 6 else {"graph": "ring"}
        )
        return SwarmConfig.of(
            {
                "name": "assignment",
                "mission": "task_assignment",
                "seed": 4,
                "drones": [
                    {"id": i, "home": [*home, 0.0]} for i, home in enumerate(homes)
                ],
                "flight": {"takeoff_height": 0.5, "landing_speed": 0.6},
                "fence": {"min": [-4.0, -4.0, 0.0], "max": [4.0, 4.0, 3.0]},
                "lost_after": 2.0,
                **links,
            }
        )

    def drawn(self, config: SwarmConfig, count: int) -> list[Task]:
        """Return the first `count` tasks of the seed.

        For each task the place x, y is drawn, then for each robot whether it may do the task.
        """
        # same generator as the original, so that the tables are the same
        draw = np.random.RandomState(config.seed)
        chance = self.given(config).chance
        tasks = []
        for j in range(count):
            place = (
                float(draw.uniform(-TASK_SQUARE_REACH, TASK_SQUARE_REACH)),
                float(draw.uniform(-TASK_SQUARE_REACH, TASK_SQUARE_REACH)),
            )
            robots = tuple(i for i in config.ids if draw.rand() < chance)
            tasks.append(Task(j, 0, False, place, place, robots=robots or NO_ROBOTS))
        return tasks

    def may_be_done(self, config: SwarmConfig, j: int) -> bool:
        """Return whether any robot of the swarm may do the drawn task j."""
        return self.drawn(config, j + 1)[j].robots != NO_ROBOTS

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that all tasks fit into the fence, and that the graph is undirected.

        Raises ConfigError if not.
        """
        self.given(config)
        if not config.graph().is_undirected:
            raise ConfigError(
                f"swarm {config.name}: graph", "a directed graph", "an undirected one"
            )
        low, high = np.array(shared_room(config))[:, 0:2]
        if np.any(low > -TASK_SQUARE_REACH) or np.any(high < TASK_SQUARE_REACH):
            where = f"swarm {config.name}: fence"
            box = f"room for drones from {low.round(3).tolist()} to {high.round(3).tolist()}"
            raise ConfigError(
                where,
                box,
                f"tasks lie in the square from -{TASK_SQUARE_REACH:g} to {TASK_SQUARE_REACH:g} m",
                "Widen it.",
            )
        return []

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report the tasks that were done, by generation, and why others were left.

        The cost of each table stands beside the cost of a central solver.
        """
        pairs = [
            (task, generation)
            for result in results.values()
            for task, generation in result.get("done", [])
        ]
        tables = [
            join_generation(number, rows, pairs)
            for number, rows in sorted(list_rows(results).items())
        ]
        done = [task for task, _ in pairs]
        ended = [result for result in results.values() if result.get("success")]
        why = [text for table in tables if (text := table["infeasible"])][-1:] or [
            "no robot was left to do it"
        ]
        left = {j: why[0] for result in ended for j in result["open"]}
        wrong = [
            f"task {j}: done twice" for j in dict.fromkeys(done) if done.count(j) > 1
        ]
        wrong += [
            f"generation {t['number']}: {t['cost']} m, {t['optimum']} m is possible"
            for t in tables
            if compute_gap(t) > EQUAL_COST_DIFFERENCE
        ]
        wrong += [
            f"task {j} was not done: {why[0]}"
            for j in left
            if self.may_be_done(config, j)
        ]
        return {
            "tasks": {
                "done": len(done),
                "left": len(left),
                "infeasible": sum(bool(t["infeasible"]) for t in tables),
            },
            "served_by_generation": [len(table["served"]) for table in tables],
            "worst_cost_gap_m": max(map(compute_gap, tables), default=0.0),
            "tables": tables,
            "left": left,
            "planning_s": max((table["seconds"] for table in tables), default=0.0),
            "success": not wrong,
            "reasons": {min(config.ids): "; ".join(wrong)} if wrong else {},
        }

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the paths from above over the tasks (grey), and each robot's distance from its task."""
        ways = {
            i: results[i]["way"] for i in config.ids if results.get(i, {}).get("way")
        }
        tables = [
            table for result in results.values() for table in result.get("tables", [])
        ]
        tasks = {
            j: place
            for table in tables
            for j, place in zip(table["tasks"], table["places"], strict=True)
        }
        draw_ways(
            path,
            {i: [row[:3] for row in way] for i, way in ways.items()},
            {
                i: np.array([row[3] for row in way], dtype=float)
                for i, way in ways.items()
            },
            "m from its task",
            seen={j: [[0.0, *place]] for j, place in tasks.items()},
        )
