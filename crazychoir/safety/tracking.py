"""Whether motion capture sees the drone that it says: bodies that are exchanged, turned, or not there.

Two looks, because a drone at rest, level, is like any other: before arming by places and headings, and again at 0.1 m
by what the drone and its body do. Poses are those of drones, with how the body is mounted taken off.
"""

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from crazychoir.math3d import Vec, columns, dot, wrap, yaw_of
from crazychoir.types import Pose

PLACE, ANGLE = 0.05, math.radians(5.0)
"""m, rad: more than this between what a drone says of itself and what is seen of it keeps it on the ground."""
ROSE, STAYED = 0.05, 0.03
"""m by which a body has risen, and by less than which it has not."""
FLOWN = 2.5
"""s after which a drone whose motors fly it has risen: firmware that climbs to 0.1 m takes up to 2 s for 0.03 m."""
SAMPLES = 10
"""Of motion, the least to judge by."""
MOVED = math.radians(0.3)
"""rad (rad/s of rates), root mean square: who moves less tells nothing."""
ALIKE, UNLIKE, TURNED = 0.8, 0.4, math.radians(30.0)
"""Correlation from which two move alike, below which they do not; and rad, by which a body that does is turned."""
CLEARLY = 3.0
"""How many times more of its motion is left unexplained by its own body than by another's that is taken for it."""

Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Standing:
    """A drone on the ground, before it is armed.

    home: (3,) m, None if it need not stand there;  own: what it says of itself, seen: what the cameras say of it, None
    where nothing is said.
    """

    home: Vec | None
    own: Pose | None
    seen: Pose | None


def before_arming(i: int, drones: Mapping[int, Standing]) -> list[str]:
    """Why drone i must not be armed; nothing if all agrees.

        |p_own - p_seen| <= PLACE,   |yaw_own - yaw_seen| <= ANGLE,   angle(z_own, z_seen) <= ANGLE,
        argmin_j |p_seen - home_j| = i

    A drone that is told where it is by the cameras agrees with whatever body it is told: then only homes, and what it
    does in the air, tell one from another.
    """
    me = drones[i]
    found = [] if me.own else ["it does not say where it is"]
    if me.seen is None:
        return [*found, "the cameras do not see it"]
    if me.own is not None:
        found += _disagreement(me.own, me.seen)
    return [*found, *_elsewhere(i, drones, me.seen)]


def _disagreement(own: Pose, seen: Pose) -> list[str]:
    """What it says of itself, beside what is seen of it."""
    found, far = [], float(np.linalg.norm(own.p - seen.p))
    if not far <= PLACE:
        found.append(f"it takes itself to be {far:.2f} m from where it is seen, limit {PLACE} m")
    yaw = abs(wrap(yaw_of(own.q) - yaw_of(seen.q)))
    if not yaw <= ANGLE:
        found.append(
            f"it looks {math.degrees(yaw):.0f} deg away from how it is seen, limit {math.degrees(ANGLE):.0f} deg: "
            "its body was defined, or put on, the wrong way round"
        )
    tilt = math.acos(max(-1.0, min(1.0, dot(columns(tuple(own.q))[2], columns(tuple(seen.q))[2]))))
    if not tilt <= ANGLE:
        found.append(
            f"it is seen tilted by {math.degrees(tilt):.0f} deg from what it says, limit {math.degrees(ANGLE):.0f} "
            "deg: its body is mounted askew (`crazychoir mocap calibrate`)"
        )
    return found


def _elsewhere(i: int, drones: Mapping[int, Standing], seen: Pose) -> list[str]:
    """Whether its body stands at somebody else's home."""
    homes = {j: one.home for j, one in drones.items() if one.home is not None}
    if i not in homes:
        return []
    far = {j: float(np.linalg.norm(seen.p - home)) for j, home in homes.items()}
    j = min(far, key=lambda j: far[j])
    if j == i:
        return []
    text = f"its body is {far[j]:.2f} m from the home of drone {j}, {far[i]:.2f} m from its own"
    other = drones[j].seen
    swapped = other is not None and _nearest(other.p, homes) == i
    return [f"{text}: exchanged with that of drone {j}" if swapped else text]


def _nearest(p: Vec, homes: Mapping[int, Vec]) -> int:
    return min(homes, key=lambda j: float(np.linalg.norm(p - homes[j])))


@dataclass
class Ascent:
    """What one drone and its body do from the ground to 0.1 m; `add` the newest of both, at any rate, all drones alike.

    Tilts are (roll, pitch) rad, or their rates rad/s, of R = Rz(yaw) Ry(pitch) Rx(roll): own ones by the drone's own
    sensors, as its gyroscope integrated, or the estimate of one that is told places alone until then. An estimate that
    is told attitudes by the cameras repeats those of whatever body it is told.
    """

    _times: list[float] = field(default_factory=list)
    _own: list[complex] = field(default_factory=list)
    _seen: list[complex] = field(default_factory=list)
    _heights: list[float] = field(default_factory=list)
    _flies: list[bool] = field(default_factory=list)

    def add(self, t: float, flies: bool, own: tuple[float, float], height: float, seen: tuple[float, float]) -> None:
        """At t s: whether it says that it flies, its own tilt, and height m and tilt of its body, nan if not seen."""
        self._times.append(t)
        self._flies.append(flies)
        self._own.append(complex(*own))
        self._seen.append(complex(*seen))
        self._heights.append(height)

    @property
    def rise(self) -> float:
        """m, by which its body is above where it was first; nan if it was not seen."""
        seen = [z for z in self._heights if math.isfinite(z)]
        return seen[-1] - seen[0] if seen else math.nan

    @property
    def flown(self) -> float:
        """s for which it has been flying, by its own account."""
        since = next((t for t, flies in zip(self._times, self._flies, strict=True) if flies), math.inf)
        return self._times[-1] - since if self._flies and self._flies[-1] else 0.0

    def likeness(self, other: "Ascent") -> complex | None:
        """How the drone's own tilt goes with that of the other's body; None if too little was seen, or moved.

            rho = sum s_k conj(b_k) / sqrt(sum |s_k|^2  sum |b_k|^2),   s, b: roll + i pitch, less their means

        |rho| = 1: they move alike;  arg rho: rad by which that body's axes are turned about z, 0 if they are its own.
        """
        count = min(len(self._own), len(other._seen))
        own, seen = np.array(self._own[:count]), np.array(other._seen[:count])
        good = np.isfinite(own) & np.isfinite(seen)
        if good.sum() < SAMPLES:
            return None
        s, b = _centred(own[good]), _centred(seen[good])
        energy = math.sqrt(float(np.sum(np.abs(s) ** 2) * np.sum(np.abs(b) ** 2)))
        if np.sqrt(np.mean(np.abs(s) ** 2)) < MOVED:
            return None
        return complex(np.vdot(b, s)) / energy if energy > 0.0 else 0j


def _centred(series: Complex) -> Complex:
    found: Complex = series - series.mean()
    return found


def in_the_air(i: int, ascents: Mapping[int, Ascent]) -> list[str]:
    """Why drone i must go down again, at 0.1 m; nothing if its body does what it does, or too little to tell."""
    return [*_height(i, ascents), *_motion(i, ascents)]


def _height(i: int, ascents: Mapping[int, Ascent]) -> list[str]:
    """Whether a body rises that should not, or stays that should rise."""
    me = ascents[i]
    if me.flown == 0.0:
        return [f"it does not fly, and its body has risen by {me.rise:.2f} m"] if me.rise >= ROSE else []
    if me.rise >= STAYED:
        return []
    others = [j for j, one in ascents.items() if j != i and one.flown == 0.0 and one.rise >= ROSE]
    if others:
        return [f"it flies, its body stays, and that of drone {others[0]}, which does not fly, rises: exchanged"]
    stays = "its body is not seen" if math.isnan(me.rise) else f"its body has risen by {me.rise:.2f} m"
    return [f"it flies for {me.flown:.1f} s, and {stays}"] if me.flown >= FLOWN else []


def _motion(i: int, ascents: Mapping[int, Ascent]) -> list[str]:
    """Whether it tilts as its body does.

    Drones that take off together tilt together, so a body that goes well with a drone need not be its own: it is that
    of drone j if 1 - Re rho_ij is less than 1 / CLEARLY of 1 - Re rho_ii.
    """
    rho = ascents[i].likeness(ascents[i])
    if rho is None:
        return []
    like = {j: found.real for j in ascents if j != i and (found := ascents[i].likeness(ascents[j])) is not None}
    j = max(like, key=lambda j: like[j], default=i)
    if like.get(j, -1.0) >= ALIKE and 1.0 - like[j] < (1.0 - rho.real) / CLEARLY:
        return [f"it tilts as the body of drone {j} does, not as its own: exchanged"]
    if abs(rho) < UNLIKE:
        return [f"its body does not tilt as it does (correlation {abs(rho):.2f})"]
    if abs(rho) >= ALIKE and abs(cmath.phase(rho)) > TURNED:
        return [f"its body tilts as if turned by {math.degrees(cmath.phase(rho)):.0f} deg about z"]
    return []
