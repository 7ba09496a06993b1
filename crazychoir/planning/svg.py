"""Strokes as SVG paths: what drawing programs write, as lines of places; and strokes as a picture that is read again.

An SVG picture's y points down, a floor's up: y is turned round, and units are millimetres unless a scale says else.
"""

import math
import re
from collections.abc import Iterator, Sequence
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.math3d import Mat

SCALE = 0.001
"""m a unit of the picture."""
SMOOTH = 24
"""Straight lines a curve."""
MOST_POINTS = 100_000
NUMBERS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
"""How many numbers each command of a path takes."""
_TOKEN = re.compile(r"([MmLlHhVvCcSsQqTtAaZz])|([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|([\s,]+)|(.)", re.DOTALL)
SHAPES = 'path d="..." (M L H V C S Q T A Z), polyline and polygon points="...", line'


def read_svg(path: str | Path, scale: float = SCALE) -> list[Mat]:
    """The strokes of an SVG file, see `parse_svg`."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}", f"{error}", "a readable SVG file, UTF-8") from error
    return parse_svg(text, str(path), scale)


def parse_svg(text: str, where: str, scale: float = SCALE) -> list[Mat]:
    """The strokes of an SVG text, (k, 2) rows x, y m each: its paths, polylines, polygons and lines, in their order.

    Transformations are not followed. Errors: ConfigError, with `where`.
    """
    shapes = _Shapes()
    try:
        shapes.feed(text)
    except (AssertionError, ValueError) as error:  # "<![a[", or a character by a number of 5000 digits
        raise ConfigError(where, f"a text that is no SVG: {error}", SHAPES) from error
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            strokes = [stroke for d in shapes.paths for stroke in _strokes(d, where)]
    except ArithmeticError as error:
        raise ConfigError(where, f"places that are too far off: {error}", SHAPES) from error
    if not strokes:
        raise ConfigError(where, "no line", SHAPES)
    if sum(map(len, strokes)) > MOST_POINTS:
        raise ConfigError(where, f"{sum(map(len, strokes))} places", f"at most {MOST_POINTS}")
    drawn = [np.array(stroke) * (scale, -scale) + 0.0 for stroke in strokes]
    if not all(np.isfinite(stroke).all() for stroke in drawn):
        raise ConfigError(where, "places that are not finite", SHAPES)
    return drawn


def svg_of(strokes: Sequence[Mat], scale: float = SCALE) -> str:
    """A picture of strokes, rows x, y or t, x, y m, that `parse_svg` reads as they are, to 0.01 mm."""
    flat = [stroke[:, -2:] * (1.0 / scale, -1.0 / scale) for stroke in strokes]
    low, high = np.concatenate(flat).min(axis=0) - 50.0, np.concatenate(flat).max(axis=0) + 50.0
    width, height = high - low
    paths = "\n".join(f'<path d="M{" L".join(f"{x:.2f} {y:.2f}" for x, y in one.tolist())}"/>' for one in flat)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{low[0]:.2f} {low[1]:.2f} {width:.2f} {height:.2f}" '
        f'fill="none" stroke="black" stroke-width="10">\n{paths}\n</svg>\n'
    )


class _Shapes(HTMLParser):
    """Collects the lines of a text as path data. It resolves no entities and loads nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.paths: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """One element."""
        given = {name: value or "" for name, value in attrs}
        match tag:
            case "path":
                self.paths.append(given.get("d", ""))
            case "polyline" | "polygon":
                self.paths.append(f"M{given.get('points', '')}{'Z' if tag == 'polygon' else ''}")
            case "line":
                ends = [given.get(name, "0") for name in ("x1", "y1", "x2", "y2")]
                self.paths.append("M" + " ".join(ends))


Places = list[tuple[float, float]]


def _commands(d: str, where: str) -> Iterator[tuple[str, list[float]]]:
    """Each command with its numbers; one that goes on with more numbers comes again."""
    name, numbers, given = "", list[float](), False
    for letter, number, _, other in _TOKEN.findall(d):
        if other:
            raise ConfigError(where, f"path data with {other!r}", SHAPES)
        if number:
            if not name or NUMBERS[name.upper()] == 0 or not math.isfinite(float(number)):
                raise ConfigError(where, f"path data with {number} after {name or 'nothing'!r}", SHAPES)
            numbers.append(float(number))
            if len(numbers) == NUMBERS[name.upper()]:
                yield name, numbers
                name = {"M": "L", "m": "l"}.get(name, name)
                numbers, given = [], True
        elif letter:
            if numbers or (name and not given):
                raise ConfigError(where, f"path data that breaks off in {name!r}", SHAPES)
            name, given = letter, letter in "Zz"
            if given:
                yield name, []
    if numbers or (name and not given):
        raise ConfigError(where, f"path data that breaks off in {name!r}", SHAPES)


def _strokes(d: str, where: str) -> list[Places]:
    """The lines of one path's data, each from a move to the next."""
    strokes: list[Places] = []
    here, handle, before = (0.0, 0.0), (0.0, 0.0), ""
    for name, n in _commands(d, where):
        kind = name.upper()
        n = _absolute(kind, n, here) if name.islower() else n
        if kind == "M":
            strokes.append([(n[0], n[1])])
            here = handle = (n[0], n[1])
        elif not strokes:
            raise ConfigError(where, f"path data that begins with {name!r}", "M first")
        elif kind == "Z":
            strokes[-1].append(strokes[-1][0])
            here = handle = strokes[-1][0]
            strokes.append([here])
        else:
            handle = _smooth_handle(kind, before, here, handle)
            line, handle = _drawn(kind, n, here, handle)
            strokes[-1] += line
            here = strokes[-1][-1]
        before = kind
    return [stroke for stroke in strokes if len(stroke) > 1]


def _absolute(kind: str, n: list[float], here: tuple[float, float]) -> list[float]:
    match kind:
        case "H":
            return [n[0] + here[0]]
        case "V":
            return [n[0] + here[1]]
        case "A":
            return [*n[:5], n[5] + here[0], n[6] + here[1]]
    return [x + here[k % 2] for k, x in enumerate(n)]


def _smooth_handle(
    kind: str, before: str, here: tuple[float, float], handle: tuple[float, float]
) -> tuple[float, float]:
    """The first handle of S and T: the last one of a curve before, mirrored."""
    if (kind == "S" and before in ("C", "S")) or (kind == "T" and before in ("Q", "T")):
        return 2.0 * here[0] - handle[0], 2.0 * here[1] - handle[1]
    return here


def _drawn(
    kind: str, n: list[float], here: tuple[float, float], handle: tuple[float, float]
) -> tuple[Places, tuple[float, float]]:
    """Places after `here`, and the last handle."""
    match kind:
        case "H":
            return [(n[0], here[1])], here
        case "V":
            return [(here[0], n[0])], here
        case "C":
            return _bezier([here, (n[0], n[1]), (n[2], n[3]), (n[4], n[5])]), (n[2], n[3])
        case "S":
            return _bezier([here, handle, (n[0], n[1]), (n[2], n[3])]), (n[0], n[1])
        case "Q":
            return _bezier([here, (n[0], n[1]), (n[2], n[3])]), (n[0], n[1])
        case "T":
            return _bezier([here, handle, (n[0], n[1])]), handle
        case "A":
            return _arc(here, n), here
    return [(n[0], n[1])], here


def _bezier(points: Places) -> Places:
    """By de Casteljau's algorithm."""
    places = []
    for s in (k / SMOOTH for k in range(1, SMOOTH + 1)):
        row = np.array(points)
        while len(row) > 1:
            row = (1.0 - s) * row[:-1] + s * row[1:]
        places.append((float(row[0, 0]), float(row[0, 1])))
    return places


def _arc(here: tuple[float, float], n: list[float]) -> Places:
    """An elliptical arc from `here`: rx, ry, rotation deg, large, sweep, x, y. Source: SVG 1.1, appendix F.6."""
    rx, ry, turn, end = abs(n[0]), abs(n[1]), math.radians(n[2]), (n[5], n[6])
    if min(rx, ry) == 0.0 or here == end:
        return [end]
    c, s = math.cos(turn), math.sin(turn)
    half = np.array([here[0] - end[0], here[1] - end[1]]) / 2.0
    x, y = c * half[0] + s * half[1], -s * half[0] + c * half[1]
    grown = math.sqrt(max(1.0, (x / rx) ** 2 + (y / ry) ** 2))
    rx, ry = grown * rx, grown * ry
    left = (rx * ry) ** 2 - (rx * y) ** 2 - (ry * x) ** 2
    size = math.sqrt(max(0.0, left / ((rx * y) ** 2 + (ry * x) ** 2)))
    sign = -1.0 if bool(n[3]) == bool(n[4]) else 1.0
    mx, my = sign * size * rx * y / ry, -sign * size * ry * x / rx
    begin, last = math.atan2((y - my) / ry, (x - mx) / rx), math.atan2((-y - my) / ry, (-x - mx) / rx)
    sweep = (last - begin) % (2.0 * math.pi) - (0.0 if n[4] else 2.0 * math.pi)
    cx, cy = c * mx - s * my + (here[0] + end[0]) / 2.0, s * mx + c * my + (here[1] + end[1]) / 2.0
    angles = [begin + sweep * k / SMOOTH for k in range(1, SMOOTH)]
    round_it = [(rx * math.cos(a), ry * math.sin(a)) for a in angles]
    return [*((cx + c * u - s * v, cy + s * u + c * v) for u, v in round_it), end]
