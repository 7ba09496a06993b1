"""The visible strokes of an SVG document."""

import numpy as np

from crazychoir.planning.drawing.svg_clip import ClipOutline
from crazychoir.planning.drawing.svg_document import SvgElement
from crazychoir.planning.drawing.svg_outline import MOST_POINTS, ShapeOutlines
from crazychoir.planning.drawing.svg_report import SVG_ADVICE, SvgReport
from crazychoir.planning.drawing.svg_scene import ElementScene
from crazychoir.planning.drawing.svg_shapes import SvgPage
from crazychoir.planning.drawing.svg_style import (
    STYLE_PROPERTIES,
    has_dots,
    is_painted,
    is_visible,
)
from crazychoir.types import Mat


class VisibleStrokes:
    """Collects the strokes of the shapes that are seen.

    outlines: draws the shapes
    page: page of the document; None if it declares none
    report: takes the remarks on shapes that are left out, and builds the errors
    strokes: (k, 2) rows each, in units of the picture
    """

    def __init__(
        self, outlines: ShapeOutlines, page: SvgPage | None, report: SvgReport
    ) -> None:
        self.strokes: list[Mat] = []
        self._outlines = outlines
        self._page = page
        self._report = report
        self._points = 0

    def add_shape(
        self, element: SvgElement, style: dict[str, str], scene: ElementScene
    ) -> None:
        """Add the strokes of a shape if it is visible."""
        if not is_visible(scene.inherited):
            self._report.leave_out(
                element, f"visibility: {scene.inherited['visibility']}"
            )
            return
        if not is_painted(element.name, scene.inherited):
            self._report.leave_out(element, "neither fill nor stroke")
            return
        strokes = [
            stroke
            for stroke in self._outlines.draw(element, scene)
            if has_dots(scene.inherited) or np.ptp(stroke, axis=0).any()
        ]
        if not strokes:
            self._report.leave_out(element, "it has no size")
            return
        self._points += sum(map(len, strokes))
        if self._points > MOST_POINTS:
            raise self._outlines.build_size_error(element)
        if any(style.get(name, "none") != "none" for name in STYLE_PROPERTIES.markers):
            self._report.note(f"{element.label}: flown without its markers")
        self._note_page(element, strokes)
        for stroke in strokes:
            if self._is_inside(element, stroke, scene.clips):
                self.strokes.append(stroke)

    def _is_inside(
        self, element: SvgElement, stroke: Mat, clips: tuple[ClipOutline, ...]
    ) -> bool:
        """Return whether a stroke is seen; raise ConfigError if a part of it may be seen."""
        for clip in clips:
            passed = clip.sides_passed(stroke)
            if passed.all():
                continue
            if not passed.any(axis=1).all():
                self._report.leave_out(element, f"it is outside of {clip.owner}")
                return False
            raise self._report.build_refusal(
                element, f"{clip.owner} cuts off a part of it", SVG_ADVICE.release
            )
        return True

    def _note_page(self, element: SvgElement, strokes: list[Mat]) -> None:
        """Remark that a shape is beside the page: editors show it, browsers do not."""
        if self._page is None:
            return
        places = np.concatenate(strokes)
        corner = np.array(self._page.corner)
        if (places.max(axis=0) < corner).any() or (
            places.min(axis=0) > corner + self._page.size
        ).any():
            self._report.note(f"{element.label}: flown, though it is beside the page")
