"""The swarms of `crazychoir bench flight`: a lattice with diagonals, and a ring."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.margin import Plant
from crazychoir.guidance.formation import shapes
from crazychoir.guidance.formation.shapes import Shape

SwarmShape = Literal["lattice", "ring"]
"""A lattice with diagonals, or a ring."""
LawText = Literal["shipped", "python"]
"""The bearing law that ships, or the same law as a user writes it."""
CollisionMethod = Literal["barrier", "cells", "off"]
"""How the drones keep clear of each other."""
FLIGHT_URIS: dict[Plant, str] = {
    "lightweight": WORLD_URIS.lightweight,
    "motors": WORLD_URIS.motor_level,
}
"""The uri of the drones, by engine."""
FLIGHT_PLATFORMS: dict[Plant, str] = {"lightweight": "paper", "motors": "cf21"}
"""Platform of the drones, by engine."""


@dataclass(frozen=True, slots=True)
class BenchSwarmSettings:
    """Places and leaders of the swarms of a benchmark."""

    spacing: float = 0.7
    """Distance between neighbours beside each other, m."""
    height: float = 0.5
    """Height of the formation above the floor, m; a take-off to it is short."""
    fence_distance: float = 2.0
    """Distance between the formation and the sides of the fence, m."""
    fence_height: float = 3.0
    """Height of the fence, m."""
    leader_interval: int = 5
    """Drones from one leader to the next along the border of the lattice.

    With leaders at the corners alone a lattice of 1000 drones decays at 0.03 1/s only, just above
    the least rate that flies without force.
    """


BENCH_SWARMS = BenchSwarmSettings()


@dataclass(frozen=True, slots=True)
class FlightCase:
    """One row of the benchmark: a swarm, its engine, its law, and the measured windows."""

    drones: int
    """Number of drones."""
    shape: SwarmShape = "lattice"
    """Shape of the formation."""
    plant: Plant = "lightweight"
    """Simulated engine."""
    law: LawText = "shipped"
    """Law of the followers."""
    collision: CollisionMethod = "barrier"
    """How the drones keep clear of each other."""
    window: float = 1.0
    """Length of one measurement, s of virtual time."""

    def describe(self) -> str:
        """Return the case in words."""
        parts = [f"{self.drones} drones", self.shape, self.plant]
        parts += ["law in Python"] if self.law == "python" else []
        parts += [f"collision {self.collision}"] if self.collision != "barrier" else []
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class BenchFormation:
    """Places, edges and leaders of a formation."""

    places: Shape
    """{id: (3,) m}."""
    edges: list[list[int]]
    """Pairs of ids that hear each other."""
    leaders: tuple[int, ...]
    """Ids of the drones that stand still."""


def build_formation(shape: SwarmShape, drones: int) -> BenchFormation:
    """Return the formation of this shape with this number of drones."""
    return build_ring(drones) if shape == "ring" else build_lattice(drones)


def build_lattice(drones: int) -> BenchFormation:
    """Return a grid that is as square as possible, row by row; the last row may be shorter.

    Each drone hears the drones beside it and on both diagonals, at most eight. The leaders are the
    drones at the four corners, and every fifth drone along the border. With them the graph is
    bearing-rigid, and the slowest mode of the normalised law decays much faster than 0.02 1/s, for
    5 to 1000 drones.
    """
    columns = math.ceil(math.sqrt(drones))
    rows = math.ceil(drones / columns)
    grid = shapes.grid(columns, rows, BENCH_SWARMS.spacing, BENCH_SWARMS.height)
    return BenchFormation(
        {i: place for i, place in grid.items() if i < drones},
        [edge for edge in shapes.grid_edges(columns, rows) if max(edge) < drones],
        tuple(i for i in range(drones) if _leads(i, columns, rows, drones)),
    )


def _leads(i: int, columns: int, rows: int, drones: int) -> bool:
    """Return whether drone i of a lattice leads."""
    row, column = divmod(i, columns)
    last_column = columns - 1
    last_row = rows - 1
    is_corner = row in (0, last_row) and column in (0, last_column)
    if is_corner or i == drones - 1:
        return True
    if row in (0, last_row):
        return column % BENCH_SWARMS.leader_interval == 0
    if column in (0, last_column):
        return row % BENCH_SWARMS.leader_interval == 0
    return False


def build_ring(drones: int) -> BenchFormation:
    """Return the corners of a regular polygon around the origin.

    Each drone hears its two neighbours, and two opposite drones lead. A large ring is
    ill-conditioned: the bearings of a drone's two neighbours are almost parallel, so the law
    amplifies the noise of the cameras by n^2.
    """
    corners = shapes.polygon(drones, BENCH_SWARMS.spacing)
    return BenchFormation(
        {i: (x, y, BENCH_SWARMS.height) for i, (x, y) in enumerate(corners.tolist())},
        [[i, (i + 1) % drones] for i in range(drones)],
        (0, drones // 2),
    )


def build_bench_swarm(case: FlightCase, duration: float) -> SwarmConfig:
    """Return the swarm of a case.

    The drones take off into the formation, so the law only has to hold it against the noise of the
    cameras.

    duration: s of the law
    """
    formation = build_formation(case.shape, case.drones)
    return SwarmConfig.of(
        {
            "name": f"{case.shape}{case.drones}",
            "mission": "bearing_formation",
            "mission_options": {
                "shape": {str(i): list(p) for i, p in formation.places.items()},
                "duration": duration,
            },
            "seed": 1,
            "edges": formation.edges,
            "drones": [
                {
                    "id": i,
                    "home": [*place[:2], 0.0],
                    "leader": i in formation.leaders,
                    "uri": FLIGHT_URIS[case.plant],
                    "platform": FLIGHT_PLATFORMS[case.plant],
                }
                for i, place in formation.places.items()
            ],
            "flight": {"takeoff_height": BENCH_SWARMS.height},
            # So all drones are ready at once, and what is measured is flight.
            "mocap": {"tilt_spread": 0.0},
            "collision": {"method": case.collision},
            "fence": _build_fence(formation.places),
        },
        "bench flight",
    )


def _build_fence(places: Shape) -> dict[str, Any]:
    """Return a fence around the places, from the floor up."""
    away = BENCH_SWARMS.fence_distance
    x, y, _ = zip(*places.values(), strict=True)
    return {
        "min": [min(x) - away, min(y) - away, 0.0],
        "max": [max(x) + away, max(y) + away, BENCH_SWARMS.fence_height],
    }
