"""The description that each robot sends of itself, so that all robots can plan for neighbours."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.member import RoutingMember, bound_reach
from crazychoir.routing.instance.instance import (
    PUBLIC_FIELDS,
    LocalProblem,
    Tasks,
    group_equal_robots,
)
from crazychoir.types import Ints

SENT_FIELD_NAMES = tuple(
    f.name.replace("_", " ")
    for f in fields(LocalProblem)
    if f.name not in PUBLIC_FIELDS
)
"""Names of the fields that each robot sends about itself."""
MOST_BYTES = 300_000
"""Largest size of all descriptions in one flood.

If robots have distance matrices of their own, only some robots send at a time.
"""


def introduce_robots(member: RoutingMember) -> Exchange[dict[int, LocalProblem]]:
    """Exchange the problems of all robots and return them by id.

    A problem says where the robot is, what it can carry, how far it can fly and what it is capable
    of. Also sets `member.fixed`, `member.reach` and `member.alike`.
    """
    local = member.local
    place = member.place
    member.kind = "introductions"
    at_once = (
        place.robots
        if local.distance is None
        else max(1, MOST_BYTES // local.distance.nbytes)
    )
    known: dict[int, LocalProblem] = {}
    for first in range(0, place.robots, at_once):
        turn = range(first, min(first + at_once, place.robots))
        told = yield from flood_values(
            place.robot,
            _list_own_fields(local) if place.robot in turn else None,
            place.diameter,
        )
        known |= {i: _decode_problem(local, i, told[i]) for i in turn}
    member.fixed = max(robot.fixed for robot in known.values())
    member.reach = max(bound_reach(robot) for robot in known.values())
    member.alike = {same[0]: same for same in group_equal_robots(known)}
    return known


def restrict_problem(
    local: LocalProblem, chosen: Ints, few: Tasks | None = None
) -> LocalProblem:
    """Return the problem of the same robot with the tasks `chosen` alone, (K,) in any order.

    few: these tasks, if they are already at hand: robots with the same object share its distances.
    """
    m = len(local.tasks)
    nodes = np.concatenate([chosen, m + chosen, [2 * m]])
    return replace(
        local,
        tasks=local.tasks.only(chosen) if few is None else few,
        capable=local.capable[chosen],
        aboard=None if local.aboard is None else local.aboard[chosen],
        distance=None
        if local.distance is None
        else local.distance[np.ix_(nodes, nodes)],
    )


def _list_own_fields(local: LocalProblem) -> dict[str, Any]:
    """Return the robot's own fields that are not None, as plain values."""
    own = {
        f.name: getattr(local, f.name)
        for f in fields(local)
        if f.name not in PUBLIC_FIELDS
    }
    return {
        name: _encode_profile_field(value)
        for name, value in own.items()
        if value is not None
    }


def _encode_profile_field(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == bool:
        return [value.size, np.packbits(value)]
    return list(value) if isinstance(value, tuple) else value


def _decode_problem(
    own: LocalProblem, robot: int, told: Mapping[str, Any]
) -> LocalProblem:
    masks = {
        name: _decode_mask(told[name]) for name in ("capable", "aboard") if name in told
    }
    absent = {
        f.name: f.default for f in fields(own) if f.name not in (*PUBLIC_FIELDS, *told)
    }
    window = (float(told["window"][0]), float(told["window"][1]))
    return replace(own, **{**absent, **told, **masks, "robot": robot, "window": window})


def _decode_mask(packed: Any) -> Any:
    size, bits = packed
    return np.unpackbits(np.asarray(bits), count=int(size)).astype(bool)
