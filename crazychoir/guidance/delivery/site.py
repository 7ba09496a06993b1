"""Where goods may lie, and which robots may serve which goods.

All robots know this before the flight.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from crazychoir.config.drone_room import shared_room
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.tasks.task_book import Place, Task
from crazychoir.routing.instance.instance import Instance
from crazychoir.team.graph import describe_ids
from crazychoir.types import Vec


@dataclass(frozen=True)
class DeliverySite:
    """The fence, the homes above which drones rise and land, and the loads of the robots."""

    config: SwarmConfig
    """The swarm file."""
    clearance: float
    """m, in the plane: distance of goods from the homes."""
    crew: Instance
    """Capacities, and capabilities for the first tasks: those of the instance."""
    low: Vec = field(init=False)
    """(2,) m: lower corner of the area that drones fly to."""
    high: Vec = field(init=False)
    """(2,) m: upper corner of that area."""

    def __post_init__(self) -> None:
        """Compute the corners of the area."""
        low, high = shared_room(self.config)
        object.__setattr__(self, "low", np.array(low[:2]))
        object.__setattr__(self, "high", np.array(high[:2]))

    # Where ----------------------------------------------------------------------------

    def explain_objection(self, place: Place, besides: int | None = None) -> str:
        """Return why no drone may stand above a place. Empty if it may.

        place: (2,) m.
        besides: a robot that lies at this place, with its goods. Its own home does not matter.
        """
        if not all(
            a <= x <= b for a, x, b in zip(self.low, place, self.high, strict=True)
        ):
            fence = self.config.fence
            sides = zip(fence.min[:2], place, fence.max[:2], strict=True)
            if not all(a <= x <= b for a, x, b in sides):
                room = f"{_format_place(fence.min[:2])} to {_format_place(fence.max[:2])} m"
                return f"outside the fence, {room}"
            room = f"{_format_place(self.low.round(3))} to {_format_place(self.high.round(3))} m"
            return f"at the edge of the fence: drones are sent to {room}"
        for drone in self.config.drones:
            gap = math.dist(place, drone.home[:2])
            if drone.id != besides and gap < self.clearance:
                home = f"the home of drone {drone.id}, where it rises and lands"
                return f"{gap:.2f} m from {home}; the clearance is {self.clearance:g} m"
        return ""

    def explain_bad_place(
        self, task: Task, pickup: Place, besides: int | None = None
    ) -> str:
        """Return why goods cannot be fetched from `pickup`, or cannot be delivered.

        Empty if they can.

        task: the task of the goods.
        pickup: (2,) m: where the goods lie.
        besides: a robot that lies there with the goods.
        """
        for name, place, whose in (
            ("pickup", pickup, besides),
            ("delivery", task.delivery, None),
        ):
            if found := self.explain_objection(place, whose):
                return f"its {name} {_format_place(place)} is {found}"
        return ""

    # Robots ---------------------------------------------------------------------------

    def may_serve(self, i: int, task: Task) -> bool:
        """Return whether a task is meant for robot i, whatever its load."""
        if task.id < len(self.crew.tasks):
            return bool(self.crew.capability[i, task.id])
        return not task.robots or i in task.robots

    def list_able_robots(self, task: Task) -> list[int]:
        """Return the robots of the swarm that may serve a task and can carry it."""
        return [
            i
            for i in self.config.ids
            if self.may_serve(i, task) and task.load <= self._room(i)
        ]

    def explain_unservable(self, task: Task) -> str:
        """Return why no robot of this swarm can serve a task, wherever its goods are.

        Empty if one can.
        """
        if strangers := [i for i in task.robots if i not in self.config.ids]:
            return f"there is no drone {describe_ids(strangers)}; this swarm has {describe_ids(self.config.ids)}"
        if self.list_able_robots(task):
            return ""
        chosen = [i for i in self.config.ids if self.may_serve(i, task)]
        carriers = (
            "any drone"
            if len(chosen) == len(self.config.ids)
            else f"drone {describe_ids(chosen)}, which alone may serve it,"
        )
        return f"its load {task.load:g} is more than {carriers} can carry: {self._most(chosen):g}"

    def explain_wait(self, task: Task, flying: Collection[int]) -> str:
        """Return why no flying robot can serve a task that the swarm could serve.

        Empty if one can.
        """
        able = self.list_able_robots(task)
        if any(i in flying for i in able):
            return ""
        return f"drone {describe_ids(able)}, which alone can serve it, does not fly"

    def _room(self, i: int) -> float:
        return float(self.crew.capacity[i] - self.crew.initial_load[i])

    def _most(self, ids: Collection[int]) -> float:
        return max((self._room(i) for i in ids), default=0.0)


def _format_place(place: Collection[float]) -> str:
    return f"[{', '.join(f'{x:g}' for x in place)}]"
