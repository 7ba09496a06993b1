"""Eigenvalues of formation laws."""

import numpy as np
import pytest

from crazychoir.guidance.formation import shapes
from crazychoir.guidance.formation.bearing import (
    analyse_normalised_law,
    build_bearing_laplacian,
    normalise_laplacian,
)
from crazychoir.guidance.formation.modes import (
    NYQUIST_FREQUENCIES,
    AccelerationChain,
    _choose_decisive,
    _compute_attitude_response,
    _compute_law_response,
    _is_stable,
)
from crazychoir.guidance.formation.spectrum import find_all


def lattice(rows, columns):
    """Return the followers' Laplacian of a grid, with the corners as leaders."""
    shape = shapes.grid(rows, columns, 0.7)
    neighbors = {i: set() for i in shape}
    for i, j in shapes.grid_edges(rows, columns):
        neighbors[i].add(j)
        neighbors[j].add(i)
    b_ff, _, followers = build_bearing_laplacian(
        shape, neighbors, shapes.corners(rows, columns)
    )
    return b_ff, followers


def test_the_extremes_are_those_of_all_eigenvalues():
    b_ff, followers = lattice(7, 6)
    whole = find_all(normalise_laplacian(b_ff, followers)).values.real

    found = analyse_normalised_law(b_ff, followers, every=False)

    np.testing.assert_allclose(
        np.sort(found.values), [whole.min(), whole.max()], rtol=1e-9
    )
    matrix = normalise_laplacian(b_ff, followers)
    np.testing.assert_allclose(
        matrix @ found.softest, whole.min() * found.softest, atol=1e-6
    )


@pytest.mark.parametrize("d", [0.0, 0.02, 0.06, 0.15])
@pytest.mark.parametrize("kp", [1.0, 8.0])
def test_the_decisive_modes_decide_for_all(d, kp):
    m = np.linspace(-0.99, 0.995, 60)
    law = _compute_attitude_response(AccelerationChain()) * _compute_law_response(
        kp, 1.5
    )
    stable = {each: _is_stable(each, law, d, 0.0) for each in m}

    chosen = _choose_decisive(m, law, d, 0.0)

    assert len(chosen) < len(m)
    assert all(stable[each] for each in chosen) == all(stable.values())
    assert len(law) == len(NYQUIST_FREQUENCIES)
