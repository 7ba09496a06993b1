"""Outlines of SVG shapes as polylines in units of the picture."""

import math

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.svg_document import SvgElement
from crazychoir.planning.drawing.svg_path import (
    PATH_GRAMMAR,
    PathDataError,
    PathSizeError,
    Places,
    parse_path_data,
)
from crazychoir.planning.drawing.svg_report import SvgReport
from crazychoir.planning.drawing.svg_scene import ElementScene
from crazychoir.planning.drawing.svg_shapes import build_path_data
from crazychoir.types import Mat

CURVE_TOLERANCE = 0.002
"""Distance in m between a curve and the straight lines that are flown."""
MOST_POINTS = 100_000
"""Largest number of places of a picture."""


class ShapeOutlines:
    """Turns shapes into polylines, fine enough for the scale of the flight.

    scale: m a unit of the picture
    report: builds the errors
    """

    def __init__(self, scale: float, report: SvgReport) -> None:
        self._scale = scale
        self._report = report

    def draw(self, element: SvgElement, scene: ElementScene) -> list[Mat]:
        """Return the strokes of a shape in units of the picture."""
        tolerance = CURVE_TOLERANCE / (self._scale * _compute_widening(scene.matrix))
        try:
            found = parse_path_data(
                build_path_data(element, scene.viewport), tolerance, MOST_POINTS
            )
        except PathSizeError as error:
            raise self.build_size_error(element) from error
        except PathDataError as error:
            raise self._report.build_refusal(
                element, f"with {error}", allowed=PATH_GRAMMAR.allowed
            ) from error
        return [self._placed(element, stroke, scene) for stroke in found]

    def _placed(self, element: SvgElement, stroke: Places, scene: ElementScene) -> Mat:
        """Return a stroke in units of the picture; raise ConfigError if it is not finite."""
        places = np.array(stroke)
        if np.isfinite(places).all():
            places = scene.placed(places)
        if not np.isfinite(places).all():
            raise self._report.build_refusal(element, "with places that are not finite")
        return places

    def build_size_error(self, element: SvgElement) -> ConfigError:
        """Return the error for too many places."""
        found = f"more than {MOST_POINTS} places up to {element.label}"
        return ConfigError(
            self._report.where,
            found,
            f"at most {MOST_POINTS} places",
            "Simplify the drawing.",
        )


def _compute_widening(matrix: Mat) -> float:
    """Return the largest factor by which a transform stretches a length.

    It is the largest singular value.
    """
    (a, b), (c, d) = matrix[:2, :2].tolist()
    return 0.5 * (math.hypot(a + d, b - c) + math.hypot(a - d, b + c))
