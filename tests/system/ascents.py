"""Take-offs of drones that a radio reaches, in virtual time: agents, owner and firmware, all but cflib and sockets."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from system.flights import mission_of

from crazychoir.agent.agent import Agent, AgentProcess
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.view import CameraBlur
from crazychoir.numerics.math3d import quaternion_of_yaw, quaternion_product
from crazychoir.radio.budget import compute_setpoint_rates
from crazychoir.radio.drone.radio_drone import RadioDrone, SharedRadio
from crazychoir.radio.drone.timing import LINK_CHECK_RATE
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.crtp import Packet
from crazychoir.radio.virtual.drone import VirtualCrazyflie
from crazychoir.radio.virtual.readings import make_readings
from crazychoir.radio.virtual.setup import select_from_swarm
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, Clock, run_virtual
from crazychoir.simulation.remote import RemoteBody
from crazychoir.types import Pose, State

STEP = 0.01
SLOWEST = 0.03
"""s that a packet is on its way at most."""


class Wire:
    """In place of a connection: packets reach the virtual drone some ms later, the newest of a kind counts."""

    silence, latency, answered, rssi, failure = 0.0, 0.02, 1.0, math.nan, ""

    def __init__(
        self, clock: Clock, drone: VirtualCrazyflie, draw: np.random.Generator
    ) -> None:
        self.clock, self.drone, self.draw, self._logs = (
            clock,
            drone,
            draw,
            make_readings(drone),
        )

    def send(self, packet: Packet) -> None:
        self._later(lambda: list(self.drone.take(packet)))

    def newest(self, kind: str, packet: Packet) -> None:
        self.send(packet)

    def urgent(self, packets: Iterable[Packet]) -> None:
        for packet in packets:
            self.send(packet)

    def forget(self, kind: str) -> None:
        """Nothing waits here."""

    async def log(
        self, name: str, variables: Any, period: float, data: Any, seconds: float
    ) -> None:
        self._say(tuple(variables), round(period * NS_PER_SECOND), data)

    def _say(self, names: tuple[str, ...], period_ns: int, data: Any) -> None:
        on, more = self.drone.onboard, self._logs
        values = {
            name: more[name]() if name in more else on.log(name) for name in names
        }
        at = self.drone.uptime
        self._later(lambda: data(values, at))
        self.clock.call_at(
            self.clock.now_ns() + period_ns, self._say, names, period_ns, data
        )

    def _later(self, does: Any) -> None:
        self.clock.call_at(
            self.clock.now_ns()
            + round(self.draw.uniform(0.003, SLOWEST) * NS_PER_SECOND),
            does,
        )


@dataclass
class Ascent:
    """What one drone did. rows: (s, x, y, z m, tilt rad, sum of its motors' shares) each 10 ms;  reason: why the safety
    table has brought it down, and found: s after its lift-off, at which height m, and tilt rad.
    """

    rows: list[tuple[float, ...]] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)
    reason: str = ""
    found: tuple[float, float, float] | None = None


class Hall(Actor):
    """The world, its cameras and the owner of the dongles.

    The arguments say what is wrong with each drone:  body_of: the drone that the cameras see in its place;  reaches:
    the drone that its radio reaches instead of it;  turned: rad, by which its body's axes are turned about z.
    """

    name = "hall"

    def __init__(
        self,
        agent: Agent,
        seed: int,
        body_of: dict[int, int],
        reaches: dict[int, int],
        turned: dict[int, float],
    ) -> None:
        self.agent, self.clock, config = agent, agent.clock, agent.config
        hall = select_from_swarm(config, ())
        self.world = hall.world(seed)
        self.body_of, self.turned, draw = body_of, turned, np.random.default_rng(seed)
        self.blur, self.ids = CameraBlur(config.replace(seed=seed)), config.ids
        bus = agent.bus
        shared = SharedRadio(TableOfContents(Path("nowhere")))
        self.drones, self.bodies, self.tracks = (
            {},
            {},
            {i: Ascent() for i in config.ids},
        )
        self.at = {i: reaches.get(i, i) for i in config.ids}
        for i in config.ids:
            bus.port(PORT_ADDRESSES.camera_offset + i)
        for i in config.ids:
            onboard = self.world.onboard[self.at[i]]
            port = bus.port(PORT_ADDRESSES.body_offset + i)
            kind = config.control_of(i).sender
            drone = RadioDrone(
                bus,
                config,
                i,
                kind,
                compute_setpoint_rates(config)[config.drone(i).dongle or 0],
                shared,
            )
            virtual = VirtualCrazyflie(onboard)
            for name, value in drone.handler.parameters.items():
                virtual.parameters.set(name, value)
            drone.handler.thrust, drone.preparation.release = 136_531.0, "2025.12"
            drone.link.connection = Wire(self.clock, virtual, draw)
            drone.preparation.is_prepared = drone.preparation.is_placed = True
            drone.link.state = "up"
            self.drones[i] = drone
            self.bodies[i] = RemoteBody(
                port, drone, drone.commands, kind, flight=config.flight
            )

    async def run(self) -> None:
        for i, drone in self.drones.items():
            q = self.world.states[self.world.row[self.at[i]], 6:10]
            yaw = 2.0 * math.atan2(q[2], q[3]) + self.turned.get(i, 0.0)
            self.world.onboard[self.at[i]].place(self.agent.config.drone(i).home, yaw)
            await drone.estimate.begin_logs(drone.link.connection)
        k = 0
        async for _ in self.clock.ticks(1.0 / STEP):
            k += 1
            self.world.step()
            for i, pose in self.seen(k).items():
                self.agent.bus.ports[PORT_ADDRESSES.camera_offset + i].publish(
                    DRONE_TOPICS.pose, pose, pose.age
                )
                if k % 5 == 0:
                    self.agent.bus.ports[PORT_ADDRESSES.camera_offset + i].publish(
                        DRONE_TOPICS.truth,
                        State(self.world.states[self.world.row[i]].copy()),
                    )
            if k % round(1.0 / STEP / LINK_CHECK_RATE) == 0:
                for i, drone in self.drones.items():
                    drone.watchdog.feed()
                    drone.landing.go_on()
                    self.bodies[i].look()
            if k % round(1.0 / STEP / DRONE_TOPICS.link.rate) == 0:
                for drone in self.drones.values():
                    drone.report.publish()
            self._note()

    def seen(self, k: int) -> dict[int, Pose]:
        bodies = {}
        for i in self.ids:
            x = self.world.states[self.world.row[self.body_of.get(i, i)]]
            q = quaternion_product(
                tuple(x[6:10]), tuple(quaternion_of_yaw(self.turned.get(i, 0.0)))
            )
            bodies[self.agent.config.body_name(i)] = np.array([*x[:3], *q])
        frame, late = self.blur.see(PoseFrame(k, k * STEP, bodies))
        return {
            i: Pose(frame.bodies[name], late)
            for i in self.ids
            if (name := self.agent.config.body_name(i)) in frame.bodies
        }

    def _note(self) -> None:
        for i, track in self.tracks.items():
            j = self.at[i]
            x = self.world.states[self.world.row[j]]
            tilt = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x[6] ** 2 + x[7] ** 2))))
            motors = float(sum(self.world.onboard[j].record["motors"]))
            track.rows.append((self.clock.now(), *x[:3], tilt, motors))
            pilot = self.agent.drones[i].pilot
            if track.found is None and (
                pilot.permission.cut_for or pilot.notes.brought_down
            ):
                track.reason = pilot.permission.cut_for or pilot.notes.brought_down
                began = next((row[0] for row in track.rows if row[3] > 0.005), math.nan)
                track.found = (self.clock.now() - began, float(x[2]), tilt)


def swarm(kind: str, n: int = 3, **tables: Any) -> SwarmConfig:
    drones = [
        {
            "id": i,
            "home": [0.8 * (i % 2), 0.8 * (i // 2), 0.0],
            "uri": f"udp://127.0.0.1:{21000 + i}",
            "dongle": i // 2,
            "platform": "cf21",
        }
        for i in range(n)
    ]
    return SwarmConfig.of(
        {"name": "ascents", "drones": drones, "control": {"sender": kind}, **tables}
    )


def ascend(
    config: SwarmConfig,
    seed: int,
    body_of: dict[int, int] | None = None,
    reaches: dict[int, int] | None = None,
    turned: dict[int, float] | None = None,
    flying: tuple[int, ...] | None = None,
    hover: float = 3.0,
) -> dict[int, Ascent]:
    """All take off, hover, and land."""

    async def does(me: Any) -> Any:
        await me.sleep(
            2.0 + 0.05 * float(np.random.default_rng([seed, me.id]).random())
        )
        if flying is None or me.id in flying:
            await me.take_off()
        await me.sleep(hover)
        await me.land()
        return {"success": True}

    async def main(clock: Clock) -> dict[int, Ascent]:
        agent = Agent(
            clock,
            config.replace(seed=seed),
            mission_of(does),
            config.ids,
            process=AgentProcess(is_alone=False),
        )
        hall = Hall(agent, seed, body_of or {}, reaches or {}, turned or {})
        agent.services.append(hall)
        results = await agent.run()
        for i, track in hall.tracks.items():
            track.result = results[i]
        return hall.tracks

    return run_virtual(main)
