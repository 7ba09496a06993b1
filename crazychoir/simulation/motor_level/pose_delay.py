"""The way of a camera pose to the estimator on board: late, and not always equally late."""

from collections import deque

from crazychoir.simulation.common.draws import (
    RANDOM_STREAMS,
    derive_stream_key,
    draw_uniform,
)
from crazychoir.types import Bools, Mat


class PoseDelay:
    """Frames of poses on their way to the estimators on board. No frame overtakes another.

    The delay of a frame is a function of (seed, tick) alone, uniform in latency +- jitter, rounded
    to steps of the world.

    latency: s: mean delay
    jitter: s: largest difference from the mean
    seed: of every draw
    dt: s: one step of the world
    """

    def __init__(self, latency: float, jitter: float, seed: int, dt: float) -> None:
        self._latency = latency
        self._jitter = jitter
        self._key = derive_stream_key(seed, RANDOM_STREAMS.pose_delay, 0)
        self._dt = dt
        self._waiting: deque[tuple[int, Mat, Bools]] = deque()

    def send(self, tick: int, flat: Mat, seen: Bools) -> None:
        """Send the poses of one exposure.

        flat: (n, 7): rows laid out as Pose.flat, one a drone
        seen: (n,): whether the drone was seen
        """
        delay = self._latency + self._jitter * draw_uniform(self._key, tick)
        due = tick + max(round(delay / self._dt), 0)
        if self._waiting:
            due = max(due, self._waiting[-1][0])
        self._waiting.append((due, flat, seen))

    def receive(self, tick: int) -> list[tuple[Mat, Bools]]:
        """Return the frames that arrive until this tick, and forget them."""
        arrived = []
        while self._waiting and self._waiting[0][0] <= tick:
            _, flat, seen = self._waiting.popleft()
            arrived.append((flat, seen))
        return arrived
