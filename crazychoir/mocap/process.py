"""Motion capture in a process of its own: frames of a source in, poses of the drones out."""

import logging
from dataclasses import dataclass
from typing import Any

from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.port import PORT_ADDRESSES, Bus, Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import DroneTable
from crazychoir.errors import ConfigError, Refused, error_text
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.mounting import Mounting
from crazychoir.mocap.recording import FrameRecorder, ReplaySource
from crazychoir.mocap.source import FrameSource, ReportText
from crazychoir.mocap.system import SystemSource
from crazychoir.mocap.view import CameraBlur, FrameFilter, RateLimit
from crazychoir.mocap.virtual import VirtualSource
from crazychoir.mocap.watch import TrackingWatch
from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.mailbox import Latest
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.types import Body, Pose, Vec

log = logging.getLogger(__name__)
TRACKING_CHECK_RATE = 4.0
"""Hz at which the quality of the tracking is checked."""
LISTED_BODIES = 8
"""Most names of bodies in an error."""
SHUTDOWN_PATIENCE = 60.0
"""Seconds for which the process goes on after it was asked to end.

It does so while a drone that it sees has an agent on the network, or flies.
"""


def make_source(
    clock: Clock, config: SwarmConfig, say: ReportText | None = None
) -> FrameSource:
    """Return the source of [mocap].

    Raises ConfigError if a recording cannot be read, or a library is missing.
    """
    mocap = config.mocap
    if mocap.source == "virtual":
        return VirtualSource(clock, mocap.hostname, mocap.port, say)
    if mocap.source == "replay":
        return ReplaySource(clock, mocap.file, say)
    return SystemSource(
        clock, mocap.source, mocap.hostname, mocap.options, mocap.connect_deadline, say
    )


def make_frame_filter(config: SwarmConfig) -> FrameFilter:
    """Return the view of [mocap] on its frames.

    Exact poses of virtual drones are blurred, as if cameras had measured them.
    """
    return FrameFilter(
        config.mocap.rate,
        CameraBlur(config) if config.mocap.source == "virtual" else None,
    )


@dataclass(frozen=True)
class TrackedDrone:
    """One drone that the cameras see."""

    name: str
    """Name of its body."""
    mounting: Mounting
    """Mounting of the body on the drone."""
    port: Port
    """Port that publishes its poses."""
    velocity: VelocityFilter
    """Filter for its velocity."""
    body: Latest[Body]
    """State of the drone, from the owner of its radio."""

    @property
    def flies(self) -> bool:
        """Whether the drone flies, as far as its owner has published it."""
        body = self.body.fresh()
        return body is not None and body.flying

    def make_pose(self, flat: Vec, age: float) -> Pose:
        """Return the pose of the drone, `age` s old, if its body has the pose `flat` (7,)."""
        return Pose(self.mounting.drone(flat), age)

    def find_pose(self, frame: PoseFrame, age: float) -> Pose | None:
        """Return the pose of the drone by its body in this frame, None if the frame lacks it."""
        flat = frame.bodies.get(self.name)
        return None if flat is None else self.make_pose(flat, age)


class SourceRunner(Actor):
    """Runs a source, and runs it again after a failure."""

    name = "cameras"
    restart = RESTART_ON_FAILURE

    def __init__(self, process: "MocapProcess") -> None:
        self._process = process

    async def run(self) -> None:
        """Run until the source has no more frames."""
        await self._process.source.run(self._process.take)


class MocapProcess(Actor):
    """Publishes each pose as it arrives, and the state of each drone as `truth` at the topic's rate.

    The truth of a virtual drone is exact. For another drone it is the measured pose with velocities
    derived from poses. The process ends on request, but waits up to `SHUTDOWN_PATIENCE` s while one
    of its drones has an agent on the network or flies: a drone needs poses to land.

    config: the swarm
    source: source of the frames
    process: name of this process
    host: name of this host
    incarnation: number of this life of the process
    recorder: records the frames; None: no recording
    """

    name = "mocap"

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        source: FrameSource,
        process: str,
        host: str,
        incarnation: int,
        recorder: FrameRecorder | None = None,
    ) -> None:
        self.clock = clock
        self.bus = Bus(clock, process=process, host=host)
        self.source = source
        self.recorder = recorder
        if not config.topology.seen:
            do = 'Those with uri = "udp://..." or "radio://..." are, unless pose = "onboard".'
            raise ConfigError(
                f"swarm {config.name}",
                "no drone that is seen by motion capture",
                "one or more",
                do,
            )
        self.tracks = {
            i: _make_track(
                config, self.bus.port(PORT_ADDRESSES.camera_offset + i, incarnation), i
            )
            for i in config.topology.seen
        }
        self.watch = TrackingWatch(
            {i: track.name for i, track in self.tracks.items()},
            config.mocap.rate,
            source.live,
        )
        self.view = make_frame_filter(config)
        self.failure = ""
        """Reason why the process failed; empty if it did not."""
        self._truth = RateLimit(DRONE_TOPICS.truth.rate)
        self._link: ZenohLink | None = None
        self._ending = ""
        self._until = 0.0
        self._supervisor = Supervisor(clock, "mocap", self._failed)

    async def serve(self, link: ZenohLink, *services: Actor) -> None:
        """Run the process until its end."""
        self._link = link
        await self._supervisor.run([link, *services, SourceRunner(self), self])
        if not self.failure and (nothing := self._nothing_seen()):
            self.failure = nothing
            log.error("mocap: %s", nothing)

    def _nothing_seen(self) -> str:
        """Return why no drone got a pose; empty if one did."""
        where = f"{self.source.where} ({self.source.state})"
        if not self.watch.frames:
            dropped = (
                f"; {self.view.timeless} were dropped, because their time is not a number of s"
                if self.view.timeless
                else ""
            )
            return f"{where}: no frame was seen{dropped}"
        names = [track.name for track in self.tracks.values()]
        if any(name in self.watch.sights for name in names):
            return ""
        there = (
            ", ".join(map(repr, sorted(self.watch.sights)[:LISTED_BODIES])) or "no body"
        )
        wanted = ", ".join(map(repr, names[:LISTED_BODIES]))
        do = "Correct `body` in the swarm file, or the names at the cameras; see `crazychoir mocap names`."
        return f"{where}: no body of a drone was seen: the frames have {there}, the swarm file {wanted}. {do}"

    async def run(self) -> None:
        """Log what is wrong with the tracking."""
        async for _ in self.clock.ticks(TRACKING_CHECK_RATE):
            for text in self.watch.look(self.clock.now()):
                log.warning("%s: %s", self.source.where, text)
            if self._ending:
                self._end_if_alone()

    def take(self, frame: PoseFrame, age: float) -> None:
        """Take a frame that is `age` s old, and publish its poses."""
        found = self.view.see(frame)
        if found is None:
            return
        (seen, late), now = found, self.clock.now()
        if self.recorder is not None:
            self.recorder.write(seen, now)
        self.watch.note(seen, now)
        exact = frame if self.view.blur else None
        due = self._truth.passes(frame.time)
        for track in self.tracks.values():
            pose = self._publish(track, seen.bodies.get(track.name), age + late, now)
            true = pose if exact is None else track.find_pose(exact, age)
            if true is not None:
                state = track.velocity.update(true, now)
                if due and state is not None:
                    track.port.publish(DRONE_TOPICS.truth, state, state.age)

    def _publish(
        self, track: TrackedDrone, flat: Vec | None, age: float, now: float
    ) -> Pose | None:
        """Publish and return one drone's pose.

        A pose identical to the last one is as old as that one.
        """
        if flat is None:
            return None
        pose = track.make_pose(flat, age + self.watch.age(track.name, now))
        track.port.publish(DRONE_TOPICS.pose, pose, pose.age)
        return pose

    def end(self, reason: str) -> None:
        """End as soon as no drone has an agent or flies."""
        if not self._ending:
            self._ending, self._until = reason, self.clock.now() + SHUTDOWN_PATIENCE
            if flown := self.flown:
                log.warning(
                    "mocap: %s: it goes on until drone(s) %s are down and without agents",
                    reason,
                    _join_ids(flown),
                )
        self._end_if_alone()

    @property
    def flown(self) -> list[int]:
        """Drones that are seen and have an agent on the network, or fly."""
        there = {} if self._link is None else self._link.directory
        return [i for i, track in self.tracks.items() if i in there or track.flies]

    def _end_if_alone(self) -> None:
        if not self.flown or self.clock.now() > self._until:
            self._supervisor.stop()

    def abort(self, reason: str) -> None:
        """End at once; flying drones then get no more poses."""
        self.failure = self.failure or reason
        log.error("mocap: %s", reason)
        self._supervisor.stop()

    def refuse(self, refused: Refused) -> None:
        """End because another process sees these drones already."""
        self.abort(str(refused))

    def _failed(self, actor: Actor, error: Exception, again: bool) -> None:
        if not again:
            self.abort(f"{actor.name} failed: {error_text(error)}")

    def report(self) -> dict[str, Any]:
        """Return what was seen: frames in all, frames lost on the way, and frames of each drone."""
        sights = {
            i: self.watch.sights.get(track.name) for i, track in self.tracks.items()
        }
        return {
            "success": not self.failure,
            "reason": self.failure,
            "source": self.source.where,
            "frames": self.watch.frames,
            "lost": self.view.lost,
            "late": self.view.late,
            "timeless": self.view.timeless,
            "restarts": self.source.again,
            "seen": {i: 0 if one is None else one.frames for i, one in sights.items()},
            "dropped": {
                i: self.watch.frames if one is None else one.dropped
                for i, one in sights.items()
            },
            "others": sorted(
                name
                for name in self.watch.sights
                if name not in self.watch.names.values()
            ),
            "recorded": None if self.recorder is None else self.recorder.report(),
        }


def _make_track(config: SwarmConfig, port: Port, i: int) -> TrackedDrone:
    drone = config.drone(i)
    body = Latest[Body](port.bus.clock, "body", DRONE_TOPICS.body.max_age)
    port.bus.subscribe(
        DRONE_TOPICS.body,
        config.topology.source(DRONE_TOPICS.body, i),
        port.address,
        body,
    )
    return TrackedDrone(
        config.body_name(i),
        Mounting(drone.body_offset, drone.body_rotation, _find_trim(config, drone)),
        port,
        VelocityFilter(),
        body,
    )


def _find_trim(config: SwarmConfig, drone: DroneTable) -> tuple[float, float]:
    """Return the calibrated trim (roll, pitch) in rad of a drone; simulated cameras see no trim."""
    is_simulated = config.mocap.source == "virtual"
    return (0.0, 0.0) if is_simulated else drone.calibration.trim or (0.0, 0.0)


def _join_ids(drones: list[int]) -> str:
    return ", ".join(map(str, drones))
