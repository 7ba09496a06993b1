"""The row of one flight in a table of a sweep: the figures that repeat, as plain numbers and texts."""

import json
from collections.abc import Mapping
from typing import Any

from crazychoir.bus.json_view import to_plain_values

Row = dict[str, Any]
"""Figures of one run by name: numbers, texts, truth values, or None."""
FIRST_FIGURES = ("success", "reason")
"""Figures of every run, even if it could not begin."""
FLIGHT_FIGURES = (
    "simulated_s",
    "min_separation_m",
    "formation_error_m",
    "settling_s",
    "rounds",
)
"""Figures of a flight that a row has, where the flight has them."""


def build_row(result: Mapping[str, Any]) -> Row:
    """Return the row of a flight, without times of the wall clock: equal flights have equal rows.

    result: the result of `fly_fast`
    """
    figures = to_plain_values(
        {name: result[name] for name in FLIGHT_FIGURES if name in result}
        | {name: result[name] for name in result["report"]}
    )
    row = build_first_figures(bool(result["success"]), _join_reasons(result))
    row["drones"] = result["drones"]
    for name, value in figures.items():
        row |= _flatten(name, value)
    row |= {f"messages_{name}": count for name, count in result["messages"].items()}
    row["flown_m"] = round(sum(result["flown_m"].values()), 4)
    row["digest"] = result["digest"]
    return row


def build_first_figures(success: bool, reason: str | None) -> Row:
    """Return the figures that every row begins with."""
    return dict(zip(FIRST_FIGURES, (success, reason), strict=True))


def _join_reasons(result: Mapping[str, Any]) -> str | None:
    """Return why the flight or some of its drones failed; None if none has."""
    texts = [] if result["reason"] is None else [str(result["reason"])]
    for i, reason in result["reasons"].items():
        own = str(reason).removeprefix(f"drone {i}: ")
        texts.append(f"drone {i}: {own}")
    return "; ".join(texts) or None


def _flatten(name: str, value: Any) -> Row:
    """Return a figure as numbers and texts: one a key of a dictionary; a list becomes its JSON."""
    if not isinstance(value, dict):
        return {name: json.dumps(value) if isinstance(value, list) else value}
    row: Row = {}
    for key, part in value.items():
        row |= _flatten(f"{name}.{key}", part)
    return row
