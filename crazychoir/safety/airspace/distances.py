"""Distances that drones keep from each other, and how long a drone is assumed to fly on."""

from typing import NamedTuple


class CollisionDistances(NamedTuple):
    """Distances, m, that the collision filter keeps, or from which on it acts."""

    standing_height: float = 0.08
    """Height in m above the ground below which a drone counts as standing on the floor."""
    standing_drone: float = 0.15
    """Distance in m to keep between the centres of two drones if one stands on the floor.

    At 0.137 m they would touch.
    """
    landing_beside: float = 0.2
    """Distance in m that a landing drone keeps from the centre of a drone on the floor."""
    silent_drone: float = 0.5
    """Least distance in m between the ellipsoids of this drone and a silent one, see compute_silent_gap.

    Below it this drone brakes.
    """
    floor_gap: float = 0.2
    """Least height in m above the floor of a drone that gives way, unless it wants to be lower.
    """
    near_wall: float = 1.0
    """Distance in m from a side of the fence within which that side counts."""


COLLISION_DISTANCES = CollisionDistances()


def compute_silent_gap(v_max: float, a_max: float) -> float:
    """Return the distance in m between the ellipsoids of two drones below which one brakes for the other.

    It does not hear the other one. Both may fly at each other, and each needs

        T v_max + v_max^2 / (2 a_max) + a_max / (2 k^2),   or T v_max + v_max / k if v_max < a_max / k

    because it brakes with the smaller of a_max and k v. T is BRAKING_MODEL.response_time, and k is
    BRAKING_MODEL.gain.

    v_max: m/s, largest speed
    a_max: m/s2, with which both brake
    """
    k = BRAKING_MODEL.gain
    soft = min(v_max, a_max / k)  # m/s, speed at which k v = a_max
    each = (
        BRAKING_MODEL.response_time * v_max
        + (v_max**2 - soft**2) / (2.0 * a_max)
        + soft / k
    )
    return max(COLLISION_DISTANCES.silent_drone, 2.0 * each)


class BrakingModel(NamedTuple):
    """How long a drone is assumed to go on, and how it then brakes."""

    command_time: float = 0.15
    """Seconds for which a drone is assumed to go on with its last command.

    Two drones that predict each other further ahead evade each other for ever.
    """
    silent_flight_time: float = 2.0
    """Longest time in s that a silent drone is assumed to fly on.

    Then it brakes because it does not receive the others' states.
    """
    gain: float = 4.0
    """Braking gain k in 1/s: the deceleration as a multiple of the speed."""
    response_time: float = 0.1
    """Seconds that a drone flies on until it brakes: command, attitude and rotors are late."""
    holding_speed: float = 0.2
    """Speed in m/s below which a braking drone stays where it is."""


BRAKING_MODEL = BrakingModel()
