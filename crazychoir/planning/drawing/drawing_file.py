"""Drawings in files: strokes as CSV, or what is seen in an SVG picture."""

from dataclasses import dataclass, field
from pathlib import Path

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.stroke import parse_strokes, read_strokes
from crazychoir.planning.drawing.svg import parse_picture, read_picture
from crazychoir.types import Mat


@dataclass(frozen=True)
class DrawingFile:
    """What a file says.

    strokes: (k, 3) rows t s, x, y m of a CSV file, (k, 2) rows x, y m of an SVG picture;  words: remarks on what an
    SVG picture shows and is not flown.
    """

    strokes: list[Mat]
    words: list[str] = field(default_factory=list)

    @property
    def is_timed(self) -> bool:
        """Does it say when the hand was where?"""
        return all(stroke.shape[1] == 3 for stroke in self.strokes)


def read_drawing(path: str | Path) -> DrawingFile:
    """Read a file: an SVG picture if its name ends in .svg or .svgz, else CSV. Errors: ConfigError."""
    if Path(path).suffix.lower() in (".svg", ".svgz"):
        picture = read_picture(path)
        return DrawingFile(picture.strokes, picture.words)
    return DrawingFile(read_strokes(path))


def parse_drawing(text: str, name: str) -> DrawingFile:
    """Read a text of a file with this name, which ends in .svg or .csv. Errors: ConfigError."""
    if name.lower().endswith(".svg"):
        picture = parse_picture(text, name)
        return DrawingFile(picture.strokes, picture.words)
    if name.lower().endswith(".csv"):
        return DrawingFile(parse_strokes(text, name))
    raise ConfigError("file", name, "a name that ends in .csv or .svg")
