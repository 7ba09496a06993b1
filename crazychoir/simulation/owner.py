"""The owner of a simulated world: steps it, looks at it with simulated cameras, and hands poses to the drones."""

import math
from typing import Protocol

from crazychoir.bus.local import Bus
from crazychoir.bus.topics import POSE, TRUTH
from crazychoir.math3d import Mat, rotation
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import SECOND, WORLD
from crazychoir.simulation.world import World
from crazychoir.types import Command, Pose

MOST_CATCH_UP = 20
"""Steps of a world that was late: simulated drones go on falling while nobody computes."""


class Cameras(Protocol):
    """What turns truth into poses."""

    def sample(self, x: Mat, k: int) -> list[Pose | None]:
        """What arrives at tick k, row by row."""
        ...


class Digest(Protocol):
    """What a trace of all states is fed to."""

    def update(self, data: bytes, /) -> None:
        """Take these bytes in."""
        ...


class SimulatedLink:
    """The way to one drone of a world in this process."""

    def __init__(self, world: World, drone: int) -> None:
        self.world, self.drone = world, drone

    def send(self, command: Command) -> None:
        """Held until the next one."""
        self.world.command(self.drone, command.flat)

    def cut(self) -> None:
        """Stop the motors for good."""
        self.world.cut(self.drone)


class EulerRatesLink(SimulatedLink):
    """For a world that is steered by the rates of its Euler angles, as the paper writes.

    phi' = p + (q sin phi + r cos phi) tan theta,  theta' = q cos phi - r sin phi,
    psi' = (q sin phi + r cos phi) / cos theta
    """

    def send(self, command: Command) -> None:
        """Turn body rates p, q, r into Euler-angle rates at the drone's present attitude."""
        thrust, p, q, r = command.flat.tolist()
        # The last row of R = (-sin theta, sin phi cos theta, cos phi cos theta).
        x, y, z = rotation(self.world.state(self.drone).q)[2].tolist()
        phi, cos_theta = math.atan2(y, z), max(math.hypot(y, z), 1e-6)
        turn = q * math.sin(phi) + r * math.cos(phi)
        rates = [p - turn * x / cos_theta, q * math.cos(phi) - r * math.sin(phi), turn / cos_theta]
        self.world.command(self.drone, [thrust, *rates])


class WorldOwner(Actor):
    """Integrates all simulated drones of its process in one batch, a step a tick."""

    name = "world"

    def __init__(self, bus: Bus, world: World, cameras: Cameras, rate: float, trace: Digest | None = None) -> None:
        self.bus, self.world, self.cameras, self.trace = bus, world, cameras, trace
        self.ticks = bus.clock.ticks(1.0 / world.dt, WORLD)
        self._ports = [bus.ports[i] for i in world.ids]
        self._look_every = max(1, round(1.0 / (world.dt * rate)))
        self._truth_every = max(1, round(1.0 / (world.dt * TRUTH.rate)))
        self._tick = 0
        self.looked_ns = 0
        """When the cameras last looked, by the bus's clock."""

    async def run(self) -> None:
        """One step a tick; late ticks of real time are made up for, up to a limit."""
        missed = 0
        async for due_ns in self.ticks:
            late, missed = self.ticks.missed - missed, self.ticks.missed
            for _ in range(min(late, MOST_CATCH_UP)):
                self.world.step()
            self.step((self.bus.clock.now_ns() - due_ns) / SECOND)

    def step(self, late: float = 0.0) -> None:
        """Advance, look, publish. A tick `late` s shows the world as it was when it was due: so old are its poses."""
        world = self.world
        world.step()
        self._tick += 1
        if self.trace is not None:
            self.trace.update(world.states.tobytes())
        if self._tick % self._look_every == 0:
            self.looked_ns = self.bus.clock.now_ns()
            for port, pose in zip(self._ports, self.cameras.sample(world.states, self._tick), strict=True):
                if pose is not None:
                    seen = Pose(pose.flat, pose.age + late) if late else pose
                    port.publish(POSE, seen, seen.age)
        if self._tick % self._truth_every == 0:
            for port in self._ports:
                port.publish(TRUTH, world.state(port.address), late)
