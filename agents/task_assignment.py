"""Six robots and a table of six tasks that fills up as it is worked off: each task is done by one that may do it.

crazychoir run task_assignment --fast --loss 0.2
"""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from scipy.optimize import linear_sum_assignment

from crazychoir import SwarmConfig
from crazychoir.config.drone_room import shared_room
from crazychoir.config.reader import read
from crazychoir.config.tables import Probability, Table
from crazychoir.errors import ConfigError
from crazychoir.guidance.tasks.task_assignment import TaskAssignmentGuidance, Work
from crazychoir.guidance.tasks.task_book import Task
from crazychoir.recording.analysis.tracks import draw_ways
from crazychoir.types import Mat

Results = dict[int, dict[str, Any]]
Pair = tuple[int, int]
"""A task, and the generation in which it was done."""
EDGES = [[0, 3], [1, 4], [2, 5], [3, 5], [4, 5]]
HOMES = [[1.0, 1.0], [0.0, 1.5], [-1.0, 1.0], [-1.0, -1.0], [0.0, -1.5], [1.0, -1.0]]
REACH = 3.0
"""m: tasks lie in the square from -REACH to REACH."""
NOBODY = (1 << 62,)
"""Robots of a task that no robot may do: an id that there is not."""
SAME = 1e-9
"""m, by which the team's cost of a table may differ from that of a central solver: rounding of sums."""
Times = Annotated[
    int, Meta(ge=1, le=1000, description="a number of times, 1 to 1000", examples=[8])
]


class Options(Table, frozen=True, kw_only=True):
    """[mission_options].

    generations: how often the table is filled up;  chance: that a robot may do a task.
    """

    generations: Times = 8
    chance: Probability = 0.5


def guidance(i: int, config: SwarmConfig) -> TaskAssignmentGuidance:
    """Robot i."""
    options = given(config)
    return TaskAssignmentGuidance(
        Work(lambda count: drawn(config, count), options.generations)
    )


def swarm(drones: int | None = None) -> SwarmConfig:
    """Six robots around the middle, in the graph of the original, whose first table is that of seed 4."""
    n = 6 if drones is None else drones
    angles = 2.0 * np.pi * np.arange(n) / n
    circle = max(1.5, 0.1 * n) * np.column_stack([np.cos(angles), np.sin(angles)])
    homes = HOMES if n == 6 else circle.round(3).tolist()
    links: dict[str, Any] = {"edges": EDGES} if n == 6 else {"graph": "ring"}
    return SwarmConfig.of(
        {
            "name": "assignment",
            "mission": "task_assignment",
            "seed": 4,
            "drones": [{"id": i, "home": [*home, 0.0]} for i, home in enumerate(homes)],
            "flight": {"takeoff_height": 0.5, "landing_speed": 0.6},
            "fence": {"min": [-4.0, -4.0, 0.0], "max": [4.0, 4.0, 3.0]},
            "lost_after": 2.0,
            **links,
        }
    )


def given(config: SwarmConfig) -> Options:
    """[mission_options]; raises ConfigError that names the key."""
    return read(
        config.mission_options, Options, f"swarm {config.name}", "mission_options"
    )


def drawn(config: SwarmConfig, count: int) -> list[Task]:
    """The first `count` tasks of the seed: x, y of a task, then for each robot whether it may do it."""
    # the generator of the original
    draw = np.random.RandomState(config.seed)
    chance = given(config).chance
    tasks = []
    for j in range(count):
        place = (float(draw.uniform(-REACH, REACH)), float(draw.uniform(-REACH, REACH)))
        robots = tuple(i for i in config.ids if draw.rand() < chance)
        tasks.append(Task(j, 0, False, place, place, robots=robots or NOBODY))
    return tasks


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Tasks fit into the fence, and messages go both ways."""
    given(config)
    if not config.graph().is_undirected:
        raise ConfigError(
            f"swarm {config.name}: graph", "a directed graph", "an undirected one"
        )
    low, high = np.array(shared_room(config))[:, 0:2]
    if np.any(low > -REACH) or np.any(high < REACH):
        where = f"swarm {config.name}: fence"
        box = (
            f"room for drones from {low.round(3).tolist()} to {high.round(3).tolist()}"
        )
        raise ConfigError(
            where,
            box,
            f"tasks lie in the square from -{REACH:g} to {REACH:g} m",
            "Widen it.",
        )
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Tasks done, by generation; the cost of each table beside that of a central solver; what was left, and why."""
    pairs = [
        (task, generation)
        for result in results.values()
        for task, generation in result.get("done", [])
    ]
    tables = [
        joined(number, rows, pairs)
        for number, rows in sorted(_by_number(results).items())
    ]
    done = [task for task, _ in pairs]
    ended = [result for result in results.values() if result.get("success")]
    why = [text for table in tables if (text := table["infeasible"])][-1:] or [
        "nobody was left to do it"
    ]
    left = {j: why[0] for result in ended for j in result["open"]}
    wrong = [f"task {j}: done twice" for j in dict.fromkeys(done) if done.count(j) > 1]
    wrong += [
        f"generation {t['number']}: {t['cost']} m, {t['optimum']} m is possible"
        for t in tables
        if gap(t) > SAME
    ]
    wrong += [
        f"task {j} was not done: {why[0]}" for j in left if may_be_done(config, j)
    ]
    return {
        "tasks": {
            "done": len(done),
            "left": len(left),
            "infeasible": sum(bool(t["infeasible"]) for t in tables),
        },
        "served_by_generation": [len(table["served"]) for table in tables],
        "worst_cost_gap_m": max(map(gap, tables), default=0.0),
        "tables": tables,
        "left": left,
        "planning_s": max((table["seconds"] for table in tables), default=0.0),
        "success": not wrong,
        "reasons": {min(config.ids): "; ".join(wrong)} if wrong else {},
    }


def _by_number(results: Results) -> dict[int, dict[int, dict[str, Any]]]:
    """Each generation's rows, by robot."""
    found: dict[int, dict[int, dict[str, Any]]] = {}
    for i, result in results.items():
        for table in result.get("tables", []):
            found.setdefault(table["number"], {})[i] = table
    return found


def joined(
    number: int, rows: dict[int, dict[str, Any]], done: list[Pair]
) -> dict[str, Any]:
    """One generation, of all its robots; optimum: by a central solver, None where robots are gone with their costs."""
    first = next(iter(rows.values()))
    costs = np.array(
        [[np.inf if c is None else c for c in row["costs"]] for row in rows.values()]
    )
    whole = list(rows) == first["team"]
    return {
        "number": number,
        "filled": first["filled"],
        "tasks": first["tasks"],
        "assigned": {
            i: row["mine"] for i, row in rows.items() if row["mine"] is not None
        },
        "cost": first["cost"],
        "optimum": optimum(costs) if whole else None,
        "infeasible": first["infeasible"],
        "rounds": first["rounds"],
        "seconds": max(row["seconds"] for row in rows.values()),
        "served": sorted(task for task, generation in done if generation == number),
    }


def optimum(costs: Mat) -> float | None:
    """m, the least cost of as many pairs as there can be; inf: not allowed. None if there are no tasks."""
    if costs.size == 0:
        return None
    allowed = np.isfinite(costs)
    dear = 1.0 + 2.0 * float(
        costs[allowed].sum()
    )  # dearer than all allowed pairs together
    chosen = linear_sum_assignment(np.where(allowed, costs, dear))
    return float(np.where(allowed, costs, 0.0)[chosen].sum())


def gap(table: dict[str, Any]) -> float:
    """m, by which the team's cost differs from that of the central solver; 0 where that has none."""
    return 0.0 if table["optimum"] is None else abs(table["cost"] - table["optimum"])


def may_be_done(config: SwarmConfig, j: int) -> bool:
    """Whether some robot of the swarm may do a drawn task."""
    return drawn(config, j + 1)[j].robots != NOBODY


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """The ways from above, over the tasks, grey; and how far each robot was from its task."""
    ways = {i: results[i]["way"] for i in config.ids if results.get(i, {}).get("way")}
    left = {
        i: np.array([row[3] for row in way], dtype=float) for i, way in ways.items()
    }
    ways = {i: [row[:3] for row in way] for i, way in ways.items()}
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
        ways,
        left,
        "m from its task",
        seen={j: [[0.0, *place]] for j, place in tasks.items()},
    )
