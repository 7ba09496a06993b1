"""Drawings as SVG files: what is seen of them, as strokes; and strokes as a picture to read again.

The y axis of an SVG picture points down, that of a floor up: y changes its sign. Units are
millimetres unless a scale is given. They are the units of the page's viewBox; width and height of
the page change nothing.

Flown are the visible outlines of path, rect, circle, ellipse, line, polyline and polygon, with
their transforms, also in groups, nested svg, and by use. Not visible are mere definitions (defs,
symbol, clipPath, marker, pattern, mask) and hidden elements (display, visibility, opacity, neither
fill nor stroke, no size). A visible element that cannot be flown (text, images, shapes cut by a
clip or a mask) is refused by its name.

The curves and transforms are those of svgpathtools. Its documents, and those of svgelements, are
not used. The first ignore display, style sheets, visibility, symbols and use. The second draw
markers and symbols twice. Both leave out, without a message, what they cannot read.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.svg_document import (
    READABLE_SVG_TEXT,
    SvgElement,
    read_document,
)
from crazychoir.planning.drawing.svg_outline import MOST_POINTS
from crazychoir.planning.drawing.svg_reader import SvgReader
from crazychoir.planning.drawing.svg_report import SVG_ADVICE
from crazychoir.types import Mat

__all__ = [
    "METRES_PER_UNIT",
    "MOST_POINTS",
    "Picture",
    "format_svg",
    "parse_picture",
    "parse_svg",
    "read_picture",
    "read_svg",
]

METRES_PER_UNIT = 0.001
"""Metres a unit of the picture."""
QUOTED_REMARKS = 5
"""Largest number of remarks that are quoted."""


@dataclass(frozen=True)
class Picture:
    """The visible lines of an SVG document."""

    strokes: list[Mat]
    """(k, 2) rows x, y m each, in the order of the document."""
    words: list[str]
    """The first remarks on the rest of the document."""


def read_svg(path: str | Path, scale: float = METRES_PER_UNIT) -> list[Mat]:
    """Return the strokes of an SVG file, see `parse_picture`."""
    return read_picture(path, scale).strokes


def read_picture(path: str | Path, scale: float = METRES_PER_UNIT) -> Picture:
    """Return what is seen in an SVG file, in the encoding that it declares; see `parse_picture`."""
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}", f"{error}", READABLE_SVG_TEXT) from error
    return parse_picture(data, str(path), scale)


def parse_svg(
    text: str | bytes, where: str, scale: float = METRES_PER_UNIT
) -> list[Mat]:
    """Return the strokes of an SVG text, see `parse_picture`."""
    return parse_picture(text, where, scale).strokes


def parse_picture(
    text: str | bytes, where: str, scale: float = METRES_PER_UNIT
) -> Picture:
    """Return what is seen in an SVG text.

    text: the text, or bytes in the encoding that they declare
    where: name of the file in errors
    scale: m a unit of the picture
    Raises ConfigError, with `where`, the element, its id and its line; also if nothing is seen.
    """
    root = read_document(text, where)
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            reader = SvgReader(root, where, scale)
            reader.read()
    except ArithmeticError as error:
        raise ConfigError(
            where, f"places that are too far off: {error}", SVG_ADVICE.flown
        ) from error
    if not reader.strokes:
        raise ConfigError(
            where, _describe_nothing_visible(root, reader.words), SVG_ADVICE.flown
        )
    return Picture(
        [stroke * (scale, -scale) + 0.0 for stroke in reader.strokes],
        shorten_remarks(reader.words),
    )


def _describe_nothing_visible(root: SvgElement, words: list[str]) -> str:
    """Return what was found in a picture without a visible line."""
    counts = Counter(element.name for element in root.walk() if element.name)
    names = ", ".join(f"{count} {name}" for name, count in counts.items())
    said = f" ({'; '.join(shorten_remarks(words))})" if words else ""
    return f"no line that is seen among {names}{said}"


def shorten_remarks(words: list[str]) -> list[str]:
    """Return the first remarks, and how many more there are."""
    more = len(words) - QUOTED_REMARKS
    return [*words[:QUOTED_REMARKS], f"and {more} more"] if more > 0 else words


def format_svg(strokes: Sequence[Mat], scale: float = METRES_PER_UNIT) -> str:
    """Return a picture of strokes, which `parse_svg` reads to 0.01 mm.

    strokes: rows x, y or t, x, y m
    scale: m a unit of the picture
    """
    flat = [stroke[:, -2:] * (1.0 / scale, -1.0 / scale) for stroke in strokes]
    low = np.concatenate(flat).min(axis=0) - 50.0
    high = np.concatenate(flat).max(axis=0) + 50.0
    width, height = high - low
    paths = "\n".join(
        f'<path d="M{" L".join(f"{x:.2f} {y:.2f}" for x, y in one.tolist())}"/>'
        for one in flat
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{low[0]:.2f} {low[1]:.2f} {width:.2f} {height:.2f}" '
        f'fill="none" stroke="black" stroke-width="10">\n{paths}\n</svg>\n'
    )
