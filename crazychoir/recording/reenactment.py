"""A recorded flight in front of MuJoCo's camera: its drones, in its scene, at their places."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.optimization.picture import COLOURS
from crazychoir.platforms import platform
from crazychoir.recording.analysis.figures import Flight, Track, joined
from crazychoir.recording.analysis.plots import scale
from crazychoir.recording.video import Image
from crazychoir.simulation.mujoco.film import Film
from crazychoir.simulation.mujoco.model import model_of
from crazychoir.simulation.mujoco.shape import Colour, crazyflie, scaled, shape_of
from crazychoir.types import Mat, Vec

POINTS = 25
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
        flight: Flight,
        config: SwarmConfig,
        scene: Path | None = None,
        enlarge: float = 1.0,
        trail: float = 2.0,
    ) -> None:
        self.tracks = flight.tracks
        self.trail = trail
        self.times = flight.times
        self.ids = tuple(track.drone for track in self.tracks)
        self.colours = _colours(len(self.ids))
        rows = [platform(config.drone(i).platform) for i in self.ids]
        given = config.mujoco.model
        user = (
            shape_of(Path(given), config.mujoco.body, config.mujoco.scale)
            if given
            else None
        )
        drawn = [
            user or crazyflie(row, colour)
            for row, colour in zip(rows, self.colours, strict=True)
        ]
        drawn = [scaled(shape, enlarge) for shape in drawn] if enlarge != 1.0 else drawn
        self._stands = np.array([-shape.lowest for shape in drawn])
        room = scene or (Path(config.mujoco.scene) if config.mujoco.scene else None)
        self.model = model_of(self.ids, rows, drawn, room)

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
        p = np.array([joined(track.t, track.p, moment)[0] for track in self.tracks])
        q = np.array([_turned(track, moment)[0] for track in self.tracks])
        p[:, 2] += self._stands
        return film.picture(p, q, tuple(self._trails(t)), self.colours)

    def pictures(self, film: Film, times: Vec) -> Iterator[Image]:
        """Yield one picture a time."""
        return (self.picture(film, float(t)) for t in times)

    def _trails(self, t: float) -> Iterator[Mat]:
        for track, stand in zip(self.tracks, self._stands, strict=True):
            since = (
                np.linspace(t - self.trail, t, POINTS)
                if self.trail > 0.0
                else np.zeros(0)
            )
            yield joined(track.t, track.p, since) + np.array([0.0, 0.0, stand])


def _turned(track: Track, at: Vec) -> Mat:
    """Return attitudes at times `at`, interpolated between recorded attitudes close together."""
    q = joined(track.t, track.q, at)
    unit: Mat = q / np.linalg.norm(q, axis=1, keepdims=True)
    return unit


def _colours(n: int) -> tuple[Colour, ...]:
    """Return the colours of the plots: distinct colours for few drones, a scale for many."""
    from matplotlib.colors import to_rgba

    return tuple(
        to_rgba(one) for one in (COLOURS[:n] if n <= len(COLOURS) else scale(n))
    )
