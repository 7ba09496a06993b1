"""What missions with timed goals need: options, planned flights, checks, report."""

from collections.abc import Sequence
from itertools import combinations
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Id, SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import (
    Coordinate,
    given,
    require_each,
    require_none,
)
from crazychoir.guidance.mission_pictures import draw_heights
from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.path_checks import require_inside
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.goal import timed_goals
from crazychoir.planning.piecewise import Piecewise
from crazychoir.types import FullState, Vec

GOAL_TOLERANCE = 0.05
"""m: largest distance from a goal at its time."""
NEAR_FLIGHT_DISTANCE = 0.25
"""m: below this distance of two planned flights the collision filter must keep the drones apart."""

Row = tuple[Annotated[float, Meta(gt=0, le=3600)], Coordinate, Coordinate, Coordinate]
"""A goal: t s of the law, x, y, z m."""
Rows = Annotated[tuple[Row, ...], Meta(min_length=1)]
Goals = Annotated[
    dict[Id, Rows],
    Meta(
        min_length=1,
        description="a table of drone ids, each with one row [t, x, y, z] or more: s, above 0, and m, within 1000 m",
        examples=[{"0": [[5.0, 0.0, 1.0, 1.0]]}],
    ),
]


class GoalOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    goals: Goals | None = None
    """Rows [t s of the law, x, y, z m] of each drone, instead of the crossing."""


class GoalHooks:
    """The hooks of drones that must be at their goals at given times.

    options: the table of [mission_options].
    goals: rows [t s of the law, x, y, z m] of each drone, if the options have none.
    """

    def __init__(
        self, options: type[GoalOptions], goals: Sequence[tuple[Row, ...]]
    ) -> None:
        self.options = options
        self.default_goals = goals

    def goals(self, config: SwarmConfig) -> dict[int, tuple[Row, ...]]:
        """Return the rows t, x, y, z of each drone: those of the options, or the default."""
        rows = given(config, self.options).goals
        default = self.default_goals
        return rows or {i: default[k % len(default)] for k, i in enumerate(config.ids)}

    def times(self, i: int, config: SwarmConfig) -> list[float]:
        """Return the times of the goals of drone i, in s of the law."""
        return [row[0] for row in self.goals(config)[i]]

    def flight(self, i: int, config: SwarmConfig) -> Piecewise:
        """Return the flight from above the home to each goal at its time.

        Raises ConfigError if the flight is beyond the limits or the fence.
        """
        home = config.drone(i).home
        limits = config.flight
        start = FullState.at((*home[:2], limits.ground + limits.takeoff_height))
        rows = [[*row, 0.0] for row in self.goals(config)[i]]
        room = Limits(
            v_max=limits.speed_limit,
            a_max=limits.acceleration_limit,
            low=config.fence.min,
            high=config.fence.max,
        )
        try:
            path = timed_goals(start, np.array(rows), room)
            require_inside(path, config, i, "goals")
        except ConfigError as error:
            where = (
                f"swarm {config.name}: mission_options.goals: drone {i}: {error.where}"
            )
            raise ConfigError(where, error.found, error.allowed, error.do) from error
        return path

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that each drone has goals and can be there in time.

        Returns a warning if two flights meet and no collision filter keeps the drones apart.
        """
        require_none(config)
        count = len(self.default_goals)
        if not given(config, self.options).goals and len(config.ids) != count:
            raise ConfigError(
                f"swarm {config.name}: drones",
                len(config.ids),
                f"{count}, or mission_options.goals",
            )
        require_each(config, self.goals(config), "goals")
        gap, i, j, t = self.nearest(config)
        if gap >= NEAR_FLIGHT_DISTANCE or config.collision.method != "off":
            return []
        return [
            f"drones {i} and {j} are planned {gap:.2f} m from each other at {t:.1f} s, and the collision filter is off"
        ]

    def nearest(self, config: SwarmConfig) -> tuple[float, int, int, float]:
        """Return the smallest distance between two planned flights: (m, drone, drone, s of the law).

        The distance is infinite for a single drone.
        """
        flights = {i: self.flight(i, config) for i in config.ids}
        t = np.arange(0.0, max(path.duration for path in flights.values()), 0.05)
        p = {
            i: path.samples(np.minimum(t, path.duration))[:, 0:3]
            for i, path in flights.items()
        }
        worst = (float("inf"), config.ids[0], config.ids[0], 0.0)
        for i, j in combinations(config.ids, 2):
            gaps = np.linalg.norm(p[i] - p[j], axis=1)
            k = int(np.argmin(gaps))
            worst = min(worst, (float(gaps[k]), i, j, float(t[k])))
        return worst

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return the last goal of each drone."""
        return {i: np.array(rows[-1][1:]) for i, rows in self.goals(config).items()}

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report the distance of each drone from each of its goals at its time."""
        errors = {i: results.get(i, {}).get("mark_errors_m", []) for i in config.ids}
        goals = self.goals(config)
        reasons = {
            i: text for i in config.ids if (text := _explain_miss(errors[i], goals[i]))
        }
        return {
            "success": not reasons,
            "reasons": reasons,
            "goal_errors_m": {
                i: [round(error, 4) for error in row] for i, row in errors.items()
            },
            "tracking_rms_m": {
                i: results.get(i, {}).get("tracking_rms_m") for i in config.ids
            },
        }

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the paths from above, and their heights."""
        draw_heights(path, results, self.goal(config))


def _explain_miss(errors: list[float], rows: tuple[Row, ...]) -> str:
    """Return why a drone was not at its goals in time; "" if it was."""
    if len(errors) < len(rows):
        return f"its flight ended before its goal at {rows[len(errors)][0]:g} s"
    worst = int(np.argmax(errors))
    if errors[worst] <= GOAL_TOLERANCE:
        return ""
    return f"{errors[worst]:.3f} m from its goal at {rows[worst][0]:g} s, allowed {GOAL_TOLERANCE} m"
