"""What a mission that flies a drawing needs: options, its own swarm, checks, report, picture."""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Height, Scale, SwarmTable, Text
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import Offset, Yaw, given, require_none
from crazychoir.guidance.mission_pictures import draw_plans
from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.path_checks import require_inside
from crazychoir.planning.drawing.drawing import Drawing, Pen, plan_drawing
from crazychoir.planning.drawing.drawing_file import read_drawing
from crazychoir.planning.feasibility import Limits, compute_peaks
from crazychoir.planning.number_table import read_table_text
from crazychoir.planning.piecewise import Piecewise
from crazychoir.planning.placed_trajectory import place_trajectory
from crazychoir.planning.trajectory_file import has_pieces, read_pieces
from crazychoir.types import Mat

DRAWING_TOLERANCE = 0.06
"""m: largest distance between the flown path and the drawn path.

Measured for the word of deploy/casy.toml: 42 mm for a typical drone, 13 mm for a perfect one.
"""
SAMPLE_INTERVAL = 0.02
"""s: time between two places at which the flown path and the drawing are compared."""
LONGEST_SLOWDOWN = 20.0
"""Largest factor on the duration."""
Slowdown = Annotated[
    float,
    Meta(
        ge=1,
        le=LONGEST_SLOWDOWN,
        description="a factor, 1 to 20",
        examples=[2.0],
    ),
]
Timing = Annotated[
    Literal["even", "drawn"], Meta(description='"even" or "drawn"', examples=["drawn"])
]


class DrawingOptions(SwarmTable, frozen=True, kw_only=True):
    """[mission_options]."""

    drawing: Text
    """A CSV file of rows stroke, t, x, y, or of rows duration, x^0 ... yaw^7 (a trajectory), or an SVG
    picture with a unit of 1 mm.
    """
    scale: Scale = 1.0
    """Scale of the drawing."""
    yaw: Yaw = 0.0
    """rad, or "along" the path."""
    timing: Timing = "even"
    """"drawn": as fast as the hand was, where the limits allow (CSV only)."""
    lift: Offset = 0.1
    """m: height of the flight between strokes, above the drawing."""
    height: Height | None = None
    """m above the floor: height of the drawing, or of the start of a trajectory; without it the
    take-off height.
    """
    slower: Slowdown = 1.0
    """Factor on the duration of a trajectory, or on the shortest duration of a drawing."""


class DrawingHooks:
    """The hooks of drones that each fly a drawing, with its centre over their home.

    options: the table of [mission_options].
    """

    def __init__(self, options: type[DrawingOptions]) -> None:
        self.options = options

    def drawing(self, config: SwarmConfig, i: int) -> Drawing:
        """Return the drawing that drone i flies, with its centre over the drone's home.

        A trajectory starts over the home. The jerk of a drawing is limited to what the attitude of the
        drone can follow.
        Raises ConfigError if it cannot be flown.
        """
        options = given(config, self.options)
        flight = config.flight
        home = config.drone(i).home
        height = options.height or flight.takeoff_height
        limits = Limits(
            v_max=flight.speed_limit,
            a_max=flight.acceleration_limit,
            j_max=STANDARD_GAINS.kr[0] * flight.acceleration_limit,
            low=config.fence.min,
            high=config.fence.max,
        )
        if is_trajectory(options.drawing):
            planned = _place_over(
                (home[0], home[1], flight.ground + height), options, limits
            )
            require_inside(planned.path, config, i, "trajectory")
            return planned
        strokes = read_drawing(options.drawing).strokes
        places = np.vstack([stroke[:, -2:] for stroke in strokes])
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        placed = [
            np.column_stack(
                [stroke[:, :-2], home[:2] + options.scale * (stroke[:, -2:] - middle)]
            )
            for stroke in strokes
        ]
        pen = Pen(
            height=flight.ground + height,
            lift=options.lift,
            yaw=options.yaw,
            timing=options.timing,
        )
        planned = _slow_down(plan_drawing(placed, pen, limits), options.slower)
        require_inside(planned.path, config, i, "drawing")
        return planned

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return drones side by side, 1.5 m apart along y, each with room for the word."""
        n = drones or 1
        return SwarmConfig.of(
            {
                "name": "writers",
                "mission": "drawn_path",
                "graph": "ring" if n > 1 else "empty",
                "drones": [{"id": i, "home": [0.0, 1.5 * i, 0.0]} for i in range(n)],
                "fence": {"min": [-3.0, -3.0, 0.0], "max": [3.0, 1.5 * n + 1.5, 3.0]},
            }
        )

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check the options and the drawing.

        Returns how it will be flown, and which parts are ignored.
        Raises ConfigError if the drawing cannot be flown.
        """
        options = given(config, self.options)
        require_none(config)
        flown, *_ = [self._checked(config, i) for i in config.ids]
        return [
            f"the drawing takes {flown.path.duration:.1f} s, at most {flown.speed:.2f} m/s and "
            f"{flown.acceleration:.2f} m/s2, {1e3 * flown.deviation:.1f} mm from what was drawn",
            *(f"{options.drawing}: {word}" for word in _list_remarks(options.drawing)),
        ]

    def _checked(self, config: SwarmConfig, i: int) -> Drawing:
        """Return the drawing of drone i. Raises ConfigError, with the drone, if it cannot be flown."""
        try:
            return self.drawing(config, i)
        except ConfigError as error:
            raise ConfigError(
                f"drone {i}: {error.where}",
                error.found,
                error.allowed,
                error.do,
                error.problem,
            ) from error

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report how the drawing is flown, and compare the flown path with the drawing."""
        flown = self.drawing(config, config.ids[0])
        off = {
            i: self.compute_deviation(config, i, results.get(i, {})) for i in config.ids
        }
        reasons = {
            i: f"{1e3 * far:.0f} mm from its drawing, allowed {1e3 * DRAWING_TOLERANCE:.0f} mm"
            for i, far in off.items()
            if not far <= DRAWING_TOLERANCE
        }
        return {
            "success": not reasons,
            "reasons": reasons,
            "written_mm": {i: 1e3 * far for i, far in off.items()},
            "drawing_s": flown.path.duration,
            "speed_m_s": flown.speed,
            "acceleration_m_s2": flown.acceleration,
            "deviation_mm": 1e3 * flown.deviation,
        }

    def compute_deviation(
        self, config: SwarmConfig, i: int, result: dict[str, Any]
    ) -> float:
        """Return the Hausdorff distance in m between the flown path of drone i and its drawing.

        A small distance means that no place is off, and that no place is left out.
        """
        way = np.array(result.get("way", []))
        wanted = self._places(config, i)
        if len(way) < 2:
            return float("inf")
        t = np.arange(0.0, way[-1, 0], SAMPLE_INTERVAL)
        flown = CubicSpline(way[:, 0], way[:, 1:4])(t)
        aside = cKDTree(wanted).query(flown)[0].max()
        left_out = cKDTree(flown).query(wanted)[0].max()
        return float(max(aside, left_out))

    def _places(self, config: SwarmConfig, i: int) -> Mat:
        """Return places along the drawing of drone i, (n, 3) m."""
        path = self.drawing(config, i).path
        return path.samples(np.arange(0.0, path.duration, SAMPLE_INTERVAL))[:, 0:3]

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the planned path (broad) and the flown path."""
        draw_plans(path, results, {i: self._places(config, i) for i in config.ids})


def is_trajectory(file: str) -> bool:
    """Return whether a file holds the pieces of a trajectory.

    Raises TableError for a CSV file that cannot be read.
    """
    return Path(file).suffix.lower() == ".csv" and has_pieces(read_table_text(file))


def _list_remarks(file: str) -> list[str]:
    """Return the remarks on parts of a file that are not flown."""
    return [] if is_trajectory(file) else read_drawing(file).words


def _place_over(
    start: tuple[float, float, float], options: DrawingOptions, limits: Limits
) -> Drawing:
    """Return the trajectory of the file, scaled, with its start at a place.

    start: (3,) m, world
    Raises ConfigError if it cannot be flown.
    """
    whole = read_pieces(options.drawing)
    coefficients = whole.coefficients.copy()
    coefficients[:, 0:3] *= options.scale
    scaled = Piecewise(coefficients, whole.durations)
    path = place_trajectory(scaled, limits, options.drawing, options.slower)
    path = path.shifted((np.array(start) - path.sample(0.0).p).tolist())
    peaks = compute_peaks(path)
    return Drawing(path, 0.0, peaks["speed"], peaks["acceleration"])


def _slow_down(planned: Drawing, factor: float) -> Drawing:
    """Return the drawing in `factor` times the time."""
    return Drawing(
        planned.path.slowed(factor),
        planned.deviation,
        planned.speed / factor,
        planned.acceleration / factor**2,
    )
