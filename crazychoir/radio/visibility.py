"""The bodies that a dongle's owner sees, and the check that a drone moves like its body.

Until this check has passed, the drone takes only its position from the cameras, not its attitude.
"""

import math
from dataclasses import dataclass
from functools import partial

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.identity.takeoff_check import (
    TAKEOFF_WATCH,
    TakeoffCheck,
    TiltTrack,
    compute_tilt,
)
from crazychoir.types import Body, Pose, Vec


@dataclass(frozen=True, slots=True)
class SightLimits:
    """How the cameras' poses are read for the comparison with a drone's logs."""

    pose_rate: float = 50.0
    """Hz at which the poses of bodies are read here; drones are told their poses at another rate.
    """
    longest_round_trip: float = 0.2
    """s: with a longer round trip a drone's logs are too old to be compared."""


SIGHT_LIMITS = SightLimits()


class BodySights:
    """The recent poses of the swarm's bodies from the cameras; one object a process.

    reader: the port that receives the poses
    """

    def __init__(self, bus: Bus, config: SwarmConfig, reader: int) -> None:
        self._clock = bus.clock
        self.tracks = {i: TiltTrack() for i in config.topology.seen}
        """Recent motion of each body."""
        for i in config.topology.seen:
            bus.subscribe(
                DRONE_TOPICS.pose,
                PORT_ADDRESSES.camera_offset + i,
                reader,
                Call(bus.clock, partial(self._seen, i), "sights"),
                SIGHT_LIMITS.pose_rate,
            )
            bus.subscribe(
                DRONE_TOPICS.body,
                config.topology.source(DRONE_TOPICS.body, i),
                reader,
                Call(bus.clock, partial(self._flies, i), "sights"),
            )

    def _flies(self, i: int, body: Body, age: float) -> None:
        self.tracks[i].flies = body.flying

    def _seen(self, i: int, pose: Pose, age: float) -> None:
        self.tracks[i].add(
            self._clock.now() - max(age, pose.age),
            compute_tilt(pose.q),
            float(pose.p[2]),
        )


class TakeOffWatch:
    """Watches one drone from its take-off until its body is known to move as the drone does.

    i: id of the drone
    sights: the bodies that the cameras see
    """

    def __init__(self, i: int, sights: BodySights) -> None:
        self.drone = i
        self.sights = sights
        self.found = ""
        """Reason why the drone must land; empty if nothing is wrong."""
        self._own = TiltTrack()
        self._began = math.nan
        self._flies = False
        self._ascent: TakeoffCheck | None = None

    @property
    def watched(self) -> bool:
        """Whether the drone must find its attitude by itself, because the check still runs."""
        return self._ascent is not None

    def begin(self, now: float) -> None:
        """Start the check of a standing drone that gets its first command to fly; once a flight."""
        if math.isnan(self._began):
            self._began = now
            self._ascent = TakeoffCheck(self.drone, now, self._own, self.sights.tracks)

    def give_up(self) -> None:
        """End the check because the pose jumps, which another row of the safety table handles."""
        if not self.found:
            self._ascent = None

    def note(self, taken: float, q: Vec, flies: bool, latency: float) -> bool:
        """Take a log of the drone; return whether a fault is known now.

        taken: s: when the log was taken; a link may deliver logs late and several together
        q: (4,), body to world: attitude that the drone estimates
        flies: whether the drone says that it flies
        latency: s: round trip of the link; NaN if unknown
        """
        u = compute_tilt(q)
        self._own.add(taken, u)
        if (self._flies and not flies) or (
            not flies and taken - self._began > TAKEOFF_WATCH.longest
        ):
            self._began = math.nan
            self._ascent = None
        self._flies = flies
        if (
            self._ascent is None
            or self.found
            or latency > SIGHT_LIMITS.longest_round_trip
            or taken < self._began
        ):
            return False
        self.found = self._ascent.judge(taken, u, flies)
        if self._ascent.over and not self.found:
            self._ascent = None
        return bool(self.found)
