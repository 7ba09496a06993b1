"""Drawings before they are flown, and flights compared with their drawings."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load_mission
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.trajectory_file import write_pieces


def test_a_drawing_that_is_too_fine_is_refused_before_the_flight(tmp_path):
    file = tmp_path / "waves.csv"
    x = np.linspace(0.0, 1.0, 1500)
    y = 0.1 * np.sin(2.0 * np.pi * x / 0.03)
    rows = [f"0,{0.01 * k:.2f},{x[k]:.5f},{y[k]:.5f}" for k in range(len(x))]
    file.write_text("\n".join(["stroke,t,x,y", *rows]))
    mission = load_mission("drawn_path")
    config = mission.swarm(1).replace(mission_options={"drawing": str(file)})
    words = r"drone 0: drawing: strokes\[0\]: found a flight \d+ mm beside it.*at most 39 mm.*Draw it larger"
    with pytest.raises(ConfigError, match=words):
        mission.check(config)


def test_a_word_that_is_not_flown_as_it_was_drawn_is_no_success():
    mission = load_mission("drawn_path")
    config = mission.swarm(1)
    path = mission.hooks.drawing(config, 0).path
    rows = [[t, *path.sample(t).p.tolist()] for t in np.arange(0.0, path.duration, 0.1)]
    good = mission.report(config, {0: {"way": rows}})
    assert good["success"]
    assert good["written_mm"][0] < 15.0
    for wrong in (
        rows[: len(rows) // 2],
        [[t, x, y + 0.1, z] for t, x, y, z in rows],
        [],
    ):
        report = mission.report(config, {0: {"way": wrong}})
        assert report["success"] is False
        assert "from its drawing, allowed 60 mm" in report["reasons"][0]


def test_a_trajectory_of_a_file_starts_over_each_home_at_the_height_of_the_options(
    tmp_path,
):
    file = tmp_path / "hop.csv"
    write_pieces(file, minimum_snap([[3, 3, 0], [3.5, 3, 0.4]], [0.0, 2.0]))
    mission = load_mission("drawn_path")
    options = {"drawing": str(file), "height": 1.3, "slower": 2.0, "scale": 2.0}
    config = mission.swarm(2).replace(mission_options=options)
    assert "the drawing takes 4.0 s" in mission.check(config)[0]
    path = mission.hooks.drawing(config, 1).path
    np.testing.assert_allclose(path.sample(0.0).p, (0.0, 1.5, 1.3), atol=1e-9)
    np.testing.assert_allclose(path.sample(4.0).p, (1.0, 1.5, 2.1), atol=1e-9)
    rows = [[t, *path.sample(t).p.tolist()] for t in np.arange(0.0, 4.0, 0.1)]
    report = mission.report(config, {0: {"way": rows}, 1: {"way": rows}})
    assert report["written_mm"][1] < 5.0
    assert report["reasons"][0].startswith("15")
    with pytest.raises(ConfigError, match=r"hop.csv: found up to .*slower = "):
        mission.check(
            config.replace(mission_options={"drawing": str(file), "scale": 4.0})
        )
