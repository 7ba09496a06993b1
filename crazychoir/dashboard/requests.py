"""What a page may ask for: every message is one of these, with every number within its bounds, or it is refused."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from crazychoir.agent.sketch import HAND

MOST_DRONES = 1000
Id = Annotated[int, Meta(ge=0, le=9999)]
Ids = Annotated[tuple[Id, ...], Meta(min_length=1, max_length=MOST_DRONES)]
Metres = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Place = tuple[Metres, Metres, Metres]
Spot = tuple[Metres, Metres]
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
MOST_TEXT = 200_000
Row = tuple[Annotated[float, Meta(ge=0.0, le=36_000.0)], Metres, Metres]
Stroke = Annotated[tuple[Row, ...], Meta(min_length=1, max_length=5000)]
Strokes = Annotated[tuple[Stroke, ...], Meta(min_length=1, max_length=200)]


class Ask(
    Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag=str.lower
):
    """One message of a page."""


class Order(Ask, frozen=True):
    """A command in flight; drones: None for all."""

    verb: Literal["arm", "take-off", "start", "hold", "go", "land", "home"]
    drones: Ids | None = None


class Stop(Ask, frozen=True):
    """Emergency stop, or its end; key: of one that may be said again, so that it is not taken twice."""

    drones: Ids | None = None
    clear: bool = False
    key: Annotated[str, Meta(max_length=40)] = ""


class GoTo(Ask, frozen=True, tag="go-to"):
    """Fly to a place: the k-th drone k times `offset` m from it."""

    drones: Ids
    p: Place
    yaw: Angle | None = None
    offset: Place = (0.0, 0.0, 0.0)


class Draw(Ask, frozen=True):
    """Plan a flight along strokes, and show it; it is flown by Fly.

    strokes: rows t s, x, y m;  height, lift m, yaw rad, timing, smoothing m: see planning.drawing.Pen;  v_max m/s,
    a_max m/s2: at most those of [flight];  slower: times the time that these ask for.
    """

    strokes: Strokes
    height: Metres = 1.0
    lift: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    yaw: Angle | Literal["along"] = 0.0
    timing: Literal["even", "drawn"] = "even"
    smoothing: Annotated[float, Meta(ge=0.0, le=1.0)] = HAND
    v_max: Annotated[float, Meta(gt=0.01, le=20.0)] = 0.5
    a_max: Annotated[float, Meta(gt=0.01, le=50.0)] = 1.0
    slower: Annotated[float, Meta(ge=1.0, le=20.0)] = 1.0


class Fly(Ask, frozen=True):
    """Fly what was planned last: the k-th drone k times `offset` m from it."""

    drones: Ids
    offset: Place = (0.0, 0.0, 0.0)


class Load(Ask, frozen=True):
    """Read the strokes of a file's text; the page gets them."""

    name: Annotated[str, Meta(max_length=200)]
    text: Annotated[str, Meta(max_length=MOST_TEXT)]


class Save(Ask, frozen=True):
    """Write strokes as a file's text; the page gets it."""

    strokes: Strokes
    kind: Literal["csv", "svg"] = "csv"


class Impair(Ask, frozen=True):
    """Change the simulated network: of all links, of one drone's, or of the one between two.

    cut: nothing passes between these drones and the others;  clear: take everything back.
    """

    drones: Ids | None = None
    loss: Share | None = None
    delay: Annotated[float, Meta(ge=0.0, le=60.0)] | None = None
    cut: bool = False
    clear: bool = False


class AddTask(Ask, frozen=True, tag="add-task"):
    """Another task; delivery: None for one that is done at a place."""

    pickup: Spot
    delivery: Spot | None = None
    load: Annotated[float, Meta(ge=0.0, le=1e6)] = 1.0


class CancelTask(Ask, frozen=True, tag="cancel-task"):
    """Cancel a task."""

    id: Annotated[int, Meta(ge=0, lt=1 << 62)]


Message = Order | Stop | GoTo | Draw | Fly | Load | Save | Impair | AddTask | CancelTask
_READER = msgspec.json.Decoder(Message)


def read(text: str | bytes) -> Message:
    """The message; raises msgspec.ValidationError or DecodeError, with what is wrong."""
    message: Message = _READER.decode(text)
    return message
