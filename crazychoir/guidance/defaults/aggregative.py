"""What the surveillance mission needs beside its law: options, its own swarm, checks, report."""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from crazychoir.config.drone_room import room_of
from crazychoir.config.flight_room import room_text
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Hertz, Share, SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.guidance.aggregative import Defence
from crazychoir.guidance.mission_options import (
    Duration,
    Period,
    Spot,
    Spots,
    given,
    require_none,
)
from crazychoir.guidance.mission_pictures import draw_ways
from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.path_checks import require_inside
from crazychoir.guidance.timed import TIMED_FLIGHT_LIMITS
from crazychoir.planning.feasibility import Limits
from crazychoir.planning.goal import timed_goals
from crazychoir.planning.piecewise import Piecewise
from crazychoir.team.graph import Graph
from crazychoir.types import FullState, Mat, Vec

INTRUDER_ROLE = "intruder"
"""`role` of an intruder."""
STANDING_INTRUDERS = ((-1.0, 1.0), (-1.0, -1.0), (1.0, 0.0))
"""(2,) m each: default places of intruders that stand still."""
DEFENDER_HOMES = ((0.2, 1.2), (-1.2, -1.0), (1.2, -0.8))
"""(2,) m each: homes of the defenders."""
DEFENDER_TOLERANCE = 0.02
"""m: largest distance from a defender's place at the end, when the intruders stand."""
LARGEST_DELAY = 1.5
"""s: largest delay of a defender behind a moving optimum."""
TRANSIENT_TIME = 4.0
"""s of the law in which the team converges; this time does not count for the delay."""

Weight = Annotated[float, Meta(ge=0, le=1000)]
Weights = Annotated[
    tuple[Weight, Weight, Weight],
    Meta(
        description="weights [intruder, target, team], each 0 to 1000",
        examples=[[1.0, 1.0, 1.0]],
    ),
]
Legs = Annotated[
    int, Meta(ge=1, le=100, description="a number of legs, 1 to 100", examples=[3])
]


class DefenceOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    target: Spot = (0.0, 0.0)
    """(2,) m."""
    intruders: Spots = STANDING_INTRUDERS
    """(2,) m each: places of the intruders that stand still."""
    weights: Weights = (1.0, 1.0, 1.0)
    """Weights of intruder, target and team."""
    step_size: Share = 0.05
    """Step size of the aggregative tracking."""
    round_rate: Hertz = 20.0
    """Hz: rounds a second."""
    duration: Duration = 12.0
    """s: duration of the law, if the intruders stand still."""
    leg: Period = 15.0
    """s: time of an intruder from its home to the next intruder's home."""
    legs: Legs = 3
    """Number of legs that an intruder flies."""


class DefenceHooks:
    """The hooks of a team of defenders, each with an intruder that stands still or flies.

    options: the table of [mission_options].
    """

    def __init__(self, options: type[DefenceOptions]) -> None:
        self.options = options

    def given(self, config: SwarmConfig) -> DefenceOptions:
        """Return [mission_options]. Raises ConfigError with the key that is wrong."""
        return given(config, self.options)

    def defence(self, config: SwarmConfig) -> Defence:
        """Return the cost of a defender."""
        options = self.given(config)
        return Defence(np.array(options.target), *options.weights)

    def intruder(self, i: int, config: SwarmConfig) -> int | Vec:
        """Return the intruder of defender i: its id, or its place (2,) m if it stands still."""
        k = list_defenders(config).index(i)
        flying = list_intruders(config)
        return flying[k] if flying else np.array(self.given(config).intruders[k])

    def duration(self, config: SwarmConfig) -> float:
        """Return the duration of the law in s.

        It lasts until flying intruders have stood still for a while.
        """
        options = self.given(config)
        if not list_intruders(config):
            return options.duration
        return options.legs * options.leg + 4.0 + TIMED_FLIGHT_LIMITS.rest_time

    def path(self, i: int, config: SwarmConfig) -> Piecewise:
        """Return the legs of an intruder: from its home to the next intruder's home, and on.

        Raises ConfigError if it cannot be flown.
        """
        options = self.given(config)
        flight = config.flight
        team = list_intruders(config)
        z = flight.ground + flight.takeoff_height
        k = team.index(i)
        places = [
            [*config.drone(team[(k + n) % len(team)]).home[:2], z]
            for n in range(options.legs + 1)
        ]
        goals = [[options.leg * n, *places[n], 0.0] for n in range(1, options.legs + 1)]
        limits = Limits(
            v_max=flight.speed_limit,
            a_max=flight.acceleration_limit,
            low=config.fence.min,
            high=config.fence.max,
        )
        path = timed_goals(FullState.at(places[0]), np.array(goals), limits)
        require_inside(path, config, i, f"swarm {config.name}: drone {i}")
        return path

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return three defenders in a path graph, with three intruders that stand still."""
        return SwarmConfig.of(
            {
                "name": "defence",
                "mission": "aggregative",
                "graph": "path",
                "drones": [
                    {"id": i, "home": [*home, 0.0]}
                    for i, home in enumerate(DEFENDER_HOMES)
                ],
            }
        )

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that each defender has an intruder, and hears it if it flies.

        The defenders must be connected without the intruders.
        Raises ConfigError if not.
        """
        options = self.given(config)
        flying = list_intruders(config)
        require_none(config)
        self._require_intruders(config)
        _require_graph(config)
        intruder, target, together = options.weights
        if min(intruder + target, intruder + together) <= 0.0:
            allowed = "intruder + target above 0 and intruder + team above 0: else there is no one optimum"
            raise ConfigError(
                f"swarm {config.name}: mission_options.weights",
                list(options.weights),
                allowed,
            )
        for j in flying:
            self.path(j, config)
        if not flying:
            _require_room(config, self.goal(config))
        return []

    def _require_intruders(self, config: SwarmConfig) -> None:
        """Raise ConfigError unless there are as many intruders as defenders."""
        flying = list_intruders(config)
        team = list_defenders(config)
        count = len(flying) if flying else len(self.given(config).intruders)
        if count != len(team):
            what = (
                'drones with role = "intruder"'
                if flying
                else "places in mission_options.intruders"
            )
            raise ConfigError(
                f"swarm {config.name}: intruders",
                f"{count} {what}",
                f"{len(team)}: one for each defender",
            )

    def goal(self, config: SwarmConfig) -> dict[int, Vec]:
        """Return the places of the defenders at the optimum; {} if the intruders fly."""
        options = self.given(config)
        team = list_defenders(config)
        if list_intruders(config) or len(options.intruders) != len(team):
            return {}
        best = self.defence(config).optimum(np.array(options.intruders))
        height = config.flight.ground + config.flight.takeoff_height
        return {i: np.array([*p, height]) for i, p in zip(team, best, strict=True)}

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report the defenders' distance from the optimum and their delay.

        The distance is that at the end and on the way.
        """
        team = list_defenders(config)
        if away := [i for i in team if "way" not in results.get(i, {})]:
            return {
                "success": False,
                "reasons": dict.fromkeys(away, "it has not defended to the end"),
            }
        t, flown, wanted = self.ways(config, results)
        far = np.linalg.norm(flown - wanted, axis=2)
        moving = t > TRANSIENT_TIME
        moves = (
            bool(moving.any())
            and float(np.ptp(wanted[moving], axis=0).max()) > DEFENDER_TOLERANCE
        )
        late = compute_lag(t, flown, wanted) if moves else 0.0
        reasons = {
            i: f"{end:.3f} m from its place between intruder and target at the end, allowed {DEFENDER_TOLERANCE} m"
            for i, end in zip(team, far[-1].tolist(), strict=True)
            if end > DEFENDER_TOLERANCE
        }
        if late > LARGEST_DELAY:
            reasons[team[0]] = (
                f"the defenders follow {late:.2f} s late, allowed {LARGEST_DELAY} s"
            )
        found = {
            "success": not reasons,
            "reasons": reasons,
            "places": _round_places(team, flown[-1]),
            "optimum": _round_places(team, wanted[-1]),
            "final_error_m": float(far[-1].max()),
            "rounds_made": min(results[i]["rounds"] for i in team),
        }
        if moves:
            found["lag_s"] = late
            found["following_rms_m"] = float(np.sqrt(np.mean(far[moving] ** 2)))
        return found

    def ways(self, config: SwarmConfig, results: Results) -> tuple[Vec, Mat, Mat]:
        """Return the flown and the optimal places over time.

        Returns times (T,) s of the law.
        Returns places of the defenders, (T, N, 2) m.
        Returns places at the optimum of each time, (T, N, 2) m.
        """
        team = list_defenders(config)
        rows = min(
            min(len(results[i]["way"]), len(results[i]["intruder_way"])) for i in team
        )
        flown = np.array([np.array(results[i]["way"])[:rows, 1:3] for i in team])
        seen = np.array(
            [np.array(results[i]["intruder_way"])[:rows, 1:3] for i in team]
        )
        defence = self.defence(config)
        wanted = np.array([defence.optimum(seen[:, k]) for k in range(rows)])
        t = np.array(results[team[0]]["way"])[:rows, 0]
        return t, flown.swapaxes(0, 1), wanted

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the paths of the defenders and their intruders, and the distances from the optimum."""
        team = list_defenders(config)
        t, flown, wanted = self.ways(config, results)
        far = np.linalg.norm(flown - wanted, axis=2).T
        draw_ways(
            path,
            {i: results[i]["way"][: len(t)] for i in team},
            dict(zip(team, far, strict=True)),
            "distance from the optimum [m]",
            dict(zip(team, wanted[-1], strict=True)),
            {i: results[i]["intruder_way"] for i in team},
            self.given(config).target,
        )


def list_defenders(config: SwarmConfig) -> list[int]:
    """Return the ids of all drones but the intruders."""
    return [i for i in config.ids if config.drone(i).role != INTRUDER_ROLE]


def list_intruders(config: SwarmConfig) -> list[int]:
    """Return the ids of the intruders that fly."""
    return [i for i in config.ids if config.drone(i).role == INTRUDER_ROLE]


def build_defender_graph(config: SwarmConfig) -> Graph:
    """Return the graph of the defenders alone."""
    team = list_defenders(config)
    return Graph.from_edges(
        team, [(a, b) for a, b in config.graph().edges() if a in team and b in team]
    )


def compute_lag(t: Vec, flown: Mat, wanted: Mat) -> float:
    """Return the delay in s of `flown` after the transient.

    It is the shift of `wanted` that fits `flown` best.

    t: (T,) s.
    flown: (T, N, 2) m.
    wanted: (T, N, 2) m.
    """
    shifts = np.arange(0.0, 3.0, 0.02)
    inner = t > TRANSIENT_TIME
    series = wanted.reshape(len(t), -1).T

    def misfit(shift: float) -> float:
        moved = np.array([np.interp(t[inner] - shift, t, row) for row in series]).T
        return float(np.sum((flown.reshape(len(t), -1)[inner] - moved) ** 2))

    return float(shifts[np.argmin([misfit(shift) for shift in shifts])])


def _require_graph(config: SwarmConfig) -> None:
    """Raise ConfigError unless the defenders are connected, and hear the intruders that fly."""
    where = f"swarm {config.name}: graph"
    graph = config.graph()
    team = list_defenders(config)
    if not graph.is_undirected or not build_defender_graph(config).is_connected:
        found = (
            "a directed graph"
            if not graph.is_undirected
            else f"defenders {team} are not connected by themselves"
        )
        allowed = "an undirected graph that joins all defenders"
        raise ConfigError(where, found, allowed, "Add an edge.")
    for i, j in zip(team, list_intruders(config), strict=False):
        if j not in graph.in_neighbors(i):
            raise ConfigError(
                where,
                f"no edge {i}-{j}",
                "defenders hear their intruders",
                f"Add the edge [{i}, {j}].",
            )


def _require_room(config: SwarmConfig, places: dict[int, Vec]) -> None:
    """Raise ConfigError for a place that is outside the room of its drone."""
    for i, p in places.items():
        low, high = room_of(config, i)
        if not (np.all(p >= low) and np.all(p <= high)):
            raise ConfigError(
                f"swarm {config.name}: mission_options",
                f"drone {i} would end at {np.round(p, 2).tolist()}",
                room_text(low, high),
                "Move target or intruders, or widen [fence].",
            )


def _round_places(ids: list[int], places: Mat) -> dict[int, list[float]]:
    return {i: np.round(p, 3).tolist() for i, p in zip(ids, places, strict=True)}
