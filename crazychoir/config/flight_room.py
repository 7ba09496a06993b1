"""Where drones may be sent: inside the fence, by the margins that keep the guard from braking them there."""

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


def room_of(swarm: Swarm) -> Corners:
    """Return the corners of the room of drones that fly, by the swarm file."""
    return flight_room(swarm.fence.min, swarm.fence.max, swarm.flight.ground)
