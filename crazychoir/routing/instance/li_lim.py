"""Reader for the pickup-and-delivery files of Li and Lim: time windows, a fleet at one depot."""

import math
from dataclasses import dataclass
from typing import Any

from crazychoir.errors import InstanceError
from crazychoir.routing.instance.sizes import INSTANCE_LIMITS
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES


@dataclass(frozen=True, slots=True)
class LiLimFormat:
    """The lines of an instance in the format of Li and Lim."""

    columns: tuple[str, ...] = (
        "customer",
        "x",
        "y",
        "demand",
        "ready time",
        "due time",
        "service time",
        "pickup",
        "delivery",
    )
    """Names of the columns of a line."""
    ranges: tuple[
        tuple[int, float],
        tuple[float, ...],
        tuple[float, ...],
        tuple[float, ...],
        tuple[int, float],
        tuple[int, float],
        tuple[int, float],
        tuple[int, float],
        tuple[int, float],
    ] = (
        (0, INSTANCE_LIMITS.amount),
        (-INSTANCE_LIMITS.distance_or_speed, INSTANCE_LIMITS.distance_or_speed),
        (-INSTANCE_LIMITS.distance_or_speed, INSTANCE_LIMITS.distance_or_speed),
        (-INSTANCE_LIMITS.amount, INSTANCE_LIMITS.amount),
        (0, INSTANCE_LIMITS.latest_time),
        (0, INSTANCE_LIMITS.latest_time),
        (0, INSTANCE_LIMITS.latest_time),
        (0, INSTANCE_LIMITS.amount),
        (0, INSTANCE_LIMITS.amount),
    )
    """The least and the largest number of each column."""
    whole_columns: tuple[str, ...] = ("customer", "pickup", "delivery")
    """Columns of whole numbers."""
    most_vehicles: int = 1000
    """Largest number of vehicles."""


LI_LIM_FORMAT = LiLimFormat()


@dataclass(frozen=True)
class _CustomerRow:
    """A customer."""

    customer: int
    """Number of the customer; 0 is the depot."""
    x: float
    """m."""
    y: float
    """m."""
    demand: float
    """Units of load: positive at a pickup, negative at a delivery."""
    ready: float
    """s: earliest begin of service."""
    due: float
    """s: latest begin of service."""
    service: float
    """s: service time."""
    pickup: int
    """Number of its pickup, 0 if the customer is itself a pickup."""
    delivery: int
    """Number of its delivery, 0 if the customer is itself a delivery."""


def is_li_lim(text: str) -> bool:
    """Return whether the first line that is not blank is exactly three numbers."""
    words = text.lstrip().split("\n", 1)[0].split()
    return len(words) == 3 and all(_is_number(word) for word in words)


def parse_li_lim(text: str, where: str) -> tuple[dict[str, Any], list[str]]:
    """Return the JSON object of an instance, and the name of each task.

        line 1: vehicles, capacity, speed
        others: customer, x, y, demand, ready, due, service, pickup, delivery

    Customer 0 is the depot. Distances are Euclidean, in double precision.
    Tasks are in the order of their pickups. The benchmark counts vehicles first and lengths after
    them, and so does the objective. The benchmark does not use the speed: 0 means 1, so that
    times equal lengths.
    Raises InstanceError with the line.
    Source: Li & Lim 2001, ICTAI, pp. 160-167; format of SINTEF's benchmark pages.
    """
    lines = [
        (n, line.split()) for n, line in enumerate(text.splitlines(), 1) if line.strip()
    ]
    count, capacity, speed = _parse_fleet(
        [float(word) for word in lines[0][1]], f"{where}: line {lines[0][0]}"
    )
    rows = [_parse_customer(words, f"{where}: line {n}") for n, words in lines[1:]]
    by_number = {row.customer: row for row in rows}
    if 0 not in by_number or len(by_number) != len(rows):
        raise InstanceError(
            where,
            "no customer 0, or one twice",
            "the depot 0 and each other customer once",
        )
    pairs = [
        _find_pair(row, by_number, where)
        for row in rows
        if row.customer and row.delivery
    ]
    _require_all_in(pairs, rows, where)
    depot = by_number[0]
    return {
        "home": [[depot.x, depot.y]] * count,
        "capacity": [capacity] * count,
        "speed": speed,
        "pickup": [[p.x, p.y] for p, _ in pairs],
        "delivery": [[d.x, d.y] for _, d in pairs],
        "load": [p.demand for p, _ in pairs],
        "service_time": {
            "pickup": [p.service for p, _ in pairs],
            "delivery": [d.service for _, d in pairs],
        },
        "time_windows": {
            "pickup": [[p.ready, p.due] for p, _ in pairs],
            "delivery": [[d.ready, d.due] for _, d in pairs],
            "home": [[depot.ready, depot.due]] * count,
        },
        "objective": [OBJECTIVE_NAMES.vehicles, OBJECTIVE_NAMES.total],
    }, [f"customer {p.customer} and its delivery {d.customer}" for p, d in pairs]


def _parse_fleet(numbers: list[float], where: str) -> tuple[int, float, float]:
    """Return vehicles, capacity, speed."""
    vehicles, capacity, speed = numbers
    if not (vehicles.is_integer() and 1 <= vehicles <= LI_LIM_FORMAT.most_vehicles):
        raise InstanceError(
            where,
            f"{vehicles:g} vehicles",
            f"a whole number from 1 to {LI_LIM_FORMAT.most_vehicles}",
            "Correct it.",
        )
    if not (
        0.0 <= capacity <= INSTANCE_LIMITS.amount
        and (
            speed == 0.0
            or INSTANCE_LIMITS.slowest_speed
            <= speed
            <= INSTANCE_LIMITS.distance_or_speed
        )
    ):
        found = f"capacity {capacity:g}, speed {speed:g}"
        allowed = (
            f"a capacity from 0 to {INSTANCE_LIMITS.amount:g}, a speed from "
            f"{INSTANCE_LIMITS.slowest_speed:g} to {INSTANCE_LIMITS.distance_or_speed:g}, or 0, which means 1"
        )
        raise InstanceError(where, found, allowed, "Correct the line.")
    return int(vehicles), capacity, speed or 1.0


def _require_all_in(
    pairs: list[tuple[_CustomerRow, _CustomerRow]], rows: list[_CustomerRow], where: str
) -> None:
    """Raise InstanceError unless each customer is the pickup or the delivery of a pair."""
    paired = {row.customer for pair in pairs for row in pair}
    alone = [
        row.customer for row in rows if row.customer and row.customer not in paired
    ]
    if alone:
        found = "a customer that is neither a pickup with a delivery, nor the delivery of one"
        do = "Its last two columns are: 0 and its delivery, or its pickup and 0."
        raise InstanceError(f"{where}: customer {alone[0]}", found, "pairs of both", do)
    if not pairs:
        raise InstanceError(
            where,
            "the depot alone",
            "at least one pickup and its delivery",
            "Add two lines.",
        )


def _parse_customer(words: list[str], where: str) -> _CustomerRow:
    if len(words) != len(LI_LIM_FORMAT.columns) or not all(
        _is_number(word) for word in words
    ):
        raise InstanceError(
            where,
            " ".join(words),
            f"{len(LI_LIM_FORMAT.columns)} numbers a customer",
            "Correct the line.",
        )
    numbers = [float(word) for word in words]
    for name, number, (least, most) in zip(
        LI_LIM_FORMAT.columns, numbers, LI_LIM_FORMAT.ranges, strict=True
    ):
        if not least <= number <= most or (
            name in LI_LIM_FORMAT.whole_columns and not number.is_integer()
        ):
            whole = "whole number" if name in LI_LIM_FORMAT.whole_columns else "number"
            found = f"{name} {number:.9g}"
            raise InstanceError(
                where,
                found,
                f"a {whole} from {least:g} to {most:g}",
                "Correct the line.",
            )
    customer, x, y, demand, ready, due, service, pickup, delivery = numbers
    if due < ready:
        raise InstanceError(
            where,
            f"due time {due:g}",
            f"at least {ready:g}, the ready time",
            "Correct one of the two.",
        )
    if delivery and demand < 0.0:
        found = f"demand {demand:g} of a pickup"
        raise InstanceError(
            where, found, "0 or more; its delivery has less than 0", "Correct the line."
        )
    return _CustomerRow(
        int(customer), x, y, demand, ready, due, service, int(pickup), int(delivery)
    )


def _find_pair(
    pickup: _CustomerRow, rows: dict[int, _CustomerRow], where: str
) -> tuple[_CustomerRow, _CustomerRow]:
    delivery = rows.get(pickup.delivery)
    if (
        delivery is None
        or delivery.pickup != pickup.customer
        or delivery.demand != -pickup.demand
    ):
        found = f"delivery {pickup.delivery}"
        allowed = (
            "a customer that names it as its pickup, with the demand that it loads"
        )
        raise InstanceError(
            f"{where}: customer {pickup.customer}",
            found,
            allowed,
            "Correct one of the two lines.",
        )
    return pickup, delivery


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
