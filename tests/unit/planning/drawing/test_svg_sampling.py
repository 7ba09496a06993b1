"""Generated SVG files, read by crazychoir and by two references.

The first is svgpathtools with its own reader of documents, transforms and sampling. The second is written here, from
the definitions of SVG 1.1: crazychoir takes its curves from svgpathtools, and a fault there shows against the second.
"""

import math
import random
import re

import numpy as np
import pytest
from svgpathtools import CONVERSIONS, Arc, Document, Line, parse_path

from crazychoir.planning.drawing.svg import parse_svg

LINES = 24
"""Straight lines that crazychoir makes of a curve, where they are close enough."""
COARSE = 1e-6  # m a unit: so small that LINES are always close enough
FINE = 1.0  # m a unit: straight lines are within 2 mm, or 0.002 units, of a curve
HEAD = '<svg xmlns="http://www.w3.org/2000/svg">'


class Generator:
    """Makes random documents, and the second reference beside them: the places of each stroke, in their order."""

    def __init__(self, seed):
        self.random = random.Random(seed)  # noqa: S311 - tests are repeatable
        self.strokes = []
        self.ids = 0

    def number(self):
        return round(self.random.uniform(-9.0, 9.0), self.random.choice([0, 1, 2]))

    def size(self):
        return round(self.random.uniform(0.5, 6.0), 1)

    def document(self, with_use):
        """A document of a few elements in nested groups."""
        return f"{HEAD}{''.join(self.element([], 3, with_use) for _ in range(self.random.randint(1, 4)))}</svg>"

    def element(self, maps, depth, with_use):
        """Text of an element; maps: functions of places that are applied to it, the outermost first."""
        transform, own = self.transform()
        maps = [*maps, *own]
        kinds = ["path"] * 4 + [
            "rect",
            "ellipse",
            "circle",
            "polyline",
            "polygon",
            "line",
        ]
        if depth:
            kinds += ["g"] * 3 + (["use", "svg"] if with_use else [])
        kind = self.random.choice(kinds)
        if kind == "g":
            inside = "".join(
                self.element(maps, depth - 1, with_use)
                for _ in range(self.random.randint(1, 3))
            )
            return f"<g{transform}>{inside}</g>"
        if kind == "use":
            x, y = self.number(), self.number()
            self.ids += 1
            name = f"p{self.ids}"
            inside = self.element([*maps, lambda z: z + complex(x, y)], 0, False)
            shape = re.sub(r"^<(\w+)", rf'<\1 id="{name}"', inside)
            return (
                f'<defs>{shape}</defs><use href="#{name}" x="{x}" y="{y}"{transform}/>'
            )
        if kind == "svg":
            x, y, scale = self.number(), self.number(), self.random.choice([0.5, 2.0])
            view = f'x="{x}" y="{y}" width="{400 * scale}" height="{500 * scale}" viewBox="-200 -200 400 400"'
            fit = [
                lambda z: z + complex(x, y),
                lambda z: scale * (z + complex(200, 250)),
            ]
            inside = self.element([*maps, *fit], 0, False)
            return f'<g{transform}><svg {view} overflow="visible">{inside}</svg></g>'
        d, text = getattr(self, kind)()
        for stroke in sampled(d):
            for function in reversed(maps):
                stroke = function(stroke)
            self.strokes.append(stroke)
        return f"<{kind}{transform} {text}/>"

    def transform(self):
        """The attribute, and its functions of places, the outermost first."""
        texts, maps = [], []
        for _ in range(self.random.choice([0, 0, 1, 2, 3])):
            name = self.random.choice(
                ["translate", "scale", "rotate", "around", "skewX", "skewY", "matrix"]
            )
            text, function = getattr(self, f"_{name}")()
            texts.append(text)
            maps.append(function)
        return (
            f' transform="{self.random.choice([" ", ", ", ""]).join(texts)}"'
            if texts
            else ""
        ), maps

    def _translate(self):
        x, y = self.number(), self.number()
        if self.random.random() < 0.3:
            return f"translate({x})", lambda z: z + x
        return f"translate({x} {y})", lambda z: z + complex(x, y)

    def _scale(self):
        x, y = (
            self.random.choice([0.5, -1.0, 1.5]),
            self.random.choice([0.7, -0.5, 2.0]),
        )
        if self.random.random() < 0.3:
            return f"scale({x})", lambda z: x * z
        return f"scale({x},{y})", lambda z: x * z.real + 1j * y * z.imag

    def _rotate(self):
        degrees = self.random.choice([30, -45, 90, 123.4])
        return f"rotate({degrees})", lambda z: z * np.exp(1j * math.radians(degrees))

    def _around(self):
        degrees, x, y = self.random.choice([30, -60, 180]), self.number(), self.number()
        centre = complex(x, y)
        return (
            f"rotate({degrees}, {x} {y})",
            lambda z: (z - centre) * np.exp(1j * math.radians(degrees)) + centre,
        )

    def _skewX(self):
        degrees = self.random.choice([20, -30, 45])
        return (
            f"skewX({degrees})",
            lambda z: z + math.tan(math.radians(degrees)) * z.imag,
        )

    def _skewY(self):
        degrees = self.random.choice([20, -30, 45])
        return (
            f"skewY({degrees})",
            lambda z: z + 1j * math.tan(math.radians(degrees)) * z.real,
        )

    def _matrix(self):
        a, b, c, d = self.random.choice(
            [(1, 0.5, -0.3, 1.2), (0, 1, -1, 0), (-0.8, 0.1, 0.4, 0.9)]
        )
        e, f = self.number(), self.number()
        return (
            f"matrix({a} {b} {c} {d} {e} {f})",
            lambda z: (
                (a * z.real + c * z.imag + e) + 1j * (b * z.real + d * z.imag + f)
            ),
        )

    def rect(self):
        x, y, w, h = self.number(), self.number(), self.size(), self.size()
        text = f'x="{x}" y="{y}" width="{w}" height="{h}"'
        if self.random.random() < 0.5:
            return [
                ("M", x, y),
                ("L", x + w, y),
                ("L", x + w, y + h),
                ("L", x, y + h),
                ("Z",),
            ], text
        rx, ry = min(self.size(), 0.4 * w), min(self.size(), 0.4 * h)
        arc = ("A", rx, ry, 0, 0, 1)
        d = [
            ("M", x + rx, y),
            ("L", x + w - rx, y),
            (*arc, x + w, y + ry),
            ("L", x + w, y + h - ry),
            (*arc, x + w - rx, y + h),
            ("L", x + rx, y + h),
            (*arc, x, y + h - ry),
            ("L", x, y + ry),
            (*arc, x + rx, y),
            ("Z",),
        ]
        return d, f'{text} rx="{rx}" ry="{ry}"'

    def ellipse(self, r=None):
        x, y = self.number(), self.number()
        rx, ry = (r, r) if r else (self.size(), self.size())
        arc = ("A", rx, ry, 0, 0, 1)
        d = [
            ("M", x + rx, y),
            (*arc, x, y + ry),
            (*arc, x - rx, y),
            (*arc, x, y - ry),
            (*arc, x + rx, y),
            ("Z",),
        ]
        return d, f'cx="{x}" cy="{y}" ' + (f'r="{r}"' if r else f'rx="{rx}" ry="{ry}"')

    def circle(self):
        return self.ellipse(self.size())

    def line(self):
        a, b, c, d = (self.number() for _ in range(4))
        return [("M", a, b), ("L", c, d)], f'x1="{a}" y1="{b}" x2="{c}" y2="{d}"'

    def polyline(self):
        places = [
            (self.number(), self.number()) for _ in range(self.random.randint(2, 6))
        ]
        return [
            ("M", *places[0]),
            *(("L", *place) for place in places[1:]),
        ], f'points="{self.joined(places)}"'

    def polygon(self):
        d, text = self.polyline()
        return [*d, ("Z",)], text

    def joined(self, places):
        return self.random.choice([" ", ",", ", "]).join(f"{x},{y}" for x, y in places)

    def path(self):
        """Random commands, written out or minified."""
        counts = {
            "L": 2,
            "H": 1,
            "V": 1,
            "C": 6,
            "S": 4,
            "Q": 4,
            "T": 2,
            "l": 2,
            "h": 1,
            "v": 1,
            "c": 6,
            "s": 4,
            "q": 4,
            "t": 2,
            "Z": 0,
            "z": 0,
            "M": 2,
            "m": 2,
        }
        d = [(self.random.choice("Mm"), self.number(), self.number())]
        for _ in range(self.random.randint(1, 8)):
            kind = self.random.choice([*counts, "A", "a", "A", "a", "A", "a"])
            if kind in "Aa":
                flags = self.random.randint(0, 1), self.random.randint(0, 1)
                turn = self.random.choice([0, 30, -77.5])
                d.append(
                    (
                        kind,
                        self.size(),
                        self.size(),
                        turn,
                        *flags,
                        self.number() + 0.003,
                        self.number(),
                    )
                )
            else:
                d.append((kind, *(self.number() for _ in range(counts[kind]))))
        d.append(("l", 1, 2))
        return d, f'd="{self.written(d)}"'

    def written(self, d):
        is_minified = self.random.random() < 0.7
        text, before = "", ""
        for name, *numbers in d:
            goes_on = {"M": "L", "m": "l"}.get(
                before, before
            ) == name and name not in "MmZz"
            if not (is_minified and goes_on):
                text += name if is_minified else f" {name} "
            for k, number in enumerate(numbers):
                text = self.appended(
                    text,
                    number,
                    is_minified,
                    is_after_flag=name in "Aa" and k in (4, 5),
                )
            before = name
        return text

    def appended(self, text, number, is_minified, is_after_flag):
        """The text and one number more, with a separator where it needs one."""
        shown = f"{number:g}"
        if not is_minified:
            return f"{text}{shown} "
        shown = re.sub(r"^(-?)0\.", r"\1.", shown)
        last = re.search(r"[0-9.]+$", text)
        is_glued = (
            is_after_flag
            or last is None
            or shown[0] == "-"
            or (shown[0] == "." and "." in last.group())
        )
        return text + ("" if is_glued else " ") + shown


def sampled(d):
    """The strokes of commands, complex places: the end of a line, LINES places of a curve."""
    strokes, here, handle, before = [], 0j, 0j, ""
    for name, *n in d:
        kind, base = name.upper(), here if name.islower() else 0j
        if kind == "Z":
            here = strokes[-1][0]
            strokes[-1].append(here)
            strokes.append([here])
        elif kind == "A":
            end = complex(n[5], n[6]) + base
            strokes[-1] += arc(here, *n[:5], end)
            here = end
        elif kind in "HV":
            here = (
                complex(n[0] + base.real, here.imag)
                if kind == "H"
                else complex(here.real, n[0] + base.imag)
            )
            strokes[-1].append(here)
        else:
            places = [
                complex(x, y) + base for x, y in zip(n[::2], n[1::2], strict=True)
            ]
            if kind in "ST":
                places.insert(
                    0,
                    2.0 * here - handle
                    if before in {"S": "CS", "T": "QT"}[kind] and before
                    else here,
                )
            if kind == "M":
                strokes.append([places[0]])
            elif kind == "L":
                strokes[-1].append(places[0])
            else:
                strokes[-1] += bezier([here, *places])
            handle = places[-2] if kind in "CSQT" else 0j
            here = places[-1]
        before = kind
    return [
        np.array(stroke)
        for stroke in strokes
        if any(place != stroke[0] for place in stroke)
    ]


def bezier(points):
    t = np.arange(1, LINES + 1) / LINES
    degree = len(points) - 1
    return list(
        sum(
            math.comb(degree, k) * t**k * (1 - t) ** (degree - k) * point
            for k, point in enumerate(points)
        )
    )


def arc(here, rx, ry, degrees, large, sweep, end):
    """Places on an arc, from its implicit equation: in units where the ellipse is the unit circle."""
    turn = np.exp(1j * math.radians(degrees))
    first, last = (
        (z / turn).real / rx + 1j * (z / turn).imag / ry for z in (here, end)
    )
    chord = last - first
    grown = max(1.0, abs(chord) / 2.0)
    first, last, chord = first / grown, last / grown, chord / grown
    height = math.sqrt(max(0.0, 1.0 - (abs(chord) / 2.0) ** 2))
    side = 1j if bool(large) != bool(sweep) else -1j
    centre = (first + last) / 2.0 + side * height * chord / abs(chord)
    angle = np.angle((last - centre) / (first - centre))
    if sweep and angle < 0.0:
        angle += 2.0 * math.pi
    if not sweep and angle > 0.0:
        angle -= 2.0 * math.pi
    places = centre + (first - centre) * np.exp(
        1j * angle * np.arange(1, LINES + 1) / LINES
    )
    places *= grown
    return list(turn * (rx * places.real + 1j * ry * places.imag))


@pytest.mark.parametrize("seed", range(200))
def test_generated_files_are_read_as_the_definitions_say(seed):
    generator = Generator(seed)
    text = generator.document(with_use=True)
    read = [
        (stroke[:, 0] - 1j * stroke[:, 1]) / COARSE
        for stroke in parse_svg(text, "a.svg", COARSE)
    ]
    assert len(read) == len(generator.strokes)
    for stroke, wanted in zip(read, generator.strokes, strict=True):
        assert stroke == pytest.approx(wanted, abs=2e-3), text


def distance_to(places, lines):
    """The largest distance of places from straight lines (k, 2), complex."""
    a, b = lines[None, :, 0], lines[None, :, 1]
    along = np.clip(
        ((places[:, None] - a) * np.conj(b - a)).real
        / np.maximum(np.abs(b - a) ** 2, 1e-30),
        0.0,
        1.0,
    )
    return float(np.abs(places[:, None] - a - along * (b - a)).min(axis=1).max())


def lines_of(strokes):
    return np.concatenate(
        [np.column_stack([stroke[:-1], stroke[1:]]) for stroke in strokes]
    )


def sampled_by_svgpathtools(text):
    """Return the places of each segment, complex.

    `transform` of svgpathtools 1.8.0 makes other ellipses of some arcs that are turned or sheared. This function
    samples arcs before the transform, and multiplies their places by the matrix that svgpathtools finds.
    """
    t = np.linspace(0.0, 1.0, 100)
    found = []
    for path in Document.from_svg_string(text).paths():
        convert = CONVERSIONS[path.element.tag.rpartition("}")[2]]
        matrix = np.array(path.transform)
        for segment, plain in zip(path, parse_path(convert(path.element)), strict=True):
            if isinstance(plain, Arc):
                place = plain.point(t)
                x, y, _ = matrix @ np.array([place.real, place.imag, np.ones(len(t))])
                found.append(x + 1j * y)
            else:
                found.append(
                    segment.point(t[[0, -1]] if isinstance(segment, Line) else t)
                )
    return found


@pytest.mark.parametrize("seed", range(1000, 1080))
def test_generated_files_are_read_as_svgpathtools_samples_them(seed):
    text = Generator(seed).document(with_use=False)
    wanted = sampled_by_svgpathtools(text)
    read = [
        stroke[:, 0] - 1j * stroke[:, 1] for stroke in parse_svg(text, "a.svg", FINE)
    ]
    assert distance_to(np.concatenate(wanted), lines_of(read)) < 0.01, text
    assert distance_to(np.concatenate(read), lines_of(wanted)) < 0.02, text
    length = np.abs(np.diff(lines_of(read), axis=1)).sum()
    assert length == pytest.approx(
        np.abs(np.diff(lines_of(wanted), axis=1)).sum(), rel=0.01
    ), text
