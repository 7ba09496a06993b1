import numpy as np
import pytest

from crazychoir.errors import SolverError
from crazychoir.optimization.problems.equilibration import (
    find_scaling_exponents,
    invert_scaled,
    remove_rounding,
)


@pytest.mark.parametrize("seed", range(20))
def test_the_inverse_is_as_exact_in_any_units(seed):
    chance = np.random.default_rng(seed)
    m = int(chance.integers(1, 12))
    B = chance.normal(size=(m, m)) * (chance.random((m, m)) < 0.7) + 3.0 * np.eye(m)
    r = 10.0 ** chance.uniform(-9, 9, m)
    s = 10.0 ** chance.uniform(-9, 9, m)
    inverse = invert_scaled(r[:, None] * B * s)
    np.testing.assert_allclose(
        s[:, None] * inverse * r, np.linalg.inv(B), rtol=1e-9, atol=1e-11
    )


def test_units_that_are_powers_of_two_change_no_bit():
    chance = np.random.default_rng(1)
    B = chance.normal(size=(6, 6))
    r = 2.0 ** chance.integers(-40, 40, 6)
    s = 2.0 ** chance.integers(-40, 40, 6)
    plain = invert_scaled(2.0 ** chance.integers(-40, 40, 6)[:, None] * B * 1.0)
    assert plain.shape == (6, 6)
    one = s[:, None] * invert_scaled(r[:, None] * B * s) * r
    other = s[::-1, None] * invert_scaled(r[::-1, None] * B * s[::-1]) * r[::-1]
    np.testing.assert_allclose(one, other, rtol=1e-13)


def test_zeros_of_a_triangular_matrix_stay_exact_zeros():
    chance = np.random.default_rng(2)
    B = np.triu(chance.normal(size=(7, 7))) + 2.0 * np.eye(7)
    inverse = invert_scaled(
        10.0 ** chance.uniform(-6, 6, 7)[:, None] * B * 10.0 ** chance.uniform(-6, 6, 7)
    )
    assert (np.tril(inverse, -1) == 0.0).all()


def test_scaling_brings_all_entries_near_1():
    chance = np.random.default_rng(3)
    B = 2.0 ** (chance.integers(-30, 30, 5)[:, None] + chance.integers(-30, 30, 8))
    r, s = find_scaling_exponents(B)
    assert np.abs(np.log2(np.ldexp(B, r[:, None] + s))).max() <= 2.0
    assert not np.concatenate(
        find_scaling_exponents(np.array([[1.0, 0.0], [0.5, 3.0]]))
    ).any()


@pytest.mark.parametrize(
    "B", [np.zeros((2, 2)), np.ones((2, 2)), np.array([[1e6, 3e6], [1e-6, 3e-6]])]
)
def test_dependent_columns_are_refused(B):
    with pytest.raises(SolverError, match="a singular basis"):
        invert_scaled(B)


def test_a_sum_that_rounding_explains_is_zero_whatever_the_others_are():
    value = np.array([1e-17, 1e-17, -1e-3])
    assert remove_rounding(value, np.array([1.0, 1e-17, 1.0])).tolist() == [
        0.0,
        1e-17,
        -1e-3,
    ]
