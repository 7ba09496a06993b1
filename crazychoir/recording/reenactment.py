"""A recorded flight in front of MuJoCo's camera: its drones, in its scene, at their places."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.platforms import find_platform
from crazychoir.recording.analysis.figures import (
    RecordedFlight,
    RecordedTrack,
    interpolate_track,
)
from crazychoir.recording.analysis.plots import colour_scale
from crazychoir.recording.video import Image
from crazychoir.simulation.mujoco.film import Film
from crazychoir.simulation.mujoco.model import compile_model
from crazychoir.simulation.mujoco.shape import (
    Colour,
    make_crazyflie_shape,
    read_shape,
    scale_shape,
)
from crazychoir.types import Mat, Vec

TRAIL_POINTS = 25
"""Points of a trail."""


class Reenactment:
    """Places and shapes of the drones of a flight.

    flight: the recorded flight
    config: its swarm file
    scene: an MJCF file that replaces the swarm file's
    enlarge: factor of the drones' size, to see them in a wide room
    trail: s: length of the trail behind each drone
    """

    def __init__(
        self,
        flight: RecordedFlight,
        config: SwarmConfig,
        scene: Path | None = None,
        enlarge: float = 1.0,
        trail: float = 2.0,
    ) -> None:
        self.tracks = flight.tracks
        self.trail = trail
        self.times = flight.times
        self.ids = tuple(track.drone for track in self.tracks)
        self.colours = _drone_colours(len(self.ids))
        rows = [find_platform(config.drone(i).platform) for i in self.ids]
        given = config.mujoco.model
        user = (
            read_shape(Path(given), config.mujoco.body, config.mujoco.scale)
            if given
            else None
        )
        drawn = [
            user or make_crazyflie_shape(row, colour)
            for row, colour in zip(rows, self.colours, strict=True)
        ]
        drawn = (
            [scale_shape(shape, enlarge) for shape in drawn]
            if enlarge != 1.0
            else drawn
        )
        self._stands = np.array([-shape.lowest for shape in drawn])
        room = scene or (Path(config.mujoco.scene) if config.mujoco.scene else None)
        self.model = compile_model(self.ids, rows, drawn, room)

    def film(self, width: int, height: int, camera: str = "") -> Film:
        """Return the camera.

        Raises ConfigError if there is no such camera or the size is wrong.
        """
        places = np.vstack([track.p for track in self.tracks])
        return Film(
            self.model,
            self.ids,
            width,
            height,
            places.min(axis=0),
            places.max(axis=0),
            camera,
        )

    def picture(self, film: Film, t: float) -> Image:
        """Return the picture t s after the beginning of the recording."""
        moment = np.array([t])
        p = np.array(
            [interpolate_track(track.t, track.p, moment)[0] for track in self.tracks]
        )
        q = np.array(
            [_interpolate_attitudes(track, moment)[0] for track in self.tracks]
        )
        p[:, 2] += self._stands
        return film.picture(p, q, tuple(self._trails(t)), self.colours)

    def pictures(self, film: Film, times: Vec) -> Iterator[Image]:
        """Yield one picture a time."""
        return (self.picture(film, float(t)) for t in times)

    def _trails(self, t: float) -> Iterator[Mat]:
        for track, stand in zip(self.tracks, self._stands, strict=True):
            since = (
                np.linspace(t - self.trail, t, TRAIL_POINTS)
                if self.trail > 0.0
                else np.zeros(0)
            )
            yield interpolate_track(track.t, track.p, since) + np.array(
                [0.0, 0.0, stand]
            )


def _interpolate_attitudes(track: RecordedTrack, at: Vec) -> Mat:
    """Return attitudes at times `at`, interpolated between recorded attitudes close together."""
    q = interpolate_track(track.t, track.q, at)
    unit: Mat = q / np.linalg.norm(q, axis=1, keepdims=True)
    return unit


def _drone_colours(n: int) -> tuple[Colour, ...]:
    """Return the colours of the plots: distinct colours for few drones, a scale for many."""
    from matplotlib.colors import to_rgba

    return tuple(
        to_rgba(one)
        for one in (
            PICTURE_STYLE.colours[:n]
            if n <= len(PICTURE_STYLE.colours)
            else colour_scale(n)
        )
    )
