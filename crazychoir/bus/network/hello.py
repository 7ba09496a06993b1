"""HELLO: a process describes itself to all other processes.

Checks which parts of it are believed.
"""

from importlib.metadata import version
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.frames import MAX_NAME
from crazychoir.bus.port import BODIES, OBSERVER, Interest
from crazychoir.errors import CodecError, error_text

VERSION = version("crazychoir")
"""Version of crazychoir."""
MAX_ADDRESSES = 4096
"""Most drones, and most observers, in a HELLO."""
MAX_OBSERVERS = 16
"""Most observers of a process, without the bodies and eyes of drones."""
MAX_INTERESTS = 16_384
"""Most interests in a HELLO."""
MAX_AGREED = 32
"""Most digests in a HELLO."""
MIN_RATE = 1e-3  # Hz
"""Lowest rate of an interest; 0 asks for every value."""
MAX_RATE = 1e6  # Hz
"""Highest rate of an interest."""
TIE = 0.05  # s
"""Longer than a HELLO takes, so that two processes agree which of them started first."""

_Name = Annotated[str, Meta(max_length=MAX_NAME)]
_Drones = Annotated[
    list[Annotated[int, Meta(ge=0, lt=OBSERVER)]], Meta(max_length=MAX_ADDRESSES)
]
_Observers = Annotated[
    list[Annotated[int, Meta(ge=OBSERVER, lt=1 << 32)]], Meta(max_length=MAX_ADDRESSES)
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
    interests: Annotated[list[Interest], Meta(max_length=MAX_INTERESTS)]
    """Topics that it wants from other processes."""
    heard: Annotated[list[_Name], Meta(max_length=MAX_ADDRESSES)]
    """Processes with a HELLO that has arrived there."""
    stopped: bool
    """True while an emergency stop is in force."""
    agreed: Annotated[dict[_Name, _Name], Meta(max_length=MAX_AGREED)] = {}
    """Digest of each key of its swarm file that bodies and agents must agree on.

    It is empty for an observer.
    """

    @classmethod
    def of(cls, payload: bytes) -> "Hello":
        """Return the HELLO of a payload; raise CodecError if it is invalid."""
        value: Any = decode(payload)
        try:
            hello = msgspec.convert(value, cls)
        except Exception as error:
            raise CodecError(f"HELLO: {error_text(error)}") from error
        looking = sum(j < BODIES for j in hello.observers)
        if looking > MAX_OBSERVERS:
            raise CodecError(
                f"HELLO: {looking} observers; allowed: {MAX_OBSERVERS} of a process."
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
            if one.rate == 0.0 or MIN_RATE <= one.rate <= MAX_RATE
        ]
        return [one for one in sensible if one.reader in own]

    def precedes(self, process: str, lead: float) -> bool:
        """Return True if the sender started before `process`; in a tie the lesser name wins.

        lead: seconds that the sender has been up longer
        """
        return lead > 0.0 or (lead > -TIE and self.process < process)
