"""SVG path data as lines of places: all commands, written out or minified."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from svgpathtools import Arc, CubicBezier, QuadraticBezier

from crazychoir.planning.drawing.svg_document import shorten_text

LEAST_LINES_PER_CURVE = 24
"""Least number of straight lines a curve."""
MOST_LINES_PER_CURVE = 10_000
"""Largest number of straight lines a curve."""
COMMAND_NUMBERS = {
    "M": 2,
    "L": 2,
    "H": 1,
    "V": 1,
    "C": 6,
    "S": 4,
    "Q": 4,
    "T": 2,
    "A": 7,
    "Z": 0,
}
"""Number of numbers that each command takes."""


@dataclass(frozen=True, slots=True)
class PathGrammar:
    """The grammar of path data."""

    flag_positions: tuple[int, ...] = (3, 4)
    """Positions of the flags of an arc: one digit, 0 or 1, after which no separator is needed.
    """
    allowed: str = "path data of M L H V C S Q T A Z and finite numbers"
    """Text for what is allowed."""
    token: re.Pattern[str] = re.compile(
        r"(?P<command>[MmLlHhVvCcSsQqTtAaZz])"
        r"|(?P<number>[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
        r"|(?P<separator>[\s,]+)",
        re.ASCII,
    )
    """a command, a number, or a separator."""
    flag: re.Pattern[str] = re.compile(r"[01]")
    """One digit, 0 or 1."""


PATH_GRAMMAR = PathGrammar()


Places = list[tuple[float, float]]
"""x and y of each place."""
PathCommand = tuple[str, list[float]]
"""A command and its numbers."""


class PathDataError(ValueError):
    """Path data that cannot be read; the text says what was found."""


class PathSizeError(PathDataError):
    """Path data of too many places."""


def parse_path_data(d: str, tolerance: float, most: int) -> list[Places]:
    """Return the lines of path data, each from a move to the next.

    A curve becomes straight lines that stay within `tolerance` of it.

    d: the path data
    tolerance: in units of the data
    most: largest number of places
    Raises PathDataError for wrong data, PathSizeError for more places, and ArithmeticError for
    numbers that are too large.
    """
    count = 0
    strokes: list[Places] = []
    here = (0.0, 0.0)
    handle = (0.0, 0.0)
    before = ""
    for name, written in _iterate_commands(d):
        kind = name.upper()
        numbers = _make_absolute(kind, written, here) if name.islower() else written
        if kind == "M":
            here = (numbers[0], numbers[1])
            handle = here
            strokes.append([here])
        elif not strokes:
            raise PathDataError(
                f"path data that begins with {name!r}, not with M first"
            )
        elif kind == "Z" and before == "Z":
            continue
        elif kind == "Z":
            here = strokes[-1][0]
            handle = here
            strokes[-1].append(here)
            strokes.append([here])
        else:
            handle = _compute_smooth_handle(kind, before, here, handle)
            line, handle = _draw_command(kind, numbers, here, handle, tolerance)
            count += len(line)
            if count > most:
                raise PathSizeError(f"path data of more than {most} places")
            strokes[-1] += line
            here = strokes[-1][-1]
        before = kind
    return [stroke for stroke in strokes if len(stroke) > 1]


def _iterate_commands(d: str) -> Iterator[PathCommand]:
    """Yield each command with its numbers.

    A command that is followed by more numbers than it takes is repeated.
    """
    name = ""
    numbers: list[float] = []
    is_complete = True
    for command, number in _iterate_tokens(d):
        if command:
            _check_complete(name, numbers, is_complete)
            name = command
            is_complete = command in "Zz"
            if is_complete:
                yield name, []
            continue
        if not name or COMMAND_NUMBERS[name.upper()] == 0:
            raise PathDataError(
                f"path data with {shorten_text(number)} after {name or 'nothing'!r}"
            )
        if not math.isfinite(float(number)):
            raise PathDataError(f"path data with {shorten_text(number)} after {name!r}")
        numbers.append(float(number))
        if len(numbers) == COMMAND_NUMBERS[name.upper()]:
            yield name, numbers
            name = {"M": "L", "m": "l"}.get(name, name)
            numbers = []
            is_complete = True
    _check_complete(name, numbers, is_complete)


def _check_complete(name: str, numbers: list[float], is_complete: bool) -> None:
    """Raise PathDataError for a command without all its numbers."""
    if numbers or not is_complete:
        raise PathDataError(f"path data that breaks off in {name!r}")


def _iterate_tokens(d: str) -> Iterator[tuple[str, str]]:
    """Yield commands and numbers, one of the two empty. A flag of an arc is a single digit."""
    at = 0
    is_arc = False
    count = 0
    while at < len(d):
        token = PATH_GRAMMAR.token.match(d, at)
        if token is None:
            raise PathDataError(f"path data with {d[at]!r}")
        if (
            token["number"]
            and is_arc
            and count % COMMAND_NUMBERS["A"] in PATH_GRAMMAR.flag_positions
        ):
            token = PATH_GRAMMAR.flag.match(d, at)
            if token is None:
                raise PathDataError(
                    f"path data with {d[at : at + 8]!r} where an arc has a flag, 0 or 1"
                )
            count += 1
            yield "", token.group()
        elif token["number"]:
            count += 1
            yield "", token["number"]
        elif token["command"]:
            is_arc = token["command"] in "Aa"
            count = 0
            yield token["command"], ""
        at = token.end()


def _make_absolute(
    kind: str, numbers: list[float], here: tuple[float, float]
) -> list[float]:
    """Return the numbers of a relative command as those of an absolute one."""
    match kind:
        case "H":
            return [numbers[0] + here[0]]
        case "V":
            return [numbers[0] + here[1]]
        case "A":
            return [*numbers[:5], numbers[5] + here[0], numbers[6] + here[1]]
    return [number + here[k % 2] for k, number in enumerate(numbers)]


def _compute_smooth_handle(
    kind: str, before: str, here: tuple[float, float], handle: tuple[float, float]
) -> tuple[float, float]:
    """Return the first handle of S and T: the last handle of a curve before, mirrored."""
    if (kind == "S" and before in ("C", "S")) or (kind == "T" and before in ("Q", "T")):
        return 2.0 * here[0] - handle[0], 2.0 * here[1] - handle[1]
    return here


def _draw_command(
    kind: str,
    n: list[float],
    here: tuple[float, float],
    handle: tuple[float, float],
    tolerance: float,
) -> tuple[Places, tuple[float, float]]:
    """Return the places after `here`, and the last handle."""
    match kind:
        case "H":
            return [(n[0], here[1])], here
        case "V":
            return [(here[0], n[0])], here
        case "C":
            return _draw_bezier(
                [here, (n[0], n[1]), (n[2], n[3]), (n[4], n[5])], tolerance
            ), (n[2], n[3])
        case "S":
            return _draw_bezier(
                [here, handle, (n[0], n[1]), (n[2], n[3])], tolerance
            ), (
                n[0],
                n[1],
            )
        case "Q":
            return _draw_bezier([here, (n[0], n[1]), (n[2], n[3])], tolerance), (
                n[0],
                n[1],
            )
        case "T":
            return _draw_bezier([here, handle, (n[0], n[1])], tolerance), handle
        case "A":
            return _draw_arc(here, n, tolerance), here
    return [(n[0], n[1])], here


def _draw_bezier(points: Places, tolerance: float) -> Places:
    """Return places on a Bezier curve of degree 2 or 3.

    |chord - curve| <= |B''| / (8 n^2)
    |B''| <= degree (degree - 1) max |p_k - 2 p_(k+1) + p_(k+2)|
    """
    corners = [complex(*point) for point in points]
    degree = len(corners) - 1
    curve = QuadraticBezier(*corners) if degree == 2 else CubicBezier(*corners)
    steps = list(pairwise(corners))
    bend = max(abs((c - b) - (b - a)) for (a, b), (_, c) in pairwise(steps))
    return _sample_curve(curve, degree * (degree - 1) * bend, points[-1], tolerance)


def _draw_arc(here: tuple[float, float], n: list[float], tolerance: float) -> Places:
    """Return places on an elliptical arc from `here`.

    n: rx, ry, rotation deg, large, sweep, x, y
    """
    radii = (abs(n[0]), abs(n[1]))
    end = (n[5], n[6])
    if here == end:
        return []
    if min(radii) == 0.0:
        return [end]
    curve = Arc(
        complex(*here), complex(*radii), n[2], bool(n[3]), bool(n[4]), complex(*end)
    )
    bend = max(curve.radius.real, curve.radius.imag) * math.radians(curve.delta) ** 2
    return _sample_curve(curve, bend, end, tolerance)


def _sample_curve(
    curve: Arc | QuadraticBezier | CubicBezier,
    bend: float,
    end: tuple[float, float],
    tol: float,
) -> Places:
    """Return places on the curve after its beginning.

    curve: the curve
    bend: its largest second derivative
    end: its last place
    tol: largest distance from the curve
    """
    count = math.sqrt(bend / (8.0 * tol))
    if not count <= MOST_LINES_PER_CURVE:
        raise OverflowError("a curve of very many lines")
    n = max(LEAST_LINES_PER_CURVE, math.ceil(count))
    places = curve.point(np.arange(1, n) / n)
    return [*zip(places.real.tolist(), places.imag.tolist(), strict=True), end]
