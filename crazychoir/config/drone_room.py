"""Where one drone may fly, and where it may be sent: for its guard, and for the checks of a mission before take-off."""

from crazychoir.config.flight_room import Corners, flight_room
from crazychoir.config.link_loss import TILT_TIMES, fence_inset
from crazychoir.config.swarm_config import SwarmConfig


def fence_of(config: SwarmConfig, i: int) -> Corners:
    """Return the corners of the box in which drone i flies, m, world.

    It is [fence], smaller by the inset of link_loss for a drone that a radio reaches and that is streamed set-points.
    """
    low = config.fence.min
    high = config.fence.max
    sender = config.control_of(i).sender
    if i not in config.topology.reached or sender not in TILT_TIMES:
        return low, high
    x = fence_inset(config, sender).given
    return (low[0] + x, low[1] + x, low[2]), (high[0] - x, high[1] - x, high[2])


def room_of(config: SwarmConfig, i: int) -> Corners:
    """Return the corners of the room in which drone i may be sent: nowhere inside does its guard brake it."""
    return flight_room(*fence_of(config, i), config.flight.ground)


def shared_room(config: SwarmConfig) -> Corners:
    """Return the corners of the room in which every drone may be sent."""
    rooms = [room_of(config, i) for i in config.ids]
    a, b, c = (max(low[k] for low, _ in rooms) for k in range(3))
    d, e, f = (min(high[k] for _, high in rooms) for k in range(3))
    return (a, b, c), (d, e, f)
