"""Figures around the homes of drones."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.guidance.defaults.figures import FigureHooks, FigureOptions
from crazychoir.guidance.mission import load_mission

HOOKS = FigureHooks(FigureOptions)
SWARM = load_mission("targets").swarm(2)


def test_a_circle_lies_around_the_home():
    config = SWARM.replace(mission_options={"size": 0.5, "laps": 1.0})
    figure = HOOKS.figure(config, 1)
    center = np.add(config.drone(1).home, [0.0, 0.0, config.flight.takeoff_height])
    for t in np.linspace(0.0, figure.duration, 20):
        assert np.linalg.norm(figure.sample(t).p - center) == pytest.approx(0.5)


def test_the_length_is_that_of_the_circles():
    config = SWARM.replace(mission_options={"size": 0.5, "laps": 2.0})
    length = HOOKS.report(config, {})["figure_m"]
    assert length >= 2.0 * np.pi * 0.5 * 2.0 - 0.05


def test_a_figure_that_is_too_fast_is_refused_by_drone():
    config = SWARM.replace(mission_options={"size": 1.0, "period": 1.0})
    with pytest.raises(ConfigError, match="mission_options: drone 0: trajectory"):
        HOOKS.check(config)
