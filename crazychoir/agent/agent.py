"""One process of a swarm: its drones, each a small set of connected actors, and its world."""

import asyncio
import logging
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from crazychoir.agent.assembly import (
    DroneSurroundings,
    build_drone,
    connect_airspace,
)
from crazychoir.agent.dead_man import DeadMan
from crazychoir.agent.drone import Drone
from crazychoir.agent.drone_commands import DroneCommands
from crazychoir.agent.mission_runner import MissionRunner
from crazychoir.agent.operator_commands import OperatorCommands
from crazychoir.agent.worlds import world_actors
from crazychoir.bus.commands import CommandServer
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.network import impairment_of
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.robots import find_sender
from crazychoir.errors import ConfigError, Refused, error_text
from crazychoir.flight.tick import FlightTick
from crazychoir.guidance.decision.law_stage import LawStage
from crazychoir.guidance.mission import Mission, compute_mission_hash
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.shared_ticks import SharedTicks
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.runtime.user_code_guard import GuardFactory, share_watch
from crazychoir.runtime.watchdog import Stall
from crazychoir.safety.rules.modes import MOTORS_OFF_MODES
from crazychoir.simulation.remote import OwnerWatch
from crazychoir.simulation.telemetry import round_log_period
from crazychoir.simulation.trace import Trace

log = logging.getLogger(__name__)


class StatusActor(Actor):
    """Publishes the status of the drone four times a second, while it is read."""

    name = "status"

    def __init__(self, drone: Drone, ticks: SharedTicks) -> None:
        self.drone = drone
        self.ticks = ticks

    async def run(self) -> None:
        """Publish at each tick of the clock."""
        self.drone.port.latched.offer(DRONE_TOPICS.status, self.drone.status)
        await self.ticks.serve(self._publish)

    def _publish(self) -> None:
        port = self.drone.port
        if port.is_read(DRONE_TOPICS.status):
            port.publish(DRONE_TOPICS.status, self.drone.status())


class Pacemaker(Actor):
    """Ticks the drones that receive no poses."""

    name = "pacemaker"

    def __init__(self, tick: FlightTick, rate: float) -> None:
        self.tick = tick
        self.rate = rate

    async def run(self) -> None:
        """Check once a period."""
        async for _ in self.tick.clock.ticks(self.rate, aligned=True):
            self.tick.tick_late_drones()


@dataclass(frozen=True, slots=True)
class AgentProcess:
    """The process in which an agent lives."""

    name: str = "local"
    """Name of the process."""
    incarnation: int = 1
    """Identifies this life of the process."""
    is_alone: bool = True
    """Whether the whole swarm is in this process, and none of its worlds has an owner elsewhere."""


LOCAL_PROCESS = AgentProcess()


class Agent:
    """The drones `ids` of a swarm, in this process.

    clock: the clock of the swarm.
    config: the swarm file.
    mission: the mission file.
    ids: ids of the drones.
    process: the process in which the drones live.
    trace: digest of virtual time.
    """

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        mission: Mission,
        ids: tuple[int, ...],
        *,
        process: AgentProcess = LOCAL_PROCESS,
        trace: Trace | None = None,
    ) -> None:
        self.clock = clock
        self.config = config
        self.ids = ids
        host = config.drone(ids[0]).host or socket.gethostname().split(".")[0]
        self.bus = Bus(clock, impairment_of(config), process.name, host)
        self.bus.tap = trace.message if trace else None
        self.incarnation = process.incarnation
        self.watchdog: GuardFactory | None = None
        self.alarm: Callable[[int, str], None] = lambda drone, text: None
        for i in ids:
            self.bus.port(i, process.incarnation)
        if process.is_alone and config.topology.reached:
            raise _not_simulated(config)
        self.owned = (
            ()
            if process.is_alone
            else tuple(i for i in ids if i in config.topology.elsewhere)
        )
        self.owners = world_actors(
            self.bus, config, tuple(i for i in ids if i not in self.owned), trace=trace
        )
        self.owner_of = {i: owner for owner in self.owners for i in owner.world.ids}
        self.services: list[Actor] = []
        self.runners: dict[int, MissionRunner] = {}
        self._ended_for = ""
        """Why all missions were ended; empty if they were not."""
        self.drones: dict[int, Drone] = {}
        self.commands: dict[int, DroneCommands] = {}
        patience = 0.0 if process.is_alone else config.flight.dead_man
        self.dead_man = (
            DeadMan(clock, patience, self._flies, self.land_all) if patience else None
        )
        surroundings = DroneSurroundings(
            bus=self.bus,
            mission=mission,
            mission_hash=compute_mission_hash(config, mission),
            graph=config.graph(),
            start_deadline=config.start_deadline,
            owners=self.owner_of,
            tick=FlightTick(
                self.bus, len(ids), max(config.mocap.rate, config.radio.log_rate)
            ),
        )
        connect_airspace(config, self.bus, surroundings.tick)
        if surroundings.tick.airspace is not None and trace is not None:
            surroundings.tick.airspace.trace = trace.update
        self._status_ticks = SharedTicks(clock, DRONE_TOPICS.status.rate)
        self.laws = LawStage(surroundings.tick, self.bus.impairment)
        with share_watch():
            for i in ids:
                self._add_drone(i, surroundings)
        for owner in self.owners:
            kinds = {i: find_sender(config, i) for i in owner.world.ids}
            rows = surroundings.tick.connect_world(
                owner.world.ids, owner.commands, kinds
            )
            owner.takers.append(rows)
        self.pacemaker = Pacemaker(surroundings.tick, config.mocap.rate)
        self.supervisor = Supervisor(
            clock, f"process {process.name}", self._shared_failed
        )

    def _add_drone(self, i: int, surroundings: DroneSurroundings) -> None:
        """Build drone i, and let it obey operators."""
        drone = build_drone(self.config, i, surroundings, self._supervisor(i))
        self.drones[i] = drone
        if drone.remote is not None:
            drone.remote.found_cut = partial(self._found_cut, i)
        if drone.sensors is not None:
            for variables, period in self._list_logs(drone):
                drone.sensors.check(variables, period)
        commands = DroneCommands(drone, self._orders_of(drone), self._hear_console)
        self.commands[i] = commands
        CommandServer(drone.port, commands.execute, commands.stop)

    def _list_logs(self, drone: Drone) -> list[tuple[tuple[str, ...], float]]:
        """Return the variables and periods in s of the [[logs]] of a drone."""
        return [
            (row.variables, round_log_period(row.rate))
            for row in self.config.logs
            if row.drones is None or drone.id in row.drones
        ]

    def _hear_console(self) -> None:
        """Note that an operator's console is there."""
        if self.dead_man is not None:
            self.dead_man.heard()

    def _supervisor(self, i: int) -> Supervisor:
        return Supervisor(
            self.clock,
            f"drone {i}",
            lambda actor, error, again: self._failed(i, actor, error, again),
        )

    async def run(self) -> dict[int, dict[str, Any]]:
        """Fly the mission, and return each drone's result."""
        async with asyncio.TaskGroup() as group:
            owner = group.create_task(self.supervisor.run(self._shared()), name="world")
            drones = list(self.drones.values())
            others = [
                group.create_task(
                    d.supervisor.run(self._flying(d)), name=f"drone {d.id}"
                )
                for d in drones
            ]
            guided = [
                group.create_task(self._guide(d), name=f"drone {d.id} life")
                for d in drones
            ]
            await asyncio.wait(guided)
            for drone in drones:
                drone.supervisor.stop()
            await asyncio.wait(others)
            self.supervisor.stop()
            await owner
        return {i: drone.result for i, drone in self.drones.items()}

    def _shared(self) -> list[Actor]:
        """Return the actors that all drones of this process share."""
        drones = self.drones.values()
        remotes = {d.id: d.remote for d in drones if d.remote is not None}
        actors: list[Actor] = [*self.services, *self.owners]
        if remotes:
            actors.append(OwnerWatch(self.clock, remotes, self._orphaned))
        actors += [d.radio_watch for d in drones if d.radio_watch is not None]
        actors.append(self.pacemaker)
        if self.dead_man is not None:
            actors.append(self.dead_man)
        return actors

    def _flies(self) -> bool:
        return any(
            drone.pilot.mode not in MOTORS_OFF_MODES for drone in self.drones.values()
        )

    def _flying(self, drone: Drone) -> list[Actor]:
        return [
            drone.barrier.monitor,
            drone.pilot,
            StatusActor(drone, self._status_ticks),
        ]

    async def _guide(self, drone: Drone) -> None:
        """Run the guidance under its own supervisor.

        When it ends the drone flies on until it is down.
        """
        if drone.sensors is not None:
            for variables, period in self._list_logs(drone):
                drone.sensors.log(variables, period)
        supervisor = self._supervisor(drone.id)
        runner = MissionRunner(drone, self.config, self.watchdog, self.laws)
        self.runners[drone.id] = runner
        reason = drone.barrier.refused or self._ended_for
        if reason:
            runner.abort(reason)
        await supervisor.run([runner])

    def _orders_of(self, drone: Drone) -> OperatorCommands:
        i = drone.id

        def abort(why: str) -> None:
            self.runners[i].abort(why, by_operator=True)

        def over() -> str:
            return self.runners[i].over

        has_radio = i in self.config.topology.reached
        arm = drone.remote.arm if drone.remote is not None and has_radio else None
        return OperatorCommands(drone, self.config, abort, over, arm)

    def land_all(self, reason: str) -> None:
        """Land every drone and end every mission.

        A mission that has not begun never begins.
        reason: why, in words.
        """
        self._ended_for = self._ended_for or reason
        for i in self.runners:
            self.drones[i].pilot.land(reason)
        for runner in self.runners.values():
            runner.abort(reason)

    def _orphaned(self, i: int) -> None:
        """End the mission of drone i, because its world is gone.

        If it flew, the safety table has brought it down.
        """
        pilot = self.drones[i].pilot
        reason = pilot.notes.brought_down or "its world is gone"
        pilot.land(reason)
        self.runners[i].abort(reason)

    def _found_cut(self, i: int, why: str) -> None:
        """Leave out a drone that cannot fly. The others learn the reason."""
        if not self.drones[i].pilot.permission.cut_for:
            self.drones[i].barrier.refused = why
            if i in self.runners:
                self.runners[i].abort(why)

    def cut_all(self, reason: str) -> None:
        """Stop all motors now."""
        for drone in self.drones.values():
            drone.pilot.cut(reason)

    def refuse(self, refused: Refused) -> None:
        """End this process, because the swarm has refused it."""
        log.error("%s", refused)
        self.land_all(str(refused))

    def stalled(self, stall: Stall) -> None:
        """Tell the others which event loop hangs, and where. Called from the watchdog's thread."""
        words = stall.actor.split()
        drone = (
            int(words[1])
            if len(words) > 1 and words[0] == "drone" and words[1].isdigit()
            else self.ids[0]
        )
        self.alarm(drone, str(stall))

    def _shared_failed(self, actor: Actor, error: Exception, again: bool) -> None:
        """Land all drones when the world or the pacemaker fails.

        No drone can fly on without them.

        A pilot that still gets ticks may cut its motors instead.
        """
        if actor in self.owners or actor is self.pacemaker:
            self.land_all(f"{actor.name} failed: {error_text(error)}")

    def _failed(self, i: int, actor: Actor, error: Exception, again: bool) -> None:
        drone = self.drones[i]
        text = f"drone {i}: {actor.name} failed: {error_text(error)}"
        drone.port.publish(DRONE_TOPICS.log, text)
        if actor.name == "guidance":
            drone.result = {"success": False, "reason": text}
            drone.port.publish(DRONE_TOPICS.result, drone.result)
            drone.pilot.guidance_failed(error_text(error))
        elif actor.name == "pilot" and not again:
            drone.pilot.cut(text)


def _not_simulated(config: SwarmConfig) -> ConfigError:
    """Return the error for a drone with a radio in virtual time."""
    i = config.topology.reached[0]
    do = 'Leave --fast out, or write uri = "sim://" for a flight in virtual time.'
    return ConfigError(
        f"drone {i}: uri", config.drone(i).uri, "a simulated drone, in virtual time", do
    )
