"""The clips that SVG elements refer to."""

from collections.abc import Mapping

from crazychoir.planning.drawing.svg_clip import ClipOutline, find_convex_corners
from crazychoir.planning.drawing.svg_document import SvgElement, shorten_text
from crazychoir.planning.drawing.svg_outline import ShapeOutlines
from crazychoir.planning.drawing.svg_report import SVG_ADVICE, SvgReport
from crazychoir.planning.drawing.svg_scene import ELEMENT_NAMES, ElementScene
from crazychoir.planning.drawing.svg_shapes import SHAPE_NAMES, parse_transforms
from crazychoir.planning.drawing.svg_style import (
    INITIAL_VALUES,
    StyleSheets,
    find_hiding_property,
)


class ClipReader:
    """Reads the clips of elements, as far as they are one convex shape.

    styles: styles of the elements
    by_id: elements of the document by id
    outlines: draws the shapes of clips
    report: builds the errors
    """

    def __init__(
        self,
        styles: StyleSheets,
        by_id: Mapping[str, SvgElement],
        outlines: ShapeOutlines,
        report: SvgReport,
    ) -> None:
        self._styles = styles
        self._by_id = by_id
        self._outlines = outlines
        self._report = report

    def read_clips(
        self, element: SvgElement, style: dict[str, str], scene: ElementScene
    ) -> tuple[ClipOutline, ...]:
        """Return the clips of the element itself.

        Raises ConfigError for masks, and for clips that are not convex.
        """
        if self._referred(style.get("mask", "none")) is not None:
            raise self._report.build_refusal(
                element, f"with mask: {shorten_text(style['mask'])}", SVG_ADVICE.release
            )
        clip = self._referred(style.get("clip-path", "none"))
        if clip is None:
            return ()
        if not isinstance(clip, SvgElement) or clip.name != "clipPath":
            raise self._report.build_refusal(
                element,
                f"with clip-path: {shorten_text(style['clip-path'])}",
                SVG_ADVICE.release,
            )
        shapes = [
            child
            for child in clip.children
            if child.name in (*SHAPE_NAMES, *ELEMENT_NAMES.texts, "use")
        ]
        is_plain = len(shapes) == 1 and shapes[0].name in SHAPE_NAMES
        styles = [self._styles.of(part) for part in (clip, *shapes)]
        has_more = any(
            "clip-path" in one or "mask" in one or find_hiding_property(one)
            for one in styles
        )
        if (
            not is_plain
            or has_more
            or clip.attributes.get("clipPathUnits", "userSpaceOnUse")
            != "userSpaceOnUse"
        ):
            raise self._report.build_refusal(
                element,
                f"cut by {clip.label}, which is more than one shape",
                SVG_ADVICE.release,
            )
        for part in (clip, *shapes):
            scene = scene.transformed(
                parse_transforms(part.attributes.get("transform", ""))
            )
        corners = find_convex_corners(self._outlines.draw(shapes[0], scene))
        if corners is None:
            raise self._report.build_refusal(
                element, f"cut by {clip.label}, which is not convex", SVG_ADVICE.release
            )
        return (ClipOutline(corners, clip.label),)

    def _referred(self, value: str) -> SvgElement | str | None:
        """Return the element of url(#id), or another value as it is.

        Returns None for none, or for an unknown id.
        """
        if value in ("none", "", "inherit", *INITIAL_VALUES):
            return None
        if value.startswith("url(") and value.endswith(")"):
            name = value[4:-1].strip().strip("\"'").strip()
            if name.startswith("#"):
                return self._by_id.get(name[1:])
        return value
