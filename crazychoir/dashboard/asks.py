"""What a page may ask for: every message is one of these, with every number within its bounds, or it is refused."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

MOST_DRONES = 1000
Id = Annotated[int, Meta(ge=0, le=9999)]
Ids = Annotated[tuple[Id, ...], Meta(min_length=1, max_length=MOST_DRONES)]
Metres = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Place = tuple[Metres, Metres, Metres]
Spot = tuple[Metres, Metres]


class Ask(Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag=str.lower):
    """One message of a page."""


class Order(Ask, frozen=True):
    """A command in flight; drones: None for all."""

    verb: Literal["take-off", "start", "hold", "go", "land", "home"]
    drones: Ids | None = None


class Stop(Ask, frozen=True):
    """Emergency stop, or its end."""

    drones: Ids | None = None
    clear: bool = False


Message = Order | Stop
_READER = msgspec.json.Decoder(Message)


def read(text: str | bytes) -> Message:
    """The message; raises msgspec.ValidationError or DecodeError, with what is wrong."""
    message: Message = _READER.decode(text)
    return message
