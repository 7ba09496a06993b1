"""True states of all drones of a world, for every engine."""

import math
from collections.abc import Sequence

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.types import Bools, Mat, Pose, State, Vec


class Truth:
    """True states of the drones of a world, one row a drone, and questions about them.

    ids: the drones
    p0: (N, 3) m: start positions; heights below the floor z = 0 are raised to it
    yaw0: (N,) rad: start headings, zero if None
    platform: one for all drones, or one a drone
    dt: s: one step of the world
    states: (N, 13): rows laid out as State.flat
    impact: (N,) m/s: fastest touch-down of each drone
    limited: (N,): number of steps in which a command exceeded what the drone can do
    """

    def __init__(
        self,
        ids: Sequence[int],
        p0: Mat,
        yaw0: Vec | None,
        platform: Platform | Sequence[Platform],
        dt: float,
    ) -> None:
        self.ids = tuple(ids)
        self.dt = dt
        self.tick = 0
        n = len(self.ids)
        name = type(self).__name__
        if np.shape(p0) != (n, 3) or not np.all(np.isfinite(p0)):
            raise ConfigError(
                f"{name}: p0", p0, f"finite, shape ({n}, 3): one row a drone"
            )
        self.platforms = (
            (platform,) * n if isinstance(platform, Platform) else tuple(platform)
        )
        if len(self.platforms) != n:
            raise ConfigError(
                f"{name}: platform",
                [p.name for p in self.platforms],
                f"one platform, or {n}",
            )
        self.row = {drone: row for row, drone in enumerate(self.ids)}
        self.states = _make_resting_states(p0, np.zeros(n) if yaw0 is None else yaw0)
        self._allowed = [row.max_landing_speed for row in self.platforms]
        self.limited = np.zeros(n)
        self.impact = np.zeros(n)
        self._resting = np.where(self.states[:, 2] > 0.0, 0.0, 1.0)

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.tick * self.dt

    def replace_body(self, i: int, platform: Platform) -> None:
        """Give drone i another true body; its state stays."""
        row = self.row[i]
        self.platforms = (
            *self.platforms[:row],
            platform,
            *self.platforms[row + 1 :],
        )
        self._allowed[row] = platform.max_landing_speed

    def put(self, i: int, p: Vec, yaw: float) -> None:
        """Put drone i at rest and level at p (3,) m, world, with this heading in rad.

        Its counters begin again.
        """
        row = self.row[i]
        self.states[row] = _make_resting_states(p[None, :], np.array([yaw]))[0]
        self._resting[row] = 0.0 if self.states[row, 2] > 0.0 else 1.0
        self.impact[row] = 0.0
        self.limited[row] = 0.0

    def see(self, i: int, pose: Pose) -> None:
        """Do nothing: these drones run no estimator."""

    def see_frame(self, flat: Mat, seen: Bools) -> None:
        """Do nothing, as `see`."""

    def state(self, i: int) -> State:
        """Return a copy of the true state of drone i."""
        return State(self.states[self.row[i]].copy())

    def resting(self, i: int) -> bool:
        """Return True if drone i stands on the floor."""
        return bool(self._resting[self.row[i]])

    @property
    def crashed(self) -> list[int]:
        """The drones that touched something faster than their platform allows."""
        return [
            i
            for i, hit, most in zip(self.ids, self.impact, self._allowed, strict=True)
            if hit > most
        ]

    def harm(self, i: int) -> str:
        """Return what broke drone i and at which speed; empty if it is not broken."""
        impact = self.impact[self.row[i]]
        allowed = self._allowed[self.row[i]]
        if not impact > allowed:
            return ""
        return f"crashed: hit {self.struck(i)} at {impact:.2f} m/s, allowed {allowed:g} m/s"

    def struck(self, i: int) -> str:
        """Return the name of the thing that drone i hit fastest."""
        return "the floor"

    def closest(self) -> tuple[int, int, float]:
        """Return the two closest drones and their distance in m; (-1, -1, inf) for one drone."""
        if len(self.ids) < 2:
            return -1, -1, math.inf
        from crazychoir.numerics.near_pairs import find_nearest  # takes 0.1 s

        near = find_nearest(self.states[:, 0:3])
        i = int(near.distances.argmin())
        j = int(near.rows[i])
        return self.ids[min(i, j)], self.ids[max(i, j)], float(near.distances[i])

    def min_separation(self) -> float:
        """Return the smallest distance between two drones in m; inf for one drone."""
        return self.closest()[2]


def _make_resting_states(p0: Mat, yaw0: Vec) -> Mat:
    """Return (N, 13) level states at rest at p0, raised to the floor where p0 is below it."""
    x = np.zeros((len(p0), 13))
    x[:, 0:3] = p0
    x[:, 2] = np.maximum(x[:, 2], 0.0)
    x[:, 8] = np.sin(0.5 * yaw0)
    x[:, 9] = np.cos(0.5 * yaw0)
    return x
