"""The network of a swarm as who looks on sees it; and names, ports and files so that two runs never meet."""

import asyncio
import contextlib
import random
import socket
import tempfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.access import OBSERVERS
from crazychoir.bus.hello import VERSION
from crazychoir.bus.local import OBSERVER, Bus
from crazychoir.bus.zenoh import ZenohLink
from crazychoir.errors import ConfigError
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.swarm.config import SwarmConfig

REPLAY = "Replay"
"""The host of what a recording says: no host of a swarm file can have this name."""
LOWEST = 10_000
"""Of the ports that are drawn: below it are those of well-known services, and the default base_port."""


def observer(clock: Clock, config: SwarmConfig) -> ZenohLink:
    """The link of an observer under a name and an address of its own: many may look on at once, from many hosts."""
    draw = random.SystemRandom()
    host = own_name(config)
    bus = Bus(clock, process=f"{OBSERVERS}-{host}.{draw.getrandbits(32):08x}", host=host)
    bus.port(OBSERVER + 1 + draw.getrandbits(24), draw.getrandbits(32))
    return observer_link(bus, config)


def observer_link(bus: Bus, config: SwarmConfig) -> ZenohLink:
    """The network as an observer sees it: connected to every process of the swarm file, listening nowhere known."""
    return ZenohLink(
        bus, config.name, listen=[f"{config.scheme}/127.0.0.1:0"], connect=list(config.endpoints().values()),
        routers=config.routers,
        incarnation=random.SystemRandom().getrandbits(62), version=VERSION, lease=config.lease,
        access=config.access(bus.host),
    )  # fmt: skip


def own_name(config: SwarmConfig) -> str:
    """Whose certificate an observer shows: an operator's, if one is here, else that of a host; raises ConfigError."""
    if not config.secured:
        return "observer"
    names = list(dict.fromkeys([*config.security.operators, *config.hosts]))
    here = [name for name in names if (Path(config.security.keys) / name).is_dir()]
    if not here:
        do = f"Copy the folder of this host there; see `crazychoir keys add {names[0]}`."
        raise ConfigError("security.keys", config.security.keys, f"a folder with that of {', '.join(names)}", do)
    return here[0]


@contextlib.asynccontextmanager
async def attached(link: ZenohLink, *actors: Actor) -> AsyncIterator[None]:
    """On the network, with these actors at work; afterwards all have stopped."""
    link.open()
    serving = asyncio.create_task(Supervisor(link.bus.clock, "observer").run([link, *actors]))
    await link.bus.clock.sleep(0.0)  # it has begun: one that is cancelled before closes nothing, and the process stays
    try:
        yield
    finally:
        serving.cancel()
        await asyncio.wait([serving])


@contextlib.contextmanager
def swarm_file(config: SwarmConfig) -> Iterator[Path]:
    """The swarm as a file, while it flies: for its processes, and for who wants to look into it."""
    with tempfile.TemporaryDirectory(prefix=f"crazychoir-{config.name}-") as folder:
        path = Path(folder) / "swarm.json"
        path.write_text(config.dumps(), encoding="utf-8")
        yield path


def apart(config: SwarmConfig, processes: int | None) -> SwarmConfig:
    """The same swarm under a name and on ports of its own, in so many processes: two runs side by side never meet."""
    groups = [list(map(int, part)) for part in np.array_split(config.ids, processes)] if processes else None
    suffix = f"{random.SystemRandom().getrandbits(32):08x}"
    changes: dict[str, Any] = {"name": f"{config.name[:30]}-{suffix}"}
    if groups:
        changes["processes"] = [group for group in groups if group]
    changed = config.replace(**changes)
    return changed.replace(base_port=free_ports(list(changed.endpoints())))


def free_ports(offsets: list[int], attempts: int = 200) -> int:
    """A base port such that base + offset is free for each offset, also when it is used a second later.

    Below the ports that the system gives to who connects: one that calls a port of those before anybody listens on it
    may be given this very port, is then connected to itself, and the port is taken.
    """
    draw = random.SystemRandom()
    end = _first_of_connections() - max(offsets)
    for _ in range(attempts):
        base = draw.randrange(min(LOWEST, end // 2), end)
        if all(_free(base + offset) for offset in offsets):
            return base
    raise ConfigError("base_port", f"no free block for {len(offsets)} processes", "free ports", "Set base_port.")


def _first_of_connections() -> int:
    try:
        return int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text(encoding="utf-8").split()[0])
    except (OSError, ValueError, IndexError):
        return 32_768


def _free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
