"""What the drones of a recorded flight were doing, and when: phases of flight, and the stops that they came to."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.bus.topics import RESULT, STATUS
from crazychoir.recording.mcap.sequence import told
from crazychoir.runtime.clock import SECOND

COUNT = re.compile(r"(\d+)(?:/\d+)? (?:stops|done)")
"""How far a drone is, in what it says of its task: "1/4 stops", "3 stops done", "2 done, task 9"."""
SIGNS = {"pickup": "+", "delivery": "\N{MINUS SIGN}"}
ON_GROUND = "on ground"


@dataclass(frozen=True)
class Span:
    """From `begin` to `end` s a drone was in a phase of flight, and said so of its task."""

    drone: int
    begin: float
    end: float
    phase: str
    task: str


@dataclass(frozen=True)
class Stop:
    """At t s a drone was done with a stop: "+3" the pickup of task 3, "−3" its delivery, "3" task 3;
    "(2)" its second one, where its result does not say which.
    """

    drone: int
    t: float
    label: str


@dataclass(frozen=True)
class Work:
    """Of all drones, each in order of time; as exact as the statuses come, four a second."""

    spans: tuple[Span, ...]
    stops: tuple[Stop, ...]

    @property
    def drones(self) -> list[int]:
        """Those that have said anything."""
        return sorted({span.drone for span in self.spans})

    @property
    def flown(self) -> bool:
        """Whether anybody left the ground."""
        return any(span.phase != ON_GROUND for span in self.spans)

    def write(self, path: Path) -> None:
        """A CSV file, a row a span, with the stops that were done in it."""
        rows = ["drone,begin_s,end_s,phase,task,stops"]
        for span in self.spans:
            done = " ".join(
                s.label
                for s in self.stops
                if s.drone == span.drone and span.begin <= s.t < span.end
            )
            words = (span.phase, span.task, done.replace(SIGNS["delivery"], "-"))
            texts = ",".join('"' + word.replace('"', '""') + '"' for word in words)
            rows.append(f"{span.drone},{span.begin:.3f},{span.end:.3f},{texts}")
        path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def work_of(path: Path, began: float) -> Work:
    """The work of a recorded flight, in s after `began`; raises ConfigError for what is no recording."""
    said: dict[int, list[tuple[float, str, str]]] = {}
    served: dict[int, list[str]] = {}
    for message in told(path, (STATUS.name, RESULT.name)):
        values = message.values()
        drone = message.source.drone
        if message.source.topic == RESULT.name:
            served[drone] = _labels(json.loads(values["json"]))
        else:
            t = message.came_ns / SECOND - began
            said.setdefault(drone, []).append((t, values["phase"], values["task"]))
    spans = tuple(
        span for drone, rows in sorted(said.items()) for span in _spans(drone, rows)
    )
    stops = tuple(
        s for drone in sorted(said) for s in _stops(drone, spans, served.get(drone, []))
    )
    return Work(spans, stops)


def _spans(drone: int, rows: list[tuple[float, str, str]]) -> list[Span]:
    """Rows (t s, phase, task) in order of time, those that say the same joined."""
    begins = [k for k, row in enumerate(rows) if k == 0 or row[1:] != rows[k - 1][1:]]
    ends = [*begins[1:], len(rows) - 1]
    return [
        Span(drone, rows[a][0], rows[b][0], *rows[a][1:])
        for a, b in zip(begins, ends, strict=True)
    ]


def _stops(drone: int, spans: tuple[Span, ...], served: list[str]) -> list[Stop]:
    """A stop wherever the count of a drone rises."""
    found: list[Stop] = []
    for span in spans:
        if span.drone != drone:
            continue
        count = COUNT.search(span.task)
        while count is not None and len(found) < int(count[1]):
            k = len(found)
            found.append(
                Stop(drone, span.begin, served[k] if k < len(served) else f"({k + 1})")
            )
    return found


def _labels(result: Any) -> list[str]:
    """Of the stops of a drone's result, if it has any: of pickups and deliveries, or (task, ...) each.

    A mission of the user may say something else by the same names.
    """
    try:
        served = [
            f"{SIGNS.get(stop['kind'], '')}{stop['task']}"
            for stop in result.get("served", ())
        ]
        return served or [str(task) for task, *_ in result.get("done", ())]
    except (AttributeError, TypeError, KeyError, ValueError):
        return []
