"""Whether the body that the cameras take for a drone moves as the drone does, from its take-off on.

On the ground, level, one drone is like any other, and one that is told by the cameras how it looks agrees with whatever
body it is told. In the air its own sensors tell: a drone whose body is another's, or is turned about the vertical, is
steered the wrong way, tilts more and more, and its body does not tilt as it does. Nothing here is worth more than its
independence: until this has judged, the drone is told places, and no attitudes.
"""

import cmath
import math
from bisect import bisect
from collections import deque
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from crazychoir.types import Vec

Complex = npt.NDArray[np.complex128]
NOISE, SHARE = math.radians(0.25), 0.2
"""rad, and share of its tilt, by which what a drone says of its own tilt and what is seen of it may differ, beside what
the cameras are seen to be wrong by."""
ODD = 5.0
"""Cost of one sample at most: a pose that is wrong touches two, and tells nothing."""
CLEARLY, ALIKE, UNLIKE = 12.0, 6.0, 40.0
"""Cost by which another body, or the own one turned, must explain a drone's motion better; within which these two do so
equally well; and beyond which its own body does not, whoever's does."""
RATIO, MOVED = 3.0, 0.5
"""How many times less that cost is then; and the share of all motion that is left where nobody's body explains it."""
SHAKEN = math.radians(1.0)
"""rad: more noise than that is none: somebody puts the drone down."""
TURNED = math.radians(30.0)
"""rad: a body that is turned by less is not called so."""
LAGS = (0.01, 0.03, 0.05, 0.08, 0.12)
"""s by which what a drone says of itself may be late: the one of these that fits best."""
STAYS, ROSE, SURELY = 0.03, 0.15, 0.2
"""m by less than which a body has not risen, by which another has that should not; and s for which that is so."""
WINDOW, STOOD, KEPT = 20, 0.5, 1.5
"""Samples that are looked at; s of standing before the take-off, from which tilts count; and of poses that are kept."""
SHORTEST, LONGEST, ENOUGH = 2.0, 8.0, 40.0
"""s that a take-off is watched: at least, at most; and the cost of its motion from which on it has been judged."""


def tilt(q: Vec) -> complex:
    """Where up is, in the plane of the body: the x and y, as one complex number, of R(q)^T e_z.

        u = 2 (q_x q_z - q_w q_y) + 2 i (q_y q_z + q_w q_x)

    q: (4,) body to world. A body whose axes are turned by psi about its z sees u e^(-i psi).
    """
    x, y, z, w = q.tolist()
    return complex(2.0 * (x * z - w * y), 2.0 * (y * z + w * x))


class Track:
    """How one body was tilted lately, and how high it is, m;  flies: whether its drone says that it does."""

    def __init__(self) -> None:
        self._times: deque[float] = deque()
        self._tilts: deque[complex] = deque()
        self.height = math.nan
        self.flies = True

    def add(self, t: float, u: complex, height: float = math.nan) -> None:
        """At t s."""
        if self._times and t <= self._times[-1]:
            return
        self.height = height
        self._times.append(t)
        self._tilts.append(u)
        while self._times[0] < t - KEPT:
            self._times.popleft()
            self._tilts.popleft()

    def at(self, t: float) -> complex:
        """Between its neighbours in time, the newest after it; nan if it was not seen within 0.1 s."""
        times = self._times
        k = bisect(times, t)
        if k == len(times):
            return (
                self._tilts[-1] if times and t - times[-1] < 0.1 else complex(math.nan)
            )
        if k == 0 or times[k] - times[k - 1] > 0.2:
            return complex(math.nan)
        share = (t - times[k - 1]) / (times[k] - times[k - 1])
        return (1.0 - share) * self._tilts[k - 1] + share * self._tilts[k]

    def rest(self, since: float, until: float) -> tuple[complex, float]:
        """The mean between two times, nan if it was not seen; and the variance an axis, rad2, at most SHAKEN^2."""
        found = np.array(
            [
                u
                for t, u in zip(self._times, self._tilts, strict=True)
                if since <= t <= until
            ]
        )
        if not found.size:
            return complex(math.nan), 0.0
        return complex(found.mean()), min(0.5 * float(found.var()), SHAKEN**2)


class Ascent:
    """One take-off of drone i: its own tilt beside those of its body and of all others.

        s_k = u_own(t_k) - mean of u_own before,   b_jk = u_j(t_k - lag) - mean of u_j before
        J_j(psi) = min over lags of sum_k min(|s_k - e^(i psi) b_jk|^2 / (2 sigma_k^2), ODD)
        sigma_k^2 = NOISE^2 + n_own^2 + n_i^2 + (SHARE |s_k|)^2

    over the last WINDOW samples;  n_own, n_i: rad, standard deviations an axis before the take-off.
    Its body is another's if J_i(0) - J_j(0) > CLEARLY for a j; turned, if J_i(0) - J_i(psi) > CLEARLY for the
    psi = arg sum_k s_k conj(b_ik) that fits best, |psi| > TURNED; in both cases the better cost is less than
    J_i(0) / RATIO. It is nobody's if J_i(0) > UNLIKE and sum |s - b|^2 > MOVED sum (|s|^2 + |b|^2). And it is another's
    if it stays on the floor, while that of a drone that does not fly rises.
    """

    def __init__(
        self, i: int, now: float, own: Track, bodies: Mapping[int, Track]
    ) -> None:
        self.drone = i
        self._began = now
        self._bodies = bodies
        self._said = own
        self._level, self._zeros, self._noise = (
            complex(math.nan),
            dict[int, complex](),
            math.nan,
        )
        self._own: deque[complex] = deque(maxlen=WINDOW)
        self._seen: dict[int, deque[list[complex]]] = {
            j: deque(maxlen=WINDOW) for j in bodies
        }
        self._moved = 0.0
        self._heights = {j: track.height for j, track in bodies.items()}
        self._rises: tuple[int, float] = (
            i,
            now,
        )  # whose body rises instead of its own, and since when
        self.over = False
        """Whether it has been judged: it moves as its body does, or has been watched for long enough."""

    def judge(self, now: float, u: complex, flies: bool) -> str:
        """What is wrong, empty if nothing is, when the drone says its tilt u, and whether it flies, of this time."""
        if not self._zeros:
            self._look_back()
        s = u - self._level
        self._own.append(s)
        for j, track in self._bodies.items():
            self._seen[j].append([track.at(now - lag) - self._zeros[j] for lag in LAGS])
        self._moved += min(abs(s) ** 2 / (2.0 * self._noise), ODD)
        watched = now - self._began
        self.over = watched > LONGEST or (watched > SHORTEST and self._moved > ENOUGH)
        return self._by_tilts() or (self._by_heights(now) if flies else "")

    def _look_back(self) -> None:
        """At how all stood, once it has said all that it has said of that."""
        began = self._began
        since = self._began - STOOD
        rest = {j: track.rest(since, began) for j, track in self._bodies.items()}
        self._level, noise = self._said.rest(since, began)
        self._zeros = {j: level for j, (level, _) in rest.items()}
        self._noise = NOISE**2 + noise + rest[self.drone][1]

    def _by_heights(self, now: float) -> str:
        """Whether its body stays while it flies, and another's rises, whose drone does not fly."""
        rises = {
            j: track.height - self._heights[j] for j, track in self._bodies.items()
        }
        others = [
            j
            for j in rises
            if j != self.drone and rises[j] > ROSE and not self._bodies[j].flies
        ]
        j = others[0] if others and rises[self.drone] < STAYS else self.drone
        if j != self._rises[0]:
            self._rises = j, now
        if j == self.drone or now - self._rises[1] < SURELY:
            return ""
        return f"it flies, its body stays on the floor, and that of drone {j}, which does not fly, rises"

    def _by_tilts(self) -> str:
        s = np.array(self._own)
        own = np.array(self._seen[self.drone])
        good = np.isfinite(s) & np.isfinite(own).all(axis=1)
        s = s[good]
        own = own[good]
        mine = self._cost(s, own)
        if mine <= CLEARLY:
            return ""
        others = {
            j: self._cost(s, np.array(seen)[good])
            for j, seen in self._seen.items()
            if j != self.drone
        }
        j = min(others, key=lambda j: others[j], default=self.drone)
        swapped, (turned, psi) = others.get(j, math.inf), self._turned(s, own)
        better = min(mine - CLEARLY, mine / RATIO)
        if min(swapped, turned) < better:
            another = f"the body of drone {j}"
            its_own = f"its own turned by {math.degrees(psi):.0f} deg about z"
            likely = [another] * (swapped < min(better, turned + ALIKE))
            likely += [its_own] * (turned < min(better, swapped + ALIKE))
            return f"it does not tilt as its body does, but as {' or '.join(likely)}"
        left = np.sum(np.abs(s[:, None] - own) ** 2, axis=0)
        moved = np.sum(np.abs(own) ** 2, axis=0)
        nobodys = mine > UNLIKE and bool(
            np.all(left > MOVED * (moved + np.sum(np.abs(s) ** 2)))
        )
        return "it does not tilt as its body does" if nobodys else ""

    def _turned(self, s: Complex, own: Complex) -> tuple[float, float]:
        """The cost of its own body, turned as fits best, and by how many rad; infinite if that is by little."""
        psi = cmath.phase(complex(np.sum(s[:, None] * own.conj())))
        return (
            self._cost(s, cmath.exp(1j * psi) * own) if abs(psi) > TURNED else math.inf
        ), psi

    def _cost(self, s: Complex, seen: Complex) -> float:
        """J: s (n,), seen (n, lags); who was not seen explains nothing."""
        if not s.size:
            return 0.0
        variance = 2.0 * (self._noise + (SHARE * np.abs(s)) ** 2)
        each = np.abs(s[:, None] - seen) ** 2 / variance[:, None]
        return float(
            np.where(np.isfinite(each), np.minimum(each, ODD), ODD).sum(axis=0).min()
        )
