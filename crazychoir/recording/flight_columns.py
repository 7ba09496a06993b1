"""The columns of one drone in a recording, for a calibration: pose, set-point and log variables."""

from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.decode import MessageDecoder
from crazychoir.recording.mcap.reading import read_header
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.simulation.identification.calibration.columns import (
    FIRMWARE_LOGS,
    gather_arrays,
    make_continuous,
    regularise,
)
from crazychoir.types import FullState, Mat, Vec

COLUMN_TOPICS = (
    DRONE_TOPICS.pose.name,
    DRONE_TOPICS.reference.name,
    DRONE_TOPICS.telemetry.name,
)
"""Topics that are read."""
FEWEST_VALUES = 2
"""Least number of values of a topic that can be interpolated."""


def read_flight_columns(path: Path, drone: int | str | None = None) -> dict[str, Mat]:
    """Return the columns of `calibration.columns` for one drone of a recording, a row each 10 ms.

    drone: its id, or its name in the recorded swarm; None for the only drone with log variables
    Raises ConfigError if the recording has no such drone, or lacks poses or log variables.
    """
    rows = _gather(path)
    told = [i for i, name in rows if name == DRONE_TOPICS.telemetry.name]
    if drone is None and len(told) > 1:
        raise ConfigError(
            str(path), f"log variables of drones {told}", "one drone", "Use --drone."
        )
    i = told[0] if drone is None and told else _find_id(path, drone)
    poses, references, logs = (rows.get((i, name), []) for name in COLUMN_TOPICS)
    if len(logs) < FEWEST_VALUES or len(poses) < FEWEST_VALUES:
        missing = "log variables" if len(logs) < FEWEST_VALUES else "poses"
        which = "any drone" if i is None else f"drone {i}"
        raise ConfigError(
            str(path),
            f"no {missing} of {which}",
            "poses from cameras, and the motors, gyroscope and battery",
            "A mission records them if its guidance calls self.log"
            f"({', '.join(map(repr, FIRMWARE_LOGS))}, period=0.01) at its start.",
        )
    return regularise(_join(logs, poses, references), str(path))


def _find_id(path: Path, drone: int | str | None) -> int | None:
    """Return the id of a drone with this id or name in the recorded swarm."""
    if not isinstance(drone, str):
        return drone
    config = SwarmConfig.loads(read_header(path).swarm, f"{path}: swarm.json")
    return config.find_drones([drone], "--drone")[0]


def _gather(path: Path) -> dict[tuple[int | None, str], list[tuple[float, Any]]]:
    """Return the times of birth in s and the values of each drone and topic."""
    values = MessageDecoder(path)
    rows: dict[tuple[int | None, str], list[tuple[float, Any]]] = {}
    for message in read_messages(path, COLUMN_TOPICS):
        key = (message.source.drone, message.source.topic)
        born = message.born_ns / NS_PER_SECOND
        rows.setdefault(key, []).append((born, values.of(message)))
    return rows


def _join(
    logs: list[tuple[float, Any]],
    poses: list[tuple[float, Any]],
    references: list[tuple[float, Any]],
) -> dict[str, Mat]:
    """Return all arrays at the times of the log variables."""
    names = [name for name in FIRMWARE_LOGS if any(name in said for _, said in logs)]
    whole = [(t, said) for t, said in logs if all(name in said for name in names)]
    t = (
        np.array([born - said[names[0]][1] for born, said in whole])
        if names
        else np.zeros(0)
    )
    kept = _find_growing(t)
    named: dict[str, Vec] = {
        name: np.array([said[name][0] for _, said in whole])[kept] for name in names
    }
    t = t[kept]
    arrays = gather_arrays({"t": t, **named})
    pose_times = np.array([born for born, _ in poses])
    flat = np.array([pose.flat for _, pose in poses])
    grown = _find_growing(pose_times)
    arrays["p"] = _interpolate(t, pose_times[grown], flat[grown, 0:3])
    arrays["q"] = _interpolate(t, pose_times[grown], make_continuous(flat[grown, 3:7]))
    places = [(born, r.flat[0:3]) for born, r in references if isinstance(r, FullState)]
    if len(places) >= FEWEST_VALUES:
        times = np.array([born for born, _ in places])
        arrays["sp"] = _interpolate(t, times, np.array([p for _, p in places]))
    steps = np.diff(pose_times[grown])
    arrays["gap"] = np.interp(t, pose_times[grown][1:], steps)
    return arrays


def _find_growing(t: Vec) -> Any:
    """Return which times (n,) are later than all before."""
    latest = np.concatenate([[-np.inf], np.maximum.accumulate(t)[:-1]])
    return t > latest if len(t) else np.zeros(0, bool)


def _interpolate(t: Vec, times: Vec, columns: Mat) -> Mat:
    return np.column_stack([np.interp(t, times, column) for column in columns.T])
