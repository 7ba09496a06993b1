"""The picture of a survey; how it looks is for eyes."""

from crazychoir.radio.survey.survey import ChannelResult
from crazychoir.radio.survey.survey_picture import draw_survey

ROWS = [
    ChannelResult(10, (1.0, 0.5), (90, 5, 3, 1, 1), (0.001, 0.002), (-50.0, 1.0)),
    ChannelResult(12, (0.0, 0.0), (0, 0, 0, 0, 100), None, None),
    ChannelResult(20, (1.0, 0.9), (99, 1, 0, 0, 0), (0.001, 0.001), (-55.0, 2.0)),
]


def test_a_survey_is_drawn_with_unanswered_channels_and_the_truth_of_a_model(
    tmp_path,
):
    files = [tmp_path / name for name in ("real.png", "simulated.png")]
    draw_survey(ROWS, (20,), files[0])
    draw_survey(ROWS, (20,), files[1], {10: 0.7, 12: 0.0, 20: 0.96})
    assert [file.read_bytes()[:4] for file in files] == [b"\x89PNG"] * 2
    assert files[0].read_bytes() != files[1].read_bytes()
