"""Pickup and delivery in flight: tasks appear and are cancelled, drones are lost and join, and the team plans again.

crazychoir run online_delivery --fast --loss 0.2
"""

from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct

from crazychoir.errors import ConfigError
from crazychoir.guidance.airspace import levels
from crazychoir.guidance.online_delivery import OnlinePDVRPGuidance, Options
from crazychoir.guidance.replanning import AUCTION, KINDS
from crazychoir.guidance.task_book import Fate, Place, Task
from crazychoir.guidance.task_source import ADDED, Event
from crazychoir.routing.instance import Instance
from crazychoir.safety.guard import EDGE
from crazychoir.swarm.config import SwarmConfig

Results = dict[int, dict[str, Any]]
FLIGHT = {"takeoff_height": 0.4, "speed_limit": 1.5, "acceleration_limit": 3.0, "landing_speed": 0.6}
ROOM, DOCK = 5.0, 0.8
"""m: goods lie in a square, the drones stand outside, on two of its sides."""
ALLOWED = (
    "instance", "tasks", "later", "appear", "cancel", "recover", "service_time", "until", "level_spacing", "clearance",
    "method",
)  # fmt: skip
Seconds = Annotated[float, Meta(ge=0.0)]
Ids = tuple[Annotated[int, Meta(ge=0)], ...]
Row = TypeVar("Row")


class Appearance(Struct, frozen=True, forbid_unknown_fields=True):
    """One [[mission_options.appear]]: a task, t s after the start; robots: who alone may serve it, empty: all."""

    t: Seconds
    pickup: Place
    delivery: Place
    load: Annotated[float, Meta(ge=0.0)] = 1.0
    robots: Ids = ()
    heard_by: Ids = ()


class Cancellation(Struct, frozen=True, forbid_unknown_fields=True):
    """One [[mission_options.cancel]]."""

    t: Seconds
    task: int
    heard_by: Ids = ()


def guidance(i: int, config: SwarmConfig) -> OnlinePDVRPGuidance:
    """Robot i, with its own part of the instance."""
    own = instance(config).local(i)
    return OnlinePDVRPGuidance(own, known(config), events(config), options(config))


def swarm(drones: int | None = None) -> SwarmConfig:
    """Ten drones along two sides of a room, each linked to the four nearest; tasks are drawn from the seed."""
    n = 10 if drones is None else drones
    rows = [(k // 2, k % 2) for k in range(n)]
    gap = ROOM / max(1, (n - 1) // 2)
    homes = [[round(gap * column, 3), -DOCK if side == 0 else ROOM + DOCK, 0.0] for column, side in rows]
    return SwarmConfig.of(
        {
            "name": "online",
            "mission": "online_delivery",
            "drones": [{"id": i, "home": home} for i, home in enumerate(homes)],
            "graph": "k-regular:4" if n > 5 else "complete",
            "flight": FLIGHT,
            "fence": {"min": [-2.0, -DOCK - 1.0, 0.0], "max": [ROOM + 2.0, ROOM + DOCK + 1.0, 3.0]},
            "lost_after": 2.0,
        }
    )


def instance(config: SwarmConfig) -> Instance:
    """The instance that the options name; without one, tasks that are drawn from the seed."""
    path = config.mission_options.get("instance")
    return Instance.load(path) if path is not None else drawn(config)


def drawn(config: SwarmConfig) -> Instance:
    """`tasks` goods (15) in the square, loads 1 or 2, capacities 2 to 4, each robot capable of three in four."""
    draw, n, m = np.random.default_rng(config.seed), len(config.ids), config.mission_options.get("tasks", 15)
    points = draw.uniform(0.0, ROOM, size=(2 * m, 2))
    capacity = draw.integers(2, 4, size=n, endpoint=True)
    mask = draw.random((n, m)) < 0.75
    mask[draw.integers(n, size=m), np.arange(m)] = True
    return Instance.parse(
        {
            "home": [list(config.drone(i).home[:2]) for i in config.ids],
            "pickup": points[:m].round(2).tolist(),
            "delivery": points[m:].round(2).tolist(),
            "load": draw.integers(1, 2, size=m, endpoint=True).astype(float).tolist(),
            "capacity": capacity.astype(float).tolist(),
            "capability": mask.tolist(),
        },
        f"online_delivery, seed {config.seed}",
    )


def known(config: SwarmConfig) -> list[Task]:
    """The tasks of the instance: all know them at the start."""
    tasks = instance(config).tasks
    return [
        Task(j, 0, False, _place(tasks.pickup[j]), _place(tasks.delivery[j]), float(tasks.load[j]))
        for j in range(len(tasks))
    ]


def events(config: SwarmConfig) -> list[Event]:
    """Tasks that appear, numbered after those of the instance, and cancellations."""
    tasks = {task.id: task for task in known(config)}
    found = []
    for row in _appearing(config):
        task = Task(len(tasks), 0, False, row.pickup, row.delivery, row.load, row.robots)
        tasks[task.id] = task
        found.append(Event(row.t, task, row.heard_by))
    for cancel in _rows(config, "cancel", Cancellation):
        if cancel.task not in tasks:
            where = f"swarm {config.name}: mission_options.cancel"
            raise ConfigError(where, f"task {cancel.task}", f"0 to {len(tasks) - 1}")
        gone = msgspec.structs.replace(tasks[cancel.task], cancelled=True)
        found.append(Event(cancel.t, gone, cancel.heard_by))
    return found


def _rows(config: SwarmConfig, key: str, kind: type[Row]) -> list[Row]:
    try:
        return msgspec.convert(list(config.mission_options.get(key, ())), list[kind])  # type: ignore[valid-type]
    except (msgspec.ValidationError, TypeError) as error:
        allowed = f"tables of {', '.join(kind.__annotations__)}"
        raise ConfigError(f"swarm {config.name}: mission_options.{key}", str(error), allowed) from error


def _appearing(config: SwarmConfig) -> list[Appearance]:
    """What `appear` says; without it and without an instance, `later` (5) tasks, each heard of by three robots."""
    options = config.mission_options
    if "appear" in options or "instance" in options:
        return _rows(config, "appear", Appearance)
    draw, n = np.random.default_rng([config.seed, 1]), options.get("later", 5)
    times, points = draw.uniform(3.0, 20.0, size=(n, 1)), draw.uniform(0.0, ROOM, size=(n, 2, 2))
    hears = [draw.choice(config.ids, size=min(3, len(config.ids)), replace=False).tolist() for _ in range(n)]
    return [
        Appearance(float(t[0]), _place(p[0]), _place(p[1]), heard_by=tuple(who))
        for t, p, who in zip(times, points, hears, strict=True)
    ]


def options(config: SwarmConfig) -> Options:
    """What all robots have in common."""
    given, flight = config.mission_options, config.flight
    highest = config.fence.max[2] - flight.ground - EDGE
    last = max((event.t for event in events(config)), default=0.0)
    return Options(
        levels(config.ids, flight.takeoff_height, given.get("level_spacing", 0.2), highest),
        service_time=given.get("service_time", 1.0),
        recover=given.get("recover", False),
        until=max(last, given.get("until", 0.0)),
        clearance=given.get("clearance", 0.4),
        method=given.get("method", AUCTION),
    )


def check(config: SwarmConfig, force: bool = False) -> list[str]:
    """The drones stand where the instance says, all levels fit, and nobody serves a task above another one's home."""
    where = f"swarm {config.name}: mission_options"
    if unknown := [key for key in config.mission_options if key not in ALLOWED]:
        raise ConfigError(where, unknown, ", ".join(ALLOWED))
    problem, chosen = instance(config), options(config)
    if chosen.method not in KINDS:
        raise ConfigError(f"{where}.method", chosen.method, ", ".join(KINDS))
    if config.ids != tuple(range(problem.robots)):
        raise ConfigError(f"swarm {config.name}: drones", list(config.ids), f"0 to {problem.robots - 1}")
    if not config.graph().is_undirected:
        raise ConfigError(f"swarm {config.name}: graph", "a directed graph", "an undirected one")
    homes = np.array([config.drone(i).home[:2] for i in config.ids])
    for i, home in enumerate(problem.home):
        if np.linalg.norm(homes[i] - home[:2]) > 0.05:
            raise ConfigError(f"swarm {config.name}: drones[{i}].home", homes[i].tolist(), f"{home.tolist()}")
    for task in [*known(config), *(event.task for event in events(config))]:
        if task.id >= ADDED:
            raise ConfigError(where, f"task {task.id}", f"fewer than {ADDED} tasks")
        for place in (task.pickup, task.delivery):
            gaps = np.linalg.norm(homes - place, axis=1)
            if gaps.min() < chosen.clearance:
                found = f"{list(place)} of task {task.id}, {gaps.min():.2f} m from the home of drone {gaps.argmin()}"
                raise ConfigError(where, found, f"at least {chosen.clearance:g} m, the clearance")
    return []


def report(config: SwarmConfig, results: Results) -> dict[str, Any]:
    """What has become of each task, by those who have seen the end."""
    told = [r["tasks"] for r in results.values() if "tasks" in r and r.get("success")]
    stops = [stop for r in results.values() for stop in r.get("served", [])]
    delivered = sorted(stop["task"] for stop in stops if stop["kind"] == "delivery")
    fates = told[0] if told else {}
    count = {fate.value: sum(value[0] == fate.value for value in fates.values()) for fate in Fate}
    done = count[Fate.DELIVERED.value] + count[Fate.CANCELLED.value]
    twice = [j for j in delivered if delivered.count(j) > 1]
    return {
        "success": bool(fates) and done == len(fates) and not twice and all(other == fates for other in told),
        "tasks": {"total": len(fates), **{name: number for name, number in count.items() if number}},
        "twice": twice,
        "plannings": max((len(r.get("plannings_s", [])) for r in results.values()), default=0),
        "longest_wait_s": max((r.get("longest_wait_s", 0.0) for r in results.values()), default=0.0),
    }


def _place(p: Any) -> tuple[float, float]:
    return float(p[0]), float(p[1])
