"""The check after take-off that the body seen by the cameras moves as the drone does.

On the ground, level, one drone is like any other, and a drone that gets its attitude from the
cameras agrees with any body. In the air its own sensors decide. A drone with another's body, or
with a body turned about the vertical, is steered the wrong way and tilts more and more, and its
body does not tilt as it does. The check needs independent measurements: until it has judged, the
drone gets places only, and no attitudes.
"""

import cmath
import math
from bisect import bisect
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crazychoir.types import Vec

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class TiltNoise:
    """How a drone's own tilt may differ from the seen tilt of its body."""

    noise: float = math.radians(0.25)
    """Difference in rad between a drone's own tilt and the seen tilt, beside camera errors."""
    share: float = 0.2
    """Share of its tilt by which both may differ in addition."""
    largest_noise: float = math.radians(1.0)
    """Largest noise in rad; more is not noise: a person puts the drone down."""
    lags: tuple[float, ...] = (0.01, 0.03, 0.05, 0.08, 0.12)
    """Delays in s of a drone's own tilt that are tried; the best fit counts."""


TILT_NOISE = TiltNoise()


@dataclass(frozen=True, slots=True)
class TiltJudgement:
    """When the tilts prove that a body is another drone's, turned, or no drone's."""

    largest_sample_cost: float = 5.0
    """Largest cost of one sample: a wrong pose affects two samples and proves nothing."""
    clear_gain: float = 12.0
    """Cost by which another body, or the own one turned, must explain the motion better."""
    alike: float = 6.0
    """Cost within which these two explanations count as equally good."""
    unlike: float = 40.0
    """Cost beyond which the drone's own body does not explain its motion, whichever does."""
    better_ratio: float = 3.0
    """Factor by which the cost of a better explanation must be smaller."""
    unexplained_share: float = 0.5
    """Share of all motion that remains if no body explains it."""
    least_turn: float = math.radians(30.0)
    """Angle in rad below which a turned body is not reported."""
    enough_cost: float = 40.0
    """Cost of its motion from which on the take-off has been judged."""


TILT_JUDGEMENT = TiltJudgement()


@dataclass(frozen=True, slots=True)
class RiseLimits:
    """When the heights prove that another body rises instead of the drone's own."""

    stays_below: float = 0.03
    """Rise in m below which a body has not risen."""
    rises_above: float = 0.15
    """Rise in m above which another body has risen that should not."""
    duration: float = 0.2
    """Seconds for which this must hold."""


RISE_LIMITS = RiseLimits()


@dataclass(frozen=True, slots=True)
class TakeoffWatch:
    """How much of a take-off is watched, and of the time before it."""

    samples: int = 20
    """Number of samples that are compared."""
    reference_time: float = 0.5
    """Seconds on the ground before the take-off that give the reference tilt."""
    kept_time: float = 1.5
    """Seconds for which poses are kept."""
    shortest: float = 2.0
    """Least time in s that a take-off is watched."""
    longest: float = 8.0
    """Longest time in s that a take-off is watched."""


TAKEOFF_WATCH = TakeoffWatch()


def compute_tilt(q: Vec) -> complex:
    """Return where up is in the plane of the body: x and y of R(q)^T e_z as one complex number.

        u = 2 (q_x q_z - q_w q_y) + 2 i (q_y q_z + q_w q_x)

    A body with axes turned by psi about its z sees u e^(-i psi).

    q: (4,): body to world
    """
    x, y, z, w = q.tolist()
    return complex(2.0 * (x * z - w * y), 2.0 * (y * z + w * x))


class TiltTrack:
    """The recent tilts of one body, and its height."""

    def __init__(self) -> None:
        self._times: deque[float] = deque()
        self._tilts: deque[complex] = deque()
        self.height = math.nan
        """m."""
        self.flies = True
        """Whether its drone reports that it flies."""

    def add(self, t: float, u: complex, height: float = math.nan) -> None:
        """Add the tilt u at the time t in s, and the height in m."""
        if self._times and t <= self._times[-1]:
            return
        self.height = height
        self._times.append(t)
        self._tilts.append(u)
        while self._times[0] < t - TAKEOFF_WATCH.kept_time:
            self._times.popleft()
            self._tilts.popleft()

    def at(self, t: float) -> complex:
        """Return the tilt at the time t in s, interpolated.

        After the newest sample it is that sample. Returns nan if the body was not seen within 0.1
        s.
        """
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
        """Return the mean tilt between two times, and its variance per axis.

        since: s
        until: s
        Returns nan for the mean if the body was not seen; the variance in rad2 is at most TILT_NOISE.largest_noise^2.
        """
        found = np.array(
            [
                u
                for t, u in zip(self._times, self._tilts, strict=True)
                if since <= t <= until
            ]
        )
        if not found.size:
            return complex(math.nan), 0.0
        return complex(found.mean()), min(
            0.5 * float(found.var()), TILT_NOISE.largest_noise**2
        )


class TakeoffCheck:
    """One take-off of drone i: its own tilt is compared with those of its body and all others.

        s_k = u_own(t_k) - mean of u_own before,   b_jk = u_j(t_k - lag) - mean of u_j before
        J_j(psi) = min over lags of sum_k min(|s_k - e^(i psi) b_jk|^2 / (2 sigma_k^2), c)
        c = TILT_JUDGEMENT.largest_sample_cost
        sigma_k^2 = TILT_NOISE.noise^2 + n_own^2 + n_i^2 + (TILT_NOISE.share |s_k|)^2

    The sums are over the last TAKEOFF_WATCH.samples samples. n_own and n_i are standard deviations per axis before
    the take-off, in rad. The check reports four errors.

    The body is another drone's:

        J_i(0) - J_j(0) > TILT_JUDGEMENT.clear_gain for a j

    The body is turned, by the best fit psi = arg sum_k s_k conj(b_ik):

        J_i(0) - J_i(psi) > TILT_JUDGEMENT.clear_gain,   |psi| > TILT_JUDGEMENT.least_turn

    In both cases the better cost must also be less than J_i(0) / TILT_JUDGEMENT.better_ratio.

    The body belongs to no drone:

        J_i(0) > TILT_JUDGEMENT.unlike,   sum |s - b|^2 > TILT_JUDGEMENT.unexplained_share sum (|s|^2 + |b|^2)

    The body is another drone's, by the heights: it stays on the floor while the body of a drone
    that does not fly rises.

    i: id of the drone
    now: s
    own: the drone's own tilt
    bodies: the tilt of each body, by id
    """

    def __init__(
        self, i: int, now: float, own: TiltTrack, bodies: Mapping[int, TiltTrack]
    ) -> None:
        self.drone = i
        self._began = now
        self._bodies = bodies
        self._said = own
        self._level = complex(math.nan)
        self._zeros = dict[int, complex]()
        self._noise = math.nan
        self._own: deque[complex] = deque(maxlen=TAKEOFF_WATCH.samples)
        self._seen: dict[int, deque[list[complex]]] = {
            j: deque(maxlen=TAKEOFF_WATCH.samples) for j in bodies
        }
        self._moved = 0.0
        self._heights = {j: track.height for j, track in bodies.items()}
        # The body that rises instead of the drone's own, and since when.
        self._rises: tuple[int, float] = (
            i,
            now,
        )
        self.over = False
        """Whether the judgement is final.

        Drone and body move alike, or the watch has been long enough.
        """

    def judge(self, now: float, u: complex, flies: bool) -> str:
        """Return what is wrong, empty if nothing is.

        now: s
        u: the tilt that the drone reports for this time
        flies: whether the drone reports that it flies
        """
        if not self._zeros:
            self._look_back()
        s = u - self._level
        self._own.append(s)
        for j, track in self._bodies.items():
            self._seen[j].append(
                [track.at(now - lag) - self._zeros[j] for lag in TILT_NOISE.lags]
            )
        self._moved += min(
            abs(s) ** 2 / (2.0 * self._noise), TILT_JUDGEMENT.largest_sample_cost
        )
        watched = now - self._began
        self.over = watched > TAKEOFF_WATCH.longest or (
            watched > TAKEOFF_WATCH.shortest
            and self._moved > TILT_JUDGEMENT.enough_cost
        )
        return self._by_tilts() or (self._by_heights(now) if flies else "")

    def _look_back(self) -> None:
        """Compute the reference tilts and the noise from the time before the take-off.

        It is called when the drone's reports of that time have arrived.
        """
        began = self._began
        since = self._began - TAKEOFF_WATCH.reference_time
        rest = {j: track.rest(since, began) for j, track in self._bodies.items()}
        self._level, noise = self._said.rest(since, began)
        self._zeros = {j: level for j, (level, _) in rest.items()}
        self._noise = TILT_NOISE.noise**2 + noise + rest[self.drone][1]

    def _by_heights(self, now: float) -> str:
        """Return what is wrong by the heights, empty if nothing is.

        It is wrong if the body stays down while the drone flies, and the body of a drone that does
        not fly rises.
        """
        rises = {
            j: track.height - self._heights[j] for j, track in self._bodies.items()
        }
        others = [
            j
            for j in rises
            if j != self.drone
            and rises[j] > RISE_LIMITS.rises_above
            and not self._bodies[j].flies
        ]
        j = (
            others[0]
            if others and rises[self.drone] < RISE_LIMITS.stays_below
            else self.drone
        )
        if j != self._rises[0]:
            self._rises = j, now
        if j == self.drone or now - self._rises[1] < RISE_LIMITS.duration:
            return ""
        return f"it flies, its body stays on the floor, and that of drone {j}, which does not fly, rises"

    def _by_tilts(self) -> str:
        """Return what is wrong by the tilts, empty if nothing is."""
        s = np.array(self._own)
        own = np.array(self._seen[self.drone])
        good = np.isfinite(s) & np.isfinite(own).all(axis=1)
        s = s[good]
        own = own[good]
        mine = self._cost(s, own)
        if mine <= TILT_JUDGEMENT.clear_gain:
            return ""
        others = {
            j: self._cost(s, np.array(seen)[good])
            for j, seen in self._seen.items()
            if j != self.drone
        }
        j = min(others, key=lambda j: others[j], default=self.drone)
        swapped, (turned, psi) = others.get(j, math.inf), self._turned(s, own)
        better = min(
            mine - TILT_JUDGEMENT.clear_gain, mine / TILT_JUDGEMENT.better_ratio
        )
        if min(swapped, turned) < better:
            another = f"the body of drone {j}"
            its_own = f"its own turned by {math.degrees(psi):.0f} deg about z"
            likely = [another] * (swapped < min(better, turned + TILT_JUDGEMENT.alike))
            likely += [its_own] * (turned < min(better, swapped + TILT_JUDGEMENT.alike))
            return f"it does not tilt as its body does, but as {' or '.join(likely)}"
        left = np.sum(np.abs(s[:, None] - own) ** 2, axis=0)
        moved = np.sum(np.abs(own) ** 2, axis=0)
        nobodys = mine > TILT_JUDGEMENT.unlike and bool(
            np.all(
                left
                > TILT_JUDGEMENT.unexplained_share * (moved + np.sum(np.abs(s) ** 2))
            )
        )
        return "it does not tilt as its body does" if nobodys else ""

    def _turned(self, s: Complex, own: Complex) -> tuple[float, float]:
        """Return the cost of the drone's own body, turned as fits best, and the angle in rad.

        The cost is infinite if the angle is small.
        """
        psi = cmath.phase(complex(np.sum(s[:, None] * own.conj())))
        return (
            self._cost(s, cmath.exp(1j * psi) * own)
            if abs(psi) > TILT_JUDGEMENT.least_turn
            else math.inf
        ), psi

    def _cost(self, s: Complex, seen: Complex) -> float:
        """Return the cost J; a body that was not seen explains nothing.

        s: (n,)
        seen: (n, lags)
        """
        if not s.size:
            return 0.0
        variance = 2.0 * (self._noise + (TILT_NOISE.share * np.abs(s)) ** 2)
        each = np.abs(s[:, None] - seen) ** 2 / variance[:, None]
        return float(
            np.where(
                np.isfinite(each),
                np.minimum(each, TILT_JUDGEMENT.largest_sample_cost),
                TILT_JUDGEMENT.largest_sample_cost,
            )
            .sum(axis=0)
            .min()
        )
