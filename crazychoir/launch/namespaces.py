"""Simulated workstations on one machine, to test a swarm of several hosts.

They are network namespaces on one switch. This needs Linux, root and iproute2.
Each namespace has an address and a loopback of its own. It sees the others through `NAMESPACE_DEVICE` only.
"""

import contextlib
import secrets
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from crazychoir.errors import ConfigError

NAMESPACE_DEVICE: Final = "veth0"
"""Name of the network device of each workstation."""
SWITCH_BRIDGE: Final = "bridge0"
"""Name of the bridge that connects the workstations."""


@dataclass(frozen=True)
class SwitchedNamespaces:
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
        run_iproute("-n", self.names[host], "link", "set", NAMESPACE_DEVICE, "down")

    def mend(self, host: str) -> None:
        """Restore the link of a host."""
        run_iproute("-n", self.names[host], "link", "set", NAMESPACE_DEVICE, "up")


@contextlib.contextmanager
def make_switched_namespaces(
    addresses: Mapping[str, str],
) -> Iterator[SwitchedNamespaces]:
    """Make a namespace for each host with its IPv4 address, in a /24 network; delete all at the end.

    The names are random, so that two runs at the same time do not collide.
    Raises ConfigError if namespaces cannot be made.
    """
    token = secrets.token_hex(3)
    hosts = SwitchedNamespaces(f"cc-{token}-switch")
    with contextlib.ExitStack() as stack:
        stack.enter_context(make_namespace(hosts.switch))
        run_iproute("-n", hosts.switch, "link", "add", SWITCH_BRIDGE, "type", "bridge")
        run_iproute("-n", hosts.switch, "link", "set", SWITCH_BRIDGE, "up")
        for k, (host, address) in enumerate(addresses.items()):
            name = stack.enter_context(make_namespace(f"cc-{token}-{k}"))
            hosts.names[host] = name
            connect_devices((name, NAMESPACE_DEVICE), (hosts.switch, f"port{k}"))
            run_iproute(
                "-n", hosts.switch, "link", "set", f"port{k}", "master", SWITCH_BRIDGE
            )
            run_iproute(
                "-n", name, "address", "add", f"{address}/24", "dev", NAMESPACE_DEVICE
            )
        yield hosts


@contextlib.contextmanager
def make_namespace(name: str) -> Iterator[str]:
    """Make a namespace with a loopback, and delete it at the end."""
    run_iproute("netns", "add", name)
    try:
        run_iproute("-n", name, "link", "set", "lo", "up")
        yield name
    finally:
        run_iproute("netns", "delete", name)


def connect_devices(one: tuple[str, str], other: tuple[str, str]) -> None:
    """Connect two devices, each given as (namespace, name), and bring them up."""
    (here, device), (there, peer) = one, other
    run_iproute(
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
    run_iproute("-n", here, "link", "set", device, "up")
    run_iproute("-n", there, "link", "set", peer, "up")


def run_iproute(*arguments: str) -> None:
    """Run iproute2.

    Raises ConfigError with its message if it fails or is not installed.
    """
    where = "network namespaces"
    needed = "They need Linux, root and iproute2."
    program = shutil.which("ip")
    if program is None:
        raise ConfigError(where, "no program `run_iproute`", "that of iproute2", needed)
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
