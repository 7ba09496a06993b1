"""Pickup-and-delivery instances with time windows as Li and Lim wrote them: a fleet at one depot."""

import math
from dataclasses import dataclass
from typing import Any

from crazychoir.errors import InstanceError

COLUMNS = 9
MOST_VEHICLES = 1000


@dataclass(frozen=True)
class _Row:
    """A customer: place m, demand, window s, service s, its pickup and its delivery, 0 where it is that itself."""

    customer: int
    x: float
    y: float
    demand: float
    ready: float
    due: float
    service: float
    pickup: int
    delivery: int


def is_li_lim(text: str) -> bool:
    """Whether the first line is three numbers and nothing else."""
    words = text.split("\n", 1)[0].split()
    return len(words) == 3 and all(_is_number(word) for word in words)


def parse_li_lim(text: str, where: str) -> dict[str, Any]:
    """As the JSON object of an instance: tasks in the order of their pickups' numbers, double-precision distances.

        line 1: vehicles, capacity, speed
        others: customer, x, y, demand, ready, due, service, pickup, delivery;   customer 0 is the depot

    The benchmark counts vehicles first and lengths after them, so `fixed_cost` is a power of ten above the sum of
    the tours for each task alone, which no plan worth having exceeds.
    Raises InstanceError with the line. Source: Li & Lim 2001, ICTAI, pp. 160-167; format of SINTEF's benchmark pages.
    """
    lines = [(n, line.split()) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    count, capacity, speed = _fleet([float(word) for word in lines[0][1]], f"{where}: line 1")
    rows = [_row(words, f"{where}: line {n}") for n, words in lines[1:]]
    by_number = {row.customer: row for row in rows}
    if 0 not in by_number or len(by_number) != len(rows):
        raise InstanceError(where, "no customer 0, or one twice", "the depot 0 and each other customer once")
    pairs = [_pair(row, by_number, where) for row in rows if row.customer and row.delivery]
    _require_all_in(pairs, rows, where)
    depot = by_number[0]
    alone = sum(_length(depot, p) + _length(p, d) + _length(d, depot) for p, d in pairs)
    return {
        "home": [[depot.x, depot.y]] * count,
        "capacity": [capacity] * count,
        "speed": speed,
        "pickup": [[p.x, p.y] for p, _ in pairs],
        "delivery": [[d.x, d.y] for _, d in pairs],
        "load": [p.demand for p, _ in pairs],
        "service_time": {"pickup": [p.service for p, _ in pairs], "delivery": [d.service for _, d in pairs]},
        "time_windows": {
            "pickup": [[p.ready, p.due] for p, _ in pairs],
            "delivery": [[d.ready, d.due] for _, d in pairs],
            "home": [[depot.ready, depot.due]] * count,
        },
        "fixed_cost": 10.0 ** math.ceil(math.log10(max(alone, 1.0))),
    }


def _fleet(numbers: list[float], where: str) -> tuple[int, float, float]:
    """Vehicles, capacity, speed."""
    vehicles, capacity, speed = numbers
    if not (vehicles.is_integer() and 1 <= vehicles <= MOST_VEHICLES):
        raise InstanceError(where, f"{vehicles:g} vehicles", f"a whole number from 1 to {MOST_VEHICLES}", "Mend it.")
    if capacity < 0.0 or speed <= 0.0:
        found = f"capacity {capacity:g}, speed {speed:g}"
        raise InstanceError(where, found, "a capacity of 0 or more, a speed above 0", "Mend the line.")
    return int(vehicles), capacity, speed


def _require_all_in(pairs: list[tuple[_Row, _Row]], rows: list[_Row], where: str) -> None:
    """Each customer is the pickup or the delivery of one pair."""
    paired = {row.customer for pair in pairs for row in pair}
    alone = [row.customer for row in rows if row.customer and row.customer not in paired]
    if alone:
        found = "a customer that is neither a pickup with a delivery, nor the delivery of one"
        do = "Its last two columns are: 0 and its delivery, or its pickup and 0."
        raise InstanceError(f"{where}: customer {alone[0]}", found, "pairs of both", do)
    if not pairs:
        raise InstanceError(where, "the depot alone", "at least one pickup and its delivery", "Add two lines.")


def _row(words: list[str], where: str) -> _Row:
    if len(words) != COLUMNS or not all(_is_number(word) for word in words):
        raise InstanceError(where, " ".join(words), f"{COLUMNS} numbers a customer", "Mend the line.")
    customer, x, y, demand, ready, due, service, pickup, delivery = (float(word) for word in words)
    return _Row(int(customer), x, y, demand, ready, due, service, int(pickup), int(delivery))


def _pair(pickup: _Row, rows: dict[int, _Row], where: str) -> tuple[_Row, _Row]:
    delivery = rows.get(pickup.delivery)
    if delivery is None or delivery.pickup != pickup.customer or delivery.demand != -pickup.demand:
        found = f"delivery {pickup.delivery}"
        allowed = "a customer that names it as its pickup, with the demand that it loads"
        raise InstanceError(f"{where}: customer {pickup.customer}", found, allowed, "Mend one of the two lines.")
    return pickup, delivery


def _length(a: _Row, b: _Row) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
