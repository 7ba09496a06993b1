"""HELLO: a process describes itself to all other processes.

Checks which parts of it are believed.
"""

from dataclasses import dataclass
from importlib.metadata import version
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.frames import FRAME_FORMAT
from crazychoir.bus.network.local_address import NO_LOCAL_ADDRESS, LocalAddress
from crazychoir.bus.port import PORT_ADDRESSES, Interest
from crazychoir.errors import CodecError, error_text

PACKAGE_VERSION = version("crazychoir")
"""Version of crazychoir."""


@dataclass(frozen=True, slots=True)
class HelloRules:
    """Limits of the contents of a HELLO, and of its time on the way."""

    max_addresses: int = 4096
    """Most drones, and most observers, in a HELLO."""
    max_observers: int = 16
    """Most observers of a process, without the bodies and eyes of drones."""
    max_interests: int = 16_384
    """Most interests in a HELLO."""
    max_digests: int = 32
    """Most digests in a HELLO."""
    lowest_rate: float = 1e-3
    """Lowest rate of an interest; 0 asks for every value."""
    highest_rate: float = 1e6
    """Highest rate of an interest."""
    start_tie: float = 0.05
    """Longer than a HELLO takes, so that two processes agree which of them started first."""


HELLO_RULES = HelloRules()


_Name = Annotated[str, Meta(max_length=FRAME_FORMAT.max_name_length)]
_Drones = Annotated[
    list[Annotated[int, Meta(ge=0, lt=PORT_ADDRESSES.first_observer)]],
    Meta(max_length=HELLO_RULES.max_addresses),
]
_Observers = Annotated[
    list[Annotated[int, Meta(ge=PORT_ADDRESSES.first_observer, lt=1 << 32)]],
    Meta(max_length=HELLO_RULES.max_addresses),
]


class Hello(msgspec.Struct, frozen=True):
    """The description of a process, sent when it changes, and repeated.

    Its envelope has its age, so that repeats have the same bytes.
    """

    process: _Name
    """Name of the process."""
    host: _Name
    """Name of its host."""
    incarnation: Annotated[int, Meta(ge=0)]
    """64 random bits, drawn when the process started."""
    version: _Name
    """Version of crazychoir."""
    uptime: Annotated[float, Meta(ge=0.0, le=1e9)]
    """Seconds since its start when the HELLO was made."""
    drones: _Drones
    """Ids of its drones."""
    observers: _Observers
    """Addresses of its other ports."""
    interests: Annotated[list[Interest], Meta(max_length=HELLO_RULES.max_interests)]
    """Topics that it wants from other processes."""
    stopped: bool
    """True while an emergency stop is in force."""
    agreed: Annotated[dict[_Name, _Name], Meta(max_length=HELLO_RULES.max_digests)] = {}
    """Digest of each key of its swarm file that bodies and agents must agree on.

    It is empty for an observer.
    """
    local: LocalAddress = NO_LOCAL_ADDRESS
    """Where the processes of its host find it."""
    hears_receiver: bool = False
    """True if a HELLO of the process that gets this one has arrived at the sender."""
    lacks_token: bool = False
    """True if the sender gets frames of the process that gets this HELLO, and has no token of it."""

    @classmethod
    def of(cls, payload: bytes) -> "Hello":
        """Return the HELLO of a payload; raise CodecError if it is invalid."""
        value: Any = decode(payload)
        try:
            hello = msgspec.convert(value, cls)
        except Exception as error:
            raise CodecError(f"HELLO: {error_text(error)}") from error
        looking = sum(j < PORT_ADDRESSES.body_offset for j in hello.observers)
        if looking > HELLO_RULES.max_observers:
            raise CodecError(
                f"HELLO: {looking} observers; allowed: {HELLO_RULES.max_observers} of a process."
            )
        return hello

    def payload(self) -> bytes:
        """Return the payload."""
        return encode(msgspec.to_builtins(self))

    @property
    def addresses(self) -> list[int]:
        """Addresses of all ports of the process."""
        return [*self.drones, *self.observers]

    def wants(self) -> list[Interest]:
        """Return its interests, without those for readers of other
        processes and those with invalid rates.
        """
        own = frozenset(self.addresses)
        sensible = [
            one
            for one in self.interests
            if one.rate == 0.0
            or HELLO_RULES.lowest_rate <= one.rate <= HELLO_RULES.highest_rate
        ]
        return [one for one in sensible if one.reader in own]

    def precedes(self, process: str, lead: float) -> bool:
        """Return True if the sender started before `process`; in a tie the lesser name wins.

        lead: seconds that the sender has been up longer
        """
        return lead > 0.0 or (lead > -HELLO_RULES.start_tie and self.process < process)
