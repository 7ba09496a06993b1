"""Timed goals: each drone must be at its goals at given times.

By default four drones cross a square along its diagonals, at the same height and the same time. The
collision filter guides them around each other.

crazychoir run goto --fast --picture out/goto.png
"""

from itertools import combinations
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.config.tables import Id, SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import (
    Coordinate,
    given,
    require_each,
    require_none,
)
from crazychoir.guidance.path_checks import require_inside
from crazychoir.guidance.timed import TimedFlight
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.goal import timed_goals
from crazychoir.planning.piecewise import Piecewise
from crazychoir.recording.analysis.tracks import draw_ways
from crazychoir.types import FullState, Vec

Results = dict[int, dict[str, Any]]
"""The results of all drones, by id."""
SQUARE_CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
"""(2,) m each: corners of the square."""
CORNER_TIMES = (5.0, 25.0, 45.0)
"""s of the law at which a drone is at its own corner, at the opposite one, and at the next."""
CROSSING_HEIGHT = 1.0
"""m: height of the crossing."""
START_SCALE = 0.8
"""Scale from the corners to the places where the drones start."""
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


class Options(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    goals: Goals | None = None
    """Rows [t s of the law, x, y, z m] of each drone, instead of the crossing."""


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i."""
    return TimedFlight(flight(i, config), [row[0] for row in goals(config)[i]])


def flight(i: int, config: SwarmConfig) -> Piecewise:
    """Return the flight from above the home to each goal at its time.

    Raises ConfigError if the flight is beyond the limits or the fence.
    """
    home = config.drone(i).home
    limits = config.flight
    start = FullState.at((*home[:2], limits.ground + limits.takeoff_height))
    rows = [[*row, 0.0] for row in goals(config)[i]]
    room = Limits(
        v_max=limits.speed_limit,
        a_max=limits.acceleration_limit,
        low=config.fence.min,
        high=config.fence.max,
    )
    try:
        way = timed_goals(start, np.array(rows), room)
        require_inside(way, config, i, "goals")
    except ConfigError as error:
        where = f"swarm {config.name}: mission_options.goals: drone {i}: {error.where}"
        raise ConfigError(where, error.found, error.allowed, error.do) from error
    return way


def goals(config: SwarmConfig) -> dict[int, tuple[Row, ...]]:
    """Return the rows t, x, y, z of each drone: those of the options, or the crossing."""
    rows = given(config, Options).goals
    return rows or {i: crossing(k) for k, i in enumerate(config.ids)}


def crossing(k: int) -> tuple[Row, ...]:
    """Return the goals of the k-th drone: its own corner, the opposite one, and the next."""
    corners = [SQUARE_CORNERS[(k + turn) % len(SQUARE_CORNERS)] for turn in (0, 2, 3)]
    return tuple(
        (t, *corner, CROSSING_HEIGHT)
        for t, corner in zip(CORNER_TIMES, corners, strict=True)
    )


def swarm(drones: int | None = None) -> SwarmConfig:
    """Return four drones, each slightly inside its corner."""
    return SwarmConfig.of(
        {
            "name": "crossing",
            "mission": "goto",
            "drones": [
                {"id": i, "home": [START_SCALE * x, START_SCALE * y, 0.0]}
                for i, (x, y) in enumerate(SQUARE_CORNERS)
            ],
            "flight": {"takeoff_height": 0.5},
            "fence": {"min": [-2.0, -2.0, 0.0], "max": [2.0, 2.0, 2.5]},
        }
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Check that each drone has goals and can be there in time.

    Returns a warning if two flights meet and no collision filter keeps the drones apart.
    """
    require_none(config)
    if not given(config, Options).goals and len(config.ids) != len(SQUARE_CORNERS):
        raise ConfigError(
            f"swarm {config.name}: drones",
            len(config.ids),
            f"{len(SQUARE_CORNERS)}, or mission_options.goals",
        )
    require_each(config, goals(config), "goals")
    gap, i, j, t = nearest(config)
    if gap >= NEAR_FLIGHT_DISTANCE or config.collision.method != "off":
        return []
    return [
        f"drones {i} and {j} are planned {gap:.2f} m from each other at {t:.1f} s, and the collision filter is off"
    ]


def nearest(config: SwarmConfig) -> tuple[float, int, int, float]:
    """Return the smallest distance between two planned flights: (m, drone, drone, s of the law).

    The distance is infinite for a single drone.
    """
    flights = {i: flight(i, config) for i in config.ids}
    t = np.arange(0.0, max(way.duration for way in flights.values()), 0.05)
    p = {
        i: way.samples(np.minimum(t, way.duration))[:, 0:3]
        for i, way in flights.items()
    }
    worst = (float("inf"), config.ids[0], config.ids[0], 0.0)
    for i, j in combinations(config.ids, 2):
        gaps = np.linalg.norm(p[i] - p[j], axis=1)
        k = int(np.argmin(gaps))
        worst = min(worst, (float(gaps[k]), i, j, float(t[k])))
    return worst


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Return the last goal of each drone."""
    return {i: np.array(rows[-1][1:]) for i, rows in goals(config).items()}


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Report the distance of each drone from each of its goals at its time."""
    errors = {i: results.get(i, {}).get("mark_errors_m", []) for i in config.ids}
    reasons = {
        i: text for i in config.ids if (text := _late(errors[i], goals(config)[i]))
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


def _late(errors: list[float], rows: tuple[Row, ...]) -> str:
    if len(errors) < len(rows):
        return f"its flight ended before its goal at {rows[len(errors)][0]:g} s"
    worst = int(np.argmax(errors))
    if errors[worst] <= GOAL_TOLERANCE:
        return ""
    return f"{errors[worst]:.3f} m from its goal at {rows[worst][0]:g} s, allowed {GOAL_TOLERANCE} m"


def picture(config: SwarmConfig, results: Results, path: str) -> None:
    """Draw the paths from above, and their heights."""
    heights = {i: np.array(results[i]["way"])[:, 3] for i in config.ids}
    draw_ways(
        path, {i: results[i]["way"] for i in config.ids}, heights, "z [m]", goal(config)
    )
