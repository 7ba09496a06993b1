import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.drawing_file import parse_drawing, read_drawing

SVG = '<svg xmlns="http://www.w3.org/2000/svg"><path id="e" d=""/><path d="M0 0L1000 0"/></svg>'
CSV = "# by hand\nstroke,t,x,y\n0,0,0,0\n0,1,1,0\n"


def test_a_drawing_is_read_by_the_end_of_its_name(tmp_path):
    for name, text, is_timed in (("a.SVG", SVG, False), ("a.csv", CSV, True)):
        (tmp_path / name).write_text(text)
        for drawn in (read_drawing(tmp_path / name), parse_drawing(text, name)):
            (stroke,) = drawn.strokes
            assert stroke[:, -2:].tolist() == [[0, 0], [1, 0]]
            assert drawn.is_timed == is_timed
            assert len(drawn.words) == (0 if is_timed else 1)


def test_a_drawing_that_is_compressed_or_of_another_kind_is_refused(tmp_path):
    (tmp_path / "a.svgz").write_bytes(b"\x1f\x8b\x08")
    with pytest.raises(ConfigError, match="gunzip"):
        read_drawing(tmp_path / "a.svgz")
    with pytest.raises(ConfigError, match=r"ends in \.csv or \.svg"):
        parse_drawing(SVG, "a.txt")
