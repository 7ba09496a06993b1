"""What all robots of a team know of each other after they have introduced themselves."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from weakref import WeakValueDictionary

from crazychoir.routing.distributed.clusters import Neighbors
from crazychoir.routing.distributed.member import bound_reach
from crazychoir.routing.distributed.plan_measure import PlanMeasure
from crazychoir.routing.distributed.team_order import TeamOrder
from crazychoir.routing.instance.instance import (
    LocalProblem,
    Tasks,
    group_equal_robots,
)

Descriptions = tuple[tuple[int, bytes], ...]
"""(robot, its encoded description) of all robots."""


@dataclass(frozen=True, eq=False)
class TeamKnowledge:
    """The problems of all robots, and what follows from them alone.

    All robots know the same, so the robots of one process hold one such object; see
    `recall_knowledge`. Each part is computed at its first use.
    """

    robots: Mapping[int, LocalProblem]
    """The problem of each robot, by id."""

    @cached_property
    def order(self) -> TeamOrder:
        """The order of robots and tasks."""
        return TeamOrder.of(self.robots)

    @cached_property
    def near(self) -> Neighbors:
        """The distances between robots."""
        return Neighbors(self.robots, self.order)

    @cached_property
    def measure(self) -> PlanMeasure:
        """The values by which plans are compared."""
        one = next(iter(self.robots.values()))
        return PlanMeasure(self.robots, one.vehicle_weight)

    @cached_property
    def fixed(self) -> float:
        """m: the highest fixed cost of a robot."""
        return max(robot.fixed for robot in self.robots.values())

    @cached_property
    def reach(self) -> float:
        """m: upper bound on the distance between two places."""
        return max(bound_reach(robot) for robot in self.robots.values())

    @cached_property
    def alike(self) -> Mapping[int, tuple[int, ...]]:
        """Groups of identical robots, by the lowest id."""
        return MappingProxyType(
            {same[0]: same for same in group_equal_robots(self.robots)}
        )


def recall_knowledge(
    tasks: Tasks,
    objective: tuple[str, ...],
    descriptions: Descriptions,
    decode: Callable[[], Mapping[int, LocalProblem]],
) -> TeamKnowledge:
    """Return what follows from these descriptions; equal ones give one object while it is in use.

    tasks: the tasks of this robot; the robots of a process share the object.
    objective: of the team.
    descriptions: of all robots.
    decode: returns the problems of all robots.
    """
    key = (tasks, objective, descriptions)
    known = _KNOWN_TEAMS.get(key)
    if known is None:
        known = TeamKnowledge(MappingProxyType(dict(decode())))
        _KNOWN_TEAMS[key] = known
    return known


_KNOWN_TEAMS: WeakValueDictionary[
    tuple[Tasks, tuple[str, ...], Descriptions], TeamKnowledge
] = WeakValueDictionary()
