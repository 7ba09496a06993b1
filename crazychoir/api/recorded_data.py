"""All that a recording of a flight holds: positions, activity, messages, figures and pictures."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.agent.mission_result import MISSION_REASONS
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import ConfigError, reason_or
from crazychoir.launch.flight import FIGURES_KEY
from crazychoir.recording.analysis.activity import FlightActivity, read_activity
from crazychoir.recording.analysis.communication import TeamMessages, read_team_messages
from crazychoir.recording.analysis.figures import (
    FLIGHT_TOPICS,
    RecordedFlight,
    recorded_flight,
)
from crazychoir.recording.analysis.log_plots import (
    LoggedVariables,
    log_pictures,
    read_logged_variables,
)
from crazychoir.recording.analysis.plots import Pictures, Reasons, flight_pictures
from crazychoir.recording.analysis.team_plots import team_pictures
from crazychoir.recording.mcap.reading import EXPECTED_RECORDING, Recording, read
from crazychoir.recording.mcap.records import RECORDING_HINT
from crazychoir.recording.mcap.sequence import read_messages

DATA_TOPICS = (*FLIGHT_TOPICS, DRONE_TOPICS.status.name, DRONE_TOPICS.result.name)
"""Topics with at least one message in a recording of a flight."""
FORMATION_FIGURES = ("formation_error_m", "settling_s")
"""Figures of a mission with a goal, which a recording of its run has."""
NO_RECORDED_RESULT = "no result in the recording"
"""Reason of a drone that has no recorded result."""


@dataclass(frozen=True)
class RecordedData:
    """All that a recording of a flight holds."""

    recording: Recording
    """The file."""
    flight: RecordedFlight
    """Positions and references of the drones."""
    work: FlightActivity
    """Phases of flight, and completed stops."""
    talk: TeamMessages
    """Messages between the drones."""
    logged: LoggedVariables
    """Log variables of the drones; empty if they told none."""

    def figures(self) -> dict[str, Any]:
        """Return the figures of the recorded positions, and the recorded ones of the formation."""
        began, ended = self.recording.seconds
        recorded = json.loads(self.recording.outcome.get(FIGURES_KEY, "{}"))
        formation = {
            name: recorded[name] for name in FORMATION_FIGURES if name in recorded
        }
        return {"seconds": float(ended - began), **self.flight.figures(), **formation}

    def run_figures(self) -> dict[str, Any]:
        """Return the figures of the run; dictionaries of drones have their ids as keys.

        `fly` and `crazychoir run` record them, without times of the wall clock. For another recording
        they are computed from the results and positions of the drones.
        """
        recorded = self.recording.outcome.get(FIGURES_KEY)
        if recorded is not None:
            figures: dict[str, Any] = restore_ids(json.loads(recorded))
            return figures
        about = self.recording.about
        ids = [int(i) for i in about["drones"].split(",")]
        positions = self.figures()
        results = _read_results(self.recording.path)
        reasons = {i: _find_reason(results.get(i)) for i in ids}
        return {
            "mission": about["mission"] or None,
            "success": not any(reasons.values()),
            "drones": len(ids),
            "seed": int(about["seed"]),
            "simulated_s": positions["seconds"],
            "min_separation_m": positions["min_separation_m"],
            "digest": self.recording.outcome.get("digest"),
            "reason": None,
            "reasons": {i: text for i, text in reasons.items() if text},
            "flown_m": {i: own["flown_m"] for i, own in positions["drones"].items()},
            "results": results,
        }

    def pictures(self) -> tuple[Pictures, Reasons]:
        """Return the pictures that can be drawn, and for each other picture the reason.

        Raises ConfigError if nothing can be drawn.
        """
        pictures, missing = flight_pictures(self.flight)
        more, without = team_pictures(self.flight, self.work, self.talk)
        pictures = pictures | more | log_pictures(self.logged)
        missing = missing | without
        if not pictures:
            raise ConfigError(
                str(self.recording.path),
                "; ".join(dict.fromkeys(missing.values())),
                EXPECTED_RECORDING,
                RECORDING_HINT,
            )
        return pictures, missing

    def tables(self) -> dict[str, Callable[[Path], None]]:
        """Return for each table (CSV) the function that writes it, by the name of the table."""
        tables: dict[str, Callable[[Path], None]] = {
            f"drone{track.drone}": track.write for track in self.flight.tracks
        }
        if np.isfinite(self.flight.separation).any():
            tables["separation"] = self.flight.write_separation
        if self.logged.rows:
            tables["logs"] = self.logged.write
        return tables | {
            "tasks": self.work.write,
            "messages": self.talk.write,
            "rounds": self.talk.write_rounds,
            "convergence": self.talk.write_history,
        }


def restore_ids(value: Any) -> Any:
    """Return a value of JSON with numbers for the keys that are numbers, as drone ids are."""
    if isinstance(value, dict):
        return {
            int(key) if isinstance(key, str) and key.isdecimal() else key: restore_ids(
                item
            )
            for key, item in value.items()
        }
    if isinstance(value, list):
        return [restore_ids(item) for item in value]
    return value


def _read_results(path: Path) -> dict[int, dict[str, Any]]:
    """Return the last recorded result of each drone."""
    results: dict[int, dict[str, Any]] = {}
    for message in read_messages(path, (DRONE_TOPICS.result.name,)):
        results[message.source.drone] = restore_ids(
            json.loads(message.values()["json"])
        )
    return dict(sorted(results.items()))


def _find_reason(result: dict[str, Any] | None) -> str:
    """Return why a drone with this result has failed; empty if it has not."""
    if result is None:
        return NO_RECORDED_RESULT
    if result.get("success"):
        return ""
    return str(reason_or(result.get("reason"), MISSION_REASONS.unsaid))


def read_data(path: Path) -> RecordedData:
    """Read a recording of a flight.

    Raises ConfigError if the file is no recording of a flight.
    """
    recording = read(path, DATA_TOPICS)
    flight = recorded_flight(recording)
    began, _ = recording.seconds
    work = read_activity(path, began)
    talk = read_team_messages(path, began)
    logged = read_logged_variables(path, began)
    return RecordedData(recording, flight, work, talk, logged)
