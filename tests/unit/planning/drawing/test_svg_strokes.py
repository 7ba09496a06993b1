import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing import svg_strokes
from crazychoir.planning.drawing.svg_clip import ClipOutline
from crazychoir.planning.drawing.svg_document import SvgElement
from crazychoir.planning.drawing.svg_outline import ShapeOutlines
from crazychoir.planning.drawing.svg_report import SvgReport
from crazychoir.planning.drawing.svg_scene import ElementScene
from crazychoir.planning.drawing.svg_shapes import SvgPage
from crazychoir.planning.drawing.svg_strokes import VisibleStrokes

LINE = SvgElement("line", {"x2": "1"}, 3)
LABEL = "<line> in line 3"
WINDOW = np.array([[-1.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-1.0, 1.0]])


@pytest.fixture
def report():
    return SvgReport("a.svg")


def scene(clips=(), **inherited):
    return ElementScene(np.eye(3), inherited, None, clips)


def collect(report, page=None):
    return VisibleStrokes(ShapeOutlines(1.0, report), page, report)


@pytest.mark.parametrize(
    ("inherited", "reason"),
    [
        ({"visibility": "hidden"}, "visibility: hidden"),
        ({"stroke": "none"}, "neither fill nor stroke"),
    ],
)
def test_unseen_shapes_are_left_out_with_a_reason(report, inherited, reason):
    visible = collect(report)
    visible.add_shape(LINE, {}, scene(**inherited))
    assert visible.strokes == []
    assert report.words == [f"{LABEL}: left out: {reason}"]


def test_a_visible_shape_is_kept_and_its_markers_are_named(report):
    visible = collect(report)
    visible.add_shape(LINE, {"marker-end": "url(#a)"}, scene())
    assert visible.strokes[0].tolist() == [[0, 0], [1, 0]]
    assert report.words == [f"{LABEL}: flown without its markers"]


def test_a_shape_beside_the_page_is_flown_with_a_remark(report):
    visible = collect(report, SvgPage((5.0, 0.0), (9.0, 9.0)))
    visible.add_shape(LINE, {}, scene())
    assert len(visible.strokes) == 1
    assert report.words == [f"{LABEL}: flown, though it is beside the page"]


def test_a_clip_keeps_leaves_out_or_refuses_a_stroke(report):
    visible = collect(report)
    visible.add_shape(LINE, {}, scene((ClipOutline(WINDOW, "the clip"),)))
    assert len(visible.strokes) == 1
    visible.add_shape(LINE, {}, scene((ClipOutline(WINDOW + 5.0, "the clip"),)))
    assert len(visible.strokes) == 1
    assert report.words == [f"{LABEL}: left out: it is outside of the clip"]
    with pytest.raises(ConfigError, match="the clip cuts off a part of it"):
        visible.add_shape(
            LINE, {}, scene((ClipOutline(WINDOW - (1.5, 0.0), "the clip"),))
        )


def test_the_places_of_all_shapes_are_counted_together(report, monkeypatch):
    monkeypatch.setattr(svg_strokes, "MOST_POINTS", 5)
    visible = collect(report)
    visible.add_shape(LINE, {}, scene())
    visible.add_shape(LINE, {}, scene())
    with pytest.raises(ConfigError, match="places up to <line>"):
        visible.add_shape(LINE, {}, scene())
