from crazychoir.planning.drawing.svg_document import SvgElement
from crazychoir.planning.drawing.svg_report import SVG_ADVICE, SvgReport

CIRCLE = SvgElement("circle", {"id": "eye"}, 7)


def test_remarks_keep_their_order_and_name_the_element():
    report = SvgReport("a.svg")
    report.note("first")
    report.leave_out(CIRCLE, "it has no size")
    assert report.words == [
        "first",
        '<circle id="eye"> in line 7: left out: it has no size',
    ]


def test_a_refusal_names_the_file_the_element_and_what_to_do():
    text = str(SvgReport("a.svg").build_refusal(CIRCLE, "with r=x", "Delete it."))
    assert text.startswith('a.svg: found <circle id="eye"> in line 7 with r=x')
    assert SVG_ADVICE.flown in text
    assert text.endswith("Delete it.")
