"""Messages between the drones of a recorded flight: rates, and convergence of the rounds."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.routing.instance.vehicle import OBJECTIVE_NAMES
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.message_kind import MessageKind
from crazychoir.types import Mat, Vec


@dataclass(frozen=True, slots=True)
class MessageStatistics:
    """How the messages between the drones of a recording are counted."""

    counters: tuple[str, ...] = ("sent", "lost", "resent")
    """Fields of a status that count messages."""
    rate_step: float = 1.0
    """Seconds between two values of the message rates."""
    kinds_with_content: tuple[str, ...] = tuple(
        kind.name.lower() for kind in MessageKind if kind <= MessageKind.DOUBLE
    )
    """Kinds of round messages with a value."""


MESSAGE_STATISTICS = MessageStatistics()


@dataclass(frozen=True)
class ChannelRounds:
    """The rounds of one algorithm."""

    name: str
    """Name of the channel."""
    rounds: Vec
    """(n,): the rounds with at least one message that arrived, in order."""
    different: Vec
    """(n,): count of different messages in each round; 1 if all drones said the same."""
    spread: Vec | None
    """(n,): max over drones and entries of |x_i - mean_j x_j| in each round.

    None if messages are not numbers of one shape.
    """


@dataclass(frozen=True)
class TeamMessages:
    """Messages between the drones of a recorded flight."""

    t: Vec
    """(n,) s: times of the rates."""
    rates: Mat
    """(n, 3) 1/s: messages sent, lost and resent between all drones, averaged since the time
    before.
    """
    channels: tuple[ChannelRounds, ...]
    """Channels in order of their first message."""
    history: dict[int, Mat]
    """Planning of each drone with planned routes, (n, 3).

    A row has the round, the value of the relaxation and the cost of the best plan, for each
    change; NaN while unknown.
    """
    unit: str = "m"
    """Unit of value and cost: "m" of all routes, or "s" until the last drone is back.

    It is the objective of the team.
    """

    def write(self, path: Path) -> None:
        """Write the rates as a CSV file."""
        header = ",".join(
            ["t_s", *(f"{name}_1_s" for name in MESSAGE_STATISTICS.counters)]
        )
        np.savetxt(
            path,
            np.column_stack([self.t, self.rates]),
            "%.3f",
            ",",
            header=header,
            comments="",
        )

    def write_rounds(self, path: Path) -> None:
        """Write the rounds as a CSV file."""
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
        """Write the planning of all drones as a CSV file."""
        rows = [
            np.column_stack([np.full(len(own), i), own])
            for i, own in sorted(self.history.items())
        ]
        table = np.vstack(rows) if rows else np.zeros((0, 4))
        formats = ("%d", "%d", "%.6f", "%.6f")
        header = f"drone,round,relaxed_{self.unit},cost_{self.unit}"
        np.savetxt(path, table, formats, ",", header=header, comments="")


def read_team_messages(path: Path, began: float) -> TeamMessages:
    """Return the messages of a recorded flight, in s after `began`.

    Raises ConfigError if the file is no recording.
    """
    counted: dict[int, list[tuple[float, ...]]] = {}
    said: dict[str, dict[int, dict[int, str]]] = {}
    history: dict[int, Mat] = {}
    unit = "m"
    for message in read_messages(
        path,
        (
            DRONE_TOPICS.status.name,
            MESSAGE_TOPICS.rounds.name,
            DRONE_TOPICS.result.name,
        ),
    ):
        values = message.values()
        drone = message.source.drone
        if message.source.topic == DRONE_TOPICS.result.name:
            result = json.loads(values["json"])
            changes = _planned_rows(result)
            if changes is not None:
                history[drone] = changes
                objective = result.get("objective")
                unit = (
                    "s"
                    if isinstance(objective, list)
                    and objective[:1] == [OBJECTIVE_NAMES.makespan]
                    else "m"
                )
        elif message.source.topic == DRONE_TOPICS.status.name:
            row = (
                message.came_ns / NS_PER_SECOND - began,
                *(float(values[name]) for name in MESSAGE_STATISTICS.counters),
            )
            counted.setdefault(drone, []).append(row)
        elif values["kind"] in MESSAGE_STATISTICS.kinds_with_content:
            said.setdefault(values["channel"], {}).setdefault(
                values["round"], {}
            ).setdefault(drone, values["json"])
    t, rates = _message_rates([np.array(rows) for rows in counted.values()])
    return TeamMessages(
        t,
        rates,
        tuple(_channel_rounds(name, rounds) for name, rounds in said.items()),
        history,
        unit,
    )


def _planned_rows(result: Any) -> Mat | None:
    """Return the rows (n, 3) of Talk.history in a drone's result.

    Return None if the result has none, or uses the name for something else.
    """
    try:
        rows = np.array(result["history"], dtype=float)
    except (TypeError, KeyError, ValueError):
        return None
    return rows if rows.ndim == 2 and rows.shape[1] == 3 and len(rows) else None


def _message_rates(counted: list[Mat]) -> tuple[Vec, Mat]:
    """Return the times and the rates of the whole team from rows [t, counters] of each drone.

    The drones report at different times. Before its first and after its last report a drone adds
    no messages.
    """
    if not counted:
        return np.zeros(0), np.zeros((0, len(MESSAGE_STATISTICS.counters)))
    first = min(rows[0, 0] for rows in counted)
    last = max(rows[-1, 0] for rows in counted)
    at = np.arange(first, last + 1e-9, MESSAGE_STATISTICS.rate_step)
    total = np.zeros((len(at), len(MESSAGE_STATISTICS.counters)))
    for rows in map(_make_monotonic, counted):
        total += np.column_stack(
            [
                np.interp(at, rows[:, 0], rows[:, n + 1])
                for n in range(len(MESSAGE_STATISTICS.counters))
            ]
        )
    return at[1:], np.diff(total, axis=0) / MESSAGE_STATISTICS.rate_step


def _make_monotonic(rows: Mat) -> Mat:
    """Make counters monotonic: if one falls, the drone was restarted and counts from 0."""
    steps = np.diff(rows[:, 1:], axis=0)
    anew = (steps < 0.0).any(axis=1)
    steps[anew] = rows[1:, 1:][anew]
    return np.column_stack(
        [rows[:, 0], np.cumsum(np.vstack([rows[:1, 1:], steps]), axis=0)]
    )


def _channel_rounds(
    name: str, rounds: Mapping[int, Mapping[int, str]]
) -> ChannelRounds:
    ks = sorted(rounds)
    different = np.array([len(set(rounds[k].values())) for k in ks], dtype=float)
    spread = [_spread_of_messages(rounds[k]) for k in ks]
    known = [far for far in spread if far is not None]
    return ChannelRounds(
        name,
        np.array(ks, dtype=float),
        different,
        np.array(known) if len(known) == len(ks) else None,
    )


def _spread_of_messages(messages: Mapping[int, str]) -> float | None:
    """Return the spread of messages that are numbers of one shape; None for other messages."""
    values: list[Any] = [json.loads(text) for text in messages.values()]
    try:
        x = np.array(values, dtype=float)
    except (ValueError, TypeError):
        return None
    return float(np.abs(x - x.mean(axis=0)).max()) if x.size else None
