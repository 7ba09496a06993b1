"""[mission_options] of the online mission: its keys, units, ranges and defaults. The reader checks with them."""

from typing import Annotated

from msgspec import Meta

from crazychoir.config.checks import TOUCHING
from crazychoir.config.tables import Flag, Ids, Seconds, Table, Text
from crazychoir.guidance.delivery.replanning import AUCTION, KINDS
from crazychoir.guidance.tasks.task_book import LARGEST, Place
from crazychoir.guidance.tasks.task_source import ADDED

Spot = Annotated[Place, Meta(description="a place [x, y] in m", examples=[[1.0, 2.5]])]
Load = Annotated[
    float,
    Meta(
        ge=0.0,
        le=LARGEST,
        description="a load, 0 to 1e6, as the capacities",
        examples=[1.0],
    ),
]
MOST = ADDED // 2
Number = Annotated[
    int,
    Meta(ge=1, le=MOST, description=f"a number of tasks, 1 to {MOST}", examples=[15]),
]
Further = Annotated[
    int,
    Meta(ge=0, le=MOST, description=f"a number of tasks, 0 to {MOST}", examples=[5]),
]
TaskId = Annotated[
    int, Meta(ge=0, description="the number of a task, not negative", examples=[4])
]
Gap = Annotated[
    float,
    Meta(
        ge=TOUCHING,
        le=100.0,
        description=f"m, {TOUCHING:g} (nearer, drones touch) to 100",
        examples=[0.4],
    ),
]
Method = Annotated[
    str,
    Meta(
        pattern=f"^({'|'.join(KINDS)})$",
        description=", ".join(KINDS),
        examples=[AUCTION],
    ),
]


class Appearance(Table, frozen=True, kw_only=True):
    """One [[mission_options.appear]]: a task, t s after the start; robots: who alone may serve it, empty: all.

    heard_by: who hears of it, and tells the others, empty: all.
    """

    t: Seconds
    pickup: Spot
    delivery: Spot
    load: Load = 1.0
    robots: Ids = ()
    heard_by: Ids = ()


class Cancellation(Table, frozen=True, kw_only=True):
    """One [[mission_options.cancel]], t s after the start."""

    t: Seconds
    task: TaskId
    heard_by: Ids = ()


Appearances = Annotated[
    tuple[Appearance, ...],
    Meta(
        description="tables of t, pickup, delivery",
        examples=[[{"t": 5.0, "pickup": [1, 1], "delivery": [4, 3]}]],
    ),
]
Cancellations = Annotated[
    tuple[Cancellation, ...],
    Meta(description="tables of t and task", examples=[[{"t": 8.0, "task": 4}]]),
]


class DeliveryOptions(Table, frozen=True, kw_only=True):
    """[mission_options].

    instance: a file; without one `tasks` are drawn from the seed, and unless `appear` says which, `later` more;
    recover: goods of a robot that is gone are fetched from where it was last;  service_time: s at each stop;
    until: s after the start before which the mission does not end;  clearance: m from other robots' homes,
    in the plane;  method: how tasks are shared out, see Replanning.
    """

    instance: Text | None = None
    tasks: Number = 15
    later: Further = 5
    appear: Appearances = ()
    cancel: Cancellations = ()
    recover: Flag = False
    service_time: Seconds = 1.0
    until: Seconds = 0.0
    clearance: Gap = 0.4
    method: Method = AUCTION
