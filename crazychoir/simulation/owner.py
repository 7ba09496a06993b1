"""The owner of a simulated world: it steps the world and hands over the poses of the drones.

The poses come from simulated cameras. Parts of the same process that are in `takers` get them by a
call. All other readers get them as messages.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np

from crazychoir.bus.port import Bus, Port
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority
from crazychoir.simulation.command_rows import CommandRows, RowLink
from crazychoir.simulation.common.world import COMMAND_TYPES, DroneLink, World
from crazychoir.simulation.telemetry import Telemetry
from crazychoir.types import Body, CameraFrame, Command, Mat

LARGEST_CATCH_UP = 20
"""Largest number of missed steps that a late world makes up for.

Missed steps are computed because simulated drones continue to fall while no code runs.
"""


class PoseSampler(Protocol):
    """Simulated cameras, which turn true states into poses."""

    def sample(self, x: Mat, k: int) -> CameraFrame | None:
        """Return the frame that arrives at tick k; None if none arrives.

        x: (n, 13), true states, one row a drone
        k: number of the tick, one a step of the world
        """
        ...


class FrameTaker(Protocol):
    """A part of this process that takes the poses of all drones of a world by one call."""

    def take_frame(self, frame: CameraFrame) -> None:
        """Take the poses of an exposure, in the order of the ids of the world."""
        ...


class Digest(Protocol):
    """A hash that takes all states."""

    def update(self, *tables: Mat) -> None:
        """Add these C-contiguous tables to the hash."""
        ...


class ReadDrones:
    """Finds the drones of one world from which a topic is read, so that only those are published.

    bus: the bus that carries the messages
    ports: ports of the drones by id
    """

    def __init__(self, bus: Bus, ports: Mapping[int, Port]) -> None:
        self._bus = bus
        self._ports = ports
        self._addresses: dict[int, tuple[int, ...]] = {}
        self._found: dict[int, list[tuple[int, int, Port]]] = {}

    def find(self, topic: Topic) -> list[tuple[int, int, Port]]:
        """Return the row, the id and the port of each drone from which the topic is read."""
        addresses = self._bus.find_read_addresses(topic)
        if addresses is not self._addresses.get(topic.number):
            self._addresses[topic.number] = addresses
            read = set(addresses)
            self._found[topic.number] = [
                (row, i, port)
                for row, (i, port) in enumerate(self._ports.items())
                if port.address in read
            ]
        return self._found[topic.number]


@dataclass
class DelayedLink:
    """A link with a delay: a command sent before step k takes effect at step k + steps.

    A cut takes effect at once.
    """

    link: DroneLink
    """The link of the drone without delay."""
    steps: int
    """Steps of the world between sending and effect."""
    _way: deque[tuple[int, Command]] = field(default_factory=deque)
    _step: int = 0

    def send(self, command: Command) -> None:
        """Put the command into the queue."""
        self._way.append((self._step + self.steps, command))

    def cut(self) -> None:
        """Discard all queued commands and stop the motors for good."""
        self._way.clear()
        self.link.cut()

    def advance(self) -> None:
        """Begin a step of the world: deliver the commands that are due."""
        while self._way and self._way[0][0] <= self._step:
            self.link.send(self._way.popleft()[1])
        self._step += 1


class WorldOwner(Actor):
    """Steps the drones of one world, one step a tick.

    bus: the bus that carries the messages
    world: the simulated world
    cameras: the simulated cameras
    rate: Hz: frames of the cameras
    trace: a hash to which all states are added; None for no hash
    base: the body of drone i uses the port base + i
    delay: steps by which commands are late
    """

    name = "world"

    def __init__(
        self,
        bus: Bus,
        world: World,
        cameras: PoseSampler,
        rate: float,
        trace: Digest | None = None,
        base: int = 0,
        delay: int = 0,
    ) -> None:
        self.bus = bus
        self.world = world
        self.cameras = cameras
        self.trace = trace
        self.ticks = bus.clock.ticks(1.0 / world.dt, AlarmPriority.WORLD, aligned=True)
        self._ports = {i: bus.ports[base + i] for i in world.ids}
        self.telemetry = Telemetry(world, self._ports)
        self.takers: list[FrameTaker] = []
        """Parts of this process that take each frame of the cameras."""
        self.commands = CommandRows(world, delay)
        """Commands of the kinds that the world takes as rows."""
        self._delayed: dict[int, DelayedLink] = {}
        self._read = ReadDrones(bus, self._ports)
        for i, port in self._ports.items():
            port.latched.offer(DRONE_TOPICS.body, partial(self._describe_body, i))
        self._look_every = max(1, round(1.0 / (world.dt * rate)))
        self._truth_every = max(1, round(1.0 / (world.dt * DRONE_TOPICS.truth.rate)))
        self._body_every = max(1, round(1.0 / (world.dt * DRONE_TOPICS.body.rate)))
        self._tick = 0
        self.looked_ns = 0
        """Time of the last camera frame in ns, on the clock of the bus."""
        self.flying: Callable[[int], bool] = lambda i: False
        """Returns True if commands of another process have brought drone i into the air."""
        self.cut: Callable[[int], bool] = lambda i: False
        """Returns True if another process has cut the motors of drone i."""

    def link(self, i: int, kind: str) -> DroneLink:
        """Return the link to drone i, with the delay of commands.

        Raises ConfigError if the world of the drone does not obey this kind.
        """
        link = self.world.link(i, kind)
        if kind in self.commands.kinds:
            row = self.world.ids.index(i)
            return RowLink(self.commands, row, link, COMMAND_TYPES[kind])
        if self.commands.delay:
            link = self._delayed[i] = DelayedLink(link, self.commands.delay)
        return link

    async def run(self) -> None:
        """Step the world once a tick.

        Ticks missed in real time are made up for, up to LARGEST_CATCH_UP, before the cameras look.
        """
        ticks = self.ticks
        missed = 0
        async for _ in ticks:
            ticks.skip()
            late = ticks.missed - missed
            missed = ticks.missed
            for _ in range(min(late, LARGEST_CATCH_UP)):
                self._advance()
            self.step((self.bus.clock.now_ns() - ticks.due_ns) / NS_PER_SECOND)

    def step(self, late: float = 0.0) -> None:
        """Advance the world, take a camera frame if one is due, and publish.

        late: s: delay of this tick. The world then shows the time at which the tick was due, so the
            poses are older by this much.
        """
        world = self.world
        self._advance()
        self._tick += 1
        if self.trace is not None:
            self.trace.update(np.ascontiguousarray(world.states))
        if self._tick % self._look_every == 0:
            self._look(late)
        if self._tick % self._truth_every == 0:
            for _, i, port in self._read.find(DRONE_TOPICS.truth):
                port.publish(DRONE_TOPICS.truth, world.state(i), late)
        if self.telemetry.every:
            self.telemetry.step(self._tick, late)
        if self._tick % self._body_every == 0:
            for _, i, port in self._read.find(DRONE_TOPICS.body):
                port.publish(DRONE_TOPICS.body, self._describe_body(i), late)

    def _look(self, late: float) -> None:
        """Take a frame with the cameras, and hand it over.

        late: s: delay of this tick
        """
        self.looked_ns = self.bus.clock.now_ns()
        frame = self.cameras.sample(self.world.states, self._tick // self._look_every)
        if frame is None:
            return
        if late:
            frame = frame.delayed(late)
        self._show_world(frame)
        for taker in self.takers:
            taker.take_frame(frame)
        for row, _, port in self._read.find(DRONE_TOPICS.pose):
            pose = frame.pose(row)
            if pose is not None:
                port.publish(DRONE_TOPICS.pose, pose, pose.age)

    def _show_world(self, frame: CameraFrame) -> None:
        """Give the poses to the estimators on board; an engine may take them one by one only."""
        see_frame = getattr(self.world, "see_frame", None)
        if see_frame is not None:
            see_frame(frame.flat, frame.seen)
            return
        for row, i in enumerate(self.world.ids):
            pose = frame.pose(row)
            if pose is not None:
                self.world.see(i, pose)

    def _describe_body(self, i: int) -> Body:
        return Body(self.world.harm(i), self.flying(i), self.cut(i))

    def _advance(self) -> None:
        for link in self._delayed.values():
            link.advance()
        self.commands.advance()
        self.world.step()
