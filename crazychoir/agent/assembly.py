"""Builds the parts of one drone from the swarm file, and connects them."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from crazychoir.agent.drone import Drone
from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.port import Bus, Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.calibrated import (
    find_controlled_platform,
    find_firmware,
    find_known_platform,
)
from crazychoir.config.checks import WORLD_URIS, limit_area
from crazychoir.config.drone_room import fence_of
from crazychoir.config.link_loss import TILT_TIMES, describe_crowding, fence_inset
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import AGREED_KEYS
from crazychoir.control.choice import (
    FIRMWARE_GAIN_SENDERS,
    PLACE_SENDERS,
    Controls,
    make_controls,
)
from crazychoir.control.margin import Plant as PlantKind
from crazychoir.control.position import FLATNESS_LIMITS
from crazychoir.control.robots import ROBOT_CONTROLS, find_sender
from crazychoir.flight.batch import DroneRow
from crazychoir.flight.body import DistantBody, DroneBody, LocalBody, RadioBody
from crazychoir.flight.estimate import choose_filter
from crazychoir.flight.pilot import Pilot
from crazychoir.flight.point_flights import compute_braking_limit
from crazychoir.flight.setup import FlightSetup, ReachKind
from crazychoir.flight.tick import FlightTick
from crazychoir.guidance.member import Member
from crazychoir.guidance.mission import Mission
from crazychoir.guidance.sensors import Sensors
from crazychoir.runtime.mailbox import Call
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.airspace_frames import AirspaceFrames
from crazychoir.safety.airspace.life_signs import find_heard_ns
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.collision.agreed.path_limits import (
    LOWEST_WAYPOINT,
    PLACE_SPEED,
    PathLimits,
)
from crazychoir.safety.collision.agreed.planned import PlannedFlights
from crazychoir.safety.collision.filter import CollisionFilter
from crazychoir.safety.rules.guard import Fence, Guard
from crazychoir.safety.rules.radio_watch import RadioWatch
from crazychoir.simulation.owner import WorldOwner
from crazychoir.simulation.remote import RemoteLink
from crazychoir.simulation.telemetry import list_log_names
from crazychoir.team.barrier import AgreedMission, Barrier
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph
from crazychoir.team.messages import Roster

log = logging.getLogger(__name__)
OWNER_SILENCE = 20.0
"""s: how long the owner of a dongle may be silent.

`run` restarts an owner. After this time it does not come back.
"""


@dataclass(frozen=True, slots=True)
class DroneSurroundings:
    """What the drones of a process share."""

    bus: Bus
    """Bus of the process, with a port for each drone."""
    mission: Mission
    """The mission file."""
    mission_hash: str
    """Hash of the swarm file and the mission, equal at all members of a team."""
    graph: Graph
    """Communication graph of the swarm."""
    start_deadline: float
    """s: time to wait for the team."""
    owners: dict[int, WorldOwner]
    """Owner of the world of each drone with its body in this process."""
    tick: FlightTick
    """The tick that flies the drones."""


def build_drone(
    config: SwarmConfig, i: int, shared: DroneSurroundings, supervisor: Supervisor
) -> Drone:
    """Return drone i with all its parts.

    config: the swarm file
    i: id of the drone
    shared: what the drones of this process share
    supervisor: runs the actors of the drone
    Raises ConfigError if the drone's world cannot fly its kind of command (`sender`). The owner of a
    world refuses this too, when it starts.
    """
    port = shared.bus.ports[i]
    owner = shared.owners.get(i)
    remote = _build_remote_link(config, port) if owner is None else None
    barrier = Barrier(
        port,
        shared.graph,
        AgreedMission(shared.mission_hash, PACKAGE_VERSION, AGREED_KEYS, config.seed),
        start=config.start,
        start_deadline=shared.start_deadline,
        lost_after=config.lost_after,
    )
    communicator = Communicator(port, shared.graph)
    communicator.exchange.follow(barrier)
    barrier.listeners.append(partial(_tell_apart, barrier))
    pilot = _build_pilot(config, port, shared, remote)
    radio_watch = pilot.body.watch if isinstance(pilot.body, RadioBody) else None
    guidance = shared.mission.guidance(i, config)
    guidance.foresee(Member(i, config, shared.bus.clock, communicator, pilot))
    return Drone(
        id=i,
        port=port,
        barrier=barrier,
        communicator=communicator,
        pilot=pilot,
        guidance=guidance,
        supervisor=supervisor,
        remote=remote,
        radio_watch=radio_watch,
        harm=_find_harm(i, owner, remote),
        sensors=_build_sensors(config, port, owner, remote),
        unfit=pilot.body.list_problems,
    )


def _build_remote_link(config: SwarmConfig, port: Port) -> RemoteLink:
    """Return the link to the drone's body in another process."""
    topology = config.topology
    i = port.address
    if i not in topology.reached:
        return RemoteLink(port)
    dongle = next((k for k, ids in topology.dongles.items() if i in ids), 0)
    owner = f"the owner of dongle {dongle} (crazychoir-radio --dongle {dongle})"
    return RemoteLink(port, owner, OWNER_SILENCE)


def _build_pilot(
    config: SwarmConfig,
    port: Port,
    shared: DroneSurroundings,
    remote: RemoteLink | None,
) -> Pilot:
    """Return the pilot, with its controller, its fence and its body.

    remote: link to the body elsewhere, None if it is in this process
    """
    topology = config.topology
    i = port.address
    row = shared.tick.batch.add(port.address)
    setup = _build_setup(config, i, row)
    guard = setup.make_guard(row)
    body = _build_body(config, port, setup, shared, remote, guard)
    pilot = Pilot(
        port,
        body,
        setup,
        choose_filter(
            config.control_of(i).filter,
            setup.controls,
            config.flight.ground,
            setup.rate,
            row.filters,
        ),
        _build_avoidance(config, port, setup.controls, shared.tick.airspace, row),
        shared.tick,
        row,
        guard,
    )
    if remote is not None:
        pose_source = topology.source(DRONE_TOPICS.pose, i)
        seen = Call(port.bus.clock, pilot.see, f"drone {i} pose")
        port.bus.subscribe(DRONE_TOPICS.pose, pose_source, i, seen)
        remote.found_flying = pilot.take_over
    return pilot


def _build_setup(config: SwarmConfig, i: int, row: DroneRow) -> FlightSetup:
    """Return what the pilot of drone i must know.

    row: of the drone in its batch, for its controllers
    """
    topology = config.topology
    has_own_pose = i in topology.reached and i not in topology.seen
    reach: ReachKind = "no"
    if i in topology.reached:
        reach = "own" if has_own_pose else "seen"
    return FlightSetup(
        limits=config.flight,
        room=_build_fence(config, i),
        rate=config.radio.log_rate if has_own_pose else config.mocap.rate,
        controls=_choose_controls(config, i, row),
        limit_area=Fence.box(*limit_area(config)),
        reach=reach,
        home=config.drone(i).home,
        is_replayed=config.drone(i).uri.startswith(WORLD_URIS.replay),
    )


def _build_body(
    config: SwarmConfig,
    port: Port,
    setup: FlightSetup,
    shared: DroneSurroundings,
    remote: RemoteLink | None,
    guard: Guard,
) -> DroneBody:
    """Return the body of a drone: in this process, in another one, or behind a radio.

    remote: link to the body elsewhere, None if it is in this process
    guard: of the drone, which hears of its radio
    """
    i = port.address
    if remote is None:
        return LocalBody(shared.owners[i].link(i, setup.controls.sender.kind))
    if i not in config.topology.reached:
        return DistantBody(remote)
    source = config.topology.source(DRONE_TOPICS.link, i)
    firmware = find_firmware(config.drone(i))
    return RadioBody(remote, RadioWatch(port, source, guard, firmware))


def _find_harm(
    i: int, owner: WorldOwner | None, remote: RemoteLink | None
) -> Callable[[], str]:
    """Return a function that returns the damage of the body of drone i."""
    if owner is not None:
        return partial(owner.world.harm, i)
    assert remote is not None  # noqa: S101 - the body is in this process or elsewhere
    return remote.harm


def _build_sensors(
    config: SwarmConfig,
    port: Port,
    owner: WorldOwner | None,
    remote: RemoteLink | None,
) -> Sensors:
    """Return the readings of the sensors of the drone's body."""
    i = port.address
    names = list_log_names(config.drone(i).uri)
    if owner is not None:
        return Sensors(port, i, names, partial(owner.telemetry.ask, i))
    assert remote is not None  # noqa: S101 - the body is in this process or elsewhere
    body = config.topology.source(DRONE_TOPICS.telemetry, i)
    return Sensors(port, body, names, remote.ask)


def _build_fence(config: SwarmConfig, i: int) -> Fence:
    """Return the fence of drone i.

    It is [fence], or smaller if the radio that streams to the drone may fail.
    """
    fence = Fence.box(*fence_of(config, i))
    sender = find_sender(config, i)
    if i not in config.topology.reached or sender not in TILT_TIMES:
        return fence
    margin = fence_inset(config, sender)
    here = [
        j
        for j in config.topology.reached
        if config.drone(j).host == config.drone(i).host
    ]
    alike = [j for j in here if find_sender(config, j) == sender]
    if margin.problem and i == alike[0]:  # logged once for all of them
        log.warning(
            "drones %s (%s): %s", ", ".join(map(str, alike)), sender, margin.problem
        )
    streamed = {
        j: kind
        for j in config.topology.reached
        if (kind := find_sender(config, j)) in TILT_TIMES
    }
    if near := describe_crowding(config, i, streamed):
        log.warning("drone %d (%s): %s", i, sender, near)
    return fence


def _choose_controls(config: SwarmConfig, i: int, row: DroneRow) -> Controls:
    """Return the controller and the sender of drone i."""
    drone = config.drone(i)
    plant = config.plant
    if drone.uri in ROBOT_CONTROLS:
        return ROBOT_CONTROLS[drone.uri][1](config.flight)
    kind: PlantKind = "lightweight" if drone.uri == WORLD_URIS.lightweight else "motors"
    where = f"control of drone {i}"
    choice = config.control_of(i)
    return make_controls(
        choice,
        find_controlled_platform(drone, config.motors),
        kind,
        plant.rate_lag,
        plant.command_delay,
        where,
        row.controls,
    )


def build_airspace(config: SwarmConfig, bus: Bus) -> Airspace | None:
    """Return the airspace of a process; None if its drones do not avoid others.

    config: the swarm file
    bus: of the process, with a port of each of its drones
    """
    flying = [j for j in config.ids if config.drone(j).uri not in ROBOT_CONTROLS]
    own = [j for j in flying if j in bus.ports]
    if config.collision.method == "off" or not own or len(flying) == 1:
        return None
    flight = config.flight
    rules = AirspaceRules(
        config.collision,
        flight.speed_limit,
        flight.ground,
        _list_planners(config),
        {j: str(config.drone(j).host) for j in flying},
        min(_find_braking_limit(config, j) for j in flying),
    )
    airspace = Airspace(bus, flying, rules)
    _watch_radios(config, airspace, own[0])
    return airspace


def _find_braking_limit(config: SwarmConfig, i: int) -> float:
    """Return the acceleration in m/s2 with which drone i brakes."""
    return compute_braking_limit(
        config.flight,
        find_known_platform(config.drone(i)),
        FLATNESS_LIMITS.height_share * FLATNESS_LIMITS.acceleration_share,
    )


def connect_airspace(config: SwarmConfig, bus: Bus, tick: FlightTick) -> None:
    """Let the drones of a tick keep clear of each other, and of those of other processes.

    config: the swarm file
    bus: of the process, with a port of each of its drones
    """
    airspace = build_airspace(config, bus)
    tick.airspace = airspace
    if airspace is None:
        return
    for listener, i in enumerate(airspace.own_ids):
        bus.ports[i].life_signs.append(partial(find_heard_ns, airspace, listener))
    if len(airspace.own_ids) < len(airspace.ids):
        tick.frames = AirspaceFrames(airspace)


def _list_planners(config: SwarmConfig) -> tuple[int, ...]:
    """Return the ids of the drones that a planner on board flies."""
    return tuple(
        j
        for j in config.ids
        if config.drone(j).uri not in ROBOT_CONTROLS
        and config.control_of(j).sender in FIRMWARE_GAIN_SENDERS
    )


def _build_avoidance(
    config: SwarmConfig,
    port: Port,
    chosen: Controls,
    airspace: Airspace | None,
    row: DroneRow,
) -> CollisionFilter | PlannedFlights | None:
    """Return the part that keeps drone i clear of the others.

    None if it is off, if the drone does not fly, or if it flies alone.
    """
    i = port.address
    flight = config.flight
    if airspace is None or i not in airspace.own_ids:
        return None
    planners = _list_planners(config)
    fence = Fence.box(config.fence.min, config.fence.max).with_floor(
        max(config.fence.min[2], flight.ground)
    )
    a_max = _find_braking_limit(config, i)
    traffic = Neighbours(airspace, i, keeps_all=i in planners)
    v_max = flight.speed_limit
    ground = flight.ground
    if i in planners:
        is_sent_places = config.control_of(i).sender in PLACE_SENDERS
        limits = PathLimits(
            fence.with_floor(ground + LOWEST_WAYPOINT),
            a_max,
            min(v_max, PLACE_SPEED) if is_sent_places else v_max,
            ground,
        )
        return PlannedFlights(port, config.collision, traffic, planners, limits)
    return CollisionFilter(
        config.collision, traffic, fence, a_max, v_max, ground, row.avoid
    )


def _watch_radios(config: SwarmConfig, airspace: Airspace, reader: int) -> None:
    """Subscribe the airspace to what is known of drones with radios.

    Their owners publish whether the radio reaches them. The cameras publish where they are.

    config: the swarm file
    airspace: of this process
    reader: id of a drone of this process
    """
    bus = airspace.bus
    topology = config.topology
    watched = (
        (DRONE_TOPICS.link, topology.reached, airspace.take_link),
        (DRONE_TOPICS.truth, topology.seen, airspace.see),
    )
    for topic, ids, take in watched:
        for j in ids:
            call = Call(bus.clock, partial(take, j), f"airspace: {topic.name} of {j}")
            bus.subscribe(topic, topology.source(topic, j), reader, call, topic.rate)


def _tell_apart(barrier: Barrier, roster: Roster) -> None:
    """Log once for the team, from the coordinator, that the team is divided into parts."""
    if barrier.apart and roster.ids[0] == barrier.id:
        gone = " ".join(map(str, barrier.absent))
        text = f"drone {barrier.id}: {barrier.apart}: no message of one reaches another; without drone(s) {gone}"
        log.warning(
            "%s. Start what is gone again, or add edges to the swarm file.", text
        )
        barrier.port.publish(DRONE_TOPICS.log, text)
