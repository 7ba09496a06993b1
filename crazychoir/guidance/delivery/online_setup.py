"""[mission_options] of the online mission, and its checks before any drone flies.

The reader checks keys, units, ranges and defaults with the tables.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from msgspec import Meta

from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.config.tables import Flag, Ids, Seconds, SwarmTable, Text
from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.replanning import AUCTION_METHOD, REPLANNING_METHODS
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.tasks.task_book import LARGEST_TASK_NUMBER, Place, Task
from crazychoir.guidance.tasks.task_source import FIRST_ADDED_ID
from crazychoir.team.graph import describe_ids

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


IDLE_KEYS = (("tasks", "instance"), ("later", "instance"), ("later", "appear"))
"""(key, other): a key that has no effect beside the other key."""
FLIGHT_ABILITIES = "robots in flight fly straight, start as soon as they can, end at home, and refuse no task"
"""What robots can do in flight, for the error."""


def require_used_keys(written: Mapping[str, Any], where: str) -> None:
    """Raise ConfigError for a key that has no effect beside another key."""
    for key, other in IDLE_KEYS:
        if key in written and other in written:
            allowed = "no tasks are drawn then"
            do = "Remove one of the two."
            raise ConfigError(
                f"{where}.{key}", written[key], allowed, do, f"beside {other}"
            )


def require_servable_places(
    site: DeliverySite,
    known: Sequence[Task],
    appearing: Sequence[Appearance],
    chosen: DeliveryOptions,
    where: str,
) -> None:
    """Raise ConfigError unless drones can stand where each task lies, and a drone can carry it.

    All robots that are named must exist, too.

    site: where goods may lie.
    known: tasks that are known at the start.
    appearing: tasks that appear, from the options or drawn.
    chosen: the options.
    where: the key of the options, for the error.
    """
    if len(known) + len(appearing) > FIRST_ADDED_ID:
        raise ConfigError(
            where, f"{len(known) + len(appearing)} tasks", f"at most {FIRST_ADDED_ID}"
        )
    for task in known:
        if found := site.explain_bad_place(
            task, task.pickup
        ) or site.explain_unservable(task):
            raise _build_place_error(
                f"{where}.{'tasks' if chosen.instance is None else 'instance'}",
                task.id,
                found,
            )
    for n, row in enumerate(appearing):
        task = Task(
            len(known) + n, 0, False, row.pickup, row.delivery, row.load, row.robots
        )
        if not chosen.appear:
            if found := site.explain_bad_place(task, task.pickup):
                raise _build_place_error(f"{where}.later", task.id, found)
            continue
        key = f"{where}.appear[{n}]"
        for name, place in (("pickup", row.pickup), ("delivery", row.delivery)):
            if found := site.explain_objection(place):
                raise _build_place_error(f"{key}.{name}", list(place), found)
        _require_known_drones(site, row.robots, f"{key}.robots")
        _require_known_drones(site, row.heard_by, f"{key}.heard_by")
        if found := site.explain_unservable(task):
            raise _build_place_error(f"{key}.load", row.load, found)
    for n, cancel in enumerate(chosen.cancel):
        _require_known_drones(site, cancel.heard_by, f"{where}.cancel[{n}].heard_by")


def _build_place_error(key: str, found: object, problem: str) -> ConfigError:
    allowed = "places inside the fence, at least `clearance` from homes, and loads that a drone can carry"
    return ConfigError(
        key,
        found,
        allowed,
        "Move or change the task, widen [fence], or take another seed.",
        problem,
    )


def _require_known_drones(site: DeliverySite, ids: tuple[int, ...], key: str) -> None:
    if strangers := [i for i in ids if i not in site.config.ids]:
        allowed = f"this swarm has {describe_ids(site.config.ids)}"
        problem = f"there is no drone {describe_ids(strangers)}"
        raise ConfigError(
            key,
            list(ids),
            allowed,
            "Correct the list, or leave it out for all drones.",
            problem,
        )
