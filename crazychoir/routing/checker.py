"""An independent judge of plans: it re-flies every route and shares no code with the solvers."""

import math
from collections.abc import Iterator

from crazychoir.errors import CrazyChoirError
from crazychoir.routing.instance import Instance
from crazychoir.routing.plan import Plan, Route

TOLERANCE = 1e-6


class PlanError(CrazyChoirError, ValueError):
    """A plan breaks rules of its instance; `violations` lists them."""

    def __init__(self, violations: list[str]) -> None:
        self.violations = tuple(violations)
        super().__init__("the plan is not feasible: " + "; ".join(violations))


def check(instance: Instance, plan: Plan) -> list[str]:
    """What is wrong with the plan, one sentence each; an empty list if nothing is.

    Checked: robots exist and fly once; pickup before delivery, by the same robot; load on board <= capacity
    after every stop; capability; length as flown equals the stated one and keeps the limit; every task exactly once.
    """
    found = list(_robots(instance, plan))
    served: dict[int, int] = {}
    for route in plan.routes:
        if 0 <= route.robot < len(instance.home):
            found.extend(f"robot {route.robot}: {wrong}" for wrong in _route(instance, route))
        for stop in route.stops:
            if stop.kind == "pickup":
                served[stop.task] = served.get(stop.task, 0) + 1
    for task in range(len(instance.tasks.load)):
        if served.get(task, 0) != 1:
            found.append(f"task {task} is served {served.get(task, 0)} times, not once")
    return found


def require_feasible(instance: Instance, plan: Plan) -> None:
    """Raise PlanError if `check` finds anything."""
    violations = check(instance, plan)
    if violations:
        raise PlanError(violations)


def _robots(instance: Instance, plan: Plan) -> Iterator[str]:
    seen: list[int] = []
    for route in plan.routes:
        if not 0 <= route.robot < len(instance.home):
            yield f"robot {route.robot} does not exist; there are 0 to {len(instance.home) - 1}"
        if route.robot in seen:
            yield f"robot {route.robot} has two routes"
        seen.append(route.robot)


def _route(instance: Instance, route: Route) -> Iterator[str]:
    yield from _stops(instance, route)
    at = list(instance.home[route.robot])
    flown = 0.0
    for stop in route.stops:
        if 0 <= stop.task < len(instance.tasks.load):
            points = instance.tasks.pickup if stop.kind == "pickup" else instance.tasks.delivery
            flown += math.dist(at, points[stop.task])
            at = list(points[stop.task])
    flown += math.dist(at, instance.home[route.robot])
    if not abs(flown - route.length) <= TOLERANCE:  # so that NaN is wrong too
        yield f"states a length of {route.length:.6f} m but flies {flown:.6f} m"
    if flown > instance.route_length_limit + TOLERANCE:
        yield f"flies {flown:.6f} m, limit {instance.route_length_limit:g} m"


def _stops(instance: Instance, route: Route) -> Iterator[str]:
    on_board: list[int] = []
    capacity = float(instance.capacity[route.robot])
    for stop in route.stops:
        if not 0 <= stop.task < len(instance.tasks.load):
            yield f"task {stop.task} does not exist"
        elif stop.kind not in ("pickup", "delivery"):
            yield f"does {stop.kind!r} with task {stop.task}, neither pickup nor delivery"
        elif stop.kind == "pickup":
            on_board.append(stop.task)
            if not instance.capability[route.robot][stop.task]:
                yield f"is not capable of task {stop.task}"
            held = math.fsum(float(instance.tasks.load[j]) for j in on_board)
            if held > capacity + TOLERANCE:
                yield f"carries {held:g} after picking up task {stop.task}, capacity {capacity:g}"
        elif stop.task in on_board:
            on_board.remove(stop.task)
        else:
            yield f"delivers task {stop.task} without having it on board"
    if on_board:
        yield f"comes home with task(s) {', '.join(map(str, on_board))} on board"
