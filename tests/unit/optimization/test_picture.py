"""Pictures of what converges, and of what does not."""

import warnings

import numpy as np
import pytest
from matplotlib.figure import Figure

from crazychoir.errors import ConfigError
from crazychoir.optimization.picture import draw_convergence, fill_convergence

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
        draw_convergence({"x": series}, tmp_path / "p.png", "title")
        draw_convergence(
            {"x": series}, tmp_path / "t.png", times={i: STEPS * 0.1 for i in series}
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
    recorded = {"x": {0: STEPS, 1: -STEPS}}
    draw_convergence(recorded, tmp_path / "p.svg", common=common)
    assert f"<!-- {what} -->" in (tmp_path / "p.svg").read_text()


def test_what_is_no_array_of_numbers_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="picture: basis of agent 3"):
        draw_convergence({"basis": {3: [[1.0], [1.0, 2.0]]}}, tmp_path / "p.png")


def test_each_recorded_value_is_drawn_and_an_error_on_a_logarithmic_axis_alone():
    figure = Figure()
    series = {0: STEPS, 1: STEPS + 1.0}
    errors = {0: np.exp(-STEPS), 1: np.zeros(5)}
    fill_convergence(figure, {"x": series, "error": errors})
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == [
        "x of each agent",
        "distance of x from\nthe mean at the end",
        "error of each agent",
    ]
    assert [axes.get_yscale() for axes in figure.axes] == ["linear", "log", "log"]
    np.testing.assert_array_equal(figure.axes[2].lines[0].get_ydata(), errors[0])
