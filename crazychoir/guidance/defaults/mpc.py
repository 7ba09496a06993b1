"""What the predictive-control mission needs beside its law: options, its own swarm, checks, report."""

from itertools import combinations
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir.config.drone_room import room_of
from crazychoir.config.flight_room import room_text
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Acceleration, DroneTable, Speed, SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import Duration, Spot, given, own
from crazychoir.guidance.mission_pictures import draw_ways
from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.mpc import Motion
from crazychoir.types import Vec

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


class MPCOptions(SwarmTable, frozen=True, kw_only=True):
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


class MPCDroneOptions(SwarmTable, frozen=True, kw_only=True):
    """`options` of a drone."""

    speed: Speed | None = None
    """m/s: largest, in x and in y, instead of that of the mission."""
    goal: Spot | None = None
    """(2,) m: instead of home + shift."""


class MPCHooks:
    """The hooks of a team that moves by model predictive control, each drone to its goal.

    options: the table of [mission_options].
    drone_options: the table of the `options` of a drone.
    """

    def __init__(
        self,
        options: type[MPCOptions],
        drone_options: type[MPCDroneOptions] = MPCDroneOptions,
    ) -> None:
        self.options = options
        self.drone_options = drone_options

    def given(self, config: SwarmConfig) -> MPCOptions:
        """Return [mission_options]. Raises ConfigError with the key that is wrong."""
        return given(config, self.options)

    def motion(self, config: SwarmConfig, drone: DroneTable) -> Motion:
        """Return how a drone may move."""
        options = self.given(config)
        return Motion(
            options.step,
            options.horizon,
            own(config, drone, self.drone_options).speed or options.speed,
            options.acceleration,
            options.jerk,
        )

    def goal_of(self, config: SwarmConfig, drone: DroneTable) -> Vec:
        """Return the goal of a drone, (2,) m."""
        goal = own(config, drone, self.drone_options).goal
        if goal is not None:
            return np.array(goal)
        return np.add(drone.home[:2], self.given(config).shift)

    def planned_reach(self, config: SwarmConfig) -> float:
        """Return the `reach` of plans in m: that of the options less a margin."""
        return self.given(config).reach - REACH_MARGIN

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return four drones in a row, each linked to the next. The third drone is slow."""
        n = 4 if drones is None else drones
        rows: list[dict[str, Any]] = [
            {"id": i, "home": [-1.5, round(0.6 * (i - 0.5 * (n - 1)), 3), 0.0]}
            for i in range(n)
        ]
        for row in rows[2:3]:
            row["options"] = {"speed": SLOW_DRONE_SPEED}
        return SwarmConfig.of(
            {
                "name": "row",
                "mission": "mpc",
                "graph": "path" if n > 1 else "empty",
                "drones": rows,
                "fence": {
                    "min": [-3.0, -0.3 * n - 2.0, 0.0],
                    "max": [3.0, 0.3 * n + 2.0, 2.5],
                },
            }
        )

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that the problem is feasible at the start of the drones.

        They start at rest. Goals must lie in the fence, and neighbours within `reach`.
        Raises ConfigError if not.
        """
        self.given(config)
        graph = config.graph()
        if not graph.is_undirected or not graph.is_connected:
            raise ConfigError(
                f"swarm {config.name}: graph",
                "one-way or in parts",
                "undirected and connected",
                "Add an edge.",
            )
        for drone in config.drones:
            self._require_possible(config, drone)
        self._require_near(config)
        return []

    def _require_possible(self, config: SwarmConfig, drone: DroneTable) -> None:
        """Raise ConfigError for a goal outside the fence, and for a speed above [flight]."""
        where = f"swarm {config.name}: drone {drone.id}"
        low, high = room_of(config, drone.id)
        place = self.goal_of(config, drone)
        if np.any(place < low[:2]) or np.any(place > high[:2]):
            raise ConfigError(
                f"{where}: goal",
                place.tolist(),
                room_text(low, high),
                "Change mission_options.shift, or widen [fence].",
            )
        speed = self.motion(config, drone).speed
        most = config.flight.speed_limit / 2**0.5
        if speed > most:
            allowed = f"at most {most:.2f} m/s: flight.speed_limit on a diagonal"
            raise ConfigError(f"{where}: speed", speed, allowed)

    def _require_near(self, config: SwarmConfig) -> None:
        """Raise ConfigError for neighbours that are too far ahead of each other before they start."""
        reach = self.planned_reach(config)
        left = {
            drone.id: self.goal_of(config, drone) - drone.home[:2]
            for drone in config.drones
        }
        for i, j in config.graph().edges():
            ahead = float(np.abs(left[i] - left[j]).max())
            if ahead > reach:
                raise ConfigError(
                    f"swarm {config.name}: drone {i}: goal",
                    f"{ahead:.2f} m more or less to go than drone {j}, in x or in y",
                    f"at most {reach:.2f} m: mission_options.reach less {REACH_MARGIN} m",
                    "Move goals or homes, or raise mission_options.reach: the plans are infeasible at the start.",
                )

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return the goals."""
        height = config.flight.ground + config.flight.takeoff_height
        return {
            drone.id: np.array([*self.goal_of(config, drone), height])
            for drone in config.drones
        }

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report whether all drones are at their goals, and the largest lead over a neighbour."""
        goals = self.goal(config)
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
        ahead, pair = self.most_ahead(config, results)
        reach = self.given(config).reach
        if ahead > reach:
            reasons[pair[0]] = (
                f"{ahead:.3f} m ahead of or behind drone {pair[1]}, allowed {reach} m"
            )
        counts = {
            name: {i: results[i][name] for i in config.ids}
            for name in ("solved", "loosened", "kept", "infeasible")
        }
        return {
            "success": not reasons,
            "reasons": reasons,
            "reach_m": reach,
            "most_ahead_m": ahead,
            **counts,
        }

    def most_ahead(
        self, config: SwarmConfig, results: Results
    ) -> tuple[float, tuple[int, int]]:
        """Return the largest distance by which a drone was ahead of a neighbour, and the two drones.

        The distance is in m, in x or in y.
        """
        rows = min(len(results[i]["way"]) for i in config.ids)
        left = {
            i: np.array(results[i]["way"])[:rows, 1:3]
            - self.goal_of(config, config.drone(i))
            for i in config.ids
        }
        graph = config.graph()
        worst = (0.0, (config.ids[0], config.ids[0]))
        for i, j in combinations(config.ids, 2):
            if j in graph.neighbors(i):
                worst = max(worst, (float(np.abs(left[i] - left[j]).max()), (i, j)))
        return worst

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the paths, and how far each drone still had to go."""
        left = {}
        for i in config.ids:
            places = np.array(results[i]["way"])[:, 1:3]
            goal = self.goal_of(config, config.drone(i))
            left[i] = np.linalg.norm(places - goal, axis=1)
        draw_ways(
            path,
            {i: results[i]["way"] for i in config.ids},
            left,
            "still to go [m]",
            self.goal(config),
        )
