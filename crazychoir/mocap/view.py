"""Turn the frames of a source into the published frames.

These are in order, at a limited rate, and blurred if they are exact.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.files.recorded_times import RECORDED_TIME_LIMITS
from crazychoir.filters.poses import is_readable
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.simulated import SimulatedMocap


@dataclass(frozen=True, slots=True)
class FrameTiming:
    """How the times of frames are judged."""

    early_share: float = 0.9
    """Share of a period by which a frame may come early. A smaller share would let only 90 of 120
    frames a second pass a limit of 100.
    """
    restart_jump: float = 1.0
    """s: time goes back by at least this when a source was started again."""


FRAME_TIMING = FrameTiming()


class RateLimit:
    """Lets at most `rate` frames a second through, on average.

    A frame at time t passes if t >= due - e / rate with e = `FRAME_TIMING.early_share`; then due
    becomes max(due, t) + 1 / rate. Therefore frames that come at exactly this rate all pass, even
    with jitter. If t is before the last frame, the clock was set back: the frame passes, and due is
    counted from t.

    rate: Hz
    """

    def __init__(self, rate: float) -> None:
        self.period = 1.0 / rate
        self._due = -math.inf
        self._last = -math.inf

    def passes(self, t: float) -> bool:
        """Return whether a frame passes.

        t: s: time of the frame, on the source's clock
        """
        is_set_back = t < self._last
        self._last = t
        if is_set_back:
            self._due = t
        if t < self._due - FRAME_TIMING.early_share * self.period:
            return False
        self._due = max(self._due, t) + self.period
        return True


class CameraBlur:
    """Turns exact poses into poses as cameras would measure them.

    Noise, tilt, dropouts and latency are those of [mocap]. Bodies that belong to no drone stay
    exact.
    """

    def __init__(self, config: SwarmConfig) -> None:
        ids = config.topology.seen
        self._names = [config.body_name(i) for i in ids]
        self._cameras = SimulatedMocap.of(config, ids)
        self._rate = config.mocap.rate
        self._tick = -1
        self._began = math.nan

    def see(self, frame: PoseFrame) -> tuple[PoseFrame, float]:
        """Return the frame that arrives in place of this one, and its age in s."""
        x = np.full((len(self._names), 13), np.nan)
        for row, name in enumerate(self._names):
            if name in frame.bodies:
                x[row, 0:3] = frame.bodies[name][0:3]
                x[row, 6:10] = frame.bodies[name][3:7]
        seen = self._cameras.sample(x, self._next_tick(frame.time))
        bodies = {
            name: flat for name, flat in frame.bodies.items() if name not in self._names
        }
        if seen is None:
            return replace(frame, bodies=bodies), 0.0
        shown = {
            name: flat
            for name, flat, is_seen in zip(
                self._names, seen.flat, seen.seen.tolist(), strict=True
            )
            if is_seen and is_readable(flat)
        }
        return replace(frame, bodies=bodies | shown), seen.age if shown else 0.0

    def _next_tick(self, t: float) -> int:
        """Return the number of the exposure of a frame at t s.

        It is the number of periods since the first frame, and larger than the last number.
        """
        if math.isnan(self._began):
            self._began = t
        self._tick = max(self._tick + 1, round((t - self._began) * self._rate))
        return self._tick


class FrameFilter:
    """Decides which frames of a source are published, and in which form.

    Invalid poses are left out. Times may have any origin. The number of a frame distinguishes a
    late frame from a clock that was set back.

    rate: Hz: highest rate
    blur: blurs exact poses; None for cameras
    """

    def __init__(self, rate: float, blur: CameraBlur | None = None) -> None:
        self.blur = blur
        self.lost = 0
        """Frames that never arrived, by their numbers."""
        self.late = 0
        """Frames that arrived after a later one."""
        self.timeless = 0
        """Frames with a time that is not in seconds."""
        self._pace = RateLimit(rate)
        self._last = PoseFrame(-1, -math.inf, {})

    def see(self, frame: PoseFrame) -> tuple[PoseFrame, float] | None:
        """Return the frame to publish, and how many s older it is than the given frame.

        Returns None if no frame is published.
        """
        if not self._follows(frame) or not self._pace.passes(frame.time):
            return None
        good = {name: flat for name, flat in frame.bodies.items() if is_readable(flat)}
        frame = replace(frame, bodies=good)
        return (frame, 0.0) if self.blur is None else self.blur.see(frame)

    def _follows(self, frame: PoseFrame) -> bool:
        """Return whether a frame is later than the last, or its source was started again."""
        last = self._last
        if not abs(frame.time) < RECORDED_TIME_LIMITS.largest_time:  # also true for NaN
            self.timeless += 1
            return False
        if (
            last.time - FRAME_TIMING.restart_jump < frame.time <= last.time
            and frame.number <= last.number
        ):
            self.late += 1
            return False
        if last.number >= 0 and frame.time > last.time:
            self.lost += max(0, frame.number - last.number - 1)
        self._last = frame
        return True
