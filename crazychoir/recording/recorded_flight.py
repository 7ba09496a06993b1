"""A flight of a drone in a recording of --record, to compare the simulator with."""

from pathlib import Path

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.recording.flight_columns import read_flight_columns
from crazychoir.simulation.identification.calibration.flight import find_delay
from crazychoir.simulation.identification.calibration.telemetry import find_interpolated
from crazychoir.simulation.identification.flights import (
    FLIGHT_RULES,
    FLIGHT_TIME_STEP,
    RealFlight,
    find_airborne_rows,
    make_real_flight,
    read_flight,
)

RECORDING_SUFFIX = ".mcap"
"""Suffix of the recordings of `--record`."""
SWARM_SUFFIX = ".toml"
"""Suffix of swarm files, which users take for flights."""
LOST_GAP = 1.0
"""s: gap of rows that were interpolated over lost packets; longer than each that counts as known."""
NO_CLOSED_LOOP = "no set-points that its firmware followed by itself: no closed loop"
"""Note of a flight that was controlled from outside."""


def read_any_flight(path: Path, drone: int | str | None = None) -> RealFlight:
    """Read a flight, from a recording of --record or from a file of arrays.

    drone: its id or name in a recording of several; None for the only drone with log variables
    Raises ConfigError if it is no flight, lacks a column, or is too short.
    """
    if path.suffix == SWARM_SUFFIX:
        do = f"crazychoir doctor --swarm {path} checks a swarm file."
        raise ConfigError(str(path), "a swarm file", "a recorded flight", do)
    if path.suffix == RECORDING_SUFFIX:
        return read_recorded_flight(path, drone)
    return read_flight(path)


def read_recorded_flight(path: Path, drone: int | str | None = None) -> RealFlight:
    """Read the flight of one drone from a recording of --record.

    The drone's clock is aligned with that of the poses. The references of our controllers are no set-points of the
    firmware, so they are left out.

    drone: its id or name; None for the only drone with log variables
    Raises ConfigError as `read_flight_columns`, or if the drone does not fly long enough.
    """
    columns = read_flight_columns(path, drone)
    columns.pop("sp", None)
    notes = [NO_CLOSED_LOOP]
    is_lost = find_interpolated(columns["gyro"])
    gap = columns.get("gap", np.full(len(is_lost), FLIGHT_TIME_STEP))
    columns["gap"] = np.where(is_lost, np.maximum(gap, LOST_GAP), gap)
    height = columns["p"][:, 2] - columns["p"][0, 2]
    airborne = find_airborne_rows(path.stem, height)
    is_known = columns["gap"] <= FLIGHT_RULES.longest_gap
    columns["delay"] = find_delay(columns, is_known, airborne, notes)
    return make_real_flight(path.stem, columns, notes)
