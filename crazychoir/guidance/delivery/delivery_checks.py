"""Checks of options, instance and swarm of the online mission, before any drone flies."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.delivery_options import Appearance, DeliveryOptions
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.tasks.task_book import Task
from crazychoir.guidance.tasks.task_source import FIRST_ADDED_ID
from crazychoir.routing.instance.instance import Instance
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.team.graph import describe_ids

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


def require_flyable_features(
    problem: Instance,
    key: str,
    flown: Collection[str] = (),
    allowed: str = FLIGHT_ABILITIES,
) -> None:
    """Raise ConfigError for features of an instance that no robot obeys in flight.

    Without this error they would be ignored silently.

    problem: the instance.
    key: key of the instance, for the error.
    flown: features that the robots of this mission obey.
    allowed: what the robots do, in words.
    """
    tasks = problem.tasks
    there = {
        "end": problem.end is not None,
        "open_tours": problem.open_tours,
        "distance": problem.distance is not None,
        "service_time": tasks.service.any(),
        "time_windows or release": tasks.earliest.any()
        or np.isfinite(tasks.latest).any(),
        "time_windows of homes": problem.window[:, 0].any()
        or np.isfinite(problem.window[:, 1]).any(),
        "penalty": np.isfinite(tasks.penalty).any(),
        "recharge": problem.recharge != 1,
        "objective": problem.objective != (OBJECTIVE_NAMES.total,),
    }
    if found := [
        name for name, is_there in there.items() if is_there and name not in flown
    ]:
        times = (
            ""
            if "service_time" in flown
            else "; service_time of [mission_options] holds for all stops"
        )
        do = f"Leave it out of the instance{times}."
        raise ConfigError(key, problem.name, allowed, do, f"it has {', '.join(found)}")


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
        if found := site.lies_badly(task, task.pickup) or site.never(task):
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
            if found := site.lies_badly(task, task.pickup):
                raise _build_place_error(f"{where}.later", task.id, found)
            continue
        key = f"{where}.appear[{n}]"
        for name, place in (("pickup", row.pickup), ("delivery", row.delivery)):
            if found := site.objection(place):
                raise _build_place_error(f"{key}.{name}", list(place), found)
        _require_known_drones(site, row.robots, f"{key}.robots")
        _require_known_drones(site, row.heard_by, f"{key}.heard_by")
        if found := site.never(task):
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
