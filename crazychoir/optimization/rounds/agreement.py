"""Finite-time agreement as generators: `heard = yield message` is one round.

Write a distributed algorithm as a plain sequence of `yield from` these functions. Most of them
need `diameter`, the largest distance between two agents of the graph. They end in the same
round at every agent, with the same value.
"""

from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.optimization.rounds.messages import (
    INTEGER_TYPES,
    REAL_NUMBER_TYPES,
    build_malformed_error,
)
from crazychoir.optimization.rounds.program import Exchange
from crazychoir.types import Vec


def flood_values(robot: int, value: Any, diameter: int) -> Exchange[dict[int, Any]]:
    """Return the values of all robots, by robot id in increasing order.

    Each value crosses each edge at most once in each direction.

    robot: id of this robot
    value: value of this robot
    diameter: rounds of the exchange
    """
    return (yield from _flood(robot, {robot: value}, diameter))


def flood_offers(
    robot: int, offer: Any | None, diameter: int
) -> Exchange[dict[int, Any]]:
    """Return the offers of all robots that make one, by robot id in increasing order.

    A robot without an offer sends nothing of its own, so that few offers cost few bytes.

    robot: id of this robot
    offer: offer of this robot, or None
    diameter: rounds of the exchange
    """
    own = {} if offer is None else {robot: offer}
    return (yield from _flood(robot, own, diameter))


def _flood(robot: int, own: dict[int, Any], diameter: int) -> Exchange[dict[int, Any]]:
    """Return what all robots know at the start, by robot id; `own` is what this robot knows."""
    known = dict(own)
    news = [[origin, item] for origin, item in own.items()]
    for k in range(diameter):
        heard = yield news
        news = []
        for j, arrived in heard.items():
            if not _are_rows(arrived, INTEGER_TYPES, object):
                raise build_malformed_error(
                    f"agent {robot}: flood", j, k, arrived, "a list of [agent, value]"
                )
            for origin, item in arrived:
                if origin not in known:
                    known[origin] = item
                    news.append([origin, item])
    return {i: known[i] for i in sorted(known)}


def find_best_offer(
    offer: list[Any] | None, diameter: int
) -> Exchange[list[Any] | None]:
    """Return the offer with the least (offer[0], offer[1]), or None if no robot makes an offer.

    A robot sends an offer once, in the round after it has become the best that the robot knows.

    offer: [cost, robot id, ...], or None
    """
    best = offer
    news = offer
    for k in range(diameter):
        heard = yield news
        news = None
        for j, other in heard.items():
            try:
                better = other is not None and (
                    best is None or (other[0], other[1]) < (best[0], best[1])
                )
            except (TypeError, LookupError, ValueError):
                raise build_malformed_error(
                    "best offer", j, k, other, "an offer, [cost, robot, ...], or None"
                ) from None
            if better:
                best = other
                news = other
    return best


def find_highest_bids(
    bids: dict[int, list[Any]], diameter: int
) -> Exchange[dict[int, list[Any]]]:
    """Return the highest bid of all robots for each task that has a bid.

    bids: {task: [amount, robot]} of this robot
    At equal amounts the lowest robot id wins.
    """
    best = dict(bids)
    for k in range(diameter):
        heard = yield [[task, *bid] for task, bid in sorted(best.items())]
        for j, arrived in heard.items():
            if not _are_rows(arrived, INTEGER_TYPES, REAL_NUMBER_TYPES, INTEGER_TYPES):
                raise build_malformed_error(
                    "highest bids", j, k, arrived, "a list of [task, amount, robot]"
                )
            for task, amount, robot in arrived:
                if task not in best or (amount, -robot) > (
                    best[task][0],
                    -best[task][1],
                ):
                    best[task] = [amount, robot]
    return {task: best[task] for task in sorted(best)}


def find_greatest(values: Vec, diameter: int) -> Exchange[Vec]:
    """Return the greatest value of each entry over all agents (max-consensus).

    The graph may change from round to round.
    """
    for k in range(diameter):
        heard = yield values
        for j, other in heard.items():
            if not (
                isinstance(other, np.ndarray)
                and other.shape == values.shape
                and other.dtype.kind in "fiu"
            ):
                raise build_malformed_error(
                    "greatest", j, k, other, f"shape {values.shape}, of numbers"
                )
        values = np.maximum.reduce([values, *heard.values()])
    return values


def require_same_everywhere(value: Any, where: str, name: str) -> Exchange[None]:
    """Raise ConfigError if a neighbour has another `value`; takes one round.

    value: a number or a list
    where: text that says where the value comes from, for the error
    name: name of the value, for the error
    """
    heard = yield value
    for j, other in heard.items():
        if isinstance(other, np.ndarray) or other != value:
            raise ConfigError(
                f"{where}: {name} of agent {j}",
                other,
                f"{value}, the same at all agents",
            )


def _are_rows(arrived: Any, *kinds: Any) -> bool:
    """Return True if `arrived` is a list of lists with parts of these types."""
    return isinstance(arrived, list) and all(
        isinstance(row, list)
        and len(row) == len(kinds)
        and all(map(isinstance, row, kinds))
        for row in arrived
    )
