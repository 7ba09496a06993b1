"""Drawings in files: strokes as CSV, or the visible lines of an SVG picture."""

from dataclasses import dataclass, field
from pathlib import Path

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.stroke import parse_strokes, read_strokes
from crazychoir.planning.drawing.svg import parse_picture, read_picture
from crazychoir.types import Mat


@dataclass(frozen=True)
class DrawingFile:
    """The contents of a file."""

    strokes: list[Mat]
    """(k, 3) rows t s, x, y m of a CSV file, or (k, 2) rows x, y m of an SVG picture."""
    words: list[str] = field(default_factory=list)
    """Remarks on what an SVG picture shows and is not flown."""

    @property
    def is_timed(self) -> bool:
        """Whether the file says when the hand was where."""
        return all(stroke.shape[1] == 3 for stroke in self.strokes)


def read_drawing(path: str | Path) -> DrawingFile:
    """Read a file: an SVG picture if its name ends in .svg or .svgz, else CSV.

    Raises ConfigError for a file that cannot be read.
    """
    if Path(path).suffix.lower() in (".svg", ".svgz"):
        picture = read_picture(path)
        return DrawingFile(picture.strokes, picture.words)
    return DrawingFile(read_strokes(path))


def parse_drawing(text: str, name: str) -> DrawingFile:
    """Read the text of a file with this name, which ends in .svg or .csv.

    Raises ConfigError for another name, or a text that cannot be read.
    """
    if name.lower().endswith(".svg"):
        picture = parse_picture(text, name)
        return DrawingFile(picture.strokes, picture.words)
    if name.lower().endswith(".csv"):
        return DrawingFile(parse_strokes(text, name))
    raise ConfigError("file", name, "a name that ends in .csv or .svg")
