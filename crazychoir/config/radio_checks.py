"""Checks of the drones with a radio, and of the dongles that they share."""

import math
from collections.abc import Mapping

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

LEAST_OWN_POSE_RATE = 25.0
"""Least Hz at which a drone must report its own pose if no camera sees it."""
FIRST_UDP_NUMBER = 0xE7
"""Number of the virtual drone 0 in packets with several poses; the number of drone k is k higher."""


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


def address_number(drone: DroneTable) -> int:
    """Return the number by which a drone knows its own pose among others: the last byte of its address."""
    found = radio_uri(drone.uri)
    if found:
        return int(found.address[-2:], 16)
    return (FIRST_UDP_NUMBER + drone.id) % 256


def radio_settings(drone: DroneTable) -> tuple[int, str]:
    """Return the channel and the data rate of a drone; of a udp:// drone those of no radio.

    A broadcast reaches the drones with the same settings.
    """
    found = radio_uri(drone.uri)
    return (found.channel, found.rate) if found else (-1, "")


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
    _check_numbers(swarm, where)
    _parameters(swarm.radio.parameters, f"{where}: radio.parameters")
    for n, drone in enumerate(swarm.drones):
        _parameters(drone.parameters, f"{where}: drones[{n}].parameters")
    _own_poses(swarm, where)
    _radio_hosts(swarm, where)
    _check_bodies(swarm, where)


def _check_numbers(swarm: Swarm, where: str) -> None:
    """Raise ConfigError for two drones if one would take the pose of the other out of a broadcast.

    Every drone of a channel hears a broadcast: also a drone of another dongle, and a drone that
    estimates its own pose.
    """
    told = _broadcast_drones(swarm)
    alike: dict[tuple[object, ...], list[int]] = {}
    for n, drone in enumerate(swarm.drones):
        if not drone.uri.startswith(RADIO_SCHEME):
            continue  # by UDP a drone is sent the packets of its own dongle only
        number = address_number(drone)
        others = alike.setdefault((*radio_settings(drone), number), [])
        for other in others:
            if told.isdisjoint((drone.id, swarm.drones[other].id)):
                continue
            raise ConfigError(
                f"{where}: drones[{n}].uri",
                show_value(drone.uri),
                "on each channel, addresses with different last bytes",
                "Give it another address, or set broadcast = false in [radio].",
                f"drones[{other}] has the last byte {number:02X}, too: one would take the other's pose",
            )
        others.append(n)


def _broadcast_drones(swarm: Swarm) -> set[int]:
    """Return the drones with poses that may be broadcast: a dongle broadcasts two poses or more."""
    if swarm.radio.broadcast is False:
        return set()
    seen = set(camera_drones(swarm))
    of_dongles = [seen.intersection(ids) for ids in drones_by_dongle(swarm).values()]
    return set().union(*(ids for ids in of_dongles if len(ids) > 1))


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
            and swarm.radio.log_rate < LEAST_OWN_POSE_RATE
        ):
            problem = f"drones[{n}] sends its own pose, and brakes if the pose is older than 0.1 s"
            do = f"Set log_rate = {LEAST_OWN_POSE_RATE:g} in [radio]; more if the dongle can carry it."
            raise ConfigError(
                f"{where}: radio.log_rate",
                swarm.radio.log_rate,
                f"{LEAST_OWN_POSE_RATE:g} Hz or more",
                do,
                problem,
            )


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
