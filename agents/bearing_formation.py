"""Bearing formation: leaders stand still, followers take their places by bearings to their neighbours alone.

crazychoir run bearing_formation --fast
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from crazychoir import CFDistributedFeedback, SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.bearing import KP, KV, check_formation
from crazychoir.math3d import projector
from crazychoir.swarm.graph import span
from crazychoir.swarm.tables import Drone
from crazychoir.types import Acceleration, Heard, Point, State, Vec

Shape = Mapping[int, Point]
Results = dict[int, dict[str, Any]]

SQUARE = {0: (0.0, 0.0, 1.0), 1: (1.0, 0.0, 1.0), 2: (1.0, 1.0, 1.0), 3: (0.0, 1.0, 1.0)}
EDGES = [[0, 1], [0, 3], [1, 2], [1, 3], [2, 3]]
LEADERS = (0, 1)
TOLERANCE = 0.01
"""m from its place at the end of the law: a drone that is farther away has not formed up."""


class BearingFormation(CFDistributedFeedback):
    """Follower: u_i = - sum_j P_ij [ kp (p_i - p_j) + kv (v_i - v_j) ],  P_ij = I - g_ij g_ij^T.

    shape: {id: (3,) m}, where the bearings g_ij come from;  neighbors: those that i hears;  kp: 1/s2;  kv: 1/s.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3).
    """

    def __init__(
        self, i: int, shape: Shape, neighbors: Iterable[int], leader: bool, kp: float = KP, kv: float = KV
    ) -> None:
        self.leader, self.neighbors = leader, tuple(neighbors)
        # The law as one product, u = K (x_i, x_j, x_k, ...), with states x (13,) of which p and v count.
        blocks = [np.kron([kp, kv], projector(np.subtract(shape[j], shape[i]))) for j in self.neighbors]
        self.K = np.hstack([np.pad(block, ((0, 0), (0, 7))) for block in (-sum(blocks), *blocks)])

    def step(self, me: State, heard: Heard) -> Acceleration | None:
        """The follower's law; a leader hovers, and so does who does not hear all its neighbours."""
        if self.leader or len(heard) < len(self.neighbors):
            return None
        states = [me.flat]
        for j in self.neighbors:
            states.append(heard[j].flat)
        return Acceleration(self.K.dot(np.concatenate(states)))


def guidance(i: int, config: SwarmConfig) -> BearingFormation:
    """The law of drone i."""
    drone, options = config.drone(i), config.mission_options
    law = BearingFormation(
        i, shape(config), config.graph().neighbors(i), drone.leader, options.get("kp", KP), options.get("kv", KV)
    )
    law.duration = options.get("duration", 20.0)
    return law


def shape(config: SwarmConfig) -> Shape:
    """{id: (3,) m}: from the mission options; else the square for four drones, for others their homes."""
    given = config.mission_options.get("shape")
    if given is None:
        return SQUARE if config.ids == tuple(SQUARE) else {drone.id: drone.home for drone in config.drones}
    found = {int(i): (float(p[0]), float(p[1]), float(p[2])) for i, p in given.items()}
    if tuple(sorted(found)) != config.ids:
        raise ConfigError("mission_options.shape", sorted(found), f"a corner of each drone, {span(config.ids)}")
    return found


def swarm(drones: int | None = None) -> SwarmConfig:
    """The paper's example: the followers start 0.5 to 1 m away from their corners, drawn from the swarm's seed."""
    return SwarmConfig.of(
        {
            "name": "bearing",
            "mission": "bearing_formation",
            "edges": EDGES,
            "drones": [{"id": i, "home": [*SQUARE[i][:2], 0.0], "leader": i in LEADERS} for i in SQUARE],
            "plant": {"rate_lag": 0.0, "command_delay": 0.0},
        }
    )


def scatter(config: SwarmConfig) -> SwarmConfig:
    """The same swarm with its followers' homes moved at random, 0.5 to 1 m, clear of the others."""
    draw = np.random.default_rng(config.seed)
    homes = {drone.id: np.array(drone.home) for drone in config.drones}
    for drone in config.drones:
        if not drone.leader:
            homes[drone.id] = _clear_place(draw, drone.id, homes)
    drones = [{**_plain(drone), "home": homes[drone.id].tolist()} for drone in config.drones]
    return config.replace(drones=drones)


def goal(config: SwarmConfig) -> dict[int, Vec]:
    """Where the shape is when the leaders stand on theirs: scaled as their distance is."""
    corners = {i: np.array(p) for i, p in shape(config).items()}
    leaders = [drone for drone in config.drones if drone.leader]
    height = config.flight.ground + config.flight.takeoff_height
    a, b = leaders[0], leaders[1]
    flown = np.subtract(b.home, a.home)
    scale = np.linalg.norm(flown) / np.linalg.norm(corners[b.id] - corners[a.id])
    start = np.array([a.home[0], a.home[1], height])
    return {i: start + scale * (corner - corners[a.id]) for i, corner in corners.items()}


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """Refuses a graph on which the shape is not held by its bearings, or which needs minutes."""
    options, graph = config.mission_options, config.graph()
    leaders = [drone.id for drone in config.drones if drone.leader]
    neighbors = {i: graph.in_neighbors(i) for i in graph.ids}
    corners = {i: p for i, p in shape(config).items() if i in graph.ids}
    report = check_formation(corners, neighbors, leaders, options.get("kp", KP), options.get("kv", KV), force=force)
    return list(report.warnings)


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """Every drone is in its place at the end of the law, by its own estimate; who is not, or did not hear, is named."""
    goals, reasons = goal(config), {}
    for i, result in results.items():
        far = float(np.linalg.norm(goals[i] - result["place"])) if "place" in result else 0.0
        if far > TOLERANCE:
            reasons[i] = f"{far:.3f} m from its place at the end of the law, allowed {TOLERANCE} m{_deaf(result)}"
    return {"success": not reasons, "reasons": reasons}


def _deaf(result: dict[str, Any]) -> str:
    unheard = ", ".join(f"drone {j} for {seconds:.2f} s" for j, seconds in result["unheard_s"].items())
    return f"; did not hear {unheard}" if unheard else ""


def _clear_place(draw: np.random.Generator, i: int, homes: dict[int, Vec]) -> Vec:
    while True:
        angle, far = draw.uniform(0.0, 2.0 * np.pi), draw.uniform(0.5, 1.0)
        place: Vec = homes[i] + far * np.array([np.cos(angle), np.sin(angle), 0.0])
        if all(np.linalg.norm(place - p) > 0.4 for j, p in homes.items() if j != i):
            return place


def _plain(drone: Drone) -> dict[str, object]:
    return {"id": drone.id, "leader": drone.leader, "yaw": drone.yaw, "uri": drone.uri, "platform": drone.platform}
