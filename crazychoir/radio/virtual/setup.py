"""Choose the virtual drones, from a swarm file or on a grid, and their properties."""

import socket
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec

from crazychoir.config.calibrated import build_body, find_thrust_factor
from crazychoir.config.checks import WORLD_STEP
from crazychoir.config.dongle_plan import capacity_of
from crazychoir.config.number_lists import parse_spans
from crazychoir.config.radio_checks import address_number
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.config.tables import DroneTable
from crazychoir.config.uris import udp_uri
from crazychoir.errors import ConfigError
from crazychoir.firmware.release import (
    DESCRIBED_RELEASE,
    THRUST_RELEASES,
    parse_release,
)
from crazychoir.mocap.frames import FRAME_PROTOCOL
from crazychoir.mocap.mounting import CENTRED_BODY, Mounting
from crazychoir.platforms import Platform, find_platform
from crazychoir.radio.virtual.drone import (
    MODELLED_DRONE,
    DroneIdentity,
    device_name_of,
)
from crazychoir.radio.virtual.toc import read_firmware_names
from crazychoir.simulation.common.world import WorldSetup
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.onboard.units import FULL_THRUST_COMMAND

GRID_HOST = "127.0.0.1"
"""Host of drones on a grid."""
PORT_TAKEN_ADVICE = (
    "The swarm file names it, and another `crazychoir virtual`, or another program, has it: end that, or change the "
    "uri of the drone, or mocap.port, in the file."
)
"""Advice if a port of a swarm is taken."""


@dataclass(frozen=True)
class DroneSeat:
    """The address and the properties of one drone."""

    id: int
    """Id of the drone."""
    at: tuple[str, int]
    """Host and port."""
    body: str
    """Name of its body for the cameras; empty if they do not show it."""
    number: int
    """Last byte of its address."""
    decks: tuple[str, ...]
    """Decks that it carries."""
    release: str = DESCRIBED_RELEASE
    """Release of its firmware."""
    device: str = DroneIdentity.device
    """Kind of drone, as its firmware tells it."""
    mounting: Mounting = CENTRED_BODY
    """How its body is mounted on it."""


@dataclass(frozen=True)
class VirtualSwarm:
    """All virtual drones in one world."""

    config: SwarmConfig
    """The swarm."""
    drones: tuple[DroneTable, ...]
    """Rows of the swarm file for the virtual drones."""
    seats: tuple[DroneSeat, ...]
    """Address and properties of each drone."""
    poses: tuple[str, int]
    """Address of the cameras."""
    taken: str = "Choose another --port."
    """Advice if one of its ports is taken."""

    def world(self, seed: int, release: str = DESCRIBED_RELEASE) -> CrazyflieWorld:
        """Return the world with the drones at home.

        It has the drones' platforms, the swarm's [motors] and the thrust map of a release.
        """
        config = self.config
        drones = self.drones
        return CrazyflieWorld.of(
            WorldSetup(
                ids=tuple(drone.id for drone in drones),
                uris=tuple(drone.uri for drone in drones),
                homes=tuple(drone.home for drone in drones),
                yaws=tuple(drone.yaw for drone in drones),
                platforms=tuple(
                    platform_of_release(find_platform(drone.platform), release)
                    for drone in drones
                ),
                options=msgspec.to_builtins(config.motors),
                wind=config.motors.wind,
                seed=seed,
                dt=WORLD_STEP,
                mass_error=config.plant.mass_error,
                thrust_error=config.plant.thrust_error,
                bodies=tuple(
                    platform_of_release(
                        build_body(drone, config.motors.worn_battery), release
                    )
                    for drone in drones
                ),
                thrust_factors=tuple(find_thrust_factor(drone) for drone in drones),
            )
        )


def place_on_grid(
    n: int,
    port: int,
    decks: Sequence[str] | None,
    release: str = DESCRIBED_RELEASE,
) -> VirtualSwarm:
    """Return n drones on a square grid on the floor, at consecutive ports."""
    config = default_swarm(n)
    drones = tuple(
        msgspec.structs.replace(drone, platform="cf21") for drone in config.drones
    )
    places = [(drone, (GRID_HOST, port + k)) for k, drone in enumerate(drones)]
    return VirtualSwarm(
        config,
        drones,
        _make_seats(
            config, places, MODELLED_DRONE.decks if decks is None else decks, release
        ),
        (GRID_HOST, port - 1),
    )


def select_from_swarm(
    config: SwarmConfig,
    decks: Sequence[str] | None,
    release: str = DESCRIBED_RELEASE,
) -> VirtualSwarm:
    """Return the drones of a swarm with a udp:// uri on this machine, at the ports of their uris.

    Raises ConfigError if there are none, or more than the cameras can see.
    """
    places = []
    for drone in config.drones:
        found = udp_uri(drone.uri)
        if found and _is_local_host(found.host):
            places.append((drone, (found.host, found.port)))
    if not places:
        uris = ", ".join(sorted({drone.uri for drone in config.drones}))
        do = (
            'Write uri = "udp://127.0.0.1:19850" into its [[drones]], each with a port of its own; '
            'or fly a script: crazychoir.api.launch(..., bodies="virtual") does so by itself.'
        )
        raise ConfigError(
            "virtual Crazyflies: uris of the swarm",
            uris,
            "udp://HOST:PORT on this machine",
            do,
        )
    if len(places) > FRAME_PROTOCOL.most_bodies:
        do = "Serve the others by another file, or on another machine."
        allowed = f"at most {FRAME_PROTOCOL.most_bodies} at once: cameras see no more"
        raise ConfigError("virtual Crazyflies", f"{len(places)} drones", allowed, do)
    drones = tuple(drone for drone, _ in places)
    poses = (places[0][1][0], config.mocap.port)
    return VirtualSwarm(
        config,
        drones,
        _make_seats(config, places, decks, release),
        poses,
        PORT_TAKEN_ADVICE,
    )


def _is_local_host(host: str) -> bool:
    """Return whether a host is an address of this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        try:
            door.bind((host, 0))
        except OSError:
            return False
        return True


def _make_seats(
    config: SwarmConfig,
    places: Sequence[tuple[DroneTable, tuple[str, int]]],
    decks: Sequence[str] | None,
    release: str,
) -> tuple[DroneSeat, ...]:
    seen = {config.body_name(i) for i in config.topology.seen}

    def body(drone: DroneTable) -> str:
        name = config.body_name(drone.id)
        # Empty if the name belongs to the body of another drone.
        return "" if name in seen and drone.id not in config.topology.seen else name

    return tuple(
        DroneSeat(
            drone.id,
            at,
            body(drone),
            address_number(drone),
            _default_decks(drone) if decks is None else tuple(decks),
            release,
            device_name_of(find_platform(drone.platform)),
            Mounting(drone.body_offset, drone.body_rotation),
        )
        for drone, at in places
    )


def _default_decks(drone: DroneTable) -> tuple[str, ...]:
    """Return the decks of a drone: those of the model if it locates itself, otherwise none."""
    return MODELLED_DRONE.decks if drone.pose == "onboard" else ()


def parse_decks(text: str) -> tuple[str, ...]:
    """Return the decks of a text such as "bcFlow2,bcLighthouse4" or "none".

    Raises ConfigError, with the known decks, if one is unknown.
    """
    there = sorted(
        entry.name for entry in read_firmware_names()[1] if entry.group == "deck"
    )
    found = () if text == "none" else tuple(text.split(","))
    for name in found:
        if name not in there:
            raise ConfigError(
                "--deck",
                name,
                f"none, or of {', '.join(there)}; {MODELLED_DRONE.position_deck} knows where it is",
            )
    return found


def platform_of_release(base: Platform, release: str) -> Platform:
    """Return the platform with the thrust map of a release (year and month).

    If the release is unknown, the platform has its newest thrust map.
    """
    number = parse_release(release)
    old = base.firmware.old_thrust_map
    if number is None or number > THRUST_RELEASES.measured_until or old is None:
        return base
    return replace(
        base,
        firmware=replace(base.firmware, thrust_max=FULL_THRUST_COMMAND / old / 4.0),
    )


def dongle_groups(
    hall: VirtualSwarm, text: str | None, each: int | None
) -> list[tuple[tuple[int, ...], float | None]]:
    """Return the drones of each dongle, and its capacity if the swarm file states one.

    text: groups such as "0,1|2,3"
    each: drones for each dongle
    Without both, the groups are those of the swarm file; a grid has none.
    """
    ids = tuple(seat.id for seat in hall.seats)
    if text is not None:
        return [(group, None) for group in _parse_groups(text, ids)]
    if each is not None:
        return [(ids[k : k + each], None) for k in range(0, len(ids), each)]
    found = {
        k: tuple(i for i in group if i in ids)
        for k, group in hall.config.topology.dongles.items()
    }
    return [
        (group, capacity_of(hall.config, k) if len(group) > 1 else None)
        for k, group in found.items()
        if group
    ]


def _parse_groups(text: str, ids: tuple[int, ...]) -> list[tuple[int, ...]]:
    allowed = (
        f"groups of drones, as 0,1|2,3, each of {', '.join(map(str, ids))} at most once"
    )
    found = [
        tuple(parse_spans(group, "--dongles", allowed, repeats=False))
        for group in text.split("|")
    ]
    named = [i for group in found for i in group]
    for i in named:
        if i not in ids or named.count(i) > 1:
            do = (
                f"There is no drone {i}."
                if i not in ids
                else f"Drone {i} is there {named.count(i)} times."
            )
            raise ConfigError("--dongles", text, allowed, do)
    return found
