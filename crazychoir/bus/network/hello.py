"""What a process says of itself to every other process, and what of it is believed."""

from importlib.metadata import version
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.frames import MAX_NAME
from crazychoir.bus.port import BODIES, OBSERVER, Interest
from crazychoir.errors import CodecError, error_text

VERSION = version("crazychoir")
MAX_ADDRESSES = 4096
MAX_OBSERVERS = 16
"""Of a process, that look on; beside the bodies and eyes of drones."""
MAX_INTERESTS = 16_384
MAX_AGREED = 32
MIN_RATE, MAX_RATE = 1e-3, 1e6
"""Hz, of an interest; 0 asks for everything."""
TIE = 0.05
"""s: more than a HELLO is on its way, so that two processes agree on who was there first."""

_Name = Annotated[str, Meta(max_length=MAX_NAME)]
_Drones = Annotated[
    list[Annotated[int, Meta(ge=0, lt=OBSERVER)]], Meta(max_length=MAX_ADDRESSES)
]
_Observers = Annotated[
    list[Annotated[int, Meta(ge=OBSERVER, lt=1 << 32)]], Meta(max_length=MAX_ADDRESSES)
]


class Hello(msgspec.Struct, frozen=True):
    """Sent when it changes and repeated; its envelope says how old it is, so that repeats are the same bytes.

    incarnation: of the process;  version: of crazychoir;  uptime: s, when this was said;
    heard: processes whose HELLO has arrived here;  stopped: an emergency stop is in force;  agreed: of the keys of its
    swarm file that bodies and who flies them agree on, a digest each; none of who only looks on.
    """

    process: _Name
    host: _Name
    incarnation: Annotated[int, Meta(ge=0)]
    version: _Name
    uptime: Annotated[float, Meta(ge=0.0, le=1e9)]
    drones: _Drones
    observers: _Observers
    interests: Annotated[list[Interest], Meta(max_length=MAX_INTERESTS)]
    heard: Annotated[list[_Name], Meta(max_length=MAX_ADDRESSES)]
    stopped: bool
    agreed: Annotated[dict[_Name, _Name], Meta(max_length=MAX_AGREED)] = {}

    @classmethod
    def of(cls, payload: bytes) -> "Hello":
        """From the wire; raises CodecError."""
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
        """For the wire."""
        return encode(msgspec.to_builtins(self))

    @property
    def addresses(self) -> list[int]:
        """Ports of the process."""
        return [*self.drones, *self.observers]

    def wants(self) -> list[Interest]:
        """Its interests, without those for readers of others and those with senseless rates."""
        own = frozenset(self.addresses)
        sensible = [
            one
            for one in self.interests
            if one.rate == 0.0 or MIN_RATE <= one.rate <= MAX_RATE
        ]
        return [one for one in sensible if one.reader in own]

    def precedes(self, process: str, lead: float) -> bool:
        """Whether the sender, which is up for `lead` s longer, was there before `process`; the lesser name in a tie."""
        return lead > 0.0 or (lead > -TIE and self.process < process)
