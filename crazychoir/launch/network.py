"""The network of a swarm as an observer sees it; names, ports and files for runs side by side."""

import asyncio
import contextlib
import errno
import random
import resource
import socket
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.network.access import ACCESS_RULES
from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.zenoh_link import ZenohLink
from crazychoir.bus.network.zenoh_session import SessionEndpoints
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.access import access_of
from crazychoir.config.addresses import Addresses
from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import BASE_PORT
from crazychoir.errors import ConfigError
from crazychoir.files.private_folder import scratch_folder
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.supervisor import Supervisor

REPLAY_HOST = "Replay"
"""Host name of a replayed recording; no host of a swarm file can have this name."""


@dataclass(frozen=True, slots=True)
class PortSearch:
    """How a base port is searched."""

    lowest_drawn: int = 10_000
    """Lowest port that is drawn.

    Below it are the ports of well-known services and the default base_port.
    """
    highest: int = 65_535
    """Largest number of a port."""
    most_attempts: int = 200
    """Attempts to find a base port below the ports that the system gives to connections."""


PORT_SEARCH = PortSearch()


TIME_WAIT_STATE = 6  # state of a closed connection, in /proc/net/tcp
FILES_BESIDE = 256
"""Open files of a run, beside those for its processes."""
FILES_PER_PROCESS = 4
"""Open files for each process of a run: a port, two pipes and a process handle."""


def make_observer_link(clock: Clock, config: SwarmConfig) -> ZenohLink:
    """Return the link of an observer.

    Its name and address are random, so that many observers on many hosts can join a swarm.
    """
    draw = random.SystemRandom()
    host = choose_certificate_name(config)
    bus = Bus(
        clock,
        process=f"{ACCESS_RULES.observer_prefix}-{host}.{draw.getrandbits(32):08x}",
        host=host,
    )
    bus.port(
        PORT_ADDRESSES.first_observer + 1 + draw.getrandbits(24), draw.getrandbits(32)
    )
    return configure_observer(bus, config)


def configure_observer(bus: Bus, config: SwarmConfig) -> ZenohLink:
    """Return the network as an observer sees it.

    The link connects to every process of the swarm file. It listens at a free port of this machine.
    """
    addresses = Addresses(config)
    incarnation = random.SystemRandom().getrandbits(62)
    own = Introduction(config.name, incarnation, PACKAGE_VERSION)
    reach = SessionEndpoints(
        listen=[f"{addresses.scheme}/127.0.0.1:0"],
        connect=list(addresses.endpoints().values()),
        routers=addresses.routers,
        lease=config.lease,
        remote_processes=addresses.count_remote(bus.host),
    )
    return ZenohLink(bus, own, reach, access=access_of(config, bus.host))


def choose_certificate_name(config: SwarmConfig) -> str:
    """Return the name on the certificate that an observer shows.

    This is an operator's, if its keys are here, else that of a host.
    Raises ConfigError if there are no keys.
    """
    if not config.secured:
        return "observer"
    names = list(dict.fromkeys([*config.security.operators, *config.hosts]))
    here = [name for name in names if (Path(config.security.keys) / name).is_dir()]
    if not here:
        do = (
            f"Copy the folder of this host there; see `crazychoir keys add {names[0]}`."
        )
        raise ConfigError(
            "security.keys",
            config.security.keys,
            f"a folder with that of {', '.join(names)}",
            do,
        )
    return here[0]


@contextlib.asynccontextmanager
async def run_attached(link: ZenohLink, *actors: Actor) -> AsyncIterator[None]:
    """Connect the link and run the actors; at the end stop all of them."""
    link.open()
    serving = asyncio.create_task(
        Supervisor(link.bus.clock, "observer").run([link, *actors])
    )
    # Let the task begin. A task that is cancelled before it begins would not close the link,
    # and the process would not end.
    await link.bus.clock.sleep(0.0)
    try:
        yield
    finally:
        serving.cancel()
        await asyncio.wait([serving])


@contextlib.contextmanager
def write_swarm_file(config: SwarmConfig) -> Iterator[Path]:
    """Write the swarm into a temporary file for its processes and observers, and yield the path."""
    with scratch_folder(f"crazychoir-{config.name}-") as folder:
        path = folder / "swarm.json"
        path.write_text(config.dumps(), encoding="utf-8")
        yield path


def isolate_swarm(config: SwarmConfig, processes: int | None) -> SwarmConfig:
    """Return the same swarm with a new name and new ports, so that it can fly beside other runs.

    processes: number of processes, None to keep those of the swarm file
    """
    with hold_isolated_swarm(config, processes) as changed:
        return changed


@contextlib.contextmanager
def hold_isolated_swarm(
    config: SwarmConfig, processes: int | None, *, keeps_port: bool = False
) -> Iterator[SwarmConfig]:
    """Yield the swarm of `isolate_swarm`, and hold its ports meanwhile.

    config: the swarm
    processes: number of processes, None to keep those of the swarm file
    keeps_port: whether to keep the base_port of the swarm file, unless it is the default
    Raises ConfigError if one of its ports is taken.
    """
    groups = (
        [list(map(int, part)) for part in np.array_split(config.ids, processes)]
        if processes
        else None
    )
    suffix = f"{random.SystemRandom().getrandbits(32):08x}"
    changes: dict[str, Any] = {"name": f"{config.name[:30]}-{suffix}"}
    if groups:
        changes["processes"] = [group for group in groups if group]
    changed = config.replace(**changes)
    places = {
        process: _parse_address(endpoint)
        for process, endpoint in Addresses(changed).endpoints().items()
    }
    given = config.base_port if keeps_port and config.base_port != BASE_PORT else None
    with reserve_ports(places, given, highest=max(config.ids)) as base:
        yield changed.replace(base_port=base)


@contextlib.contextmanager
def reserve_ports(
    places: Mapping[int, str], given: int | None = None, highest: int = 0
) -> Iterator[int]:
    """Choose a base port such that base + offset is free for each offset, and hold these ports.

    places: address for each offset
    given: base port to use, None to choose one
    highest: largest offset that must still give a valid port, even if no process listens there

    While a socket is bound to a port, the system gives that port to no connection of this machine,
    and no other run chooses it. The socket does not listen, and it can be shared (SO_REUSEADDR).
    So the process for which the port is held can listen on it, also after it is started again.
    Raises ConfigError if no block of ports is free.
    """
    _allow_files(len(places))
    for base in _draw_base_ports([*places, highest]) if given is None else [given]:
        with contextlib.ExitStack() as kept:
            taken = next(
                (
                    n
                    for n, address in places.items()
                    if not _reserve_port(address, base + n, kept)
                ),
                None,
            )
            if taken is None:
                yield base
                return
        if given is not None:
            name = (
                f"drone {taken}"
                if taken >= 0
                else "the router, or of what owns the world, the cameras or a dongle"
            )
            do = f"End what has it (`ss -anp sport = :{base + taken}`), set another, or leave it out: a run chooses."
            problem = f"port {base + taken}, that of {name}, is taken"
            raise ConfigError(
                "base_port", given, "each process needs a free port", do, problem
            )
    raise _build_no_block_error(len(places))


def _build_no_block_error(count: int) -> ConfigError:
    found = f"no free block for {count} processes"
    return ConfigError(
        "base_port",
        found,
        "free ports",
        "Let drones share processes (--processes), or set base_port.",
    )


def _draw_base_ports(offsets: list[int]) -> Iterator[int]:
    """Yield base ports to try.

    First come some ports below the range from which the system takes ports for connections: a port
    held there is missing for no connection. Then come all ports. If the range begins at 1024, only
    root could listen below it, so all ports come at once.
    """
    draw = random.SystemRandom()
    lowest = SWARM_LIMITS.lowest_port - min(0, *offsets)
    end = _read_first_connection_port() - max(offsets)
    below = range(max(lowest, min(PORT_SEARCH.lowest_drawn, end // 2)), end)
    if below:
        for _ in range(PORT_SEARCH.most_attempts):
            yield draw.choice(below)
    every = range(lowest, PORT_SEARCH.highest + 1 - max(offsets))
    yield from draw.sample(every, len(every))


def _read_first_connection_port() -> int:
    try:
        return int(
            Path("/proc/sys/net/ipv4/ip_local_port_range")
            .read_text(encoding="utf-8")
            .split()[0]
        )
    except (OSError, ValueError, IndexError):
        return 32_768


def _reserve_port(address: str, port: int, kept: contextlib.ExitStack) -> bool:
    """Bind a port until the stack is left; return False if it is taken.

    A port at an address of another machine is not held, and the result is True.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    holder = kept.enter_context(socket.socket(family, socket.SOCK_STREAM))
    try:
        holder.bind((address, port))
    except socket.gaierror:
        return True
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            return True
        if error.errno != errno.EADDRINUSE or not _has_only_closed_connections(port):
            return False
        return _reserve_after_closing(address, port, holder, kept)
    # Only after bind: with the option set before, bind would succeed on a port that another
    # socket with this option holds.
    holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    return True


def _reserve_after_closing(
    address: str, port: int, holder: socket.socket, kept: contextlib.ExitStack
) -> bool:
    """Bind a port that only closed connections still have; return False if another program was first.

    Two runs could share the port like this, so each claims it by a name of its own before.
    """
    claim = kept.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
    try:
        claim.bind(f"\0crazychoir-port-{address}-{port}")
        holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        holder.bind((address, port))
    except OSError:
        return False
    return True


def _has_only_closed_connections(port: int) -> bool:
    """Return whether only closed connections still have the port, as for a minute after a run that used it."""
    states = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with contextlib.suppress(OSError):
            for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
                _, local, _, state, *_ = line.split()
                if int(local.rpartition(":")[2], 16) == port:
                    states.append(int(state, 16))
    return bool(states) and all(state == TIME_WAIT_STATE for state in states)


def _parse_address(endpoint: str) -> str:
    """Return the address of an endpoint such as tcp/127.0.0.1:7460."""
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")


def _allow_files(processes: int) -> None:
    """Raise the limit of open files of this process to the number that this many processes need.

    Raises ConfigError if the hard limit is too low.
    """
    needed = FILES_BESIDE + FILES_PER_PROCESS * processes
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        do = f"Raise it as root (`ulimit -Hn {needed}`), or let drones share processes: --processes."
        raise ConfigError(
            "limit of open files", hard, f"{needed} for {processes} processes", do
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
