"""The limits of agreed paths: where, how fast and how hard they are flown, and when they change."""

from dataclasses import dataclass

from crazychoir.safety.rules.guard import Fence


@dataclass(frozen=True, slots=True)
class PathLimits:
    """Where and how fast a drone may fly its agreed paths."""

    fence: Fence
    """Where the drone flies."""
    a_max: float
    """Greatest acceleration in m/s2."""
    v_max: float
    """Greatest speed in m/s."""
    ground: float
    """Height of the ground in m."""


@dataclass(frozen=True, slots=True)
class PlanningTimes:
    """Times, s, by which a drone with agreed paths looks for a path, and keeps or leaves one."""

    check_interval: float = 0.1
    """Seconds between two looks for a better path."""
    horizons: tuple[float, ...] = (0.8, 0.6, 0.4)
    """Times in s that are planned ahead, the first that is clear, if the wanted reference has no known end.

    Behind another drone on the same path only the shorter ones may be clear: where that drone will rest
    if it does not come to agree with the others on more. The last one is as long as an offer and a look take.
    """
    least_gain: float = 0.3
    """Seconds that another path must save."""
    imminent_meeting: float = 1.0
    """Seconds before a meeting with a drone outside the agreement.

    Within this the drone brakes if there is no other path.
    """
    flight_break: float = 0.5
    """Seconds without a flight after which the next one begins anew."""
    landing_end: float = 60.0
    """Seconds after which each landing has ended."""


PLANNING_TIMES = PlanningTimes()


@dataclass(frozen=True, slots=True)
class PathTolerances:
    """How near a drone, its path and its wanted reference are while they still count as together."""

    moving_goal_share: float = 0.25
    """Share of the distance left to a moving goal.

    A path that ends that near to the goal still leads there. Each new path begins slowly.
    """
    on_reference: float = 0.03
    """Distance in m from the wanted reference within which the drone is on it."""
    same_speed: float = 0.1
    """Difference in m/s of their velocities, within which a drone on the wanted reference flies it."""
    off_reference: float = 0.05
    """Distance in m from the wanted reference that needs a flight of its own to catch up."""
    same_end: float = 1e-3
    """Two ends of paths within this, in m and m/s, are the same."""
    lost_path: float = 0.35
    """Distance in m between a drone and its path, beyond which it begins a new path from here.
    """


PATH_TOLERANCES = PathTolerances()


@dataclass(frozen=True, slots=True)
class PathAccelerations:
    """The accelerations of agreed paths, and the room that a hard path needs."""

    gentle: float = 0.8
    """Acceleration in m/s2 of flights among others; harder paths are flown less exactly."""
    urgent: float = 1.6
    """Acceleration in m/s2 with which the drone brakes before a drone without an announced path.
    """
    hard: float = 1.2
    """Sideways acceleration in m/s2 from which on a wanted path counts as hard."""
    hardest: float = 2.0
    """Sideways acceleration in m/s2 from which on a wanted path needs the whole room of a hard path."""
    hard_path_room: float = 0.4
    """Distance in m that the hardest paths need beside D; harder paths are flown less exactly."""


PATH_ACCELERATIONS = PathAccelerations()


def compute_hard_path_room(peak: float) -> float:
    """Return the distance in m that a wanted path needs beside D.

    It grows evenly from 0 at PATH_ACCELERATIONS.hard to the whole room at PATH_ACCELERATIONS.hardest. With
    the whole room for each hard path, drones that stand 0.6 m apart on their paths could never go on.

    peak: m/s2, largest sideways acceleration of the path
    """
    limits = PATH_ACCELERATIONS
    share = (peak - limits.hard) / (limits.hardest - limits.hard)
    return limits.hard_path_room * min(max(share, 0.0), 1.0)


PLACE_SPEED = 0.85  # m/s
"""Speed of flights among others of a drone that is sent places.

The firmware asks for at most 1.1 m/s along each horizontal axis of the body. With the drag a simulated
drone then flies at 0.9 m/s, and falls behind a faster path.
"""
LOWEST_WAYPOINT = 0.25
"""Height in m above the ground of waypoints."""
