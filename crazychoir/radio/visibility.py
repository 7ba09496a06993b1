"""What the owner of a dongle sees of all bodies, and when it lets a drone take its attitude from the cameras."""

import math
from functools import partial

from crazychoir.bus.port import EYES, Bus
from crazychoir.bus.topics import BODY, POSE
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.identity.takeoff_check import LONGEST, Ascent, Track, tilt
from crazychoir.types import Body, Pose, Vec

RATE = 50.0
"""Hz, at which bodies are looked at, and not their drones told of it."""
OLD = 0.2
"""s, there and back, from which on what a drone says of itself is too old to be compared."""


class Sights:
    """The bodies of a swarm, as the cameras have seen them lately; once a process.

    reader: the port that they come to.
    """

    def __init__(self, bus: Bus, config: SwarmConfig, reader: int) -> None:
        self._clock = bus.clock
        self.tracks = {i: Track() for i in config.seen}
        for i in config.seen:
            bus.subscribe(
                POSE,
                EYES + i,
                reader,
                Call(bus.clock, partial(self._seen, i), "sights"),
                RATE,
            )
            bus.subscribe(
                BODY,
                config.source(BODY, i),
                reader,
                Call(bus.clock, partial(self._flies, i), "sights"),
            )

    def _flies(self, i: int, body: Body, age: float) -> None:
        self.tracks[i].flies = body.flying

    def _seen(self, i: int, pose: Pose, age: float) -> None:
        self.tracks[i].add(
            self._clock.now() - max(age, pose.age), tilt(pose.q), float(pose.p[2])
        )


class TakeOff:
    """Watches one drone from when it is told to fly until it is known that its body moves as it does.

    found: why it must come down, empty if nothing is wrong.
    """

    def __init__(self, i: int, sights: Sights) -> None:
        self.drone = i
        self.sights = sights
        self.found = ""
        self._own = Track()
        self._began = math.nan
        self._flies = False
        self._ascent: Ascent | None = None

    @property
    def watched(self) -> bool:
        """Whether its attitude is its own to find meanwhile."""
        return self._ascent is not None

    def begin(self, now: float) -> None:
        """It stands, and is told to fly; once a flight."""
        if math.isnan(self._began):
            self._began = now
            self._ascent = Ascent(self.drone, now, self._own, self.sights.tracks)

    def give_up(self) -> None:
        """Its pose jumps: that is another row of the safety table."""
        if not self.found:
            self._ascent = None

    def note(self, taken: float, q: Vec, flies: bool, latency: float) -> bool:
        """It has said how it is turned, q (4,) body to world, and whether it flies; whether something was found now.

        taken: s, when it was so: links say late, and all at once, what they could not;  latency: s, there and back, nan
        if it is not known.
        """
        u = tilt(q)
        self._own.add(taken, u)
        if (self._flies and not flies) or (not flies and taken - self._began > LONGEST):
            self._began = math.nan
            self._ascent = None
        self._flies = flies
        if self._ascent is None or self.found or latency > OLD or taken < self._began:
            return False
        self.found = self._ascent.judge(taken, u, flies)
        if self._ascent.over and not self.found:
            self._ascent = None
        return bool(self.found)
