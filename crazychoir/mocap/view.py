"""From frames as a source hands them over to those that are published: in order, not too many, as cameras see them."""

import math
from dataclasses import replace

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.files.recorded_times import LARGEST_TIME
from crazychoir.filters.velocity import readable
from crazychoir.mocap.frames import Frame
from crazychoir.mocap.simulated import SimulatedMocap

EARLY = 0.9
"""Of a period that a frame may come early: less, and of 120 a second only 90 would pass a limit of 100."""
BACK = 1.0
"""s by which time goes back when a source was started again."""


class RateLimit:
    """Lets at most `rate` frames a second through, on average, and those of that very rate although they jitter.

    A frame at t passes if t >= due - EARLY / rate; then due becomes max(due, t) + 1 / rate. A time that is earlier than
    the one before is of a clock that was set back: it passes, and due counts from there.
    """

    def __init__(self, rate: float) -> None:
        self.period = 1.0 / rate
        self._due = -math.inf
        self._last = -math.inf

    def passes(self, t: float) -> bool:
        """Whether a frame of the time t s, of its source, is let through."""
        is_set_back = t < self._last
        self._last = t
        if is_set_back:
            self._due = t
        if t < self._due - EARLY * self.period:
            return False
        self._due = max(self._due, t) + self.period
        return True


class Blur:
    """What cameras would make of exact poses, by the keys of [mocap]: noise, tilt, dropouts, latency.

    Bodies that belong to no drone are shown as they are.
    """

    def __init__(self, config: SwarmConfig) -> None:
        mocap = config.mocap
        ids = config.seen
        self._names = [config.body_name(i) for i in ids]
        self._cameras = SimulatedMocap(
            ids,
            config.seed,
            noise_p=mocap.noise,
            noise_angle=mocap.noise_angle,
            dropout=mocap.dropout,
            latency_steps=round(mocap.latency * mocap.rate),
            dt=1.0 / mocap.rate,
            tilt=mocap.tilt,
        )
        self._rate = mocap.rate
        self._tick = -1
        self._began = math.nan

    def see(self, frame: Frame) -> tuple[Frame, float]:
        """The frame that arrives instead of this one, and how old it is, in s."""
        x = np.full((len(self._names), 13), np.nan)
        for row, name in enumerate(self._names):
            if name in frame.bodies:
                x[row, 0:3] = frame.bodies[name][0:3]
                x[row, 6:10] = frame.bodies[name][3:7]
        poses = self._cameras.sample(x, self._next_tick(frame.time))
        bodies = {
            name: flat for name, flat in frame.bodies.items() if name not in self._names
        }
        shown = {
            name: pose
            for name, pose in zip(self._names, poses, strict=True)
            if pose and readable(pose.flat)
        }
        age = next((pose.age for pose in shown.values()), 0.0)
        return replace(
            frame, bodies=bodies | {name: pose.flat for name, pose in shown.items()}
        ), age

    def _next_tick(self, t: float) -> int:
        """The exposure of a frame: periods since the first, one at least."""
        if math.isnan(self._began):
            self._began = t
        self._tick = max(self._tick + 1, round((t - self._began) * self._rate))
        return self._tick


class View:
    """Takes frames of a source in; says which of them are published, and how.

    Times may count from any origin. A frame that comes after a later one is told from a clock that was set back by its
    number.
    rate: Hz, at most;  blur: of exact poses, None for cameras;  lost: frames that never came, by their numbers;
    late: frames that came after a later one;  timeless: frames whose time is no time in seconds.
    Poses that are no poses are left out.
    """

    def __init__(self, rate: float, blur: Blur | None = None) -> None:
        self.blur = blur
        self.lost = 0
        self.late = 0
        self.timeless = 0
        self._pace = RateLimit(rate)
        self._last = Frame(-1, -math.inf, {})

    def see(self, frame: Frame) -> tuple[Frame, float] | None:
        """The frame to publish, and by how many s it is older than the one that came; None for none."""
        if not self._follows(frame) or not self._pace.passes(frame.time):
            return None
        good = {name: flat for name, flat in frame.bodies.items() if readable(flat)}
        frame = replace(frame, bodies=good)
        return (frame, 0.0) if self.blur is None else self.blur.see(frame)

    def _follows(self, frame: Frame) -> bool:
        """Whether it comes after the last one, or from a source that was started again."""
        last = self._last
        if not abs(frame.time) < LARGEST_TIME:  # nan, too
            self.timeless += 1
            return False
        if last.time - BACK < frame.time <= last.time and frame.number <= last.number:
            self.late += 1
            return False
        if last.number >= 0 and frame.time > last.time:
            self.lost += max(0, frame.number - last.number - 1)
        self._last = frame
        return True
