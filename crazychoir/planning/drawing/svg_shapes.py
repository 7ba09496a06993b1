"""SVG shapes as path data; lengths, transforms and viewports as numbers."""

import math
import re
from dataclasses import dataclass

import numpy as np
from svgpathtools import parse_transform

from crazychoir.planning.drawing.svg_document import SvgElement, quote_text
from crazychoir.types import Mat

ViewportSize = tuple[float, float]
"""Width and height of a viewport, in its own units."""
SHAPE_NAMES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")
"""Elements that are flown."""
LENGTH_UNITS = {
    "": 1.0,
    "px": 1.0,
    "in": 96.0,
    "cm": 96.0 / 2.54,
    "mm": 9.6 / 2.54,
    "q": 2.4 / 2.54,
    "pt": 4.0 / 3.0,
    "pc": 16.0,
}
"""Units of the picture per unit of length, as CSS defines them."""
ALLOWED_LENGTHS = f"a number, or one with %, {', '.join(filter(None, LENGTH_UNITS))}"
"""Text for what is allowed."""
ALLOWED_TRANSFORMS = "matrix(a b c d e f), translate(x y), scale(x y), rotate(deg x y), skewX(deg), skewY(deg)"
"""Text for what is allowed."""
UNITS_PER_MILLIMETRE = LENGTH_UNITS["mm"]  # units of the picture

# No expression matches a text in two ways: a hostile text costs as much as a good one as long.
_NUMBER_PATTERN = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"


@dataclass(frozen=True, slots=True)
class _AttributePatterns:
    """Patterns of attributes that are numbers, lengths or transforms."""

    length: re.Pattern[str] = re.compile(
        rf"\s*({_NUMBER_PATTERN})\s*([a-zA-Z]*|%)\s*\Z", re.ASCII
    )
    """a number with a unit."""
    number_or_gap: re.Pattern[str] = re.compile(
        rf"({_NUMBER_PATTERN})|[\s,]+", re.ASCII
    )
    """a number, or blanks and commas."""
    function: re.Pattern[str] = re.compile(
        r"[\s,]*([a-zA-Z]+)\s*\(([^()]*)\)", re.ASCII
    )
    """a transform with its arguments."""


_ATTRIBUTE_PATTERNS = _AttributePatterns()


class ShapeError(ValueError):
    """An attribute that cannot be read: what was found, and what is allowed."""

    def __init__(self, found: str, allowed: str) -> None:
        self.found = found
        self.allowed = allowed
        super().__init__(f"{found}; allowed: {allowed}")


def parse_length(
    element: SvgElement, name: str, whole: float | None, default: str = "0"
) -> float:
    """Return an attribute that is a length, in units of the picture.

    element: the element
    name: of the attribute
    whole: length of 100 %; None if the document does not say it
    default: value of a missing attribute
    Raises ShapeError for a text that is no length.
    """
    text = element.attributes.get(name, default)
    found = _ATTRIBUTE_PATTERNS.length.match(text)
    unit = found[2].lower() if found else ""
    if (
        found is None
        or not (unit == "%" or unit in LENGTH_UNITS)
        or not math.isfinite(float(found[1]))
    ):
        raise ShapeError(f"{name}={quote_text(text)}", ALLOWED_LENGTHS)
    if unit != "%":
        return float(found[1]) * LENGTH_UNITS[unit]
    if whole is None:
        raise ShapeError(
            f"{name}={quote_text(text)} of a page without viewBox, width and height",
            "a length without %",
        )
    return float(found[1]) / 100.0 * whole


def parse_numbers(text: str, what: str) -> list[float]:
    """Return a list of numbers, with or without separators.

    Raises ShapeError for another text.
    """
    found: list[float] = []
    at = 0
    while at < len(text):
        token = _ATTRIBUTE_PATTERNS.number_or_gap.match(text, at)
        if token is None:
            raise ShapeError(f"{what}={quote_text(text)}", "a list of numbers")
        if token[1]:
            found.append(float(token[1]))
        at = token.end()
    if not all(map(math.isfinite, found)):
        raise ShapeError(f"{what}={quote_text(text)}", "finite numbers")
    return found


def parse_transforms(text: str) -> Mat:
    """Return the matrix (3, 3) of a list of matrix, translate, scale, rotate, skewX and skewY.

    Numbers may stand without separators, as in translate(10-5).
    Raises ShapeError for another text.
    """
    if text.strip() in ("", "none"):
        return np.eye(3)
    written: list[str] = []
    at = 0
    while found := _ATTRIBUTE_PATTERNS.function.match(text, at):
        arguments = parse_numbers(found[2], f"transform {found[1]}")
        written.append(f"{found[1]}({','.join(map(repr, arguments))})")
        at = found.end()
    try:
        if text[at:].strip(" \t\r\n,"):
            raise ValueError(text[at:])
        matrix: Mat = parse_transform(" ".join(written), strict=True)
    except ValueError as error:
        raise ShapeError(f"transform={quote_text(text)}", ALLOWED_TRANSFORMS) from error
    return matrix


def build_path_data(element: SvgElement, viewport: ViewportSize | None) -> str:
    """Return a shape as path data; empty for a shape without size.

    element: the shape
    viewport: the size that lengths in % refer to; None if unknown
    Raises ShapeError for attributes that cannot be read.
    """
    attributes = element.attributes
    match element.name:
        case "path":
            d = attributes.get("d", "").strip()
            return "" if d == "none" else d
        case "rect":
            return _build_rectangle(element, viewport)
        case "circle" | "ellipse":
            return _build_ellipse(element, viewport)
        case "line":
            ends = [
                parse_length(element, name, _get_whole_length(name, viewport))
                for name in ("x1", "y1", "x2", "y2")
            ]
            return _format_path_data("M", ends[:2], "L", ends[2:])
    places = parse_numbers(attributes.get("points", ""), "points")
    if len(places) % 2:
        raise ShapeError(f"points of {len(places)} numbers", "two for each place")
    if not places:
        return ""
    return _format_path_data("M", places) + ("Z" if element.name == "polygon" else "")


def _build_rectangle(element: SvgElement, viewport: ViewportSize | None) -> str:
    """Return a rectangle, with round corners if it has radii, as path data."""
    x, y, width, height = (
        parse_length(element, name, _get_whole_length(name, viewport))
        for name in ("x", "y", "width", "height")
    )
    if not (width > 0.0 and height > 0.0):
        return ""
    radii = _parse_radii(element, viewport)
    rx = min(radii[0], 0.5 * width)
    ry = min(radii[1], 0.5 * height)
    right = x + width
    bottom = y + height
    if not (rx > 0.0 and ry > 0.0):
        return (
            _format_path_data("M", [x, y], "H", [right], "V", [bottom], "H", [x]) + "Z"
        )
    corner = [rx, ry, 0, 0, 1]
    return (
        _format_path_data(
            "M",
            [x + rx, y],
            "L",
            [right - rx, y],
            "A",
            [*corner, right, y + ry],
            "L",
            [right, bottom - ry],
            "A",
            [*corner, right - rx, bottom],
            "L",
            [x + rx, bottom],
            "A",
            [*corner, x, bottom - ry],
            "L",
            [x, y + ry],
            "A",
            [*corner, x + rx, y],
        )
        + "Z"
    )


def _build_ellipse(element: SvgElement, viewport: ViewportSize | None) -> str:
    """Return a circle or an ellipse as path data."""
    cx = parse_length(element, "cx", _get_whole_length("x", viewport))
    cy = parse_length(element, "cy", _get_whole_length("y", viewport))
    if element.name == "circle":
        rx = parse_length(element, "r", _get_whole_length("r", viewport))
        ry = rx
    else:
        rx, ry = _parse_radii(element, viewport)
    if not (rx > 0.0 and ry > 0.0):
        return ""
    quarter = [rx, ry, 0, 0, 1]
    return (
        _format_path_data(
            "M",
            [cx + rx, cy],
            "A",
            [*quarter, cx, cy + ry],
            "A",
            [*quarter, cx - rx, cy],
            "A",
            [*quarter, cx, cy - ry],
            "A",
            [*quarter, cx + rx, cy],
        )
        + "Z"
    )


def _parse_radii(element: SvgElement, viewport: ViewportSize | None) -> ViewportSize:
    """Return rx and ry; a missing, auto or negative one equals the other."""
    found: list[float | None] = []
    for name in ("rx", "ry"):
        is_auto = element.attributes.get(name, "auto").strip() == "auto"
        radius = (
            None
            if is_auto
            else parse_length(element, name, _get_whole_length(name, viewport))
        )
        found.append(radius if radius is None or radius >= 0.0 else None)
    rx, ry = found
    if rx is None:
        rx = ry or 0.0
    return rx, rx if ry is None else ry


def _get_whole_length(name: str, viewport: ViewportSize | None) -> float | None:
    """Return the length of 100 % of an attribute."""
    if viewport is None:
        return None
    if name == "r":
        return math.hypot(*viewport) / math.sqrt(2.0)
    return viewport[0] if "x" in name or name == "width" else viewport[1]


def _format_path_data(*parts: str | list[float]) -> str:
    """Return commands and numbers as path data."""
    return " ".join(
        part if isinstance(part, str) else " ".join(map(repr, part)) for part in parts
    )


@dataclass(frozen=True)
class SvgView:
    """The view of the inside of an <svg> or <symbol>."""

    matrix: Mat
    """(3, 3), from its units to those around it."""
    size: ViewportSize | None
    """Size of its viewport in its own units; None if the document does not say it."""
    window: Mat | None
    """(4, 2): corners of the visible part, in the units around it; None if not said."""


@dataclass(frozen=True)
class SvgPage:
    """The page of a document, in units of the picture."""

    corner: tuple[float, float]
    """(2,): its upper left corner."""
    size: ViewportSize
    """Its width and height."""


def read_page(element: SvgElement) -> SvgPage | None:
    """Return the page of the outermost element: its viewBox, or else its width and height.

    Returns None without them.
    """
    if box := _parse_view_box(element):
        return SvgPage((box[0], box[1]), (box[2], box[3]))
    if element.name != "svg" or any(
        element.attributes.get(name, "auto").strip().endswith(("%", "auto"))
        for name in ("width", "height")
    ):
        return None
    return SvgPage(
        (0.0, 0.0),
        (parse_length(element, "width", None), parse_length(element, "height", None)),
    )


def compute_view(
    element: SvgElement, outer: ViewportSize | None, given: dict[str, str]
) -> SvgView | None:
    """Return how the inside of a nested <svg> or a used <symbol> is shown; None if it has no size.

    element: the element
    outer: the viewport around it
    given: width and height of the <use>, which replace its own
    Raises ShapeError for attributes that cannot be read.
    """
    asked = SvgElement(element.name, element.attributes | given, element.line)
    x = parse_length(asked, "x", _get_whole_length("x", outer))
    y = parse_length(asked, "y", _get_whole_length("y", outer))
    box = _parse_view_box(element)
    sizes = [asked.attributes.get(name, "auto").strip() for name in ("width", "height")]
    if outer is None and any(size == "auto" or size.endswith("%") for size in sizes):
        if box is not None:
            raise ShapeError(
                "a viewBox and no size", "width and height, or a page with them"
            )
        return SvgView(_build_translation(x, y), None, None)
    for name, size in zip(("width", "height"), sizes, strict=True):
        if size == "auto":
            asked.attributes[name] = "100%"
    width = parse_length(asked, "width", _get_whole_length("width", outer))
    height = parse_length(asked, "height", _get_whole_length("height", outer))
    if not (width > 0.0 and height > 0.0) or (
        box is not None and not (box[2] > 0.0 and box[3] > 0.0)
    ):
        return None
    window = np.array(
        [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    )
    if box is None:
        return SvgView(_build_translation(x, y), (width, height), window)
    fit = _fit_view_box(
        asked.attributes.get("preserveAspectRatio", ""), box, (width, height)
    )
    return SvgView(_build_translation(x, y) @ fit, (box[2], box[3]), window)


def _parse_view_box(element: SvgElement) -> list[float] | None:
    """Return the viewBox of an element; None without one."""
    text = element.attributes.get("viewBox", "").strip()
    if not text or text == "none":
        return None
    box = parse_numbers(text, "viewBox")
    if len(box) != 4 or box[2] < 0.0 or box[3] < 0.0:
        raise ShapeError(
            f"viewBox={quote_text(text)}", "x, y, width and height, these not negative"
        )
    return box


def _fit_view_box(text: str, box: list[float], size: ViewportSize) -> Mat:
    """Return the matrix from a viewBox to a viewport of this size, as preserveAspectRatio says."""
    words = text.replace("defer", "").split() or ["xMidYMid"]
    scales = [size[0] / box[2], size[1] / box[3]]
    if words[0] == "none":
        return np.diag([*scales, 1.0]) @ _build_translation(-box[0], -box[1])
    align = re.fullmatch(r"x(Min|Mid|Max)Y(Min|Mid|Max)", words[0])
    if align is None or words[1:] not in ([], ["meet"], ["slice"]):
        raise ShapeError(
            f"preserveAspectRatio={quote_text(text)}",
            "none, or xMidYMid and its like with meet or slice",
        )
    scale = max(scales) if words[1:] == ["slice"] else min(scales)
    share = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
    left = [share[align[k + 1]] * (size[k] - scale * box[k + 2]) for k in range(2)]
    return (
        _build_translation(*left)
        @ np.diag([scale, scale, 1.0])
        @ _build_translation(-box[0], -box[1])
    )


def _build_translation(x: float, y: float) -> Mat:
    """Return the matrix of a translation."""
    matrix = np.eye(3)
    matrix[:2, 2] = (x, y)
    return matrix
