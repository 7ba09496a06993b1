"""The rules between the keys of a swarm file.

Each error names the file, the key, the value, and what to do.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.metadata import entry_points
from itertools import chain, combinations

from crazychoir import platforms
from crazychoir.bus.network.endpoints import address_fault, is_loopback
from crazychoir.config.flight_room import ABOVE_FLOOR, EDGE_MARGIN, largest_room
from crazychoir.config.radio_checks import check_radios, drones_by_dongle, has_radio
from crazychoir.config.reader import show_value
from crazychoir.config.tables import Position, Swarm
from crazychoir.config.uris import RADIO_FORM, parse_uri
from crazychoir.errors import ConfigError
from crazychoir.team.graph import Graph, describe_ids, graph_from_name


@dataclass(frozen=True, slots=True)
class WorldUris:
    """Uris of the worlds of this package."""

    lightweight: str = "sim://"
    """Uri of the lightweight world: each drone in its agent's
    process, unless the file names a world's owner.
    """
    motor_level: str = "sim://motors"
    """Uri of the motor-level world: all drones together in the process of the world's owner."""
    mujoco: str = "mujoco://"
    """Uri of the MuJoCo world: all drones together in the process of the world's owner."""
    single_integrator: str = "sim://single"
    """Uri of a point robot that does not fly and takes velocities."""
    double_integrator: str = "sim://double"
    """Uri of a point robot that does not fly and takes accelerations."""
    unicycle: str = "sim://unicycle"
    """Uri of a wheeled robot that does not fly and takes (v, w)."""
    replay: str = "replay://"
    """Start of the uri of a drone that is replayed; the file of its recording follows."""


WORLD_URIS = WorldUris()


INDEPENDENT_WORLDS = (
    WORLD_URIS.lightweight,
    WORLD_URIS.single_integrator,
    WORLD_URIS.double_integrator,
    WORLD_URIS.unicycle,
)
"""Worlds in which robots do not act on each other."""
BUILT_IN_WORLDS = (*INDEPENDENT_WORLDS, WORLD_URIS.motor_level, WORLD_URIS.mujoco)
"""All worlds of this package."""
WORLD_ENTRY_POINTS = "crazychoir.worlds"
"""Group of entry points with the worlds of other packages, named by the scheme of their uris."""
UNSUPPORTED_LINKS = {
    "usb": "A drone on a USB cable cannot be flown here: write the uri of its radio.",
    "serial": "A drone on a serial cable cannot be flown here: write the uri of its radio.",
    "tcp": "cflib's tcp:// is the WiFi of an AI deck, which is not supported here: write the uri of its radio.",
    "prrt": "cflib's prrt:// is not supported here: write the uri of its radio.",
    "cpx": "cflib's cpx:// is not supported here: write the uri of its radio.",
}
"""Links of cflib that are not supported here, and what to do instead."""
WORLD_STEP = 0.01  # s: step of the simulated worlds
LOG_PERIOD_TOLERANCE = (
    0.01  # share by which the period of [[logs]] may differ from whole steps
)


@dataclass(frozen=True, slots=True)
class SwarmLimits:
    """Limits that a swarm file must respect."""

    lowest_port: int = 1024
    """First port that does not need root."""
    least_patience: float = 2.0
    """s: least time that drones wait for a console."""
    touching_distance: float = 0.137
    """Distance between the centres of two Crazyflies below which they may touch.

    It is 92 mm from motor to motor along the diagonal (data sheet of the Crazyflie 2.1, Bitcraze), and
    half a propeller of 45 mm at each end.
    """
    planned_speed: float = 1.0
    """m/s: limit of the firmware for a drone that flies to places."""
    limit_area_margin: float = 0.5
    """m from the fence to the limit area, if the swarm file has none."""
    least_limit_area_margin: float = 0.3
    """Least distance from the fence to the limit area.

    A drone lands 0.25 m outside the fence, see safety/rules/guard.py.
    """
    oldest_pose: float = 0.10
    """Age of a pose above which a drone brakes, see safety/rules/guard.py.

    A drone with only older poses never flies.
    """


SWARM_LIMITS = SwarmLimits()


ROUTER_BELOW = 19
"""Distance of the router's port below base_port: below the owners of 16 dongles."""


def check_swarm(swarm: Swarm, where: str) -> None:
    """Raise ConfigError for the first rule that does not hold.

    where: name of the file, for errors
    """
    _check_ids(swarm, where)
    for rule in SWARM_CHECKS:
        rule(swarm, where)
    graph_of(swarm, where)


def graph_of(swarm: Swarm, where: str) -> Graph:
    """Return the communication graph: from `graph` (default
    "ring"), `edges`, or each drone's `neighbors`.
    """
    listed = [drone.id for drone in swarm.drones if drone.neighbors is not None]
    written = {
        "graph": swarm.graph_name,
        "edges": swarm.edges,
        "neighbors": listed or None,
    }
    sources = [name for name, value in written.items() if value is not None]
    if len(sources) > 1:
        raise ConfigError(
            f"{where}: graph",
            " and ".join(sources),
            "one of graph, edges, neighbors",
            "Remove the others.",
        )
    if listed:
        return _from_neighbors(swarm, where)
    if swarm.edges is not None:
        return _from_edges(swarm, where)
    try:
        return graph_from_name(
            swarm.graph_name or "ring", _members(swarm), swarm.seed, swarm.directed
        )
    except ConfigError as error:
        raise ConfigError(
            f"{where}: graph", error.found, error.allowed, error.do
        ) from error


def _from_edges(swarm: Swarm, where: str) -> Graph:
    """Return the graph with the edges of the file."""
    ids = _members(swarm)
    for n, edge in enumerate(swarm.edges or ()):
        _check_known(ids, edge, f"{where}: edges[{n}]")
        if edge[0] == edge[1]:
            raise ConfigError(
                f"{where}: edges[{n}]",
                show_value(edge),
                "an edge joins two drones",
                "Remove it.",
                "a loop",
            )
    return Graph.from_edges(ids, swarm.edges or (), swarm.directed)


def _from_neighbors(swarm: Swarm, where: str) -> Graph:
    """Return the graph in which drone i receives from drones[i].neighbors."""
    ids = _members(swarm)
    heard: dict[int, tuple[int, ...]] = {}
    for n, drone in enumerate(swarm.drones):
        key = f"{where}: drones[{n}].neighbors"
        if drone.neighbors is None:
            raise ConfigError(
                key,
                "nothing",
                "a list, as the other drones have one",
                "For none, neighbors = [].",
            )
        _check_known(ids, drone.neighbors, key)
        if drone.id in drone.neighbors:
            raise ConfigError(
                key,
                show_value(drone.neighbors),
                "a neighbour is another one",
                "Remove it.",
                "the drone itself",
            )
        heard[drone.id] = drone.neighbors
    if not swarm.directed:
        _check_mutual(swarm, heard, where)
    return Graph.from_neighbors(heard)


def _check_mutual(swarm: Swarm, heard: dict[int, tuple[int, ...]], where: str) -> None:
    """Check that neighbours of an undirected graph list each other."""
    at = {drone.id: n for n, drone in enumerate(swarm.drones)}
    one_sided = [
        (i, j) for i, others in heard.items() for j in others if i not in heard[j]
    ]
    for i, j in one_sided[:1]:
        raise ConfigError(
            f"{where}: drones[{at[i]}].neighbors",
            show_value(heard[i]),
            "neighbours of an undirected graph list each other",
            f"Add {i} to drones[{at[j]}].neighbors, or set directed = true.",
            f"drone {j} does not list drone {i}",
        )


def _members(swarm: Swarm) -> list[int]:
    return sorted(drone.id for drone in swarm.drones)


def _check_known(ids: list[int], named_ids: tuple[int, ...], key: str) -> None:
    """Check that all of these ids are drones of the swarm."""
    for j in named_ids:
        if j not in ids:
            raise ConfigError(
                key,
                show_value(named_ids),
                f"this swarm has {describe_ids(ids)}",
                f"Add a [[drones]] with id = {j}, or correct the list.",
                f"there is no drone {j}",
            )


def _check_roles(swarm: Swarm, where: str) -> None:
    """Check that roles are unique, and that each drone's role exists."""
    names = [row.name for row in swarm.roles]
    for n, name in enumerate(names):
        if name in names[:n]:
            raise ConfigError(
                f"{where}: roles[{n}].name",
                show_value(name),
                "each role is there once",
                "Rename it.",
            )
    for n, drone in enumerate(swarm.drones):
        if names and drone.role and drone.role not in names:
            problem = "there is no such [[roles]]"
            allowed = f"one of {', '.join(names)}, or nothing"
            raise ConfigError(
                f"{where}: drones[{n}].role",
                show_value(drone.role),
                allowed,
                "Correct the name.",
                problem,
            )


def _check_ids(swarm: Swarm, where: str) -> None:
    """Check that there are drones, and that each id is unique."""
    if not swarm.drones:
        raise ConfigError(
            f"{where}: drones", "no drone", "one or more", "Add a [[drones]]."
        )
    first: dict[int, int] = {}
    for n, drone in enumerate(swarm.drones):
        if drone.id in first:
            problem = f"drones[{first[drone.id]}] has this id"
            raise ConfigError(
                f"{where}: drones[{n}].id",
                drone.id,
                "each id is there once",
                "Give it another id.",
                problem,
            )
        first[drone.id] = n


def _check_names(swarm: Swarm, where: str) -> None:
    """Check that each name of a drone is there once."""
    first: dict[str, int] = {}
    for n, drone in enumerate(swarm.drones):
        if drone.name and drone.name in first:
            raise ConfigError(
                f"{where}: drones[{n}].name",
                show_value(drone.name),
                "each name is there once",
                "Rename the drone.",
                f"drones[{first[drone.name]}] has this name",
            )
        first[drone.name] = n


def _check_logs(swarm: Swarm, where: str) -> None:
    """Check that [[logs]] name drones of the swarm, and have a period that log blocks can have."""
    for n, row in enumerate(swarm.logs):
        if row.drones is not None:
            _check_known(_members(swarm), row.drones, f"{where}: logs[{n}].drones")
        ticks = 1.0 / (row.rate * WORLD_STEP)
        if abs(ticks - round(ticks)) > LOG_PERIOD_TOLERANCE * ticks:
            raise ConfigError(
                f"{where}: logs[{n}].rate",
                row.rate,
                "a rate with a period of whole 10 ms, as the firmware's log blocks have",
                f"For example {1.0 / (round(ticks) * WORLD_STEP):.4g}.",
            )


def _check_batteries(swarm: Swarm, where: str) -> None:
    """Check that drones do not land at a voltage at which they may take off."""
    for n, drone in enumerate(swarm.drones):
        warning = drone.battery_warning
        critical = drone.battery_critical
        if warning is not None and critical is not None and critical >= warning:
            raise ConfigError(
                f"{where}: drones[{n}].battery_critical",
                critical,
                f"below battery_warning = {warning:g}",
                "Lower it: under load the voltage is lower than at rest.",
            )


def _check_uris(swarm: Swarm, where: str) -> None:
    """Check that each uri names a world or a radio address."""
    for n, drone in enumerate(swarm.drones):
        if drone.uri in BUILT_IN_WORLDS or drone.uri.startswith(WORLD_URIS.replay):
            continue
        if has_radio(drone):
            parse_uri(drone.uri, f"{where}: drones[{n}].uri")
            continue
        key, (scheme, mark, _) = f"{where}: drones[{n}].uri", drone.uri.partition("://")
        is_foreign = bool(mark) and scheme != "sim"
        if is_foreign and scheme in engines_of_others():
            continue
        if scheme in UNSUPPORTED_LINKS:
            raise ConfigError(
                key, show_value(drone.uri), RADIO_FORM, UNSUPPORTED_LINKS[scheme]
            )
        links = "udp://HOST:PORT", "radio://DONGLE/CHANNEL/RATE/ADDRESS"
        flown = (
            *BUILT_IN_WORLDS,
            f"{WORLD_URIS.replay}FILE",
            *links,
            *(f"{name}://" for name in engines_of_others()),
        )
        near = get_close_matches(
            scheme, [form.partition("://")[0] for form in flown], 1
        )
        like = next(
            (form for form in flown if near and form.startswith(near[0])), "sim://"
        )
        other = (
            f"install a package with the entry point {scheme} in {WORLD_ENTRY_POINTS}"
            if is_foreign
            else "leave it out"
        )
        raise ConfigError(
            key,
            show_value(drone.uri),
            ", ".join(flown),
            f'Write uri = "{like}", or {other}.',
        )


def engines_of_others() -> tuple[str, ...]:
    """Return the schemes of the worlds of installed packages."""
    return tuple(
        sorted({entry.name: None for entry in entry_points(group=WORLD_ENTRY_POINTS)})
    )


def _check_platforms(swarm: Swarm, where: str) -> None:
    """Check that each platform exists."""
    for n, drone in enumerate(swarm.drones):
        platforms.find_platform(drone.platform, f"{where}: drones[{n}].platform")


def _check_delay(swarm: Swarm, where: str) -> None:
    """Check the command delay: only the lightweight world can have a fraction of a step."""
    steps = swarm.plant.command_delay / WORLD_STEP
    if abs(steps - round(steps)) > 1e-6 and any(
        drone.uri != WORLD_URIS.lightweight for drone in swarm.drones
    ):
        raise ConfigError(
            f"{where}: plant.command_delay",
            swarm.plant.command_delay,
            f"multiples of {WORLD_STEP:g} s, a step of the world, unless all drones are {WORLD_URIS.lightweight}",
            f"For example {WORLD_STEP * round(steps):g}.",
        )


def _check_speed(swarm: Swarm, where: str) -> None:
    """Check the speed limit of drones with the sender "xyz".

    Nothing on board reports that a drone is behind its places: its reference would run away from
    it.
    """
    rows = {row.name: row for row in swarm.roles}
    planned = [
        drone.id
        for drone in swarm.drones
        if rows.get(drone.role, swarm.control).sender == "xyz"
    ]
    if planned and swarm.flight.speed_limit > SWARM_LIMITS.planned_speed:
        problem = (
            f"drone {planned[0]} is sent places (xyz), which the firmware flies to at "
            f"{SWARM_LIMITS.planned_speed:g} m/s"
        )
        allowed = f"at most {SWARM_LIMITS.planned_speed:g} m/s with xyz"
        do = "Lower it, or choose another sender."
        raise ConfigError(
            f"{where}: flight.speed_limit",
            swarm.flight.speed_limit,
            allowed,
            do,
            problem,
        )


def _check_box(swarm: Swarm, where: str) -> None:
    """Check that the fence is a box, and that the take-off height is in it."""
    low = swarm.fence.min
    high = swarm.fence.max
    if any(a >= b for a, b in zip(low, high, strict=True)):
        raise ConfigError(
            f"{where}: fence",
            _between(low, high),
            "max above min in x, y and z",
            "Exchange them.",
        )
    room_low, room_high = largest_room(swarm)
    if any(a >= b for a, b in zip(room_low, room_high, strict=True)):
        raise ConfigError(
            f"{where}: fence",
            _between(low, high),
            f"a box of more than {2.0 * EDGE_MARGIN:g} m aside, and more than "
            f"{ABOVE_FLOOR + EDGE_MARGIN:g} m above flight.ground",
            "Widen it.",
            "no room is left inside it in which a drone may be sent",
        )
    top = swarm.flight.ground + swarm.flight.takeoff_height
    if not low[2] <= top <= high[2]:
        raise ConfigError(
            f"{where}: flight.takeoff_height",
            swarm.flight.takeoff_height,
            f"[fence] goes from {low[2]:g} to {high[2]:g} m",
            "Lower it, or raise fence.max.",
            f"above flight.ground it ends at {top:g} m, outside the fence",
        )


def limit_area(swarm: Swarm) -> tuple[Position, Position]:
    """Return the corners of the area outside which motors stop at once.

    It is [keep_out], else [fence] with SWARM_LIMITS.limit_area_margin m more on each side.
    """
    (a, b, c), (d, e, f) = swarm.fence.min, swarm.fence.max
    low = swarm.keep_out.min
    high = swarm.keep_out.max
    return low or (
        a - SWARM_LIMITS.limit_area_margin,
        b - SWARM_LIMITS.limit_area_margin,
        c - SWARM_LIMITS.limit_area_margin,
    ), high or (
        d + SWARM_LIMITS.limit_area_margin,
        e + SWARM_LIMITS.limit_area_margin,
        f + SWARM_LIMITS.limit_area_margin,
    )


def _check_limit_area(swarm: Swarm, where: str) -> None:
    """Check the limit area.

    A drone that leaves the fence lands before its motors are cut. It needs room for that above and
    on each side.
    """
    fence, (low, high) = swarm.fence, limit_area(swarm)
    room = [a - b for a, b in zip(fence.min[:2], low[:2], strict=True)]
    room += [b - a for a, b in zip(fence.max, high, strict=True)]
    if min(room) < SWARM_LIMITS.least_limit_area_margin or low[2] > fence.min[2]:
        raise ConfigError(
            f"{where}: keep_out",
            _between(low, high),
            f"{SWARM_LIMITS.least_limit_area_margin:g} m or more around [fence], which goes "
            f"from {_between(fence.min, fence.max)}",
            "Widen it, shrink [fence], or leave [keep_out] out: 0.5 m around the fence.",
            f"{min(room):.2g} m from a side of the fence"
            if min(room) < SWARM_LIMITS.least_limit_area_margin
            else "its floor is above the fence's",
        )


def _check_homes(swarm: Swarm, where: str) -> None:
    """Check that homes are inside the fence."""
    low = swarm.fence.min
    high = swarm.fence.max
    (a, b, _), top = largest_room(swarm)
    for n, drone in enumerate(swarm.drones):
        is_inside = all(
            x <= y <= z for x, y, z in zip(low, drone.home, high, strict=True)
        )
        if not is_inside or not all(
            x <= y <= z for x, y, z in zip((a, b, low[2]), drone.home, top, strict=True)
        ):
            raise ConfigError(
                f"{where}: drones[{n}].home",
                show_value(drone.home),
                f"[fence] goes from {_between(low, high)}",
                "Move the drone, or widen [fence].",
                f"nearer than {EDGE_MARGIN:g} m to a side of the fence"
                if is_inside
                else "outside the fence",
            )
    _check_spacing(swarm, where)


def _check_spacing(swarm: Swarm, where: str) -> None:
    """Check that homes are far enough from each other."""
    places = {drone.id: drone.home for drone in swarm.drones}
    for i, j, d in near_pairs(places, (1.0, 1.0, 1.0), SWARM_LIMITS.touching_distance):
        n = next(n for n, drone in enumerate(swarm.drones) if drone.id == i)
        raise ConfigError(
            f"{where}: drones[{n}].home",
            show_value(places[i]),
            f"homes are {SWARM_LIMITS.touching_distance} m apart or more",
            "Move one of them.",
            f"{d:.2g} m from the home of drone {j}",
        )
    refuse_conflicts(swarm, {i: p for i, p in places.items()}, f"{where}: homes")


def near_pairs(
    places: Mapping[int, Position], scale: Position, least: float
) -> Iterator[tuple[int, int, float]]:
    """Yield pairs of drones at places less than `least` m apart, with their distance.

    scale: factor on each axis before distances are computed
    """
    by_x = sorted(
        (tuple(s * c for s, c in zip(scale, p, strict=True)), i)
        for i, p in places.items()
    )
    for k, (p, i) in enumerate(by_x):
        for q, j in by_x[k + 1 :]:
            if q[0] - p[0] >= least:
                break
            if (d := math.dist(p, q)) < least:
                yield i, j, d


def refuse_conflicts(swarm: Swarm, places: Mapping[int, Position], where: str) -> None:
    """Raise ConfigError if drones at these places could never
    stay clear of each other, by [collision].
    """
    if swarm.collision.method == "off":
        return
    x, y, z = swarm.collision.semi_axes
    for i, j, d in near_pairs(places, (1.0, x / y, x / z), 2.0 * x):
        found = f"drone {i} at {show_value(places[i])}, drone {j} at {show_value(places[j])}"
        allowed = f"places {2.0 * x:g} m apart or more, vertical distances times {x / z:.2g} ([collision] semi_axes)"
        problem = f"{d:.2g} m apart: in conflict"
        raise ConfigError(where, found, allowed, "Move one of them.", problem)


def _check_pose_age(swarm: Swarm, where: str) -> None:
    """Check the age of poses.

    Just before the next pose arrives, the last one is latency + 1 / rate old. Simulated cameras
    count the latency in periods.
    """
    mocap = swarm.mocap
    periods = mocap.latency * mocap.rate
    if abs(periods - round(periods)) > 1e-6:
        raise ConfigError(
            f"{where}: mocap.latency",
            mocap.latency,
            f"multiples of {1.0 / mocap.rate:g} s, 1 / rate",
        )
    oldest = mocap.latency + 1.0 / mocap.rate
    if oldest > SWARM_LIMITS.oldest_pose:
        raise ConfigError(
            f"{where}: mocap",
            f"latency {mocap.latency:g} s, rate {mocap.rate:g} Hz",
            f"at most {SWARM_LIMITS.oldest_pose:g} s: a drone with an older pose brakes",
            "Lower the latency, or raise the rate.",
            f"poses get {oldest:.3g} s old before the next one comes",
        )


def _between(low: Position, high: Position) -> str:
    return f"{show_value(low)} to {show_value(high)}"


def _check_hosts(swarm: Swarm, where: str) -> None:
    """Check the names and addresses of hosts."""
    for name, address in swarm.hosts.items():
        key = f"{where}: hosts.{name}"
        if not re.fullmatch(r"[a-z0-9_-]{1,40}", name):
            raise ConfigError(
                key,
                show_value(name),
                "names of 1 to 40 of a-z, 0-9, _ and -",
                "Rename it.",
            )
        if fault := address_fault(address):
            raise ConfigError(
                key, show_value(address), "an IP address or a DNS name", fault
            )


def is_secured(swarm: Swarm) -> bool:
    """Return True if the network is encrypted and closed.

    Without `insecure` it is, as soon as a host is not this machine.
    """
    wanted = swarm.security.insecure
    return (
        not all(map(is_loopback, swarm.hosts.values()))
        if wanted is None
        else not wanted
    )


def _check_security(swarm: Swarm, where: str) -> None:
    """Check that a closed network has hosts and operators."""
    if not is_secured(swarm):
        return
    if not swarm.hosts:
        do = "Add [hosts], or leave security.insecure out: no other host reaches this machine's own addresses."
        raise ConfigError(
            f"{where}: security.insecure", "false", "a swarm with [hosts]", do
        )
    if not swarm.security.operators:
        do = f"Add [security] with operators = {show_value([next(iter(swarm.hosts))])}, or with insecure = true."
        raise ConfigError(
            f"{where}: security.operators",
            "nothing",
            "the hosts that may command, as by stop",
            do,
        )


def _check_placement(swarm: Swarm, where: str) -> None:
    """Check that each drone's host exists."""
    names = ", ".join(swarm.hosts) or "none, there is no [hosts]"
    for n, drone in enumerate(swarm.drones):
        if drone.host is None and swarm.hosts:
            do = f"Add host = {show_value(next(iter(swarm.hosts)))}."
            raise ConfigError(
                f"{where}: drones[{n}].host",
                "nothing",
                f"a name of [hosts]: {names}",
                do,
            )
        if drone.host is not None and drone.host not in swarm.hosts:
            raise ConfigError(
                f"{where}: drones[{n}].host",
                show_value(drone.host),
                f"[hosts] has {names}",
                f'Add {drone.host} = "its address" to [hosts], or correct the name.',
                "there is no such host",
            )


def world_owned_drones(swarm: Swarm) -> tuple[int, ...]:
    """Return the drones simulated, in real time, by the process of the world's owner.

    The ids are in increasing order.
    """
    named = swarm.world.owned or swarm.world.host is not None
    simulated = [drone for drone in swarm.drones if not has_radio(drone)]
    return tuple(
        sorted(
            drone.id
            for drone in simulated
            if named or drone.uri not in INDEPENDENT_WORLDS
        )
    )


def _check_world(swarm: Swarm, where: str) -> None:
    """Check that the host of the world's owner exists."""
    host = swarm.world.host
    names = ", ".join(swarm.hosts) or "none, there is no [hosts]"
    if host is not None and host not in swarm.hosts:
        problem = "there is no such host"
        raise ConfigError(
            f"{where}: world.host",
            show_value(host),
            f"[hosts] has {names}",
            "Correct the name.",
            problem,
        )
    if host is None and swarm.hosts and world_owned_drones(swarm):
        do = f"Add [world] with host = {show_value(next(iter(swarm.hosts)))}: crazychoir-world runs there."
        raise ConfigError(
            f"{where}: world.host", "nothing", f"a name of [hosts]: {names}", do
        )


def _check_router(swarm: Swarm, where: str) -> None:
    """Check that the router's host exists."""
    names = ", ".join(swarm.hosts) or "none, there is no [hosts]"
    if swarm.router is not None and swarm.router not in swarm.hosts:
        problem = "there is no such host"
        do = "Correct the name, or leave router out: hosts then reach each other directly."
        raise ConfigError(
            f"{where}: router",
            show_value(swarm.router),
            f"[hosts] has {names}",
            do,
            problem,
        )


def _check_processes(swarm: Swarm, where: str) -> None:
    """Check that each drone is in one process, and each process on one host."""
    if swarm.processes is None:
        return
    ids = _members(swarm)
    host = {drone.id: drone.host for drone in swarm.drones}
    for n, group in enumerate(swarm.processes):
        key = f"{where}: processes[{n}]"
        _check_known(ids, group, key)
        if any(host[i] != host[group[0]] for i in group):
            raise ConfigError(
                key,
                show_value(group),
                "a process is on one host",
                "Split it.",
                "drones of several hosts",
            )
    placed = sorted(chain(*swarm.processes))
    if wrong := [i for i in ids if placed.count(i) != 1]:
        problem = f"drone {wrong[0]} is there {placed.count(wrong[0])} times"
        raise ConfigError(
            f"{where}: processes",
            show_value(swarm.processes),
            "each drone is in one process",
            "Correct it, or leave processes out: one process a drone.",
            problem,
        )


def _check_dead_man(swarm: Swarm, where: str) -> None:
    """Check that the time without a console is not too short."""
    seconds = swarm.flight.dead_man
    if 0.0 < seconds < SWARM_LIMITS.least_patience:
        allowed = (
            f"0 (never), or {SWARM_LIMITS.least_patience:g} s and more: a console speaks "
            "twice a second, and one word may be lost"
        )
        raise ConfigError(
            f"{where}: flight.dead_man",
            seconds,
            allowed,
            "Raise it: all would land at once.",
        )


def _check_start(swarm: Swarm, where: str) -> None:
    """Check that the swarm has as many drones as the start needs."""
    if isinstance(swarm.start, int) and swarm.start > len(swarm.drones):
        allowed = f'"all", or 1 to {len(swarm.drones)} drones'
        raise ConfigError(
            f"{where}: start", swarm.start, allowed, "Lower it, or add drones."
        )


def _check_ports(swarm: Swarm, where: str) -> None:
    """Check that all ports are in the allowed range."""
    last = _members(swarm)[-1]
    if swarm.base_port + last > 65535:
        problem = f"a process listens on base_port + its lowest drone id, here up to {swarm.base_port + last}"
        raise ConfigError(
            f"{where}: base_port",
            swarm.base_port,
            "ports end at 65535",
            "Lower it.",
            problem,
        )
    below = 0
    if found := drones_by_dongle(swarm):
        below = 3 + max(found)
    elif world_owned_drones(swarm):
        below = 1
    if swarm.router is not None:
        below = ROUTER_BELOW
    if swarm.base_port - below < SWARM_LIMITS.lowest_port:
        problem = (
            f"routers, owners of worlds and radios listen down to base_port - {below}"
        )
        raise ConfigError(
            f"{where}: base_port",
            swarm.base_port,
            f"ports begin at {SWARM_LIMITS.lowest_port}",
            "Raise it.",
            problem,
        )


def _check_link_edges(swarm: Swarm, where: str) -> None:
    """Check that the rules of edges name drones of the swarm."""
    for n, edge in enumerate(swarm.network.edges):
        key = f"{where}: network.edges[{n}]"
        ends = tuple(i for i in (edge.source, edge.destination) if i is not None)
        if not ends:
            raise ConfigError(
                key,
                "neither source nor destination",
                "one or both",
                "A rule for all goes into [network].",
            )
        _check_known(_members(swarm), ends, key)


def _check_bursts(swarm: Swarm, where: str) -> None:
    """Check that bursts have a loss, and are as long as this loss demands."""
    links = {"network": swarm.network} | {
        f"network.edges[{n}]": edge for n, edge in enumerate(swarm.network.edges)
    }
    for key, link in links.items():
        link.require_possible_bursts(f"{where}: {key}.burst")


def _check_partitions(swarm: Swarm, where: str) -> None:
    """Check that partitions end after they begin, and that their groups are disjoint."""
    for n, cut in enumerate(swarm.network.partitions):
        key = f"{where}: network.partitions[{n}]"
        for group in cut.groups:
            _check_known(_members(swarm), group, f"{key}.groups")
        if cut.until is not None and cut.until <= cut.at:
            raise ConfigError(
                f"{key}.until",
                cut.until,
                f"later than at = {cut.at:g}",
                "Leave it out: it never heals.",
            )
        if twice := [i for a, b in combinations(cut.groups, 2) for i in a if i in b]:
            problem = f"drone {twice[0]} is in two groups"
            raise ConfigError(
                f"{key}.groups",
                show_value(cut.groups),
                "groups are disjoint",
                "Correct the groups.",
                problem,
            )


SWARM_CHECKS = (
    _check_names,
    _check_uris,
    _check_platforms,
    _check_batteries,
    _check_logs,
    _check_delay,
    _check_roles,
    _check_speed,
    _check_box,
    _check_limit_area,
    _check_homes,
    _check_pose_age,
    _check_hosts,
    _check_placement,
    _check_world,
    _check_router,
    _check_processes,
    _check_dead_man,
    _check_start,
    _check_ports,
    _check_link_edges,
    _check_bursts,
    _check_partitions,
    check_radios,
    _check_security,
)
"""All rules, in the order of their errors."""
