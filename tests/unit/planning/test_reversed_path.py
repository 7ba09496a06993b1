"""A path of polynomials that is flown from its end to its start."""

import numpy as np

from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.trajectory_file import read_pieces


def test_reversed_path_is_the_path_backwards_with_all_derivatives():
    path = minimum_snap(
        [[0, 0, 1], [1, 0.5, 1.2], [2, 0, 1]], [0.0, 1.5, 4.0], yaws=[0.0, 0.5, 1.0]
    )
    back = path.reversed()
    t = np.linspace(0.0, path.duration, 101)
    signs = np.array([1.0] * 3 + [-1.0] * 3 + [1.0] * 3 + [-1.0] * 3 + [1.0, -1.0])
    there = path.samples(path.duration - t)
    assert np.allclose(back.samples(t), signs * there, atol=1e-8)
    assert np.allclose(back.durations, path.durations[::-1])
    assert np.allclose(back.reversed().coefficients, path.coefficients, atol=1e-9)


def test_shipped_figure_of_eight_begins_and_ends_at_rest_at_its_centre(repository):
    path = read_pieces(repository / "agents" / "data" / "figure8.csv")
    assert np.allclose(path.sample(0.0).flat, 0.0)
    assert np.allclose(path.end, 0.0, atol=1e-9)
    places = path.samples(np.linspace(0.0, path.duration, 500))[:, 0:3]
    assert np.allclose(np.abs(places).max(axis=0), [0.8, 0.4, 0.0], atol=0.01)
    assert path.peaks[0] < 1.0
