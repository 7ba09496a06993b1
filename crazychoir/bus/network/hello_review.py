"""The decision on the HELLO of another process: may it take part beside this one?"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.local_address import NO_LOCAL_ADDRESS, LocalAddress
from crazychoir.bus.port import PORT_ADDRESSES, Bus

COPY_FILE_ADVICE: Final = "Copy one file to every host, and start both again."
"""Advice of an error text."""
OWNED_ADDRESSES: Final = (
    (PORT_ADDRESSES.camera_offset, "the motion capture"),
    (PORT_ADDRESSES.body_offset, "the world"),
)
"""First address and name of what only one process may own."""


@dataclass(frozen=True, slots=True)
class Introduction:
    """How a process introduces itself to the others."""

    swarm: str
    """Name of the swarm."""
    incarnation: int
    """Number of the process; a restarted one has another number."""
    version: str
    """Version of crazychoir."""
    agreed: Mapping[str, str] = field(default_factory=dict)
    """{key of the swarm file: hash of its value} on which all owners must agree."""
    local: LocalAddress = NO_LOCAL_ADDRESS
    """Where the processes of this host find it."""


class HelloReview:
    """Finds the reason to refuse another process.

    bus: bus of this process
    own: how this process introduces itself
    """

    def __init__(self, bus: Bus, own: Introduction) -> None:
        self._bus = bus
        self._own = own

    def find_refusal(self, hello: Hello, uptime: float) -> tuple[str, str]:
        """Return the reason to refuse a process, and advice for the user, or two empty texts.

        uptime: seconds since the start of the process
        """
        sender = f"process {hello.process} on host {hello.host}"
        since = f"and has done so for {uptime:.1f} s"
        stop = (
            "Give this agent another --id, or stop that one."
            if self._bus.drones()
            else "Stop one of them."
        )
        doubles = ", ".join(str(i) for i in hello.drones if i in self._bus.ports)
        if doubles:
            return f"{sender} flies drone(s) {doubles} too {since}", stop
        for base, owns in OWNED_ADDRESSES:
            same = ", ".join(
                str(j - base)
                for j in hello.observers
                if j >= base and j in self._bus.ports
            )
            if same:
                return f"{sender} owns {owns} of drone(s) {same} too {since}", stop
        if hello.version != self._own.version:
            return (
                f"{sender} runs version {hello.version}, this one runs {self._own.version}",
                "",
            )
        owner = any(
            j >= PORT_ADDRESSES.body_offset
            for j in (*hello.observers, *self._bus.ports)
        )
        differ = [
            key
            for key, value in hello.agreed.items()
            if self._own.agreed.get(key, value) != value
        ]
        if owner and differ:
            return (
                f"{sender} has another swarm file than this process, with another {', '.join(differ)}",
                COPY_FILE_ADVICE,
            )
        return "", ""


def describe_address(address: int) -> str:
    """Return an address in words."""
    for base, what in (
        (PORT_ADDRESSES.camera_offset, "what cameras see of drone"),
        (PORT_ADDRESSES.body_offset, "the body of drone"),
    ):
        if address >= base:
            return f"{what} {address - base}"
    return f"drone {address}"
