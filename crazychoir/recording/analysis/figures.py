"""Figures of a recorded flight: positions, references, errors, and distances between drones."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.choice import FIRMWARE_GAIN_SENDERS
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.odometry import rotate_to_world
from crazychoir.recording.mcap.reading import RecordedValues, Recording
from crazychoir.types import Mat, Vec

FLIGHT_TOPICS = (
    DRONE_TOPICS.truth.name,
    DRONE_TOPICS.state.name,
    DRONE_TOPICS.reference.name,
)
UNSEEN_DRONES_KEY = "unseen"
"""Key in a recording's `about` with the drones that no cameras see."""
LARGEST_JOINED_GAP = 0.15
"""Seconds between two positions up to which they are joined by a line."""
TRACK_COLUMNS = (
    "t_s",
    "x_m",
    "y_m",
    "z_m",
    "qx",
    "qy",
    "qz",
    "qw",
    "vx_m_s",
    "vy_m_s",
    "vz_m_s",
    "wx_rad_s",
    "wy_rad_s",
    "wz_rad_s",
    "reference_x_m",
    "reference_y_m",
    "reference_z_m",
    "tracking_error_m",
    "estimation_error_m",
)
SEPARATION_COLUMNS = ("t_s", "least_distance_m")


@dataclass(frozen=True)
class RecordedTrack:
    """One drone at the n times t with a known position."""

    drone: int
    """Id of the drone."""
    source: str
    """Topic of its positions: `truth`, or its own `state`.

    It is `state` for a drone that no cameras see, or without recorded truth; then its estimate
    cannot be compared with anything.
    """
    t: Vec
    """(n,) s since the recording began."""
    p: Mat
    """(n, 3) m, world: position."""
    q: Mat
    """(n, 4): attitude."""
    v: Mat
    """(n, 3) m/s, world: velocity."""
    w: Mat
    """(n, 3) rad/s, body: rates."""
    reference: Mat
    """(n, 3) m, world: reference; NaN where there is none."""
    estimate: Mat
    """(n, 3) m, world: estimated position; NaN where there is none."""

    @property
    def tracking(self) -> Vec:
        """(n,) m: distance from its reference."""
        distance: Vec = np.linalg.norm(self.p - self.reference, axis=1)
        return distance

    @property
    def estimation(self) -> Vec:
        """(n,) m: distance from its own estimate."""
        distance: Vec = np.linalg.norm(self.p - self.estimate, axis=1)
        return distance

    def figures(self) -> dict[str, float | str | None]:
        """Return the figures of the track; lengths in m, None where nothing can be compared.

            rmse = sqrt(mean(e^2))

        e: tracking or estimation error at each time of the track with such an error
        """
        return {
            "source": self.source,
            "flown_m": float(np.linalg.norm(np.diff(self.p, axis=0), axis=1).sum()),
            "highest_m": float(self.p[:, 2].max()),
            "fastest_m_s": float(np.linalg.norm(self.v, axis=1).max()),
            "compared_s": float(
                np.sum(
                    np.diff(self.t)[np.isfinite(self.tracking[1:] + self.tracking[:-1])]
                )
            ),
            "tracking_rmse_m": rms(self.tracking),
            "tracking_max_m": _greatest_finite(self.tracking),
            "estimation_rmse_m": rms(self.estimation),
        }

    def table(self) -> Mat:
        """Return TRACK_COLUMNS, one row a time (n, 19); NaN where there is no value."""
        parts = (
            self.t,
            self.p,
            self.q,
            self.v,
            self.w,
            self.reference,
            self.tracking,
            self.estimation,
        )
        return np.column_stack(parts)

    def write(self, path: Path) -> None:
        """Write a CSV file, one row a time; nan where there is no value."""
        np.savetxt(
            path,
            self.table(),
            fmt="%.6f",
            delimiter=",",
            header=",".join(TRACK_COLUMNS),
            comments="",
        )


@dataclass(frozen=True)
class RecordedFlight:
    """All drones with known positions."""

    tracks: tuple[RecordedTrack, ...]
    """One track a drone."""
    times: Vec
    """(m,) s since the recording began."""
    separation: Vec
    """(m,) m: least distance between two drones at these times; NaN where fewer than two are
    known.
    """
    kept_distance: float | None = None
    """m: level distance that the collision filter keeps between two drones; None without a filter."""

    def write_separation(self, path: Path) -> None:
        """Write a CSV file with the least distance of two drones, one row a time."""
        np.savetxt(
            path,
            np.column_stack([self.times, self.separation]),
            fmt="%.6f",
            delimiter=",",
            header=",".join(SEPARATION_COLUMNS),
            comments="",
        )

    def figures(self) -> dict[str, Any]:
        """Return the figures of the flight and of each drone."""
        least = self.separation[np.isfinite(self.separation)]
        return {
            "min_separation_m": float(least.min()) if len(least) else None,
            "drones": {track.drone: track.figures() for track in self.tracks},
        }


def recorded_flight(recording: Recording) -> RecordedFlight:
    """Return the flight of a recording, with the drones that have a recorded truth or state."""
    sources = {i: _position_topic(recording, i) for i in recording.drones}
    tracks = [
        _read_track(recording, i, source) for i, source in sources.items() if source
    ]
    if not tracks:
        return RecordedFlight((), np.zeros(0), np.zeros(0))
    times = np.arange(
        min(track.t[0] for track in tracks),
        max(track.t[-1] for track in tracks),
        1.0 / DRONE_TOPICS.truth.rate,
    )
    places = np.array([interpolate_track(track.t, track.p, times) for track in tracks])
    return RecordedFlight(
        tuple(tracks),
        times,
        np.array([_least_distance(places[:, k]) for k in range(len(times))]),
        _find_kept_distance(recording),
    )


def _find_kept_distance(recording: Recording) -> float | None:
    """Return the distance in m that the recorded drones keep; None if nothing keeps them apart.

        d = 2 s_x + margin          the filter
        d = 2 s_x + margin + slack  drones that agree on paths, if all do

    s_x: first semi-axis of the ellipsoid around each drone
    """
    if not recording.swarm:
        return None
    where = f"{recording.path}: swarm.json"
    try:
        config = SwarmConfig.loads(recording.swarm, where)
    except ConfigError:
        return None  # a swarm of another version
    collision = config.collision
    if collision.method == "off":
        return None
    senders = {config.control_of(i).sender for i in config.ids}
    slack = collision.slack if senders <= {*FIRMWARE_GAIN_SENDERS} else 0.0
    return 2.0 * collision.semi_axes[0] + collision.margin + slack


def interpolate_track(t: Vec, x: Mat, at: Vec) -> Mat:
    """Interpolate x (n, m), known at increasing times t (n,) s, at the times `at` (k,) s: (k, m).

        x(s) = x_a + (s - t_a) / (t_b - t_a) (x_b - x_a),  t_a <= s <= t_b neighbours

    The result is NaN where t_b - t_a > LARGEST_JOINED_GAP, and outside of t.
    """
    if len(t) < 2:
        return np.full((len(at), x.shape[1] if len(t) else 3), np.nan)
    b = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    gap = t[b] - t[b - 1]
    share = (at - t[b - 1]) / gap
    found: Mat = x[b - 1] + share[:, None] * (x[b] - x[b - 1])
    found[(gap > LARGEST_JOINED_GAP) | (share < 0.0) | (share > 1.0)] = np.nan
    return found


def rms(e: Vec) -> float | None:
    """Return the root of the mean square of the finite entries of e; None if there are none."""
    e = e[np.isfinite(e)]
    return float(np.sqrt(np.mean(e**2))) if len(e) else None


def _position_topic(recording: Recording, i: int) -> str:
    """Return the topic with the positions of drone i; empty if there is none.

    The truth of a drone that no cameras see is its own estimate, so it is not used.
    """
    unseen = str(i) in recording.about.get(UNSEEN_DRONES_KEY, "").split(",")
    topics = (
        [DRONE_TOPICS.state.name]
        if unseen
        else [DRONE_TOPICS.truth.name, DRONE_TOPICS.state.name]
    )
    return next((name for name in topics if len(recording.of(i, name)) > 1), "")


def _read_track(recording: Recording, i: int, source: str) -> RecordedTrack:
    began = recording.seconds[0]
    t, x = _sort_by_birth(recording.of(i, source), began)
    p = x[:, 0:3]
    q = x[:, 3:7]
    v_b = x[:, 7:10]
    w = x[:, 10:13]
    reference, estimate = (
        interpolate_track(*_sort_by_birth(recording.of(i, name), began), t)[:, :3]
        for name in (DRONE_TOPICS.reference.name, DRONE_TOPICS.state.name)
    )
    if source == DRONE_TOPICS.state.name:
        estimate = np.full_like(p, np.nan)
    return RecordedTrack(
        i, source, t, p, q, rotate_to_world(q, v_b), w, reference, estimate
    )


def _sort_by_birth(values: RecordedValues, began: float) -> tuple[Vec, Mat]:
    """Return the times of birth in s since `began`, increasing, and the numbers at these times.

    Over a network one message may overtake another.
    """
    t, first = np.unique(values.born - began, return_index=True)
    return t, values.numbers[first]


def _least_distance(places: Mat) -> float:
    """Return the least distance in m between two known positions; NaN if there are not two."""
    known = places[np.isfinite(places[:, 0])]
    return float(pdist(known).min()) if len(known) > 1 else float("nan")


def _greatest_finite(e: Vec) -> float | None:
    e = e[np.isfinite(e)]
    return float(e.max()) if len(e) else None
