"""Activity of the drones of a recorded flight over time: phases of flight, and completed stops."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.runtime.clock import NS_PER_SECOND

STOP_COUNT_PATTERN = re.compile(r"(\d+)(?:/\d+)? (?:stops|done)")
"""Pattern of the count of stops in a task's text: "1/4 stops", "3 stops done", "2 done, task 9"."""
STOP_SIGNS = {
    "pickup": "+",
    "delivery": "\N{MINUS SIGN}",
}  # before the task's number in a label
ON_GROUND = "on ground"  # phase of flight


@dataclass(frozen=True)
class Span:
    """An interval in which a drone was in one phase of flight and reported one task."""

    drone: int
    """Id of the drone."""
    begin: float
    """Beginning in s."""
    end: float
    """End in s."""
    phase: str
    """Phase of flight."""
    task: str
    """Text of the drone about its task."""


@dataclass(frozen=True)
class CompletedStop:
    """A stop that a drone has completed."""

    drone: int
    """Id of the drone."""
    t: float
    """Seconds at which it was complete."""
    label: str
    """Name of the stop.

    "+3" is the pickup of task 3, "−3" its delivery, "3" task 3. "(2)" is the second stop of a
    drone with a result that does not name its stops.
    """


@dataclass(frozen=True)
class FlightActivity:
    """Activity of all drones, each in order of time.

    Times are as exact as the statuses are frequent: four a second.
    """

    spans: tuple[Span, ...]
    """Phases of flight."""
    stops: tuple[CompletedStop, ...]
    """Completed stops."""

    @property
    def drones(self) -> list[int]:
        """The drones with at least one status."""
        return sorted({span.drone for span in self.spans})

    @property
    def flown(self) -> bool:
        """True if at least one drone left the ground."""
        return any(span.phase != ON_GROUND for span in self.spans)

    def write(self, path: Path) -> None:
        """Write a CSV file, one row a span, with the stops that were completed in it."""
        rows = ["drone,begin_s,end_s,phase,task,stops"]
        for span in self.spans:
            done = " ".join(
                s.label
                for s in self.stops
                if s.drone == span.drone and span.begin <= s.t < span.end
            )
            words = (span.phase, span.task, done.replace(STOP_SIGNS["delivery"], "-"))
            texts = ",".join('"' + word.replace('"', '""') + '"' for word in words)
            rows.append(f"{span.drone},{span.begin:.3f},{span.end:.3f},{texts}")
        path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def read_activity(path: Path, began: float) -> FlightActivity:
    """Return the activity of a recorded flight, in s after `began`.

    Raises ConfigError if the file is no recording.
    """
    said: dict[int, list[tuple[float, str, str]]] = {}
    served: dict[int, list[str]] = {}
    for message in read_messages(
        path, (DRONE_TOPICS.status.name, DRONE_TOPICS.result.name)
    ):
        values = message.values()
        drone = message.source.drone
        if message.source.topic == DRONE_TOPICS.result.name:
            served[drone] = _labels(json.loads(values["json"]))
        else:
            t = message.came_ns / NS_PER_SECOND - began
            said.setdefault(drone, []).append((t, values["phase"], values["task"]))
    spans = tuple(
        span for drone, rows in sorted(said.items()) for span in _spans(drone, rows)
    )
    stops = tuple(
        s for drone in sorted(said) for s in _stops(drone, spans, served.get(drone, []))
    )
    return FlightActivity(spans, stops)


def _spans(drone: int, rows: list[tuple[float, str, str]]) -> list[Span]:
    """Return the spans of rows (t s, phase, task) in order of time.

    Equal rows in sequence become one span.
    """
    begins = [k for k, row in enumerate(rows) if k == 0 or row[1:] != rows[k - 1][1:]]
    ends = [*begins[1:], len(rows) - 1]
    return [
        Span(drone, rows[a][0], rows[b][0], *rows[a][1:])
        for a, b in zip(begins, ends, strict=True)
    ]


def _stops(
    drone: int, spans: tuple[Span, ...], served: list[str]
) -> list[CompletedStop]:
    """Return the stops of a drone: one wherever its count rises."""
    found: list[CompletedStop] = []
    for span in spans:
        if span.drone != drone:
            continue
        count = STOP_COUNT_PATTERN.search(span.task)
        while count is not None and len(found) < int(count[1]):
            k = len(found)
            found.append(
                CompletedStop(
                    drone, span.begin, served[k] if k < len(served) else f"({k + 1})"
                )
            )
    return found


def _labels(result: Any) -> list[str]:
    """Return the labels of the stops in a drone's result; empty if it has none.

    The result lists pickups and deliveries, or (task, ...) each. A user's mission may use the same
    names for something else.
    """
    try:
        served = [
            f"{STOP_SIGNS.get(stop['kind'], '')}{stop['task']}"
            for stop in result.get("served", ())
        ]
        return served or [str(task) for task, *_ in result.get("done", ())]
    except (AttributeError, TypeError, KeyError, ValueError):
        return []
