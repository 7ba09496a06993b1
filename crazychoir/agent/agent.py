"""One process of a swarm: its drones, each a small set of connected actors, and its world."""

import asyncio
import logging
import socket
from collections.abc import Callable
from functools import partial
from typing import Any

from crazychoir.agent.dead_man import WATCHED_COMMAND, DeadMan
from crazychoir.agent.drone import AgentDrone
from crazychoir.agent.mission_runner import GuidanceActor
from crazychoir.agent.operator_commands import OPERATOR_COMMANDS as ORDERS
from crazychoir.agent.operator_commands import OperatorCommands
from crazychoir.agent.steering import Steering
from crazychoir.agent.worlds import world_actors
from crazychoir.bus.commands import COMMANDED_PREFIX, CommandServer
from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.checks import WORLD_URIS, limit_area
from crazychoir.config.drone_room import fence_of
from crazychoir.config.link_loss import TILT_TIMES, describe_crowding, fence_inset
from crazychoir.config.network import impairment_of
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import AGREED_KEYS
from crazychoir.control.choice import FIRMWARE_GAIN_SENDERS, Controls, make_controls
from crazychoir.control.margin import Plant as PlantKind
from crazychoir.control.position import FLATNESS_LIMITS
from crazychoir.control.robots import ROBOT_CONTROLS, find_sender
from crazychoir.errors import ConfigError, Refused, error_text
from crazychoir.flight.estimate import choose_filter
from crazychoir.flight.pilot import Pilot, ReachKind
from crazychoir.flight.point_flights import compute_braking_limit
from crazychoir.guidance.member import Member
from crazychoir.guidance.mission import Mission, compute_mission_hash
from crazychoir.guidance.sensors import Sensors
from crazychoir.platforms import find_platform
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.mailbox import Call
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.runtime.user_code_guard import GuardFactory
from crazychoir.runtime.watchdog import Stall
from crazychoir.safety.collision.agreed.planned import LOWEST_WAYPOINT, PlannedFlights
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.safety.collision.neighbour_table import NeighbourTable
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import MOTORS_OFF_MODES
from crazychoir.safety.rules.radio_watch import RadioWatch
from crazychoir.simulation.common.world import DroneLink
from crazychoir.simulation.remote import OwnerWatch, RemoteLink
from crazychoir.simulation.telemetry import list_log_names
from crazychoir.simulation.trace import Trace
from crazychoir.team.barrier import Barrier
from crazychoir.team.communicator import Communicator
from crazychoir.team.messages import Roster

log = logging.getLogger(__name__)
OWNER_SILENCE = 20.0
"""s: how long the owner of a dongle may be silent.

`run` restarts an owner. After this time it does not come back.
"""
QUERY_COMMANDS = ("param_get", "task_list", "overview", "ping", WATCHED_COMMAND)
"""Commands that change nothing."""
DRONE_COMMANDS = (
    *ORDERS,
    "go-to",
    "fly",
    "impair",
    "param_set",
    "task_add",
    "task_cancel",
    *QUERY_COMMANDS,
)
"""Commands that operators may send to a drone."""


class StatusActor(Actor):
    """Publishes the status of the drone four times a second."""

    name = "status"

    def __init__(self, drone: AgentDrone) -> None:
        self.drone = drone

    async def run(self) -> None:
        """Publish at each tick of the clock."""
        async for _ in self.drone.port.bus.clock.ticks(
            DRONE_TOPICS.status.rate, drone=self.drone.id
        ):
            self.drone.port.publish(DRONE_TOPICS.status, self.drone.status())


class Pacemaker(Actor):
    """Ticks the pilots that receive no poses."""

    name = "pacemaker"

    def __init__(self, clock: Clock, pilots: list[Pilot], rate: float) -> None:
        self.clock = clock
        self.pilots = pilots
        self.rate = rate

    async def run(self) -> None:
        """Check once a period."""
        async for _ in self.clock.ticks(self.rate):
            now_ns = self.clock.now_ns()
            for pilot in self.pilots:
                pilot.nudge(now_ns)


class Agent:
    """The drones `ids` of a swarm, in this process.

    clock: the clock of the swarm.
    config: the swarm file.
    mission: the mission file.
    ids: ids of the drones.
    process: name of the process.
    incarnation: identifies this life of the process.
    trace: digest of virtual time.
    start_deadline: s for the start of the team. None: that of the swarm file.
    alone: the whole swarm is in this process, and none of its worlds has an owner elsewhere.
    """

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        mission: Mission,
        ids: tuple[int, ...],
        *,
        process: str = "local",
        incarnation: int = 1,
        trace: Trace | None = None,
        start_deadline: float | None = None,
        alone: bool = True,
    ) -> None:
        self.clock = clock
        self.config = config
        self.mission = mission
        self.ids = ids
        self.trace = trace
        host = config.drone(ids[0]).host or socket.gethostname().split(".")[0]
        self.bus = Bus(clock, impairment_of(config), process, host)
        self.bus.tap = trace.message if trace else None
        self.incarnation = incarnation
        self.watchdog: GuardFactory | None = None
        self.alarm: Callable[[int, str], None] = lambda drone, text: None
        for i in ids:
            self.bus.port(i, incarnation)
        if alone and config.reached:
            raise _not_simulated(config)
        self.owned = () if alone else tuple(i for i in ids if i in config.elsewhere)
        self.owners = world_actors(
            self.bus, config, tuple(i for i in ids if i not in self.owned), trace=trace
        )
        self._owner_of = {i: owner for owner in self.owners for i in owner.world.ids}
        self._graph = config.graph()
        self._start_deadline = (
            config.start_deadline if start_deadline is None else start_deadline
        )
        self._digest = compute_mission_hash(config, mission)
        self._remotes = {i: self._remote(i) for i in self.owned}
        self._radios: list[RadioWatch] = []
        self.drones: dict[int, AgentDrone] = {i: self._drone(i) for i in ids}
        pilots = [drone.pilot for drone in self.drones.values()]
        self.pacemaker = Pacemaker(clock, pilots, config.mocap.rate)
        patience = 0.0 if alone else config.flight.dead_man
        self.dead_man = (
            DeadMan(clock, patience, self._flies, self.land_all) if patience else None
        )
        self.supervisor = Supervisor(clock, f"process {process}", self._shared_failed)
        self.services: list[Actor] = []
        self._guidances: dict[int, GuidanceActor] = {}
        self._orders = {i: self._orders_of(drone) for i, drone in self.drones.items()}
        self._steering = {i: Steering(drone) for i, drone in self.drones.items()}

    def _drone(self, i: int) -> AgentDrone:
        config = self.config
        port = self.bus.ports[i]
        barrier = Barrier(
            port,
            self._graph,
            mission_hash=self._digest,
            version=PACKAGE_VERSION,
            agreed_keys=AGREED_KEYS,
            seed=config.seed,
            start=config.start,
            start_deadline=self._start_deadline,
            lost_after=config.lost_after,
        )
        communicator = Communicator(port, self._graph)
        communicator.follow(barrier)
        barrier.listeners.append(partial(self._tell_apart, barrier))
        fence = self._fence(i)
        own_pose = i in config.reached and i not in config.seen
        chosen = self._controls(i)
        rate = config.radio.log_rate if own_pose else config.mocap.rate
        seen = choose_filter(
            config.control_of(i).filter, chosen, config.flight.ground, rate
        )
        link, harm = self._body(i, chosen.sender.kind)
        seen_at = config.source(DRONE_TOPICS.pose, i) if i in self.owned else i
        limit = Fence.box(*limit_area(config))
        collision = self._collision(i, chosen)
        reached: ReachKind = (
            "no" if i not in config.reached else "own" if own_pose else "seen"
        )
        pilot = Pilot(
            port,
            link,
            config.flight,
            fence,
            rate,
            chosen,
            seen,
            seen_at,
            collision,
            limit,
            reached,
            config.drone(i).home,
            config.drone(i).uri.startswith(WORLD_URIS.replay),
        )
        if i in self._remotes:
            remote = self._remotes[i]
            remote.found_flying = pilot.take_over
            pilot.turning = remote.flying
            pilot.unheard = remote.unheard
            pilot.unfit, remote.found_cut = remote.problems, partial(self._found_cut, i)
        if reached != "no":
            firmware = find_platform(config.drone(i).platform).firmware
            watch = RadioWatch(
                port, config.source(DRONE_TOPICS.link, i), pilot.guard, firmware
            )
            pilot.unfit = watch.problems
            pilot.turning = watch.turning
            pilot.astray = watch.astray
            self._radios.append(watch)
        supervisor = self._supervisor(i)
        guidance = self.mission.guidance(i, config)
        guidance.foresee(Member(i, config, self.clock, communicator, pilot))
        drone = AgentDrone(
            i,
            port,
            barrier,
            communicator,
            pilot,
            guidance,
            supervisor,
            harm,
            self._sensors(i),
            pilot.unfit,
        )
        CommandServer(port, partial(self._execute, drone), partial(self._stop, drone))
        return drone

    def _fence(self, i: int) -> Fence:
        """Return the fence of drone i.

        It is [fence], or smaller if the radio that streams to the drone may fail.
        """
        config = self.config
        fence = Fence.box(*fence_of(config, i))
        sender = find_sender(config, i)
        if i not in config.reached or sender not in TILT_TIMES:
            return fence
        margin = fence_inset(config, sender)
        here = [
            j for j in config.reached if config.drone(j).host == config.drone(i).host
        ]
        alike = [j for j in here if find_sender(config, j) == sender]
        if margin.problem and i == alike[0]:  # logged once for all of them
            log.warning(
                "drones %s (%s): %s", ", ".join(map(str, alike)), sender, margin.problem
            )
        streamed = {
            j: kind
            for j in config.reached
            if (kind := find_sender(config, j)) in TILT_TIMES
        }
        if near := describe_crowding(config, i, streamed):
            log.warning("drone %d (%s): %s", i, sender, near)
        return fence

    def _remote(self, i: int) -> RemoteLink:
        port = self.bus.ports[i]
        reached = self.config.reached
        dongle = next((k for k, ids in self.config.dongles.items() if i in ids), 0)
        owner = f"the owner of dongle {dongle} (crazychoir-radio --dongle {dongle})"
        return (
            RemoteLink(port, owner, OWNER_SILENCE) if i in reached else RemoteLink(port)
        )

    def _controls(self, i: int) -> Controls:
        drone = self.config.drone(i)
        plant = self.config.plant
        if drone.uri in ROBOT_CONTROLS:
            return ROBOT_CONTROLS[drone.uri][1](self.config.flight)
        kind: PlantKind = (
            "lightweight" if drone.uri == WORLD_URIS.lightweight else "motors"
        )
        where = f"control of drone {i}"
        row = self.config.control_of(i)
        return make_controls(
            row,
            find_platform(drone.platform),
            kind,
            plant.rate_lag,
            plant.command_delay,
            where,
        )

    def _collision(
        self, i: int, chosen: Controls
    ) -> CollisionFilter | PlannedFlights | None:
        """Return the part that keeps drone i clear of the others.

        None if it is off, if the drone does not fly, or if it flies alone.
        """
        config = self.config
        flight = self.config.flight
        flying = [j for j in config.ids if config.drone(j).uri not in ROBOT_CONTROLS]
        if config.collision.method == "off" or i not in flying or len(flying) == 1:
            return None
        planners = tuple(
            j for j in flying if config.control_of(j).sender in FIRMWARE_GAIN_SENDERS
        )
        fence = Fence.box(config.fence.min, config.fence.max).with_floor(
            max(config.fence.min[2], flight.ground)
        )
        a_max = compute_braking_limit(
            flight,
            chosen.platform,
            FLATNESS_LIMITS.height_share * FLATNESS_LIMITS.acceleration_share,
        )
        traffic = NeighbourTable(self.bus.ports[i], flying, planners)
        v_max = flight.speed_limit
        ground = flight.ground
        self._see(traffic, i)
        if i in planners:
            return PlannedFlights(
                self.bus.ports[i],
                config.collision,
                traffic,
                planners,
                fence.with_floor(ground + LOWEST_WAYPOINT),
                a_max,
                v_max,
                ground,
            )
        return CollisionFilter(config.collision, traffic, fence, a_max, v_max, ground)

    def _see(self, traffic: NeighbourTable, i: int) -> None:
        """Subscribe the table of neighbours to what is known of drones with radios.

        Their owners publish whether the radio reaches them. The cameras publish where they are.
        """
        for j in self.config.reached:
            if j != i:
                call = Call(
                    self.clock,
                    partial(traffic.linked, j),
                    f"drone {i} knows the link of {j}",
                )
                self.bus.subscribe(
                    DRONE_TOPICS.link,
                    self.config.source(DRONE_TOPICS.link, j),
                    i,
                    call,
                    DRONE_TOPICS.link.rate,
                )
        for j in self.config.seen:
            if j != i:
                call = Call(self.clock, partial(traffic.seen, j), f"drone {i} sees {j}")
                self.bus.subscribe(
                    DRONE_TOPICS.truth,
                    self.config.source(DRONE_TOPICS.truth, j),
                    i,
                    call,
                    DRONE_TOPICS.truth.rate,
                )

    def _body(self, i: int, kind: str) -> tuple[DroneLink, Callable[[], str]]:
        """Return the link to a drone's body, and a function that returns the damage of the body.

        Raises ConfigError for a kind of command that cannot be flown there. The owner of a world
        refuses such a kind too, when it starts.
        """
        if i in self._remotes:
            return self._remotes[i], self._remotes[i].harm
        owner = self._owner_of[i]
        return owner.link(i, kind), partial(owner.world.harm, i)

    def _sensors(self, i: int) -> Sensors:
        ask = (
            self._remotes[i].ask
            if i in self._remotes
            else partial(self._owner_of[i].telemetry.ask, i)
        )
        body = self.config.source(DRONE_TOPICS.telemetry, i) if i in self.owned else i
        return Sensors(
            self.bus.ports[i], body, list_log_names(self.config.drone(i).uri), ask
        )

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
        watch = (
            [OwnerWatch(self.clock, self._remotes, self._orphaned)]
            if self._remotes
            else []
        )
        dead_man = [self.dead_man] if self.dead_man else []
        return [
            *self.services,
            *self.owners,
            *watch,
            *self._radios,
            self.pacemaker,
            *dead_man,
        ]

    def _flies(self) -> bool:
        return any(
            drone.pilot.mode not in MOTORS_OFF_MODES for drone in self.drones.values()
        )

    def _flying(self, drone: AgentDrone) -> list[Actor]:
        return [drone.barrier.monitor, drone.pilot, StatusActor(drone)]

    async def _guide(self, drone: AgentDrone) -> None:
        """Run the guidance under its own supervisor.

        When it ends the drone flies on until it is down.
        """
        supervisor = self._supervisor(drone.id)
        actor = self._guidances[drone.id] = GuidanceActor(
            drone, self.config, self.watchdog
        )
        if drone.barrier.refused:
            actor.abort(drone.barrier.refused)
        await supervisor.run([actor])

    def _orders_of(self, drone: AgentDrone) -> OperatorCommands:
        i = drone.id

        def abort(why: str) -> None:
            self._guidances[i].abort(why, by_operator=True)

        def over() -> str:
            return self._guidances[i].over

        arm = self._remotes[i].arm if i in self.config.reached else None
        return OperatorCommands(drone, self.config, abort, over, arm)

    def land_all(self, reason: str) -> None:
        """Land every drone and end every mission, with this reason."""
        for drone in self.drones.values():
            drone.pilot.land(reason)
        for guidance in self._guidances.values():
            guidance.abort(reason)

    def _orphaned(self, i: int) -> None:
        """End the mission of drone i, because its world is gone.

        If it flew, the safety table has brought it down.
        """
        pilot = self.drones[i].pilot
        reason = pilot.brought_down or "its world is gone"
        pilot.land(reason)
        self._guidances[i].abort(reason)

    def _found_cut(self, i: int, why: str) -> None:
        """Leave out a drone that cannot fly. The others learn the reason."""
        if not self.drones[i].pilot.cut_for:
            self.drones[i].barrier.refused = why
            if i in self._guidances:
                self._guidances[i].abort(why)

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

    def _tell_apart(self, barrier: Barrier, roster: Roster) -> None:
        """Log once for the team, from the coordinator, that the team is cut into parts."""
        if barrier.apart and roster.ids[0] == barrier.id:
            gone = " ".join(map(str, barrier.absent))
            text = f"drone {barrier.id}: {barrier.apart}: no message of one reaches another; without drone(s) {gone}"
            log.warning(
                "%s. Start what is gone again, or add edges to the swarm file.", text
            )
            barrier.port.publish(DRONE_TOPICS.log, text)

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

    async def _execute(
        self, drone: AgentDrone, verb: str, arguments: dict[str, Any]
    ) -> Any:
        """Execute a command of an operator, and return its outcome.

        Commands that change something are published to all observers.
        """
        if verb not in QUERY_COMMANDS:
            drone.port.publish(
                DRONE_TOPICS.log, f"drone {drone.id}: {COMMANDED_PREFIX}{verb}"
            )
        if verb in ORDERS:
            return await self._orders[drone.id].execute(verb)
        match verb:
            case "impair":
                self.bus.impairment.update(arguments)
                return self.bus.impairment.describe()
            case "param_get":
                return drone.pilot.parameters.values(arguments.get("name"))
            case "param_set":
                return drone.pilot.set_parameter(arguments["name"], arguments["value"])
            case "go-to":
                return await self._steering[drone.id].go_to(arguments)
            case "fly":
                return await self._steering[drone.id].fly(arguments)
            case "overview":
                return self._overview(drone)
            case "task_add" | "task_cancel" | "task_list":
                if not hasattr(drone.guidance, "member"):
                    raise Refused(f"drone {drone.id}", "its mission has not begun")
                return await drone.guidance.asked(verb, arguments)
            case "watched":
                if self.dead_man is not None:
                    self.dead_man.heard()
                return None
            case "ping":
                return drone.pilot.mode.value
            case _:
                raise Refused(
                    f"drone {drone.id}",
                    f"no command {verb!r}; there are {', '.join(DRONE_COMMANDS)}",
                )

    def _overview(self, drone: AgentDrone) -> dict[str, Any]:
        """Return what an observer needs and no topic holds.

        links: by drone: messages sent there through the simulated network, and messages lost.
        network: what is simulated.
        route: see CFGuidance.
        """
        network = self.bus.impairment
        begun = hasattr(drone.guidance, "member")
        return {
            "links": {
                j: [to.sent, to.lost]
                for (i, j), to in network.counters.items()
                if i == drone.id
            },
            "network": network.describe(),
            "route": [list(map(float, p)) for p in drone.guidance.route()]
            if begun
            else [],
        }

    def _stop(self, drone: AgentDrone, on: bool) -> None:
        drone.port.publish(
            DRONE_TOPICS.log,
            f"drone {drone.id}: {COMMANDED_PREFIX}{'emergency stop' if on else 'clear stop'}",
        )
        if on:
            drone.pilot.cut("emergency stop")


def _not_simulated(config: SwarmConfig) -> ConfigError:
    """Return the error for a drone with a radio in virtual time."""
    i = config.reached[0]
    do = 'Leave --fast out, or write uri = "sim://" for a flight in virtual time.'
    return ConfigError(
        f"drone {i}: uri", config.drone(i).uri, "a simulated drone, in virtual time", do
    )
