import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing import svg_outline
from crazychoir.planning.drawing.svg_document import SvgElement
from crazychoir.planning.drawing.svg_outline import ShapeOutlines
from crazychoir.planning.drawing.svg_report import SvgReport
from crazychoir.planning.drawing.svg_scene import ElementScene

SCENE = ElementScene(np.eye(3), {}, None)
DOUBLED = SCENE.transformed(np.diag([2.0, 2.0, 1.0]))


def draw(name, scale=1.0, scene=SCENE, **attributes):
    outlines = ShapeOutlines(scale, SvgReport("a.svg"))
    return outlines.draw(SvgElement(name, attributes, 3), scene)


def test_an_outline_is_in_units_of_the_picture():
    (line,) = draw("line", scene=DOUBLED, x1="1", y1="2", x2="3", y2="2")
    assert line.tolist() == [[2, 4], [6, 4]]


def test_a_larger_flight_has_more_places():
    (small,) = draw("circle", r="1")
    (scaled,) = draw("circle", r="1", scale=4.0)
    (moved,) = draw("circle", r="1", scale=2.0, scene=DOUBLED)
    assert len(scaled) > len(small)
    assert len(moved) == len(scaled)


def test_an_outline_of_too_many_places_is_refused(monkeypatch):
    monkeypatch.setattr(svg_outline, "MOST_POINTS", 3)
    assert len(draw("polyline", points="0 0 1 0 1 1")[0]) == 3
    with pytest.raises(ConfigError, match="more than 3 places up to <polyline>"):
        draw("polyline", points="0 0 1 0 1 1 2 2 3 3")


def test_an_outline_without_end_is_refused():
    with pytest.raises(ConfigError, match="line 3 with places that are not finite"):
        draw("path", d="M0 0L1.7e308 0l1.7e308 0")
