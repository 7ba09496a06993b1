"""Checks of goals and paths: a bad one is refused, with the reason, before anything moves."""

import math
from collections.abc import Iterable
from typing import cast

import numpy as np
import numpy.typing as npt

from crazychoir.config.flight_room import room_text
from crazychoir.errors import ConfigError
from crazychoir.numerics.array_like import describe_value, to_floats
from crazychoir.planning.trajectory import Trajectory
from crazychoir.safety.rules.guard import Guard
from crazychoir.types import FullState, Mat, Point, Vec

ROOM_TOLERANCE = 1e-6  # m by which a place may be outside the room: rounding
HOME_DISTANCE = 0.05  # m from a home, in the plane, that counts as above it
PLACE_TEXT = "three finite numbers, m"


def require_goal(
    where: str,
    p: object,
    yaw: object,
    duration: object,
    guard: Guard,
    planar: bool,
    homes: Iterable[Point] = (),
) -> Vec:
    """Return the place to fly to for a goal, (3,) m, world.

    It is the goal itself. A goal above a home is never refused for its horizontal place, because the
    drone must be able to return: it is moved to the nearest place that the guard allows.

    where: name in errors, such as "drone 0: go_to()"
    p: goal, three numbers in m, world
    yaw: rad, None to keep the present yaw
    duration: s
    guard: of the drone; the goal must lie in its room
    planar: whether the robot does not choose its height; the height of the goal is then not checked
    homes: (3,) m each, world: places above which the drone may come down
    Raises ConfigError for a goal outside the room, or for values that are not finite numbers.
    """
    place = to_floats(p, (3,))
    if place is None or not np.isfinite(place).all():
        raise ConfigError(where, describe_value(p), PLACE_TEXT, "Give it as [x, y, z].")
    for name, value in (("yaw", yaw), ("duration", duration)):
        number = to_floats(0.0 if value is None else value, ())
        if number is None or not math.isfinite(float(number)):
            raise ConfigError(
                f"{where}: {name}", describe_value(value), "a finite number"
            )
    if any(math.dist(place[0:2], home[0:2]) <= HOME_DISTANCE for home in homes):
        place = np.array([*guard.room.nearest(place, inset=0.0)[0:2], place[2]])
    rest = np.zeros((1, 14))
    rest[0, 0:3] = place
    if _find_outside(rest, guard, planar)[0]:
        raise _build_outside_error(where, place.tolist(), guard)
    return place


def require_path(where: str, t: Vec, path: Mat, guard: Guard, planar: bool) -> None:
    """Raise ConfigError at the first set-point of a path that is outside the room of the guard.

    where: name in error texts
    t: (n,) s
    path: (n, 14), rows as FullState.flat
    guard: of the drone
    planar: whether the robot does not choose its height
    """
    is_outside = _find_outside(path, guard, planar)
    if is_outside.any():
        k = int(np.argmax(is_outside))
        raise _build_outside_error(
            f"{where}: set-point at {t[k]:.2f} s", path[k, 0:3].round(3).tolist(), guard
        )


def require_trajectory(where: str, trajectory: object) -> Trajectory:
    """Return a trajectory with set-points that kernels can take.

    A trajectory of this package returns such set-points, and is returned as it is. A user's
    trajectory is returned as a CheckedTrajectory.

    where: name for errors
    trajectory: any object
    Raises ConfigError for an object that is no trajectory, or has no finite duration.
    """
    missing = [
        name for name in ("duration", "sample", "done") if not hasattr(trajectory, name)
    ]
    do = "Make one of places: crazychoir.planning.minimum_snap.minimum_snap(places)."
    if missing:
        raise ConfigError(
            where,
            type(trajectory).__name__,
            "a trajectory: duration, sample(t), done(t)",
            do,
        )
    found = trajectory.duration  # type: ignore[attr-defined]
    duration = to_floats(found, ())
    if duration is None or not (
        math.isfinite(float(duration)) and float(duration) > 0.0
    ):
        raise ConfigError(
            f"{where}: duration",
            describe_value(found),
            "a positive number of seconds",
            do,
        )
    for t in (0.0, 0.5 * float(duration), float(duration)):
        require_setpoint(trajectory.sample(t), t)  # type: ignore[attr-defined]
    is_ours = type(trajectory).__module__.startswith("crazychoir.")
    taken = cast(Trajectory, trajectory)
    return taken if is_ours else CheckedTrajectory(taken)


def require_setpoint(found: object, t: float) -> FullState:
    """Return the result of a trajectory's sample(t), with the float64 array that kernels take.

    found: the result
    t: s
    Raises ConfigError unless it is a FullState of 14 numbers.
    """
    flat = to_floats(getattr(found, "flat", None), (14,))
    if flat is None or not isinstance(found, FullState):
        raise ConfigError(
            f"trajectory: sample({t:.2f})",
            describe_value(found),
            "a FullState of 14 numbers",
        )
    return found if flat is found.flat else FullState(flat)


class CheckedTrajectory:
    """A user's trajectory: its set-points are converted, or refused, as they are sampled."""

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self.duration = trajectory.duration

    def sample(self, t: float) -> FullState:
        """Return the reference t seconds after the start. Raises ConfigError for other objects."""
        return require_setpoint(self._trajectory.sample(t), t)

    def done(self, t: float) -> bool:
        """Return whether the end is reached at t."""
        return self._trajectory.done(t)


def _find_outside(path: Mat, guard: Guard, planar: bool) -> npt.NDArray[np.bool_]:
    """Return (n,): whether each set-point of a path is outside the room.

    A set-point that is not a number counts as outside.

    path: (n, 14), rows as FullState.flat
    """
    rows = path
    if planar:
        rows = path.copy()
        rows[:, 2] = 0.5 * (guard.room.low[2] + guard.room.high[2])
    return np.asarray(~(guard.leaves_room(rows) <= ROOM_TOLERANCE))


def _build_outside_error(
    where: str, place: Iterable[float], guard: Guard
) -> ConfigError:
    allowed = room_text(guard.room.low, guard.room.high)
    do = "Choose a place further inside, or widen [fence]."
    return ConfigError(
        where,
        str(place),
        allowed,
        do,
        "outside the fence, at its edge, or on the floor",
    )
