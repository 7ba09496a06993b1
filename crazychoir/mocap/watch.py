"""How well the cameras see: rates, gaps, bodies that are missing, nobody's, or stand exactly still; and what to say."""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crazychoir.mocap.frames import Frame
from crazychoir.runtime.throttle import Throttle
from crazychoir.types import Vec

WINDOW = 2.0
"""s over which rates are averaged."""
SLOW = 0.8
"""Of [mocap] rate, which the filters of the drones count on: below it is said."""
GAP, SHORT = 3.0, 0.05
"""Periods without a frame, or without a body in frames, that are a gap; and s of no frame that nobody minds: drones
brake after 0.1 s without a pose."""
MISSING = 0.5
"""s after which a body is missing."""
FROZEN = 0.5
"""s for which no camera measures the same digits."""
OFTEN = 0.05
"""Of the frames without a body, also where none of its gaps is long."""
STRANGE = 1.0
"""s for which a body was seen at least that belongs to nobody."""


@dataclass
class Sight:
    """What was seen of one body.

    first, last: s, when it was measured: in a frame, with other digits than before where the source is live;  shown: s,
    when it was in a frame;  frames: in which it was measured;  dropped: frames without it since the first;  gap: s, the
    longest between two measurements that has not been said;  rate: Hz, nan before there is one;  share: of the frames
    that are without it.
    """

    first: float
    last: float
    shown: float
    flat: Vec
    frames: int = 0
    dropped: int = 0
    gap: float = 0.0
    rate: float = math.nan
    share: float = 0.0
    _counted: tuple[int, int] = (0, 0)

    def see(self, flat: Vec, now: float, live: bool) -> None:
        """It is in this frame."""
        self.shown = now
        if live and self.frames and np.array_equal(flat, self.flat):
            return  # shown again: some systems hand out what they had, as often as they are asked
        self.gap = max(self.gap, now - self.last)
        self.flat = flat
        self.last = now
        self.frames += 1

    def average(self, seconds: float) -> None:
        """Its rate and share, over what was counted since this was called last."""
        seen = self.frames - self._counted[0]
        gone = self.dropped - self._counted[1]
        self.rate = seen / seconds
        self.share = gone / max(1, seen + gone)
        self._counted = self.frames, self.dropped


class Watch:
    """Takes in each frame that is published; `look` at it some times a second.

    names: of the drones' bodies, by drone;  rate: Hz that the swarm file promises;  live: whether what does not change
    at all is not measured.
    """

    def __init__(self, names: Mapping[int, str], rate: float, live: bool) -> None:
        self.names = dict(names)
        self.rate = rate
        self.live = live
        self.sights: dict[str, Sight] = {}
        self.frames = 0
        self.mean_rate = math.nan
        self._began = math.nan
        self._last = math.nan
        self._gap = 0.0
        self._window = math.nan
        self._counted = 0
        self._frames_gap = 0.0
        # since gaps were said last
        self._longest = 0.0
        self._gaps = 0
        self._throttle = Throttle()
        self._doubled: dict[str, float] = {}  # when a name was last there twice, s

    def note(self, frame: Frame, now: float) -> None:
        """A frame has come."""
        if math.isnan(self._began):
            self._began = self._window = self._last = now
        gap = now - self._last
        self._last = now
        self._gap = max(self._gap, gap)
        self._longest = max(self._longest, gap)
        self._gaps += gap > self._limit
        self.frames += 1
        for name in frame.doubled:
            self._doubled[name] = now
        for name, flat in frame.bodies.items():
            sight = self.sights.get(name)
            if sight is None:
                sight = self.sights[name] = Sight(now, now, now, flat)
            sight.see(flat, now, self.live)
        for name, sight in self.sights.items():
            sight.dropped += name not in frame.bodies

    def age(self, name: str, now: float) -> float:
        """s for which a body has shown the very same pose, where nothing that is measured does; else 0."""
        return now - self.sights[name].last if self.live else 0.0

    def look(self, now: float) -> list[str]:
        """What is wrong, each thing at most once a second and ever more rarely."""
        if now - self._window >= WINDOW:
            self._average(now)
        if math.isnan(self._began) or now - self._last > WINDOW:
            return []  # the source says that nothing comes
        found = [*self._of_frames(), *self._of_strangers(now), *self._of_doubled(now)]
        for i, name in self.names.items():
            found += self._of_body(i, name, now)
        found = [
            (topic, text) for topic, text in found if self._throttle.due(now, topic)
        ]
        if any(topic == "gap" for topic, _ in found):
            self._longest = 0.0
            self._gaps = 0
        return [text for _, text in found]

    @property
    def _limit(self) -> float:
        """s without a frame that are said."""
        return max(GAP / self.rate, SHORT)

    def _average(self, now: float) -> None:
        seconds = now - self._window
        self.mean_rate = (self.frames - self._counted) / seconds
        self._window = now
        self._counted = self.frames
        for sight in self.sights.values():
            sight.average(seconds)

    def _of_frames(self) -> list[tuple[str, str]]:
        found, (gap, self._gap) = [], (self._gap, 0.0)
        self._frames_gap = gap
        if self.mean_rate < SLOW * self.rate:
            slow = f"frames come at {self.mean_rate:.0f} Hz; the drones count on [mocap] rate = {self.rate:g}"
            found.append(
                (
                    "rate",
                    f"{slow}. Raise it at the cameras, or lower it in the swarm file.",
                )
            )
        if gap > self._limit:
            often = f"; {self._gaps} such gaps" if self._gaps > 1 else ""
            found.append(
                (
                    "gap",
                    f"no frame for {self._longest:.3f} s, more than {self._limit:g} s{often}",
                )
            )
        return found

    def _of_strangers(self, now: float) -> list[tuple[str, str]]:
        """Bodies that are seen and belong to nobody."""
        own = self.names.values()
        strange = [
            name
            for name, one in self.sights.items()
            if name not in own and one.shown - one.first > STRANGE
        ]
        if not strange or all(
            now - self.sights[name].shown > WINDOW for name in strange
        ):
            return []
        return [
            (
                "strangers",
                f"seen, and nobody's: {_list(strange)}. The swarm file has {_list(list(own))}.",
            )
        ]

    def _of_doubled(self, now: float) -> list[tuple[str, str]]:
        """Names that were lately given to two bodies of a frame."""
        said = "is there twice in a frame: which is meant is not known, so it counts as not seen. Rename one of them."
        names = sorted(name for name, at in self._doubled.items() if now - at <= WINDOW)
        return [(f"{name} doubled", f"body {name!r} {said}") for name in names]

    def _of_body(self, i: int, name: str, now: float) -> list[tuple[str, str]]:
        sight = self.sights.get(name)
        who = f"body {name!r} of drone {i}"
        if sight is None:
            if now - self._began < MISSING:
                return []
            return [(f"{i} missing", f"{who} was never seen. {self._meant(name)}")]
        if now - sight.shown > MISSING:
            return [
                (f"{i} missing", f"{who} is not seen for {now - sight.shown:.1f} s")
            ]
        if now - sight.last > FROZEN:
            still = f"{who} shows the very same pose for {now - sight.last:.1f} s"
            return [
                (
                    f"{i} frozen",
                    f"{still}: no camera measures that; it counts as not seen",
                )
            ]
        return self._of_rate(i, who, sight)

    def _of_rate(self, i: int, who: str, sight: Sight) -> list[tuple[str, str]]:
        """Gaps, dropouts, and measurements that come less often than frames."""
        gap = sight.gap
        sight.gap = 0.0
        if (
            gap > max(GAP, 1.0 + self._frames_gap * self.rate) / self.rate
        ):  # else there were no frames at all
            return [(f"{i} gap", f"{who} was not seen for {gap:.3f} s")]
        if self.live and sight.share > OFTEN:
            return [
                (
                    f"{i} often",
                    f"{who} is missing in {100.0 * sight.share:.0f} % of the frames",
                )
            ]
        if self.live and sight.rate < SLOW * min(self.rate, self.mean_rate):
            return [
                (
                    f"{i} slow",
                    f"{who} is measured at {sight.rate:.0f} Hz, shown at {self.mean_rate:.0f} Hz",
                )
            ]
        return []

    def _meant(self, name: str) -> str:
        """What there is, and which of it may be meant."""
        own = self.names.values()
        free = [other for other in self.sights if other not in own]
        near = difflib.get_close_matches(
            name.lower(), [other.lower() for other in free], n=1, cutoff=0.5
        )
        meant = next(
            (other for other in free if near and other.lower() == near[0]), None
        )
        there = (
            f"Seen are {_list(list(self.sights))}" if self.sights else "No body is seen"
        )
        return (
            f'{there}. Did you mean body = "{meant}"?'
            if meant
            else f"{there}. See `crazychoir mocap names`."
        )


def _list(names: list[str]) -> str:
    """The first of them."""
    shown = ", ".join(map(repr, sorted(names)[:8]))
    return shown + (f" and {len(names) - 8} more" if len(names) > 8 else "")
