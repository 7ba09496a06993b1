"""Where drones may be sent: inside the fence, by the margins that keep the guard from braking them there."""

from collections.abc import Iterable

from crazychoir.config.tables import Position, Swarm

EDGE = 0.005  # m from the sides and the top of the fence: nearer, noise alone carries a drone out
ABOVE_FLOOR = 0.1  # m above the ground: lower, a drone that hovers touches the floor with its motors on

Corners = tuple[Position, Position]


def flight_room(low: Position, high: Position, ground: float | None) -> Corners:
    """Return the corners of the room in which every goal, and every place of a path, must lie.

    low, high: m, world, the corners of the fence.
    ground: m, world, the height of the floor; None for a robot that drives, which may be where the fence is.
    """
    floor = low[2] + EDGE
    if ground is not None:
        floor = max(floor, ground + ABOVE_FLOOR)
    return (low[0] + EDGE, low[1] + EDGE, floor), (
        high[0] - EDGE,
        high[1] - EDGE,
        high[2] - EDGE,
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
