"""A line of drones moves on together by distributed model predictive control: nobody gets ahead of its neighbours.

crazychoir run mpc --fast
crazychoir run mpc --fast --loss 0.3

Each drone has a goal, and stays within `reach` of its neighbours in how far it still has to go, so that the formation
waits for its slowest drone; in each step the drones plan one after another, by increasing id.
[mission_options]: shift: [x, y] m, of the goals from the homes;  reach: m;  step: s;  horizon: steps;  duration: s;
speed, acceleration, jerk: m/s, m/s2, m/s3.  options of a drone: speed: m/s;  goal: [x, y] m, instead of home + shift.
"""

from itertools import combinations
from typing import Any

import msgspec
import numpy as np

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.mpc import Motion, MPCGuidance
from crazychoir.math3d import Vec
from crazychoir.recording.tracks import draw_ways
from crazychoir.safety.guard import EDGE
from crazychoir.swarm.tables import Drone

Results = dict[int, dict[str, Any]]
MARGIN = 0.05
"""m of the reach that plans leave: between two steps, and to what the drones are off their plans."""
TOLERANCE = 0.03
"""m from its goal at the end."""
SLOW = 0.25


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """[mission_options]."""

    shift: tuple[float, float] = (3.0, 0.0)
    reach: float = 0.35
    step: float = 0.4
    horizon: int = 10
    duration: float = 22.0
    speed: float = 0.6
    acceleration: float = 1.0
    jerk: float = 4.0


def given(config: SwarmConfig) -> Options:
    """[mission_options]; raises ConfigError that names the key."""
    try:
        return msgspec.convert(config.mission_options, Options)
    except msgspec.ValidationError as error:
        raise ConfigError(f"swarm {config.name}: mission_options", str(error), "see agents/mpc.py") from error


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Drone i, from its home to its goal, in the fence."""
    options, drone = given(config), config.drone(i)
    goal = goal_of(config, drone)
    low, high = np.array(config.fence.min[:2]) + EDGE - goal, np.array(config.fence.max[:2]) - EDGE - goal
    neighbors = config.graph().neighbors(i)
    law = MPCGuidance(goal, motion(options, drone), low, high, options.reach - MARGIN, neighbors)
    law.duration = options.duration
    return law


def motion(options: Options, drone: Drone) -> Motion:
    """What the drone can."""
    speed = float(drone.options.get("speed", options.speed))
    return Motion(options.step, options.horizon, speed, options.acceleration, options.jerk)


def goal_of(config: SwarmConfig, drone: Drone) -> Vec:
    """(2,) m."""
    place: Vec = np.array(drone.options.get("goal", np.add(drone.home[:2], given(config).shift)), float)
    return place


def swarm(drones: int | None = None) -> SwarmConfig:
    """Four drones in a row, each linked to the next; the third is slow."""
    n = 4 if drones is None else drones
    return SwarmConfig.of(
        {
            "name": "row",
            "mission": "mpc",
            "graph": "path" if n > 1 else "empty",
            "drones": [
                {"id": i, "home": [-1.5, round(0.6 * (i - 0.5 * (n - 1)), 3), 0.0], **slow}
                for i, slow in enumerate([{"options": {"speed": SLOW}} if i == 2 else {} for i in range(n)])
            ],
            "fence": {"min": [-3.0, -0.3 * n - 2.0, 0.0], "max": [3.0, 0.3 * n + 2.0, 2.5]},
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """The options make a problem that is feasible where the drones start: at rest, in the fence, as near as allowed."""
    options, where, graph = given(config), f"swarm {config.name}", config.graph()
    if not graph.is_undirected or not graph.is_connected:
        raise ConfigError(f"{where}: graph", "one-way or in parts", "undirected and connected", "Add an edge.")
    if options.reach <= MARGIN:
        raise ConfigError(f"{where}: mission_options.reach", options.reach, f"more than {MARGIN} m, which plans leave")
    if options.horizon < 3:
        raise ConfigError(f"{where}: mission_options.horizon", options.horizon, "3 steps or more: to start and to stop")
    for name in ("step", "speed", "acceleration", "jerk", "duration"):
        if not getattr(options, name) > 0:
            raise ConfigError(f"{where}: mission_options.{name}", getattr(options, name), "a positive number")
    for drone in config.drones:
        _require_possible(config, drone, options)
    _require_near(config, options.reach - MARGIN)
    return []


def _require_possible(config: SwarmConfig, drone: Drone, options: Options) -> None:
    """Raise ConfigError for a goal outside the fence, and for more speed than [flight] has."""
    where, low, high = f"swarm {config.name}: drone {drone.id}", config.fence.min, config.fence.max
    place = goal_of(config, drone)
    if np.any(place < np.array(low[:2]) + EDGE) or np.any(place > np.array(high[:2]) - EDGE):
        allowed = f"a goal inside [fence], {EDGE} m from its edge"
        raise ConfigError(f"{where}: goal", place.tolist(), allowed, "Change mission_options.shift, or widen [fence].")
    speed, most = motion(options, drone).speed, config.flight.speed_limit / 2**0.5
    if not 0.0 < speed <= most:
        allowed = f"above 0, at most {most:.2f} m/s: flight.speed_limit on a diagonal"
        raise ConfigError(f"{where}: speed", speed, allowed)


def _require_near(config: SwarmConfig, reach: float) -> None:
    """Raise ConfigError for neighbours that are too far ahead of each other before they start."""
    left = {drone.id: goal_of(config, drone) - drone.home[:2] for drone in config.drones}
    for i, j in config.graph().edges():
        ahead = float(np.abs(left[i] - left[j]).max())
        if ahead > reach:
            where = f"swarm {config.name}: drone {i}: goal"
            found = f"{ahead:.2f} m more or less to go than drone {j}, in x or in y"
            do = "Move goals or homes, or raise mission_options.reach: the plans are infeasible at the start."
            raise ConfigError(where, found, f"at most {reach:.2f} m: mission_options.reach less {MARGIN} m", do)


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """The goals."""
    height = config.flight.ground + config.flight.takeoff_height
    return {drone.id: np.array([*goal_of(config, drone), height]) for drone in config.drones}


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Whether all are at their goals, and how far neighbours were ahead of each other on the way."""
    goals, reasons = goal(config), {}
    for i in config.ids:
        if "way" not in results.get(i, {}):
            return {"success": False, "reasons": {i: "it has not flown to the end"}}
        far = float(np.linalg.norm(goals[i][:2] - results[i]["place"][:2]))
        if far > TOLERANCE:
            reasons[i] = f"{far:.3f} m from its goal at the end, allowed {TOLERANCE} m; {results[i]['why'] or 'slow'}"
    ahead, pair = most_ahead(config, results)
    reach = given(config).reach
    if ahead > reach:
        reasons[pair[0]] = f"{ahead:.3f} m ahead of or behind drone {pair[1]}, allowed {reach} m"
    count = {name: {i: results[i][name] for i in config.ids} for name in ("solved", "loosened", "kept", "infeasible")}
    return {"success": not reasons, "reasons": reasons, "reach_m": reach, "most_ahead_m": ahead, **count}


def most_ahead(config: SwarmConfig, results: Results) -> tuple[float, tuple[int, int]]:
    """m by which a drone was at most ahead of a neighbour, in x or in y, and who."""
    rows = min(len(results[i]["way"]) for i in config.ids)
    left = {i: np.array(results[i]["way"])[:rows, 1:3] - goal_of(config, config.drone(i)) for i in config.ids}
    graph, worst = config.graph(), (0.0, (config.ids[0], config.ids[0]))
    for i, j in combinations(config.ids, 2):
        if j in graph.neighbors(i):
            worst = max(worst, (float(np.abs(left[i] - left[j]).max()), (i, j)))
    return worst


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """The ways, and how far each still had to go."""
    shown = {i: np.array(results[i]["way"]) for i in config.ids}
    left = {i: np.linalg.norm(rows[:, 1:3] - goal_of(config, config.drone(i)), axis=1) for i, rows in shown.items()}
    draw_ways(path, {i: results[i]["way"] for i in config.ids}, left, "still to go [m]", goal(config))
