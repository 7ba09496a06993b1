"""The owner of a simulated world: it steps the world and publishes the poses of the drones.

The poses come from simulated cameras.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority
from crazychoir.simulation.common.world import DroneLink, World
from crazychoir.simulation.telemetry import Telemetry
from crazychoir.types import Body, Command, Mat, Pose

LARGEST_CATCH_UP = 20
"""Largest number of missed steps that a late world makes up for.

Missed steps are computed because simulated drones continue to fall while no code runs.
"""


class PoseSampler(Protocol):
    """Simulated cameras, which turn true states into poses."""

    def sample(self, x: Mat, k: int) -> list[Pose | None]:
        """Return the pose of each drone that arrives at tick k; None where none arrives.

        x: (n, 13), true states, one row a drone
        k: number of the tick, one a step of the world
        """
        ...


class Digest(Protocol):
    """A hash that takes the bytes of all states."""

    def update(self, data: bytes, /) -> None:
        """Add these bytes to the hash."""
        ...


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
        self.ticks = bus.clock.ticks(1.0 / world.dt, AlarmPriority.WORLD)
        self._ports = {i: bus.ports[base + i] for i in world.ids}
        self.telemetry = Telemetry(world, self._ports)
        self._delay, self._delayed = delay, dict[int, DelayedLink]()
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
        if self._delay:
            link = self._delayed[i] = DelayedLink(link, self._delay)
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
            self.trace.update(world.states.tobytes())
        if self._tick % self._look_every == 0:
            self.looked_ns = self.bus.clock.now_ns()
            poses = self.cameras.sample(world.states, self._tick)
            for (i, port), pose in zip(self._ports.items(), poses, strict=True):
                if pose is not None:
                    seen = Pose(pose.flat, pose.age + late) if late else pose
                    world.see(i, seen)
                    port.publish(DRONE_TOPICS.pose, seen, seen.age)
        if self._tick % self._truth_every == 0:
            for i, port in self._ports.items():
                port.publish(DRONE_TOPICS.truth, world.state(i), late)
        if self.telemetry.every:
            self.telemetry.step(self._tick, late)
        if self._tick % self._body_every == 0:
            for i, port in self._ports.items():
                port.publish(
                    DRONE_TOPICS.body,
                    Body(world.harm(i), self.flying(i), self.cut(i)),
                    late,
                )

    def _advance(self) -> None:
        for link in self._delayed.values():
            link.advance()
        self.world.step()
