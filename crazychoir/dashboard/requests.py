"""The messages that a page may send; a message with a number out of bounds is refused."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from crazychoir.agent.order_times import LONGEST_VELOCITY
from crazychoir.agent.sketch import SKETCH_LIMITS

MOST_DRONES = 1000
"""Largest number of drones in a message."""
Id = Annotated[int, Meta(ge=0, le=9999)]
"""Id of a drone."""
Ids = Annotated[tuple[Id, ...], Meta(min_length=1, max_length=MOST_DRONES)]
"""Ids of drones, at least one."""
Metres = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
"""m."""
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
"""From 0 to 1."""
Place = tuple[Metres, Metres, Metres]
"""(3,) m, world."""
Spot = tuple[Metres, Metres]
"""(2,) m, world."""
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
"""rad."""
Speed = Annotated[float, Meta(ge=-20.0, le=20.0)]
"""m/s."""
ParameterName = Annotated[str, Meta(min_length=1, max_length=60)]
"""Name of a parameter of the firmware, or of a group."""
ParameterValue = Annotated[float, Meta(ge=-3.5e38, le=3.5e38)]
"""A number that may fit into a float32; the firmware's type limits it further."""
MOST_TEXT = 200_000
"""Largest number of characters of a file."""
Row = tuple[Annotated[float, Meta(ge=0.0, le=36_000.0)], Metres, Metres]
"""A point of a drawing: t s, x m, y m."""
Stroke = Annotated[tuple[Row, ...], Meta(min_length=1, max_length=5000)]
"""Points of one stroke."""
Strokes = Annotated[tuple[Stroke, ...], Meta(min_length=1, max_length=200)]
"""Strokes of a drawing."""


class Ask(
    Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag=str.lower
):
    """One message of a page."""


class Order(Ask, frozen=True):
    """A flight command."""

    verb: Literal["arm", "take-off", "start", "hold", "go", "land", "home"]
    """The command."""
    drones: Ids | None = None
    """Ids of the drones, None for all."""


class Stop(Ask, frozen=True):
    """Emergency stop, or its end."""

    drones: Ids | None = None
    """Ids of the drones, None for all."""
    clear: bool = False
    """Whether to clear the stop instead."""
    key: Annotated[str, Meta(max_length=40)] = ""
    """Key of a message that the page may repeat, so that it counts only once."""


class GoTo(Ask, frozen=True, tag="go-to"):
    """Fly to a place; the k-th drone flies to a place k times `offset` away from it."""

    drones: Ids
    """Ids of the drones."""
    p: Place
    """(3,) m, world."""
    yaw: Angle | None = None
    """rad, None to keep it."""
    offset: Place = (0.0, 0.0, 0.0)
    """(3,) m, from drone to drone."""


class Steer(Ask, frozen=True):
    """Fly a drone with a velocity, until the next one comes; zeros let it rest."""

    drone: Id
    """Id of the drone."""
    v: tuple[Speed, Speed, Speed]
    """(3,) m/s, world."""
    yaw_rate: Angle = 0.0
    """rad/s."""


class Move(Ask, frozen=True):
    """Fly drones with a velocity for some seconds, then let them rest."""

    drones: Ids
    """Ids of the drones."""
    v: tuple[Speed, Speed, Speed]
    """(3,) m/s, world."""
    yaw_rate: Angle = 0.0
    """rad/s."""
    duration: Annotated[float, Meta(gt=0.0, le=LONGEST_VELOCITY)] = 1.0
    """s."""


class Draw(Ask, frozen=True):
    """Plan a flight along strokes and show it; Fly flies it."""

    strokes: Strokes
    """Rows t s, x m, y m."""
    height: Metres = 1.0
    """m, see planning.drawing.Pen."""
    lift: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.0
    """m, see Pen."""
    yaw: Angle | Literal["along"] = 0.0
    """rad, see Pen."""
    timing: Literal["even", "drawn"] = "even"
    """See Pen."""
    smoothing: Annotated[float, Meta(ge=0.0, le=1.0)] = SKETCH_LIMITS.hand_deviation
    """m, see Pen."""
    v_max: Annotated[float, Meta(gt=0.01, le=20.0)] = 0.5
    """m/s, at most that of [flight]."""
    a_max: Annotated[float, Meta(gt=0.01, le=50.0)] = 1.0
    """m/s2, at most that of [flight]."""
    slower: Annotated[float, Meta(ge=1.0, le=20.0)] = 1.0
    """Factor by which the flight takes longer than these limits demand."""


class PlanTrajectory(Ask, frozen=True, tag="trajectory"):
    """Plan a flight along the trajectory of a file, and show it; Fly flies it."""

    name: Annotated[str, Meta(max_length=200)]
    """Name of the file."""
    text: Annotated[str, Meta(max_length=MOST_TEXT)]
    """Its content: pieces, see planning.trajectory_file."""
    height: Metres = 1.0
    """m, of its start."""
    slower: Annotated[float, Meta(ge=1.0, le=20.0)] = 1.0
    """Factor on the duration of the file."""


class Fly(Ask, frozen=True):
    """Fly the last planned drawing or trajectory; the k-th drone flies it k times `offset` away."""

    drones: Ids
    """Ids of the drones."""
    offset: Place = (0.0, 0.0, 0.0)
    """(3,) m, from drone to drone."""


class Load(Ask, frozen=True):
    """Read a file's text, and return its strokes to the page, or that it is a trajectory."""

    name: Annotated[str, Meta(max_length=200)]
    """Name of the file."""
    text: Annotated[str, Meta(max_length=MOST_TEXT)]
    """Its content."""


class Save(Ask, frozen=True):
    """Write strokes as a file's text and return it to the page."""

    strokes: Strokes
    """Rows t s, x m, y m."""
    kind: Literal["csv", "svg"] = "csv"
    """Format of the file."""


class Impair(Ask, frozen=True):
    """Change the simulated network: all links, the links of one drone, or the link of two."""

    drones: Ids | None = None
    """Ids: one drone selects its links, two the link between them, None all links."""
    loss: Share | None = None
    """Share of lost messages, None for no change."""
    delay: Annotated[float, Meta(ge=0.0, le=60.0)] | None = None
    """s, None for no change."""
    cut: bool = False
    """Whether no message passes between these drones and the others."""
    clear: bool = False
    """Whether to undo all changes."""


class AddTask(Ask, frozen=True, tag="add-task"):
    """Add a task."""

    pickup: Spot
    """(2,) m, world."""
    delivery: Spot | None = None
    """(2,) m, world; None for a task that is done at one place."""
    load: Annotated[float, Meta(ge=0.0, le=1e6)] = 1.0
    """Units of load."""


class CancelTask(Ask, frozen=True, tag="cancel-task"):
    """Cancel a task."""

    id: Annotated[int, Meta(ge=0, lt=1 << 62)]
    """Id of the task."""


class ListParameters(Ask, frozen=True, tag="list-parameters"):
    """Return the names, types and access of all parameters of a drone's firmware."""

    drone: Id
    """Id of the drone."""


class ReadParameters(Ask, frozen=True, tag="read-parameters"):
    """Return the value of a parameter of a drone's firmware, or the values of a group."""

    drone: Id
    """Id of the drone."""
    name: ParameterName
    """The parameter, as led.bitmask, or the group, as led."""


class SetParameter(Ask, frozen=True, tag="set-parameter"):
    """Set a parameter of a drone's firmware, and return the value that it then has."""

    drone: Id
    """Id of the drone."""
    name: ParameterName
    """The parameter, as led.bitmask."""
    value: ParameterValue
    """The new value."""


Message = (
    Order
    | Stop
    | GoTo
    | Steer
    | Move
    | Draw
    | PlanTrajectory
    | Fly
    | Load
    | Save
    | Impair
    | AddTask
    | CancelTask
    | ListParameters
    | ReadParameters
    | SetParameter
)
"""Any message of a page."""
_MESSAGE_DECODER = msgspec.json.Decoder(Message)


def decode_page_message(text: str | bytes) -> Message:
    """Return the message; raises msgspec.ValidationError or DecodeError, with the reason."""
    message: Message = _MESSAGE_DECODER.decode(text)
    return message
