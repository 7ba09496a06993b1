"""A world of drones that follow recordings and obey no commands.

uri = "replay://flight.mcap" takes the drone with the same id from a recording of a flight;
"replay://flight.mcap?drone=3" takes drone 3. uri = "replay://intruder.csv" takes samples
t, x, y, z, yaw, ... as in planning/trajectory_file.py.
"""

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.checks import WORLD_URIS
from crazychoir.errors import ConfigError
from crazychoir.planning.trajectory_file import read_samples
from crazychoir.recording.mcap.odometry import rotate_to_world
from crazychoir.recording.mcap.reading import read
from crazychoir.simulation.common.truth import Truth
from crazychoir.simulation.common.world import (
    COMMAND_TYPES,
    DroneLink,
    WorldSetup,
    make_unsupported_kind_error,
)
from crazychoir.types import Command, Mat, Vec

LARGEST_HOME_OFFSET = 0.1
"""Largest distance in m from a drone's home to the place where its recording begins."""


def engine(setup: WorldSetup) -> "ReplayWorld":
    """Make the world of these drones.

    Raises ConfigError for a file that cannot be read, or a recording that does not begin at home.
    """
    tables = []
    for i, uri, home in zip(setup.ids, setup.uris, setup.homes, strict=True):
        tables.append(replayed_states(uri, i, setup.dt))
        start = tables[-1][0, 0:3]
        if np.linalg.norm(start - home) > LARGEST_HOME_OFFSET:
            do = f"Set home = {np.round(start, 3).tolist()}."
            raise ConfigError(
                f"drone {i}: home",
                list(home),
                f"at most {LARGEST_HOME_OFFSET} m from where {uri} begins",
                do,
            )
    return ReplayWorld(setup, tables)


def replayed_states(uri: str, drone: int, dt: float) -> Mat:
    """Return the states (K, 13), rows as State.flat, every dt s from the beginning of a recording.

    Raises ConfigError for a wrong uri or a file that cannot be read.
    """
    name, _, number = uri.removeprefix(WORLD_URIS.replay).partition("?drone=")
    if number and not number.isdecimal():
        raise ConfigError(
            f"drone {drone}: uri",
            uri,
            f"{WORLD_URIS.replay}FILE, or {WORLD_URIS.replay}FILE?drone=NUMBER",
        )
    path = Path(name)
    if path.suffix.lower() == ".csv":
        return _states_of_samples(path, dt)
    if path.suffix == ".mcap":
        return _states_of_flight(path, int(number) if number else drone, dt)
    raise ConfigError(
        f"drone {drone}: uri",
        uri,
        "a recording of a flight, .mcap, or a table of samples, .csv",
    )


def _states_of_samples(path: Path, dt: float) -> Mat:
    """Return level states with the positions and yaw of the table."""
    flight = read_samples(path, is_recording=True)
    flat = flight.samples(
        np.append(np.arange(0.0, flight.duration, dt), flight.duration)
    )
    half = 0.5 * flat[:, 12:13]
    level = np.zeros((len(flat), 2))
    rates = np.column_stack([level, flat[:, 13]])
    return np.hstack([flat[:, 0:6], level, np.sin(half), np.cos(half), rates])


def _states_of_flight(path: Path, drone: int, dt: float) -> Mat:
    """Return the recorded true states of one drone from the beginning of the recording.

    Positions are interpolated by Hermite polynomials, attitudes by chords.
    """
    recording = read(path, (DRONE_TOPICS.truth.name,))
    found = recording.of(drone, DRONE_TOPICS.truth.name)
    if len(found) < 2:
        do = f"Add ?drone= one of {recording.drones}."
        raise ConfigError(
            f"{path}: truth of drone {drone}",
            "nothing",
            "a recording of that drone",
            do,
        )
    t, first = np.unique(found.born - recording.seconds[0], return_index=True)
    if len(t) < 2 or t[-1] <= 0.0:
        where = f"{path}: truth of drone {drone}"
        raise ConfigError(
            where,
            f"{len(found)} states of one time",
            "states of a drone over some time",
        )
    x = found.numbers[first]
    q = _align_signs(x[:, 3:7])
    at = np.arange(0.0, t[-1], dt)
    inside = np.maximum(at, t[0])  # before its first true state the drone stands there
    curve = CubicHermiteSpline(t, x[:, 0:3], rotate_to_world(q, x[:, 7:10]))
    turned = _interpolate_columns(inside, t, q)
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    return np.hstack(
        [
            curve(inside),
            curve(inside, 1),
            turned,
            _interpolate_columns(inside, t, x[:, 10:13]),
        ]
    )


def _align_signs(q: Mat) -> Mat:
    """Return the attitudes with each sign chosen such that a quaternion is close to the previous.

    q and -q are the same attitude.
    """
    signs = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    found: Mat = q * np.concatenate([[1.0], signs])[:, None]
    return found


def _interpolate_columns(at: Vec, t: Vec, x: Mat) -> Mat:
    return np.column_stack([np.interp(at, t, column) for column in x.T])


class ReplayWorld(Truth):
    """A world of drones that follow tables of states, one row a step, and stay at the last row.

    They always count as standing on the floor, so no agent waits for them to land.

    tables: (rows, 13) states of each drone
    """

    flies: tuple[str, ...] = tuple(COMMAND_TYPES)
    command_timeout: float | None = None

    def __init__(self, setup: WorldSetup, tables: list[Mat]) -> None:
        places = np.array([table[0, 0:3] for table in tables])
        super().__init__(
            setup.ids, places, np.array(setup.yaws), setup.platforms, setup.dt
        )
        self._tables = tables
        self._resting = np.ones(len(tables))
        self._show()

    def step(self) -> None:
        """Advance to the next row."""
        self.tick += 1
        self._show()

    def _show(self) -> None:
        for row, table in enumerate(self._tables):
            self.states[row] = table[min(self.tick, len(table) - 1)]
            if self.tick >= len(table):
                self.states[row, 3:6] = self.states[row, 10:13] = 0.0

    def link(self, i: int, kind: str) -> DroneLink:
        """Return a link that discards all commands.

        Raises ConfigError for an unknown kind of command.
        """
        if kind not in self.flies:
            raise make_unsupported_kind_error(i, kind, self.flies)
        return DeafLink()


class DeafLink:
    """The link of a replayed drone, which obeys no commands."""

    def send(self, command: Command) -> None:
        """Discard the command."""

    def cut(self) -> None:
        """Do nothing."""
