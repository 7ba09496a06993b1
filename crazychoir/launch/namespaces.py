"""Simulated workstations on one machine, to test a swarm of several hosts.

They are network namespaces on one switch. This needs Linux, root and iproute2.
Each namespace has an address and a loopback of its own. It sees the others through `DEVICE` only.
"""

import contextlib
import secrets
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from crazychoir.errors import ConfigError

DEVICE: Final = "veth0"
"""Name of the network device of each workstation."""
SWITCH: Final = "bridge0"
"""Name of the bridge that connects the workstations."""


@dataclass(frozen=True)
class Switched:
    """The namespaces of the hosts."""

    switch: str
    """Name of the namespace with the switch."""
    names: dict[str, str] = field(default_factory=dict)
    """Name of the namespace of each host, by host."""

    def command(self, host: str) -> list[str]:
        """Return the words that begin a command line to run it on this host."""
        return ["ip", "netns", "exec", self.names[host]]

    def cut(self, host: str) -> None:
        """Cut the link of a host: from now on no packet reaches it or leaves it."""
        ip("-n", self.names[host], "link", "set", DEVICE, "down")

    def mend(self, host: str) -> None:
        """Restore the link of a host."""
        ip("-n", self.names[host], "link", "set", DEVICE, "up")


@contextlib.contextmanager
def switched(addresses: Mapping[str, str]) -> Iterator[Switched]:
    """Make one namespace a host with its IPv4 address (network of 24 bits); delete all at the end.

    The names are random, so that two runs at the same time do not meet.
    Raises ConfigError if namespaces cannot be made.
    """
    token = secrets.token_hex(3)
    hosts = Switched(f"cc-{token}-switch")
    with contextlib.ExitStack() as stack:
        stack.enter_context(namespace(hosts.switch))
        ip("-n", hosts.switch, "link", "add", SWITCH, "type", "bridge")
        ip("-n", hosts.switch, "link", "set", SWITCH, "up")
        for k, (host, address) in enumerate(addresses.items()):
            name = stack.enter_context(namespace(f"cc-{token}-{k}"))
            hosts.names[host] = name
            cable((name, DEVICE), (hosts.switch, f"port{k}"))
            ip("-n", hosts.switch, "link", "set", f"port{k}", "master", SWITCH)
            ip("-n", name, "address", "add", f"{address}/24", "dev", DEVICE)
        yield hosts


@contextlib.contextmanager
def namespace(name: str) -> Iterator[str]:
    """Make a namespace with a loopback, and delete it at the end."""
    ip("netns", "add", name)
    try:
        ip("-n", name, "link", "set", "lo", "up")
        yield name
    finally:
        ip("netns", "delete", name)


def cable(one: tuple[str, str], other: tuple[str, str]) -> None:
    """Connect two devices, each given as (namespace, name), and bring them up."""
    (here, device), (there, peer) = one, other
    ip(
        "link",
        "add",
        device,
        "netns",
        here,
        "type",
        "veth",
        "peer",
        "name",
        peer,
        "netns",
        there,
    )
    ip("-n", here, "link", "set", device, "up")
    ip("-n", there, "link", "set", peer, "up")


def ip(*arguments: str) -> None:
    """Run iproute2.

    Raises ConfigError with its message if it fails or is not installed.
    """
    where = "network namespaces"
    needed = "They need Linux, root and iproute2."
    program = shutil.which("ip")
    if program is None:
        raise ConfigError(where, "no program `ip`", "that of iproute2", needed)
    done = subprocess.run(
        [program, *arguments],
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
        timeout=30.0,
    )
    if done.returncode:
        raise ConfigError(
            where,
            f"`ip {' '.join(arguments)}`: {done.stderr.strip()}",
            "success",
            needed,
        )
