"""Watch the quality of the tracking, and report problems.

Problems are low rates, gaps, missing bodies, unknown bodies, doubled names and frozen poses.
"""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crazychoir.mocap.frames import PoseFrame
from crazychoir.runtime.throttle import Throttle
from crazychoir.types import Vec


@dataclass(frozen=True, slots=True)
class TrackingLimits:
    """Limits beyond which the tracking of bodies is reported as bad."""

    window: float = 2.0
    """s: time over which rates are averaged."""
    least_rate_share: float = 0.8
    """Share of [mocap] rate below which the rate is reported: the drones' filters expect that
    rate.
    """
    gap_periods: float = 3.0
    """Periods without a frame, or without a body in the frames, that count as a gap."""
    harmless_gap: float = 0.05
    """s: a shorter gap between frames is harmless. Drones brake later (safety/rules/guard.py)."""
    missing_time: float = 0.5
    """s: time after which a body is missing."""
    frozen_time: float = 0.5
    """s: time of identical numbers after which a pose is not a measurement."""
    dropout_share: float = 0.05
    """Share of frames without a body above which this is reported, even if no gap is long."""
    stranger_time: float = 1.0
    """s: time for which an unknown body must be seen until it is reported."""


TRACKING_LIMITS = TrackingLimits()


@dataclass
class BodyRecord:
    """The record of one body.

    A body is measured when it is in a frame; if the source is live, also with other numbers than
    before.
    """

    first: float
    """s: time of the first measurement."""
    last: float
    """s: time of the last measurement."""
    shown: float
    """s: last time that it was in a frame."""
    flat: Vec
    """(7,): last measured pose."""
    frames: int = 0
    """Frames in which it was measured."""
    dropped: int = 0
    """Frames without it since the first."""
    gap: float = 0.0
    """s: longest time between two measurements since the last check."""
    rate: float = math.nan
    """Hz of measurements; NaN while unknown."""
    share: float = 0.0
    """Share of the frames without it."""
    _counted: tuple[int, int] = (0, 0)
    """`frames` and `dropped` at the last call of `average`."""

    def see(self, flat: Vec, now: float, live: bool) -> None:
        """Take the pose of a frame that contains the body."""
        self.shown = now
        if live and self.frames and np.array_equal(flat, self.flat):
            return  # an old pose: some systems repeat it as often as they are asked
        self.gap = max(self.gap, now - self.last)
        self.flat = flat
        self.last = now
        self.frames += 1

    def average(self, seconds: float) -> None:
        """Compute `rate` and `share` from the frames since the last call.

        seconds: s since the last call
        """
        seen = self.frames - self._counted[0]
        gone = self.dropped - self._counted[1]
        self.rate = seen / seconds
        self.share = gone / max(1, seen + gone)
        self._counted = self.frames, self.dropped


class TrackingWatch:
    """Checks each published frame for problems; call `look` some times a second to get them.

    names: name of each drone's body
    rate: Hz that the swarm file promises
    live: True if identical poses are not measurements
    """

    def __init__(self, names: Mapping[int, str], rate: float, live: bool) -> None:
        self.names = dict(names)
        self.rate = rate
        self.live = live
        self.sights: dict[str, BodyRecord] = {}
        """Record of each body, by name."""
        self.frames = 0
        """Frames so far."""
        self.mean_rate = math.nan
        """Hz of frames; NaN while unknown."""
        self._began = math.nan
        self._last = math.nan
        self._gap = 0.0
        self._window = math.nan
        self._counted = 0
        self._frames_gap = 0.0
        # Longest gap and number of gaps since the last report.
        self._longest = 0.0
        self._gaps = 0
        self._throttle = Throttle()
        self._doubled: dict[str, float] = {}  # s: when a name was last doubled

    def note(self, frame: PoseFrame, now: float) -> None:
        """Take a frame."""
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
                sight = self.sights[name] = BodyRecord(now, now, now, flat)
            sight.see(flat, now, self.live)
        for name, sight in self.sights.items():
            sight.dropped += name not in frame.bodies

    def age(self, name: str, now: float) -> float:
        """Return for how many s a live body has shown the same pose.

        Returns 0 if the source is not live.
        """
        return now - self.sights[name].last if self.live else 0.0

    def look(self, now: float) -> list[str]:
        """Return what is wrong: each problem at most once a second, and more and more rarely."""
        if now - self._window >= TRACKING_LIMITS.window:
            self._average(now)
        if math.isnan(self._began) or now - self._last > TRACKING_LIMITS.window:
            return []  # the source itself reports the silence
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
        """Seconds without a frame from which a gap is reported."""
        return max(
            TRACKING_LIMITS.gap_periods / self.rate, TRACKING_LIMITS.harmless_gap
        )

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
        if self.mean_rate < TRACKING_LIMITS.least_rate_share * self.rate:
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
        """Return a problem if bodies are seen that belong to no drone."""
        own = self.names.values()
        strange = [
            name
            for name, one in self.sights.items()
            if name not in own and one.shown - one.first > TRACKING_LIMITS.stranger_time
        ]
        if not strange or all(
            now - self.sights[name].shown > TRACKING_LIMITS.window for name in strange
        ):
            return []
        return [
            (
                "strangers",
                f"bodies of no drone are seen: {_list_names(strange)}. The swarm file has {_list_names(list(own))}.",
            )
        ]

    def _of_doubled(self, now: float) -> list[tuple[str, str]]:
        """Return the names that were recently given to two bodies of a frame."""
        said = "is there twice in a frame: which is meant is not known, so it counts as not seen. Rename one of them."
        names = sorted(
            name
            for name, at in self._doubled.items()
            if now - at <= TRACKING_LIMITS.window
        )
        return [(f"{name} doubled", f"body {name!r} {said}") for name in names]

    def _of_body(self, i: int, name: str, now: float) -> list[tuple[str, str]]:
        sight = self.sights.get(name)
        body_name = f"body {name!r} of drone {i}"
        if sight is None:
            if now - self._began < TRACKING_LIMITS.missing_time:
                return []
            return [
                (f"{i} missing", f"{body_name} was never seen. {self._meant(name)}")
            ]
        if now - sight.shown > TRACKING_LIMITS.missing_time:
            return [
                (
                    f"{i} missing",
                    f"{body_name} is not seen for {now - sight.shown:.1f} s",
                )
            ]
        if now - sight.last > TRACKING_LIMITS.frozen_time:
            still = f"{body_name} shows the very same pose for {now - sight.last:.1f} s"
            return [
                (
                    f"{i} frozen",
                    f"{still}: no camera measures that; it counts as not seen",
                )
            ]
        return self._describe_rate(i, body_name, sight)

    def _describe_rate(
        self, i: int, body_name: str, sight: BodyRecord
    ) -> list[tuple[str, str]]:
        """Return gaps, dropouts, and measurements that come less often than frames."""
        gap = sight.gap
        sight.gap = 0.0
        # A shorter gap of the body is explained by a gap between frames.
        if (
            gap
            > max(TRACKING_LIMITS.gap_periods, 1.0 + self._frames_gap * self.rate)
            / self.rate
        ):
            return [(f"{i} gap", f"{body_name} was not seen for {gap:.3f} s")]
        if self.live and sight.share > TRACKING_LIMITS.dropout_share:
            return [
                (
                    f"{i} often",
                    f"{body_name} is missing in {100.0 * sight.share:.0f} % of the frames",
                )
            ]
        if self.live and sight.rate < TRACKING_LIMITS.least_rate_share * min(
            self.rate, self.mean_rate
        ):
            return [
                (
                    f"{i} slow",
                    f"{body_name} is measured at {sight.rate:.0f} Hz, shown at {self.mean_rate:.0f} Hz",
                )
            ]
        return []

    def _meant(self, name: str) -> str:
        """Return which bodies are seen, and which of them may be meant."""
        own = self.names.values()
        free = [other for other in self.sights if other not in own]
        near = difflib.get_close_matches(
            name.lower(), [other.lower() for other in free], n=1, cutoff=0.5
        )
        meant = next(
            (other for other in free if near and other.lower() == near[0]), None
        )
        there = (
            f"Seen are {_list_names(list(self.sights))}"
            if self.sights
            else "No body is seen"
        )
        return (
            f'{there}. Did you mean body = "{meant}"?'
            if meant
            else f"{there}. See `crazychoir mocap names`."
        )


def _list_names(names: list[str]) -> str:
    """Return the first names as text."""
    shown = ", ".join(map(repr, sorted(names)[:8]))
    return shown + (f" and {len(names) - 8} more" if len(names) > 8 else "")
