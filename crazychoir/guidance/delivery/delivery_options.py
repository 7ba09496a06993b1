"""[mission_options] of the online mission: keys, units, ranges and defaults.

The reader checks with them.
"""

from typing import Annotated

from msgspec import Meta

from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.config.tables import Flag, Ids, Seconds, SwarmTable, Text
from crazychoir.guidance.delivery.replanning import AUCTION_METHOD, REPLANNING_METHODS
from crazychoir.guidance.tasks.task_book import LARGEST_TASK_NUMBER, Place
from crazychoir.guidance.tasks.task_source import FIRST_ADDED_ID

Spot = Annotated[Place, Meta(description="a place [x, y] in m", examples=[[1.0, 2.5]])]
Load = Annotated[
    float,
    Meta(
        ge=0.0,
        le=LARGEST_TASK_NUMBER,
        description="a load, 0 to 1e6, as the capacities",
        examples=[1.0],
    ),
]
MOST_OPTION_TASKS = FIRST_ADDED_ID // 2
"""Largest number of tasks of an option."""
Number = Annotated[
    int,
    Meta(
        ge=1,
        le=MOST_OPTION_TASKS,
        description=f"a number of tasks, 1 to {MOST_OPTION_TASKS}",
        examples=[15],
    ),
]
Further = Annotated[
    int,
    Meta(
        ge=0,
        le=MOST_OPTION_TASKS,
        description=f"a number of tasks, 0 to {MOST_OPTION_TASKS}",
        examples=[5],
    ),
]
TaskId = Annotated[
    int, Meta(ge=0, description="the number of a task, not negative", examples=[4])
]
Gap = Annotated[
    float,
    Meta(
        ge=SWARM_LIMITS.touching_distance,
        le=100.0,
        description=f"m, {SWARM_LIMITS.touching_distance:g} (nearer, drones touch) to 100",
        examples=[0.4],
    ),
]
Method = Annotated[
    str,
    Meta(
        pattern=f"^({'|'.join(REPLANNING_METHODS)})$",
        description=", ".join(REPLANNING_METHODS),
        examples=[AUCTION_METHOD],
    ),
]


class Appearance(SwarmTable, frozen=True, kw_only=True):
    """One [[mission_options.appear]]: a task that appears in flight."""

    t: Seconds
    """s after the start."""
    pickup: Spot
    """(2,) m."""
    delivery: Spot
    """(2,) m."""
    load: Load = 1.0
    """Load of the goods, in the unit of the capacities."""
    robots: Ids = ()
    """Ids of the only robots that may serve it. Empty: all robots."""
    heard_by: Ids = ()
    """Ids of the robots that learn of it first, and tell the others. Empty: all robots."""


class Cancellation(SwarmTable, frozen=True, kw_only=True):
    """One [[mission_options.cancel]]: a task that is cancelled in flight."""

    t: Seconds
    """s after the start."""
    task: TaskId
    """Number of the task."""
    heard_by: Ids = ()
    """Ids of the robots that learn of it first, and tell the others. Empty: all robots."""


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


class DeliveryOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    instance: Text | None = None
    """File of the instance. None: tasks are drawn from the seed."""
    tasks: Number = 15
    """Number of tasks to draw, without an instance."""
    later: Further = 5
    """Number of further tasks to draw that appear in flight, without an instance and `appear`."""
    appear: Appearances = ()
    """Tasks that appear in flight."""
    cancel: Cancellations = ()
    """Tasks that are cancelled in flight."""
    recover: Flag = False
    """Goods of a lost robot are fetched from its last place."""
    service_time: Seconds = 1.0
    """s at each stop."""
    until: Seconds = 0.0
    """s after the start before which the mission does not end."""
    clearance: Gap = 0.4
    """m, in the plane: distance of goods from other robots' homes."""
    method: Method = AUCTION_METHOD
    """How tasks are shared out, see Replanning."""
