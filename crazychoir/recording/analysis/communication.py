"""What the drones of a recorded flight told each other: how many messages, and how their rounds came to agree."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.topics import RESULT, ROUND, STATUS
from crazychoir.recording.mcap.sequence import told
from crazychoir.routing.instance.vehicle import MAKESPAN
from crazychoir.runtime.clock import SECOND
from crazychoir.types import Mat, Vec

COUNTERS = ("sent", "lost", "resent")
STEP = 0.5
"""s between two rates of messages."""
WITH_CONTENT = ("data", "repeat", "ahead")


@dataclass(frozen=True)
class Channel:
    """The rounds of one algorithm.

    rounds: (n,), those of which something has arrived, in order;  different: (n,), how many different messages there
    were in each, 1 if all said the same;  spread: (n,) max over drones and entries of |x_i - mean_j x_j|, where
    messages are numbers of one shape; else None.
    """

    name: str
    rounds: Vec
    different: Vec
    spread: Vec | None


@dataclass(frozen=True)
class Talk:
    """t: (n,) s;  rates: (n, 3) 1/s of messages between drones of the whole team, sent, lost, resent, on average since
    the time before;  channels: in order of their first message;  history: by drone, (n, 3) = round, value of the
    relaxation, cost of the best plan, whenever they changed, NaN as long as unknown, of who has planned routes.
    unit: of these two: "m" of all routes, or "s" until the last drone is back, as the team has minimised.
    """

    t: Vec
    rates: Mat
    channels: tuple[Channel, ...]
    history: dict[int, Mat]
    unit: str = "m"

    def write(self, path: Path) -> None:
        """The rates as a CSV file."""
        header = ",".join(["t_s", *(f"{name}_1_s" for name in COUNTERS)])
        np.savetxt(
            path,
            np.column_stack([self.t, self.rates]),
            "%.3f",
            ",",
            header=header,
            comments="",
        )

    def write_rounds(self, path: Path) -> None:
        """The rounds as a CSV file."""
        rows = ["channel,round,different_messages,spread"]
        for channel in self.channels:
            spread = (
                np.full(len(channel.rounds), np.nan)
                if channel.spread is None
                else channel.spread
            )
            name = json.dumps(channel.name)
            for k, number, far in zip(
                channel.rounds, channel.different, spread, strict=True
            ):
                rows.append(f"{name},{k:.0f},{number:.0f},{far:.6g}")
        path.write_text("\n".join(rows) + "\n", encoding="utf-8")

    def write_history(self, path: Path) -> None:
        """The planning of all drones as a CSV file."""
        rows = [
            np.column_stack([np.full(len(own), i), own])
            for i, own in sorted(self.history.items())
        ]
        table = np.vstack(rows) if rows else np.zeros((0, 4))
        formats = ("%d", "%d", "%.6f", "%.6f")
        header = f"drone,round,relaxed_{self.unit},cost_{self.unit}"
        np.savetxt(path, table, formats, ",", header=header, comments="")


def talk_of(path: Path, began: float) -> Talk:
    """The talk of a recorded flight, in s after `began`; raises ConfigError for what is no recording."""
    counted: dict[int, list[tuple[float, ...]]] = {}
    said: dict[str, dict[int, dict[int, str]]] = {}
    history: dict[int, Mat] = {}
    unit = "m"
    for message in told(path, (STATUS.name, ROUND.name, RESULT.name)):
        values = message.values()
        drone = message.source.drone
        if message.source.topic == RESULT.name:
            result = json.loads(values["json"])
            changes = _planned(result)
            if changes is not None:
                history[drone] = changes
                objective = result.get("objective")
                unit = (
                    "s"
                    if isinstance(objective, list) and objective[:1] == [MAKESPAN]
                    else "m"
                )
        elif message.source.topic == STATUS.name:
            row = (
                message.came_ns / SECOND - began,
                *(float(values[name]) for name in COUNTERS),
            )
            counted.setdefault(drone, []).append(row)
        elif values["kind"] in WITH_CONTENT:
            said.setdefault(values["channel"], {}).setdefault(
                values["round"], {}
            ).setdefault(drone, values["json"])
    t, rates = _rates([np.array(rows) for rows in counted.values()])
    return Talk(
        t,
        rates,
        tuple(_channel(name, rounds) for name, rounds in said.items()),
        history,
        unit,
    )


def _planned(result: Any) -> Mat | None:
    """The rows (n, 3) of Talk.history of a drone's result; None where it has none, or means something else by it."""
    try:
        rows = np.array(result["history"], dtype=float)
    except (TypeError, KeyError, ValueError):
        return None
    return rows if rows.ndim == 2 and rows.shape[1] == 3 and len(rows) else None


def _rates(counted: list[Mat]) -> tuple[Vec, Mat]:
    """From rows [t, counters] of each drone, which says them now and then: a drone that is not heard yet has none."""
    if not counted:
        return np.zeros(0), np.zeros((0, len(COUNTERS)))
    first = min(rows[0, 0] for rows in counted)
    last = max(rows[-1, 0] for rows in counted)
    at = np.arange(first, last + 1e-9, STEP)
    total = np.zeros((len(at), len(COUNTERS)))
    for rows in map(_growing, counted):
        total += np.column_stack(
            [np.interp(at, rows[:, 0], rows[:, n + 1]) for n in range(len(COUNTERS))]
        )
    return at[1:], np.diff(total, axis=0) / STEP


def _growing(rows: Mat) -> Mat:
    """The same with counters that never fall: who says fewer than before was started anew, and counts from 0."""
    steps = np.diff(rows[:, 1:], axis=0)
    anew = (steps < 0.0).any(axis=1)
    steps[anew] = rows[1:, 1:][anew]
    return np.column_stack(
        [rows[:, 0], np.cumsum(np.vstack([rows[:1, 1:], steps]), axis=0)]
    )


def _channel(name: str, rounds: Mapping[int, Mapping[int, str]]) -> Channel:
    ks = sorted(rounds)
    different = np.array([len(set(rounds[k].values())) for k in ks], dtype=float)
    spread = [_spread(rounds[k]) for k in ks]
    known = [far for far in spread if far is not None]
    return Channel(
        name,
        np.array(ks, dtype=float),
        different,
        np.array(known) if len(known) == len(ks) else None,
    )


def _spread(messages: Mapping[int, str]) -> float | None:
    """Of messages that are numbers of one shape; None of any others."""
    values: list[Any] = [json.loads(text) for text in messages.values()]
    try:
        x = np.array(values, dtype=float)
    except (ValueError, TypeError):
        return None
    return float(np.abs(x - x.mean(axis=0)).max()) if x.size else None
