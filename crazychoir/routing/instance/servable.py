"""Check that every task has a robot that could serve it; if not, name the limit in the way."""

from collections.abc import Sequence

import numpy as np

from crazychoir.errors import InstanceError
from crazychoir.routing.instance.vehicle import ROUNDING_SLACK, Vehicle
from crazychoir.types import Vec


def require_servable_tasks(
    vehicles: Sequence[Vehicle], penalty: Vec, where: str, names: Sequence[str] = ()
) -> None:
    """Raise InstanceError if no robot can serve a task that must be served.

    vehicles: one robot of each kind.
    penalty: (M,), inf if the task must be served.
    where: what the error calls the instance.
    names: what the file calls the tasks, if the file is not JSON.
    """
    served = np.isfinite(penalty)
    for vehicle in vehicles:
        served[vehicle.servable] = True
    for j in np.flatnonzero(~served):
        found, allowed, do = _explain_obstacle(vehicles, int(j))
        if names:
            where = f"{where}: {names[int(j)]}"
            do = "Look at these lines, and at the first one."
            raise InstanceError(where, found, allowed, do)
        raise InstanceError(f"{where}: task {j}", found, allowed, do)


def _explain_obstacle(vehicles: Sequence[Vehicle], j: int) -> tuple[str, str, str]:
    """Return what keeps every robot from task j: what was found, what is allowed, what to do."""
    capable = [v for v in vehicles if v.capable[j]]
    if not capable:
        return (
            "no robot that is capable of it",
            "at least one",
            f"Look at column {j} of capability.",
        )
    load = float(capable[0].load[j])
    carriers = [v for v in capable if load <= v.capacity + ROUNDING_SLACK]
    if not carriers:
        most = f"{max(v.capacity for v in capable):g}, the largest capacity of the robots capable of it"
        return (
            f"load {load:g}",
            f"at most {most}",
            f"Look at load[{j}], capacity, and column {j} of capability.",
        )
    near = [v for v in carriers if v.shortest_trip[j] <= v.farthest + ROUNDING_SLACK]
    if not near:
        shortest, robot = min((float(v.shortest_trip[j]), v.robot) for v in carriers)
        found = (
            f"a tour of {shortest:.6g} m for it alone, by robot {robot}, "
            "the shortest of the robots that can carry it"
        )
        allowed = f"at most {carriers[0].farthest:g} m, the route_length_limit"
        return (
            found,
            allowed,
            f"Look at route_length_limit, home, pickup[{j}] and delivery[{j}].",
        )
    return _find_missed_window(near, j)


def _find_missed_window(vehicles: Sequence[Vehicle], j: int) -> tuple[str, str, str]:
    """Return which window has already closed when the fastest robot arrives."""
    m = vehicles[0].tasks
    for part, name in enumerate(("pickup", "delivery")):
        soonest, robot = min((float(v.soonest[part, j]), v.robot) for v in vehicles)
        latest = float(vehicles[0].latest[part * m + j])
        if soonest > latest + ROUNDING_SLACK:
            found = f"robot {robot}, the soonest, at its {name} at {soonest:.6g} s"
            return (
                found,
                f"at most {latest:g} s, the end of its window",
                f"Look at time_windows.{name}[{j}] and speed.",
            )
    robot = min((float(v.soonest_end[j] - v.latest[-1]), v.robot) for v in vehicles)[1]
    end, latest = next(
        (float(v.soonest_end[j]), float(v.latest[-1]))
        for v in vehicles
        if v.robot == robot
    )
    found = f"robot {robot} back from it at {end:.6g} s"
    return (
        found,
        f"at most {latest:g} s, the end of its window",
        f"Look at time_windows.home[{robot}] and speed.",
    )
