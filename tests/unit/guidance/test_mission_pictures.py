"""Pictures of flights from above: which lines they hold."""

import numpy as np
import pytest

from crazychoir.guidance import mission_pictures
from crazychoir.guidance.defaults.figures import FigureHooks, FigureOptions
from crazychoir.guidance.mission import load_mission

HOOKS = FigureHooks(FigureOptions)
SWARM = load_mission("targets").swarm(2)


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Draw the picture of two circles; return its lines by their colour."""
    figures = []

    def keep(figure, path, **options):
        figures.append(figure)

    def draw(results):
        monkeypatch.setattr(mission_pictures, "save_figure", keep)
        HOOKS.picture(SWARM, results, str(tmp_path / "figure.png"))
        found = {}
        for line in figures[-1].axes[0].lines:
            found.setdefault(line.get_color(), []).append(line.get_xydata())
        return found

    return draw


PLAN = mission_pictures.PLAN_STYLE["color"]
FIRST, SECOND = mission_pictures.PICTURE_STYLE.colours[:2]


def test_a_picture_of_figures_shows_what_was_flown_over_the_plan(drawn):
    way = [[0.0, 1.0, 2.0, 1.0], [0.1, 1.1, 2.2, 1.0]]
    lines = drawn({0: {"way": way}, 1: {"way": way}})
    assert len(lines[PLAN]) == 2
    np.testing.assert_allclose(lines[FIRST][0], [[1.0, 2.0], [1.1, 2.2]])
    np.testing.assert_allclose(lines[SECOND][0], [[1.0, 2.0], [1.1, 2.2]])


def test_a_picture_shows_the_whole_flight_of_a_drone_that_failed(drawn):
    track = np.array([[0.0, 0.0, 0.0, 0.0], [5.0, 0.2, 0.0, 0.6]])
    lines = drawn({0: {"success": False, "track": track}, 1: {"success": False}})
    np.testing.assert_allclose(lines[FIRST][0], [[0.0, 0.0], [0.2, 0.0]])
    assert SECOND not in lines
    assert len(lines[PLAN]) == 2
