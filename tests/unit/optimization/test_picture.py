"""Pictures of what converges, and of what does not."""

import warnings

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.optimization.picture import draw_convergence

STEPS = np.arange(5.0)


@pytest.mark.parametrize(
    "series",
    [
        {
            0: np.outer(STEPS, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
            7: np.outer(STEPS, np.ones(6)),
        },
        {0: STEPS, 1: np.outer(STEPS, [1.0, 2.0])},
        {0: np.zeros(5), 1: np.zeros(5)},
        {0: STEPS > 2, 1: STEPS > 3},
        {0: np.ones((5, 2, 2))},
    ],
)
def test_any_numbers_are_drawn(tmp_path, series):
    with warnings.catch_warnings(action="error"):
        draw_convergence(series, tmp_path / "p.png", "x", "title")
        draw_convergence(
            series, tmp_path / "t.png", "x", times={i: STEPS * 0.1 for i in series}
        )
    assert all(
        (tmp_path / name).read_bytes()[:4] == b"\x89PNG" for name in ("p.png", "t.png")
    )


@pytest.mark.parametrize(
    ("common", "what"), [(True, "the mean at the end"), (False, "its own end")]
)
def test_what_each_has_for_itself_is_drawn_with_its_distance_from_its_own_end(
    tmp_path, common, what
):
    draw_convergence({0: STEPS, 1: -STEPS}, tmp_path / "p.svg", "x", common=common)
    assert f"<!-- {what} -->" in (tmp_path / "p.svg").read_text()


def test_what_is_no_array_of_numbers_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="picture: basis of agent 3"):
        draw_convergence({3: [[1.0], [1.0, 2.0]]}, tmp_path / "p.png", "basis")
