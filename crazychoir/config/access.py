"""The access rules of the network of a swarm, as a host applies them."""

from collections.abc import Iterable
from pathlib import Path

from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.endpoints import are_local
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError


def access_of(config: SwarmConfig, host: str, *endpoints: str) -> NetworkAccess | None:
    """Return the access rules as a host applies them; None if the network is open to all.

    host: name of the host
    endpoints: given instead of those of the file
    Raises ConfigError for missing or bad keys, and for an endpoint beyond this machine if the file
    has neither keys nor insecure = true.
    """
    if not config.secured:
        _require_local(config, endpoints)
        return None
    from crazychoir.bus.network import authority  # a swarm without keys needs none

    topology = config.topology
    owners = [(topology.dongle_host(k), f"dongle{k}") for k in topology.dongles]
    owners += [(config.mocap.host, "mocap")] if topology.seen else []
    owners += [(config.world.host, "world")] if topology.owned else []
    agents = [(drone.host, str(drone.id)) for drone in config.drones]
    processes: dict[str, tuple[str, ...]] = {
        name: () for name in (*config.hosts, *config.security.operators)
    }
    for of, name in (*owners, *agents):
        processes[str(of)] += (name,)
    holders = {drone.id: str(drone.host) for drone in config.drones}
    holders |= {
        PORT_ADDRESSES.body_offset + i: str(config.world.host) for i in topology.owned
    }
    holders |= {
        PORT_ADDRESSES.body_offset + i: str(topology.dongle_host(k))
        for k, ids in topology.dongles.items()
        for i in ids
    }
    holders |= {
        PORT_ADDRESSES.camera_offset + i: str(config.mocap.host) for i in topology.seen
    }
    folder = authority.check_keys(Path(config.security.keys), host)
    return NetworkAccess(
        config.name,
        host,
        folder,
        processes,
        holders,
        config.security.operators,
        config.router,
    )


def _require_local(config: SwarmConfig, endpoints: Iterable[str]) -> None:
    """Raise ConfigError for an endpoint beyond this machine,
    unless the file allows an insecure network.
    """
    far = [
        endpoint
        for endpoint in endpoints
        if "/" in endpoint and not are_local([endpoint])
    ]  # a text without "/" is no endpoint
    if far and not config.security.insecure:
        allowed = "one of this machine's own, as tcp/127.0.0.1:7460"
        do = "Give the swarm file [hosts] and keys (deploy/README.md), or write insecure = true in [security]."
        raise ConfigError(
            "endpoint", far[0], allowed, do, "neither encrypted nor closed"
        )
