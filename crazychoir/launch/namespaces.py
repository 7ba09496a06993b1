"""Workstations on this machine: network namespaces on one switch, to try a swarm of hosts; Linux, root, iproute2.

Each has an address and a loopback of its own and sees the others through `DEVICE`, and nothing else.
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
"""The network of each workstation."""
SWITCH: Final = "bridge0"


@dataclass(frozen=True)
class Switched:
    """Namespaces by the names of their hosts;  switch: the namespace that has their switch."""

    switch: str
    names: dict[str, str] = field(default_factory=dict)

    def command(self, host: str) -> list[str]:
        """What a command line begins with to run there."""
        return ["ip", "netns", "exec", self.names[host]]

    def cut(self, host: str) -> None:
        """From now on no packet reaches it or leaves it."""
        ip("-n", self.names[host], "link", "set", DEVICE, "down")

    def mend(self, host: str) -> None:
        """Its link is back."""
        ip("-n", self.names[host], "link", "set", DEVICE, "up")


@contextlib.contextmanager
def switched(addresses: Mapping[str, str]) -> Iterator[Switched]:
    """One namespace a host, with its IPv4 address (network of 24 bits), made here and gone afterwards.

    Their names are their own, so that two runs side by side never meet. Raises ConfigError where this cannot be.
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
    """One with a loopback."""
    ip("netns", "add", name)
    try:
        ip("-n", name, "link", "set", "lo", "up")
        yield name
    finally:
        ip("netns", "delete", name)


def cable(one: tuple[str, str], other: tuple[str, str]) -> None:
    """Two devices (namespace, name) joined, and up."""
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
    """Raises ConfigError with what iproute2 says."""
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
