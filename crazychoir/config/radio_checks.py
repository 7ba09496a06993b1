"""Checks of the drones with a radio, and of the dongles that they share."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from crazychoir.config.reader import show_value
from crazychoir.config.tables import DroneTable, Swarm
from crazychoir.config.uris import (
    RADIO_SCHEME,
    UDP_SCHEME,
    parse_uri,
    radio_uri,
    udp_uri,
)
from crazychoir.errors import ConfigError


def has_radio(drone: DroneTable) -> bool:
    """Return True if a radio reaches the drone."""
    return drone.uri.startswith((UDP_SCHEME, RADIO_SCHEME))


def radio_drones(swarm: Swarm) -> tuple[int, ...]:
    """Return the drones that a radio reaches; increasing."""
    return tuple(sorted(drone.id for drone in swarm.drones if has_radio(drone)))


def drones_by_dongle(swarm: Swarm) -> dict[int, tuple[int, ...]]:
    """Return the drones of each dongle; both increasing."""
    found: dict[int, list[int]] = {}
    for drone in sorted(swarm.drones, key=lambda drone: drone.id):
        if has_radio(drone):
            found.setdefault(_dongle(drone), []).append(drone.id)
    return {number: tuple(found[number]) for number in sorted(found)}


def _dongle(drone: DroneTable) -> int:
    """Return the dongle of the key, else of a radio:// uri, else 0."""
    if drone.dongle is not None:
        return drone.dongle
    found = radio_uri(drone.uri)
    return int(found.dongle) if found else 0


def check_radios(swarm: Swarm, where: str) -> None:
    """Raise ConfigError for two drones at one address, for a dongle
    that differs from the uri's, and for unknown hosts.

    With [hosts] the uri gives the number of the dongle on its host, and the key its number in the
    swarm.
    """
    first: dict[tuple[object, ...], int] = {}
    numbers: dict[int, str] = {}
    for n, drone in enumerate(swarm.drones):
        if not has_radio(drone):
            continue
        key = f"{where}: drones[{n}]"
        same = parse_uri(drone.uri, f"{key}.uri").drone
        if same in first:
            other = swarm.drones[first[same]].uri
            written = "" if other == drone.uri else f", written as {show_value(other)}"
            problem = f"drones[{first[same]}] has this address{written}"
            do = "Give each virtual drone its own port."
            if drone.uri.startswith(RADIO_SCHEME):
                do = "Give each drone its own address: cfclient writes a new one into the drone, by USB."
            raise ConfigError(
                f"{key}.uri",
                show_value(drone.uri),
                "an address of its own",
                do,
                problem,
            )
        first[same] = n
        found = radio_uri(drone.uri)
        number = numbers.setdefault(_dongle(drone), found.dongle) if found else ""
        if found and number != found.dongle:
            problem = f"other drones of dongle {_dongle(drone)} say {number}"
            do = "Correct the uri, or its dongle."
            raise ConfigError(
                f"{key}.uri",
                show_value(drone.uri),
                "one number on its host for each dongle",
                do,
                problem,
            )
        if found and not swarm.hosts and drone.dongle not in (None, int(found.dongle)):
            problem = f"its uri says dongle {found.dongle}"
            do = "Leave dongle out, or correct one of them."
            raise ConfigError(f"{key}.dongle", drone.dongle, found.dongle, do, problem)
    _parameters(swarm.radio.parameters, f"{where}: radio.parameters")
    for n, drone in enumerate(swarm.drones):
        _parameters(drone.parameters, f"{where}: drones[{n}].parameters")
    _own_poses(swarm, where)
    _radio_hosts(swarm, where)
    _check_bodies(swarm, where)


def _parameters(table: Mapping[str, object], where: str) -> None:
    """Check the form of firmware parameters; the firmware reports at connection if it has them."""
    for name, value in table.items():
        if name.count(".") != 1:
            do = 'Put it into quotes: "posCtlPid.xKp" = 2.0.'
            raise ConfigError(
                where, show_value(name), "GROUP.NAME, as posCtlPid.xKp", do
            )
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise ConfigError(f"{where}.{name}", show_value(value), "a number")


def camera_drones(swarm: Swarm) -> tuple[int, ...]:
    """Return the drones with poses from the process of motion capture; increasing."""
    return tuple(
        sorted(
            drone.id
            for drone in swarm.drones
            if has_radio(drone) and drone.pose == "mocap"
        )
    )


def body_name(drone: DroneTable) -> str:
    """Return the name of the drone in motion capture."""
    return drone.body or drone.name or f"cf{drone.id}"


def _check_bodies(swarm: Swarm, where: str) -> None:
    """Check that each seen drone has its own body, a replay
    has a file, and poses have their own port.
    """
    first: dict[str, int] = {}
    for n, drone in enumerate(swarm.drones):
        if drone.id not in camera_drones(swarm):
            continue
        name = body_name(drone)
        if name in first:
            problem = f"drones[{first[name]}] has this body"
            do = 'Give each drone its own; without `body` it is "cf" and its id.'
            raise ConfigError(
                f"{where}: drones[{n}].body",
                show_value(name),
                "each body is there once",
                do,
                problem,
            )
        first[name] = n
        at = udp_uri(drone.uri)
        if at and swarm.mocap.source == "virtual" and at.port == swarm.mocap.port:
            problem = f"drones[{n}] has this port"
            do = "`crazychoir virtual` sends poses on the port below its first drone."
            raise ConfigError(
                f"{where}: mocap.port",
                swarm.mocap.port,
                "a port of its own",
                do,
                problem,
            )
    if first and swarm.mocap.source == "replay" and not swarm.mocap.file:
        do = 'Add for example file = "flight.csv".'
        raise ConfigError(
            f"{where}: mocap.file", "nothing", 'a recording, for source = "replay"', do
        )


def _own_poses(swarm: Swarm, where: str) -> None:
    """Check that a drone that estimates its own pose reports it often enough to fly by it."""
    for n, drone in enumerate(swarm.drones):
        if (
            has_radio(drone)
            and drone.pose == "onboard"
            and swarm.radio.log_rate < RADIO_TRAFFIC.least_own_pose_rate
        ):
            problem = f"drones[{n}] sends its own pose, and brakes if the pose is older than 0.1 s"
            do = f"Set log_rate = {RADIO_TRAFFIC.least_own_pose_rate:g} in [radio]; more if the dongle can carry it."
            raise ConfigError(
                f"{where}: radio.log_rate",
                swarm.radio.log_rate,
                f"{RADIO_TRAFFIC.least_own_pose_rate:g} Hz or more",
                do,
                problem,
            )


@dataclass(frozen=True, slots=True)
class RadioTraffic:
    """Packets a second that drones need, and the share of the capacity of a dongle that is used."""

    least_own_pose_rate: float = 25.0
    """Least Hz at which a drone must report its own pose if no camera sees it."""
    echo_rate: float = 10.0
    """Packets a second and drone: echoes."""
    planner_rate: float = 10.0
    """Packets a second and drone: lines for the planner on board."""
    request_rate: float = 2.0
    """Packets a second and drone: other requests."""
    least_attitude_rate: float = 20.0
    """Least Hz at which a drone that cameras see reports its attitude."""
    uncertainty_rate: float = 10.0
    """Hz at which a drone that estimates its own pose reports the uncertainty of it."""
    single_drone_capacity: float = 1000.0
    """Packets a second of a dongle that reaches one drone, and so never changes its channel and
    address. Source: reports of users of cflib; it was not measured here.
    """
    planned_share: float = 0.85
    """Share of the capacity that is used if the rate is chosen here.

    Close to 1, packets wait for each other.
    """
    largest_command_rate: float = 100.0
    """Hz: one command for each pose."""


RADIO_TRAFFIC = RadioTraffic()


def _radio_hosts(swarm: Swarm, where: str) -> None:
    """Check that each owner of a dongle, and motion capture, has a host, if there are [hosts]."""
    flown = drones_by_dongle(swarm)
    rows = {row.dongle: row for row in swarm.radio.dongles}
    for n, row in enumerate(swarm.radio.dongles):
        if row.dongle in [other.dongle for other in swarm.radio.dongles[:n]]:
            raise ConfigError(
                f"{where}: radio.dongles[{n}].dongle",
                row.dongle,
                "each is there once",
                "Remove one.",
            )
    named = {
        f"radio.dongles: host of dongle {k}": rows[k].host if k in rows else None
        for k in flown
    }
    if camera_drones(swarm):
        named["mocap.host"] = swarm.mocap.host
    for key, host in named.items():
        if host is None and swarm.hosts:
            do = (
                "[[radio.dongles]] with dongle and host"
                if "dongle" in key
                else "[mocap] with host"
            )
            names = f"a name of [hosts]: {', '.join(swarm.hosts)}"
            raise ConfigError(f"{where}: {key}", "nothing", names, f"Add {do}.")
        if host is not None and host not in swarm.hosts:
            allowed = (
                f"[hosts] has {', '.join(swarm.hosts) or 'none, there is no [hosts]'}"
            )
            raise ConfigError(
                f"{where}: {key}",
                show_value(host),
                allowed,
                "Correct the name.",
                "there is no such host",
            )


LEAST_COMMAND_RATES = {"fpqr": 50.0, "frpy": 30.0, "vel": 10.0, "fullstate": 20.0}
"""Least Hz of set-points, by the kind of command; a drone does not fly with fewer."""


def capacity_of(swarm: Swarm, dongle: int) -> float:
    """Return the packets a second of a dongle, from its row, else from [radio].

    A dongle that never changes its channel has at least single_drone_capacity.
    """
    row = next((row for row in swarm.radio.dongles if row.dongle == dongle), None)
    capacity = (
        row.capacity
        if row is not None and row.capacity is not None
        else swarm.radio.capacity
    )
    return (
        max(capacity, RADIO_TRAFFIC.single_drone_capacity)
        if len(drones_by_dongle(swarm)[dongle]) == 1
        else capacity
    )


def carried_rate(swarm: Swarm, dongle: int, senders: Mapping[int, str]) -> float:
    """Return the Hz of set-points of each streamed drone that a dongle reaches.

    senders: {drone: kind of command}

    The packets of a drone ride on the acknowledgements of the packets to it, one on each: they must
    fit, too.
    Raises ConfigError, with the numbers, if the dongle cannot carry either direction.
    """
    radio = swarm.radio
    ids = drones_by_dongle(swarm)[dongle]
    capacity = capacity_of(swarm, dongle)
    _check_uplink(swarm, dongle, senders)
    streamed = [i for i in ids if senders[i] in LEAST_COMMAND_RATES]
    poses = (
        radio.pose_rate
        if all(_is_sent_poses(swarm, i) for i in ids)
        else max(radio.pose_rate, radio.log_rate)
    )
    beside = len(ids) * (
        poses + RADIO_TRAFFIC.echo_rate + RADIO_TRAFFIC.request_rate
    ) + RADIO_TRAFFIC.planner_rate * (len(ids) - len(streamed))
    least = max((LEAST_COMMAND_RATES[senders[i]] for i in streamed), default=0.0)
    spare = (
        (RADIO_TRAFFIC.planned_share * capacity - beside) / len(streamed)
        if streamed
        else 0.0
    )
    rate = radio.command_rate or min(
        math.floor(spare), RADIO_TRAFFIC.largest_command_rate
    )
    most = capacity if streamed else RADIO_TRAFFIC.planned_share * capacity
    if rate >= least and beside + rate * len(streamed) <= most:
        return rate
    asked = max(rate, least)
    fits = math.floor((most - beside) / len(streamed)) if streamed else 0
    kinds = ", ".join(sorted({senders[i] for i in ids}))
    if 0.0 < radio.command_rate < least <= fits:
        allowed = (
            f"{least:g} to {fits} Hz, for what is sent by dongle {dongle} ({kinds})"
        )
        raise ConfigError(
            "radio.command_rate",
            rate,
            allowed,
            "Leave it out to choose the rate automatically.",
        )
    found = f"drones {', '.join(map(str, ids))} ({kinds}) need {beside + asked * len(streamed):g} packets a second"
    sums = f"{len(streamed)} x {asked:g} set-points, " if streamed else ""
    what = "poses" if poses == radio.pose_rate else "logs"
    each = f"{len(ids)} x {poses + RADIO_TRAFFIC.echo_rate + RADIO_TRAFFIC.request_rate:g} {what}, echoes and requests"
    plans = (
        f", {len(ids) - len(streamed)} x {RADIO_TRAFFIC.planner_rate:g} plans"
        if len(streamed) < len(ids)
        else ""
    )
    spared = (
        f"{max(spare, 0.0):.0f} set-points a second and drone"
        if streamed
        else _describe_spare_rate(capacity)
    )
    room = f"it carries {capacity:g}, {spared}"
    less = (
        _advise_fewer_commands(fits, least)
        if streamed
        else "send poses at a lower pose_rate ([radio]), "
    )
    do = f"Use more dongles, {less}or measure its capacity."
    raise ConfigError(f"dongle {dongle}", found, room, do, f"{sums}{each}{plans}")


def _advise_fewer_commands(fits: float, least: float) -> str:
    """Return advice to need fewer set-points, or an empty text.

    fits: Hz of set-points a drone that the dongle carries
    least: Hz that the kind of command needs
    """
    if fits >= least:
        return f"set command_rate = {least:g} to {fits:g} ([radio]), "
    lighter = [kind for kind, rate in LEAST_COMMAND_RATES.items() if rate <= fits]
    return f"send {' or '.join(lighter)} ({fits:g} Hz at most), " if lighter else ""


def _check_uplink(swarm: Swarm, dongle: int, senders: Mapping[int, str]) -> None:
    """Raise ConfigError if the packets from the drones of a dongle do not fit.

    They would wait on board and grow old, and answers with them.
    """
    ids = drones_by_dongle(swarm)[dongle]
    log_rate = swarm.radio.log_rate
    asked = sum(
        row.rate
        for row in swarm.logs
        for i in ids
        if row.drones is None or i in row.drones
    )
    logs = asked + sum(
        max(log_rate, RADIO_TRAFFIC.least_attitude_rate)
        if _is_sent_poses(swarm, i)
        else log_rate + RADIO_TRAFFIC.uncertainty_rate
        for i in ids
    )
    plans = sum(senders[i] not in LEAST_COMMAND_RATES for i in ids)
    said = (
        logs
        + len(ids) * (RADIO_TRAFFIC.echo_rate + RADIO_TRAFFIC.request_rate)
        + plans * RADIO_TRAFFIC.planner_rate
    )
    carries = capacity_of(swarm, dongle)
    if said <= RADIO_TRAFFIC.planned_share * carries:
        return
    kinds = ", ".join(sorted({senders[i] for i in ids}))
    found = f"drones {', '.join(map(str, ids))} ({kinds}) say {said:g} packets a second"
    answers = f"{len(ids)} x {RADIO_TRAFFIC.echo_rate + RADIO_TRAFFIC.request_rate:g} echoes and answers"
    answers += f", {plans} x {RADIO_TRAFFIC.planner_rate:g} to plans" if plans else ""
    room = f"it carries {carries:g}, {_describe_spare_rate(carries)}"
    less = "lower rates in [[logs]], " if asked else ""
    less += (
        "a lower log_rate ([radio]), "
        if log_rate > RADIO_TRAFFIC.least_attitude_rate
        or not all(_is_sent_poses(swarm, i) for i in ids)
        else ""
    )
    do = f"Use more dongles, {less}or measure its capacity."
    raise ConfigError(f"dongle {dongle}", found, room, do, f"{logs:g} logs, {answers}")


def _describe_spare_rate(capacity: float) -> str:
    return f"{RADIO_TRAFFIC.planned_share * capacity:g} with room to spare"


def _is_sent_poses(swarm: Swarm, i: int) -> bool:
    """Return True if drone i is sent its pose, False if it reports its own."""
    return next(drone for drone in swarm.drones if drone.id == i).pose == "mocap"
