"""The room in which goals may lie: inside the fence, with
margins that keep the guard from braking there.
"""

from collections.abc import Iterable

from crazychoir.config.tables import Position, Swarm

EDGE_MARGIN = 0.005  # m
"""Distance from the sides and the top of the fence: nearer, noise alone carries a drone out."""
ABOVE_FLOOR = 0.1  # m
"""Height above the ground: lower, a hovering drone touches the floor with its motors on."""

Corners = tuple[Position, Position]
"""Lowest and highest corner, m, world."""


def flight_room(low: Position, high: Position, ground: float | None) -> Corners:
    """Return the corners of the room in which every goal and every point of a path must lie.

    low: (3,) m, world: lowest corner of the fence
    high: (3,) m, world: highest corner of the fence
    ground: m, world: height of the floor; None for a robot that drives, which may be anywhere in
        the fence
    """
    floor = low[2] + EDGE_MARGIN
    if ground is not None:
        floor = max(floor, ground + ABOVE_FLOOR)
    return (low[0] + EDGE_MARGIN, low[1] + EDGE_MARGIN, floor), (
        high[0] - EDGE_MARGIN,
        high[1] - EDGE_MARGIN,
        high[2] - EDGE_MARGIN,
    )


def largest_room(swarm: Swarm) -> Corners:
    """Return the corners of the room of drones that fly in all of [fence]; drone_room knows which do not."""
    return flight_room(swarm.fence.min, swarm.fence.max, swarm.flight.ground)


def room_text(low: Iterable[float], high: Iterable[float]) -> str:
    """Return what a room allows, in words.

    low, high: m, world, its corners.
    """
    a = [round(x, 4) for x in low]
    b = [round(x, 4) for x in high]
    return f"{a} to {b} m, inside [fence] by the margins of the guard"
