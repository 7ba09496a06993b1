"""A line of drones moves by model predictive control: no drone gets ahead of its neighbours.

crazychoir run mpc --fast
crazychoir run mpc --fast --loss 0.3

The control is distributed. Each drone has a goal. The distances that two neighbours still have to
go differ by at most `reach`, so the formation waits for its slowest drone. In each step the drones
plan one after another, by increasing id.
"""

from itertools import combinations
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.config.drone_room import room_of
from crazychoir.config.flight_room import room_text
from crazychoir.config.tables import Acceleration, DroneTable, Speed, SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import Duration, Spot, given, own
from crazychoir.guidance.mpc import Motion, MPCGuidance
from crazychoir.recording.analysis.tracks import draw_ways
from crazychoir.types import Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
REACH_MARGIN = 0.05
"""m of `reach` that plans do not use.

It is left for the time between two steps, and for the drones' distance from their plans.
"""
FINAL_DISTANCE_TOLERANCE = 0.03
"""m: largest distance from the goal at the end."""
SLOW_DRONE_SPEED = 0.25
"""m/s: speed of the slow drone of the mission's own swarm."""


Reach = Annotated[
    float,
    Meta(
        gt=REACH_MARGIN,
        le=100,
        description=f"m, more than {REACH_MARGIN} m, which plans leave, to 100",
        examples=[0.35],
    ),
]
Step = Annotated[
    float, Meta(ge=0.1, le=2, description="a time in s, 0.1 to 2", examples=[0.4])
]
Horizon = Annotated[
    int,
    Meta(
        ge=3,
        le=50,
        description="3 steps or more, to start and to stop, to 50",
        examples=[10],
    ),
]
Jerk = Annotated[
    float,
    Meta(
        gt=0,
        le=1000,
        description="a jerk in m/s3, above 0, at most 1000",
        examples=[4.0],
    ),
]


class Options(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    shift: Spot = (3.0, 0.0)
    """(2,) m: from the homes to the goals."""
    reach: Reach = 0.35
    """m: how much farther than its neighbour a drone may have to go, in x and in y."""
    step: Step = 0.4
    """s: step of the plans."""
    horizon: Horizon = 10
    """Number of steps of a plan."""
    duration: Duration = 22.0
    """s: duration of the law."""
    speed: Speed = 0.6
    """m/s: largest, in x and in y."""
    acceleration: Acceleration = 1.0
    """m/s2: largest, in x and in y."""
    jerk: Jerk = 4.0
    """m/s3: largest, in x and in y."""


class DroneOptions(SwarmTable, frozen=True, kw_only=True):
    """`options` of a drone."""

    speed: Speed | None = None
    """m/s: largest, in x and in y, instead of that of the mission."""
    goal: Spot | None = None
    """(2,) m: instead of home + shift."""


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the law of drone i: from its home to its goal, inside the fence."""
    options = given(config, Options)
    drone = config.drone(i)
    goal = goal_of(config, drone)
    room = np.array(room_of(config, i))
    low, high = room[:, 0:2] - goal
    neighbors = config.graph().neighbors(i)
    law = MPCGuidance(
        goal, motion(config, drone), low, high, options.reach - REACH_MARGIN, neighbors
    )
    law.duration = options.duration
    return law


def motion(config: SwarmConfig, drone: DroneTable) -> Motion:
    """Return how the drone may move."""
    options = given(config, Options)
    speed = own(config, drone, DroneOptions).speed or options.speed
    return Motion(
        options.step, options.horizon, speed, options.acceleration, options.jerk
    )


def goal_of(config: SwarmConfig, drone: DroneTable) -> Vec:
    """Return the goal of a drone, (2,) m."""
    goal = own(config, drone, DroneOptions).goal
    return (
        np.array(goal)
        if goal is not None
        else np.add(drone.home[:2], given(config, Options).shift)
    )


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return four drones in a row, each linked to the next. The third drone is slow."""
    n = 4 if drones is None else drones
    return SwarmConfig.of(
        {
            "name": "row",
            "mission": "mpc",
            "graph": "path" if n > 1 else "empty",
            "drones": [
                {
                    "id": i,
                    "home": [-1.5, round(0.6 * (i - 0.5 * (n - 1)), 3), 0.0],
                    **slow,
                }
                for i, slow in enumerate(
                    [
                        {"options": {"speed": SLOW_DRONE_SPEED}} if i == 2 else {}
                        for i in range(n)
                    ]
                )
            ],
            "fence": {
                "min": [-3.0, -0.3 * n - 2.0, 0.0],
                "max": [3.0, 0.3 * n + 2.0, 2.5],
            },
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check that the problem is feasible at the start of the drones.

    They start at rest. Goals must lie in the fence, and neighbours within `reach`.
    Raises ConfigError if not.
    """
    options = given(config, Options)
    where = f"swarm {config.name}"
    graph = config.graph()
    if not graph.is_undirected or not graph.is_connected:
        raise ConfigError(
            f"{where}: graph",
            "one-way or in parts",
            "undirected and connected",
            "Add an edge.",
        )
    for drone in config.drones:
        _require_possible(config, drone)
    _require_near(config, options.reach - REACH_MARGIN)
    return []


def _require_possible(config: SwarmConfig, drone: DroneTable) -> None:
    """Raise ConfigError for a goal outside the fence, and for a speed above [flight]."""
    where = f"swarm {config.name}: drone {drone.id}"
    low, high = room_of(config, drone.id)
    place = goal_of(config, drone)
    if np.any(place < low[:2]) or np.any(place > high[:2]):
        raise ConfigError(
            f"{where}: goal",
            place.tolist(),
            room_text(low, high),
            "Change mission_options.shift, or widen [fence].",
        )
    speed = motion(config, drone).speed
    most = config.flight.speed_limit / 2**0.5
    if speed > most:
        allowed = f"at most {most:.2f} m/s: flight.speed_limit on a diagonal"
        raise ConfigError(f"{where}: speed", speed, allowed)


def _require_near(config: SwarmConfig, reach: float) -> None:
    """Raise ConfigError for neighbours that are too far ahead of each other before they start."""
    left = {
        drone.id: goal_of(config, drone) - drone.home[:2] for drone in config.drones
    }
    for i, j in config.graph().edges():
        ahead = float(np.abs(left[i] - left[j]).max())
        if ahead > reach:
            where = f"swarm {config.name}: drone {i}: goal"
            found = f"{ahead:.2f} m more or less to go than drone {j}, in x or in y"
            do = "Move goals or homes, or raise mission_options.reach: the plans are infeasible at the start."
            raise ConfigError(
                where,
                found,
                f"at most {reach:.2f} m: mission_options.reach less {REACH_MARGIN} m",
                do,
            )


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Return the goals."""
    height = config.flight.ground + config.flight.takeoff_height
    return {
        drone.id: np.array([*goal_of(config, drone), height]) for drone in config.drones
    }


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Report whether all drones are at their goals, and the largest lead over a neighbour."""
    goals = goal(config)
    reasons = {}
    for i in config.ids:
        if "way" not in results.get(i, {}):
            return {"success": False, "reasons": {i: "it has not flown to the end"}}
        far = float(np.linalg.norm(goals[i][:2] - results[i]["place"][:2]))
        if far > FINAL_DISTANCE_TOLERANCE:
            reasons[i] = (
                f"{far:.3f} m from its goal at the end, allowed {FINAL_DISTANCE_TOLERANCE} m; "
                f"{results[i]['why'] or 'slow'}"
            )
    ahead, pair = most_ahead(config, results)
    reach = given(config, Options).reach
    if ahead > reach:
        reasons[pair[0]] = (
            f"{ahead:.3f} m ahead of or behind drone {pair[1]}, allowed {reach} m"
        )
    count = {
        name: {i: results[i][name] for i in config.ids}
        for name in ("solved", "loosened", "kept", "infeasible")
    }
    return {
        "success": not reasons,
        "reasons": reasons,
        "reach_m": reach,
        "most_ahead_m": ahead,
        **count,
    }


def most_ahead(config: SwarmConfig, results: Results) -> tuple[float, tuple[int, int]]:
    """Return the largest distance by which a drone was ahead of a neighbour, and the two drones.

    The distance is in m, in x or in y.
    """
    rows = min(len(results[i]["way"]) for i in config.ids)
    left = {
        i: np.array(results[i]["way"])[:rows, 1:3] - goal_of(config, config.drone(i))
        for i in config.ids
    }
    graph = config.graph()
    worst = (0.0, (config.ids[0], config.ids[0]))
    for i, j in combinations(config.ids, 2):
        if j in graph.neighbors(i):
            worst = max(worst, (float(np.abs(left[i] - left[j]).max()), (i, j)))
    return worst


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the paths, and how far each drone still had to go."""
    shown = {i: np.array(results[i]["way"]) for i in config.ids}
    left = {
        i: np.linalg.norm(rows[:, 1:3] - goal_of(config, config.drone(i)), axis=1)
        for i, rows in shown.items()
    }
    draw_ways(
        path,
        {i: results[i]["way"] for i in config.ids},
        left,
        "still to go [m]",
        goal(config),
    )
