"""The processes of a swarm, and their addresses on the network."""

import ipaddress
from dataclasses import dataclass

from crazychoir.config.checks import ROUTER_BELOW
from crazychoir.config.swarm_config import SwarmConfig

LOCAL_ADDRESS = "127.0.0.1"
"""Address of this machine."""


@dataclass(frozen=True, slots=True)
class ProcessNumbers:
    """Numbers of the processes without agents.

    The number of a process with agents is the lowest id of its drones.
    """

    world: int = -1
    """Process of the world's owner."""
    motion_capture: int = -2
    """Process of motion capture."""
    first_dongle: int = -3
    """Process of dongle 0; that of dongle K has first_dongle - K."""
    router: int = -ROUTER_BELOW
    """Process of the router."""


PROCESS_NUMBERS = ProcessNumbers()


class Addresses:
    """The processes of a swarm, the drones of each, and the endpoint at which each listens."""

    def __init__(self, config: SwarmConfig) -> None:
        self._config = config
        self._topology = config.topology

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Return the ids of the drones in each process, increasing.

        The first id in a group is the number of the process.
        """
        return tuple(
            sorted(
                tuple(sorted(group))
                for group in self._config.processes or ((i,) for i in self._config.ids)
            )
        )

    def process(self, i: int) -> int:
        """Return the number of the process of drone i: the lowest id of the drones in it."""
        member = self._config.drone(i).id
        return next(group[0] for group in self.groups() if member in group)

    def endpoint(self, i: int) -> str:
        """Return the endpoint of the process of drone i.

        It is `<scheme>/<address of its host>:<base_port + number of the process>`.
        """
        return self._listens(self._config.drone(i).host, self.process(i))

    def endpoints(self) -> dict[int, str]:
        """Return the endpoint of each process, by its number.

        The router and the owners come first.
        """
        listens = {
            process: self._listens(host, process)
            for process, host in self._owners().items()
        }
        return listens | {group[0]: self.endpoint(group[0]) for group in self.groups()}

    def host_of(self, process: int) -> str | None:
        """Return the host of a process of `endpoints`; None without [hosts]."""
        return (
            self._config.drone(process).host
            if process >= 0
            else self._owners()[process]
        )

    def count_remote(self, host: str | None) -> int:
        """Return the number of processes of `endpoints` that are not on this host."""
        hosts = [self.host_of(process) for process in self.endpoints()]
        return sum(other not in (None, host) for other in hosts)

    @property
    def routers(self) -> list[str]:
        """The endpoint of the router, if there is one: then every process connects only to it."""
        return (
            [self._listens(self._config.router, PROCESS_NUMBERS.router)]
            if self._config.router is not None
            else []
        )

    def _owners(self) -> dict[int, str | None]:
        """Return the hosts of the processes that are not agents."""
        owners: dict[int, str | None] = (
            {PROCESS_NUMBERS.router: self._config.router}
            if self._config.router is not None
            else {}
        )
        owners |= {
            PROCESS_NUMBERS.first_dongle - k: self._topology.dongle_host(k)
            for k in reversed(self._topology.dongles)
        }
        owners |= (
            {PROCESS_NUMBERS.motion_capture: self._config.mocap.host}
            if self._topology.seen
            else {}
        )
        return owners | (
            {PROCESS_NUMBERS.world: self._config.world.host}
            if self._topology.owned
            else {}
        )

    def _listens(self, host: str | None, process: int) -> str:
        address = LOCAL_ADDRESS if host is None else self._config.hosts[host]
        return f"{self.scheme}/{_bracket_address(address)}:{self._config.base_port + process}"

    @property
    def scheme(self) -> str:
        """Scheme of the endpoints."""
        return "tls" if self._config.secured else "tcp"


def _bracket_address(address: str) -> str:
    try:
        return f"[{address}]" if ipaddress.ip_address(address).version == 6 else address
    except ValueError:
        return address
