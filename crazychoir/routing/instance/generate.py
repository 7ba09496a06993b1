"""Random instances, each determined by its arguments and its seed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.routing.instance.instance import Instance
from crazychoir.types import Ints, Mat

PLACEMENT_ATTEMPTS = 10_000
"""Attempts to place points before the room counts as too small."""


@dataclass(frozen=True)
class InstanceShape:
    """What random instances look like beside their numbers of robots and tasks."""

    room: Sequence[float] = (10.0, 10.0)
    """(2,) or (3,) m, size; one corner is at the origin."""
    spacing: float = 0.0
    """m: least distance between homes, and between pickups and deliveries."""
    margin: float = 0.0
    """m: distance kept from the walls."""
    heights: tuple[float, float] = (0.4, 1.2)
    """m: range of the heights of pickups and deliveries."""
    loads: tuple[int, int] = (1, 3)
    """Range of whole loads."""
    capacities: tuple[int, int] = (3, 5)
    """Range of whole capacities."""
    capable: float = 1.0
    """Share of the tasks that a robot may serve."""
    route_length_limit: float | None = None
    """m; None for no limit."""
    clusters: int = 0
    """Number of heaps in which pickups and deliveries lie instead; each is spread by a twentieth of
    the room's width around its middle. 0 for none.
    """
    fields: Mapping[str, Any] = field(default_factory=dict)
    """Further fields of the instance file."""


def random_instance(
    robots: int, tasks: int, seed: int, shape: InstanceShape | None = None
) -> Instance:
    """Return an instance with homes, pickups and deliveries uniform in a room.

    In three dimensions homes are on the floor and pickups and deliveries at random heights.
    Every task gets a robot that can serve it.

    robots: N.
    tasks: M.
    seed: of the random generator.
    shape: its room, loads and further fields; None for the defaults.
    Raises ConfigError if the room is too small for the spacing.
    """
    shape = shape or InstanceShape()
    room = shape.room
    draw = np.random.default_rng(seed)
    flat = len(room) == 2
    home = _draw_scattered(draw, robots, room[:2], shape.spacing, shape.margin)
    if shape.clusters:
        goods = _draw_heaps(draw, 2 * tasks, room[:2], shape.clusters)
    else:
        goods = _draw_scattered(draw, 2 * tasks, room[:2], shape.spacing, shape.margin)
    if not flat:
        home = np.column_stack([home, np.zeros(robots)])
        goods = np.column_stack(
            [goods, draw.uniform(*shape.heights, size=2 * tasks).round(2)]
        )
    load = draw.integers(*shape.loads, size=tasks, endpoint=True)
    capacity = draw.integers(*shape.capacities, size=robots, endpoint=True)
    mask = _draw_capability(draw, capacity, load, shape.capable)
    return Instance.parse(
        {
            "home": home.tolist(),
            "pickup": goods[:tasks].tolist(),
            "delivery": goods[tasks:].tolist(),
            "load": load.astype(float).tolist(),
            "capacity": capacity.astype(float).tolist(),
            "route_length_limit": shape.route_length_limit,
            "capability": mask.tolist(),
            **shape.fields,
        },
        f"random_instance(robots={robots}, tasks={tasks}, seed={seed})",
    )


def _draw_capability(
    draw: np.random.Generator, capacity: Ints, load: Ints, share: float
) -> npt.NDArray[np.bool_]:
    """Return an (N, M) mask, each entry true with probability `share`.

    Each task gets at least one true entry among the robots that can lift it.
    """
    mask = draw.random((len(capacity), len(load))) < share
    for j in range(len(load)):
        able = np.flatnonzero(capacity >= load[j])
        if len(able) and not mask[able, j].any():
            mask[draw.choice(able), j] = True
    return mask


def _draw_heaps(
    draw: np.random.Generator, count: int, room: Sequence[float], heaps: int
) -> Mat:
    """Return (count, 2) m, rounded to centimetres, normally distributed around `heaps` points.

    Points outside the room are moved to its border.
    """
    middle = draw.uniform([0.0, 0.0], room, size=(heaps, 2))
    points = draw.normal(middle[draw.integers(heaps, size=count)], room[0] / 20.0)
    return np.asarray(points.clip([0.0, 0.0], room).round(2))


def _draw_scattered(
    draw: np.random.Generator,
    count: int,
    room: Sequence[float],
    spacing: float,
    margin: float,
) -> Mat:
    """Return (count, 2) m, rounded to centimetres, by drawing points until they are far apart."""
    points: list[np.ndarray] = []
    for _ in range(PLACEMENT_ATTEMPTS):
        point = draw.uniform(
            [margin, margin], [room[0] - margin, room[1] - margin]
        ).round(2)
        if all(np.linalg.norm(point - other) >= spacing for other in points):
            points.append(point)
        if len(points) == count:
            return np.array(points)
    raise ConfigError(
        "random_instance",
        f"{len(points)} of {count} points placed",
        f"points {spacing:g} m apart within {room} m",
        "Take a larger room, fewer points or a smaller spacing.",
    )
