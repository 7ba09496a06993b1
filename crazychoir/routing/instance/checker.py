"""An independent check of plans: it flies every route again and shares no code with solvers."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from crazychoir.routing.instance.instance import Instance, LocalProblem
from crazychoir.routing.instance.plan import Route, RoutePlan

CHECK_TOLERANCE = 1e-6
"""Allowed difference: m, s or units of load; for the cost, relative."""


def check_plan(instance: Instance, plan: RoutePlan) -> list[str]:
    """Return what is wrong with the plan, one sentence each; an empty list if nothing is wrong.

    It checks that
    - the robots exist and each flies once,
    - each pickup comes before its delivery, by the same robot,
    - the load on board is at most the capacity after every stop,
    - capability, windows and releases are kept,
    - the stated lengths and finish times are the flown ones, and each trip keeps the limit,
    - every task is served exactly once, or refused if it may be refused,
    - the stated cost is right.
    """
    found = check_team_plan(
        [instance.local(i) for i in range(len(instance.home))], plan
    )
    cost = compute_flown_cost(instance, plan)
    if not found and not abs(cost - plan.cost) <= CHECK_TOLERANCE * max(1.0, abs(cost)):
        found.append(f"the plan states a cost of {plan.cost:.6f} but costs {cost:.6f}")
    return found


def check_team_plan(team: Sequence[LocalProblem], plan: RoutePlan) -> list[str]:
    """Return the same as `check_plan` without the cost, for robots 0..N-1 that may be in flight."""
    found = list(_check_robots(len(team), plan))
    served: dict[int, int] = {}
    for route in plan.routes:
        if 0 <= route.robot < len(team):
            found.extend(
                f"robot {route.robot}: {wrong}"
                for wrong in _check_route(team[route.robot], route)
            )
        for stop in route.stops:
            if stop.kind == "delivery":
                served[stop.task] = served.get(stop.task, 0) + 1
    for task, penalty in enumerate(team[0].tasks.penalty):
        times = served.get(task, 0)
        if times > 1 or (times == 0 and penalty == math.inf):
            found.append(f"task {task} is served {times} times, not once")
    return found


def compute_flown_cost(instance: Instance, plan: RoutePlan) -> float:
    """Return the first objective of the plan as flown, with the penalties of undelivered tasks.

    If vehicles come first this is the total length.
    """
    served = [
        stop.task
        for route in plan.routes
        for stop in route.stops
        if stop.kind == "delivery"
    ]
    penalties = sum(
        float(p) for task, p in enumerate(instance.tasks.penalty) if task not in served
    )
    known = [route for route in plan.routes if 0 <= route.robot < len(instance.home)]
    flights = [_fly_route(instance.local(route.robot), route) for route in known]
    if instance.objective[0] == "makespan":
        return max((flight.time for flight in flights), default=0.0) + penalties
    return sum(flight.length + instance.fixed_cost for flight in flights) + penalties


def _check_robots(count: int, plan: RoutePlan) -> Iterator[str]:
    seen: list[int] = []
    for route in plan.routes:
        if not 0 <= route.robot < count:
            yield f"robot {route.robot} does not exist; there are 0 to {count - 1}"
        if route.robot in seen:
            yield f"robot {route.robot} has two routes"
        seen.append(route.robot)


def _check_route(robot: LocalProblem, route: Route) -> Iterator[str]:
    yield from _check_stops(robot, route)
    flight = _fly_route(robot, route)
    if not abs(flight.length - route.length) <= CHECK_TOLERANCE:  # NaN fails too
        yield f"states a length of {route.length:.6f} m but flies {flight.length:.6f} m"
    if (
        route.finish is not None
        and not abs(flight.time - route.finish) <= CHECK_TOLERANCE
    ):
        yield f"states to be done at {route.finish:.6f} s but is at {flight.time:.6f} s"
    yield from flight.wrong


@dataclass
class _CheckedFlight:
    """The state of a robot that flies a route: progress so far and errors found."""

    robot: LocalProblem
    """The robot and its limits."""
    time: float
    """s: time so far."""
    limit: float
    """m: limit on the length of this trip."""
    length: float = 0.0
    """m: length of the route so far."""
    trip: float = 0.0
    """m: length of this trip so far."""
    wrong: list[str] = field(default_factory=list)
    """Errors found so far, a sentence each."""

    def move(self, metres: float) -> None:
        self.length += metres
        self.trip += metres
        self.time += metres / self.robot.speed

    def serve(self, stop: int, name: str) -> None:
        tasks = self.robot.tasks
        self.time = max(self.time, float(tasks.earliest[stop]))
        if self.time > tasks.latest[stop] + CHECK_TOLERANCE:
            self.wrong.append(
                f"begins the {name} at {self.time:.6f} s, its window ends at {tasks.latest[stop]:g} s"
            )
        self.time += float(tasks.service[stop])

    def end_trip(self) -> None:
        if self.trip > self.limit + CHECK_TOLERANCE:
            self.wrong.append(f"flies {self.trip:.6f} m, limit {self.limit:g} m")
        self.trip = 0.0
        self.limit = self.robot.limit


def _fly_route(robot: LocalProblem, route: Route) -> _CheckedFlight:
    """Fly the route leg by leg; leave out stops that do not exist."""
    m = len(robot.tasks.load)
    begin = max(robot.start_time, robot.window[0])
    flight = _CheckedFlight(
        robot, begin, robot.limit if robot.left is None else robot.left
    )
    at = "start"
    trips = 1
    for stop in route.stops:
        if stop.kind == "recharge":
            flight.move(_measure_way(robot, at, "end"))
            flight.end_trip()
            at = "end"
            trips = trips + 1
        elif 0 <= stop.task < m:
            there = f"{stop.kind} {stop.task}"
            flight.move(_measure_way(robot, at, there))
            flight.serve(
                stop.task if stop.kind == "pickup" else m + stop.task,
                f"{stop.kind} of task {stop.task}",
            )
            at = there
    if not robot.open_tour:
        flight.move(_measure_way(robot, at, "end"))
    flight.end_trip()
    if flight.time > robot.window[1] + CHECK_TOLERANCE:
        flight.wrong.append(
            f"is done at {flight.time:.6f} s, its window ends at {robot.window[1]:g} s"
        )
    if trips > robot.trips:
        flight.wrong.append(f"makes {trips} trips, at most {robot.trips}")
    return flight


def _measure_way(robot: LocalProblem, a: str, b: str) -> float:
    """Return the way in m between two places: "start", "end", "pickup 3", "delivery 3"."""
    if robot.distance is None:
        return math.dist(_find_point(robot, a), _find_point(robot, b))
    return float(robot.distance[_find_window_row(robot, a), _find_window_row(robot, b)])


def _find_point(robot: LocalProblem, place: str) -> list[float]:
    if place == "start" and robot.start is not None:
        return list(robot.start)
    if place in ("start", "end"):
        return list(robot.home if place == "start" or robot.end is None else robot.end)
    kind, task = place.split()
    return list(
        (robot.tasks.pickup if kind == "pickup" else robot.tasks.delivery)[int(task)]
    )


def _find_window_row(robot: LocalProblem, place: str) -> int:
    m = len(robot.tasks.load)
    if place in ("start", "end"):
        return 2 * m
    kind, task = place.split()
    return int(task) if kind == "pickup" else m + int(task)


def _check_stops(robot: LocalProblem, route: Route) -> Iterator[str]:
    """Yield what is wrong with the order of the stops and the load."""
    on_board = [
        j
        for j in range(len(robot.tasks.load))
        if robot.aboard is not None and robot.aboard[j]
    ]
    for stop in route.stops:
        if stop.kind == "recharge":
            if on_board:
                yield f"recharges with task(s) {', '.join(map(str, on_board))} on board"
        elif not 0 <= stop.task < len(robot.tasks.load):
            yield f"task {stop.task} does not exist"
        elif stop.kind not in ("pickup", "delivery"):
            yield f"does {stop.kind!r} with task {stop.task}, neither pickup nor delivery"
        elif stop.kind == "pickup":
            on_board.append(stop.task)
            yield from _check_loading(robot, on_board)
        elif stop.task in on_board:
            on_board.remove(stop.task)
        else:
            yield f"delivers task {stop.task} without having it on board"
    if on_board:
        yield f"comes home with task(s) {', '.join(map(str, on_board))} on board"


def _check_loading(robot: LocalProblem, on_board: list[int]) -> Iterator[str]:
    task = on_board[-1]
    if not robot.capable[task]:
        yield f"is not capable of task {task}"
    held = math.fsum(
        [robot.initial_load, *(float(robot.tasks.load[j]) for j in on_board)]
    )
    if held > robot.capacity + CHECK_TOLERANCE:
        yield f"carries {held:g} after picking up task {task}, capacity {robot.capacity:g}"
