import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.svg_clip_reader import ClipReader
from crazychoir.planning.drawing.svg_document import index_by_id, read_document
from crazychoir.planning.drawing.svg_outline import ShapeOutlines
from crazychoir.planning.drawing.svg_report import SVG_ADVICE, SvgReport
from crazychoir.planning.drawing.svg_scene import ElementScene
from crazychoir.planning.drawing.svg_style import StyleSheets

SCENE = ElementScene(np.eye(3), {}, None)


def read_clips(clip, **style):
    """Return the clips of an element with this style, in a document with this clip path."""
    root = read_document(f"<svg>{clip}<line/></svg>", "a.svg")
    report = SvgReport("a.svg")
    reader = ClipReader(
        StyleSheets(root, "a.svg"),
        index_by_id(root),
        ShapeOutlines(1.0, report),
        report,
    )
    style = {name.replace("_", "-"): value for name, value in style.items()}
    return reader.read_clips(root.children[-1], style, SCENE)


def test_the_clip_of_a_convex_shape_is_moved_by_its_transforms():
    clip = '<clipPath id="a" transform="translate(3)"><rect width="2" height="1"/></clipPath>'
    (outline,) = read_clips(clip, clip_path="url('#a')")
    assert outline.owner == '<clipPath id="a"> in line 1'
    assert outline.corners.min(axis=0).tolist() == [3, 0]
    assert outline.corners.max(axis=0).tolist() == [5, 1]


@pytest.mark.parametrize("value", ["none", "inherit", "initial", "url(#unknown)"])
def test_no_clip_is_read_where_none_applies(value):
    assert read_clips('<clipPath id="a"/>', clip_path=value, mask=value) == ()


@pytest.mark.parametrize(
    ("clip", "style", "words"),
    [
        ("", {"mask": "url(b.svg#a)"}, "with mask"),
        ("", {"clip_path": "circle(3px)"}, "with clip-path"),
        ('<g id="a"/>', {"clip_path": "url(#a)"}, "with clip-path"),
        ('<clipPath id="a"/>', {"clip_path": "url(#a)"}, "more than one shape"),
        (
            '<clipPath id="a"><path d="M0 0H4V4L2 1 0 4z"/></clipPath>',
            {"clip_path": "url(#a)"},
            "not convex",
        ),
    ],
)
def test_other_clips_are_refused_with_advice(clip, style, words):
    with pytest.raises(ConfigError, match=words) as raised:
        read_clips(clip, **style)
    assert str(raised.value).endswith(SVG_ADVICE.release)
