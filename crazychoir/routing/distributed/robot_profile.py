"""The description that each robot sends of itself, so that all robots can plan for neighbours."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from crazychoir.bus.codec import encode
from crazychoir.optimization.rounds.agreement import flood_values
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.routing.distributed.member import RoutingMember
from crazychoir.routing.distributed.team_knowledge import (
    TeamKnowledge,
    recall_knowledge,
)
from crazychoir.routing.instance.instance import PUBLIC_FIELDS, LocalProblem

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


def introduce_robots(member: RoutingMember) -> Exchange[TeamKnowledge]:
    """Exchange the problems of all robots and return what all robots then know.

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
    told: dict[int, dict[str, Any]] = {}
    for first in range(0, place.robots, at_once):
        turn = range(first, min(first + at_once, place.robots))
        found = yield from flood_values(
            place.robot,
            _list_own_fields(local) if place.robot in turn else None,
            place.diameter,
        )
        told |= {i: found[i] for i in turn}
    known = recall_knowledge(
        local.tasks,
        local.objective,
        tuple((i, encode(description)) for i, description in told.items()),
        lambda: {i: _decode_problem(local, i, told[i]) for i in told},
    )
    member.fixed = known.fixed
    member.reach = known.reach
    member.alike = known.alike
    return known


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
