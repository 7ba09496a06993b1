"""Compressed messages: the compressors keep their quality, CHOCO follows its equations and its rate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from in_step import run_in_step

from crazychoir.optimization.algorithms.compressed.choco import (
    ChocoGossip,
    ChocoSGD,
    ChocoSteps,
    choco_gamma,
)
from crazychoir.optimization.algorithms.compressed.compressors import (
    Quantised,
    TopK,
    pack_bits,
    unpack_bits,
)
from crazychoir.optimization.generate import random_quadratics
from crazychoir.optimization.rounds.mixing import team
from crazychoir.optimization.rounds.step_size import Diminishing
from crazychoir.team import graph as graphs

GRAPH = graphs.erdos_renyi_connected(6, 0.5, 1)
WEIGHTS = graphs.metropolis(GRAPH)
W = np.array([[WEIGHTS[i].get(j, 0.0) for j in range(6)] for i in range(6)])
START = np.random.default_rng(0).normal(size=(6, 8))
Q = random_quadratics(6, 3, seed=1)
COMPRESSORS = (Quantised(2), Quantised(5), Quantised(4, seed=7), TopK(1), TopK(3))
ENTRIES = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=12).map(np.array)


def gathered(agents, name):
    return np.array([getattr(agent, name) for agent in agents.values()])


def compressed(compressor, x, k):
    """Q of each row of x, in message k."""
    return np.array(
        [
            compressor.decode(compressor.encode(row, i, k), len(row), i, k)
            for i, row in enumerate(x)
        ]
    )


@given(st.integers(1, 16), st.lists(st.integers(0, 2**16 - 1), max_size=9))
def test_packed_numbers_come_back(bits, numbers):
    numbers = np.array(numbers, dtype=np.int64) % 2**bits
    packed = pack_bits(numbers, bits)
    assert len(packed) == -(-len(numbers) * bits // 8)
    assert unpack_bits(packed, bits, len(numbers)).tolist() == numbers.tolist()


@pytest.mark.parametrize("compressor", [Quantised(2), Quantised(5), TopK(1), TopK(3)])
@given(ENTRIES)
def test_a_compressor_keeps_its_quality(compressor, x):
    decoded = compressor.decode(compressor.encode(x, 0, 0), len(x), 0, 0)
    allowed = (1.0 - compressor.omega(len(x))) * (x @ x)
    assert (decoded - x) @ (decoded - x) <= allowed * (1 + 1e-6) + 1e-12 * (
        x @ x
    ) + 1e-70


@given(ENTRIES)
def test_quantised_entries_are_off_by_half_a_level_at_most_and_the_largest_is_exact(x):
    decoded = Quantised(5).decode(Quantised(5).encode(x, 0, 0), len(x), 0, 0)
    scale = np.abs(x).max()
    assert np.abs(decoded - x).max() <= (scale / 15 / 2) * (1 + 1e-6) + 1e-37
    largest = np.argmax(np.abs(x))
    assert decoded[largest] == pytest.approx(x[largest], rel=1e-6, abs=1e-37)


def test_the_dither_makes_the_error_independent_of_x_with_mean_0():
    x = np.array([1.0, 0.26, 0.0, -0.13])
    compressor = Quantised(3, seed=1)
    decoded = [
        compressor.decode(compressor.encode(x, 2, k), 4, 2, k) for k in range(3000)
    ]
    error = np.array(decoded) - x
    interval = 1.0 / 2.5
    assert error.mean(axis=0) == pytest.approx(np.zeros(4), abs=0.01)
    assert error.var(axis=0) == pytest.approx(np.full(4, interval**2 / 12), rel=0.05)
    assert np.abs(error).max() <= interval / 2 + 1e-6
    plain = Quantised(3).decode(Quantised(3).encode(x, 2, 0), 4, 2, 0) - x
    assert np.abs(plain).max() > 0.05  # always the same error without dither


@pytest.mark.parametrize("compressor", COMPRESSORS)
def test_choco_gossip_follows_its_equation_and_keeps_the_mean(compressor):
    agents = team(GRAPH, lambda i, w: ChocoGossip(i, START[i], w, compressor, 0.2))
    x, public = START, np.zeros_like(START)
    for k in range(25):
        run_in_step(agents, GRAPH, 1)
        public = public + compressed(compressor, x - public, k)
        x = x + 0.2 * (W - np.eye(6)) @ public
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-12)
        assert gathered(agents, "public") == pytest.approx(public, abs=1e-12)
        assert x.mean(axis=0) == pytest.approx(START.mean(axis=0), abs=1e-12)


@pytest.mark.parametrize("compressor", COMPRESSORS)
def test_choco_sgd_follows_its_equation(compressor):
    step = Diminishing(0.05, 0.7)
    agents = team(
        GRAPH,
        lambda i, w: ChocoSGD(
            i, START[i, :3], w, Q.gradient(i), compressor, ChocoSteps(0.2, step)
        ),
    )
    x, public = START[:, :3], np.zeros((6, 3))
    for k in range(25):
        run_in_step(agents, GRAPH, 1)
        half = x - step(k) * np.array([Q.gradient(i)(x[i]) for i in range(6)])
        public = public + compressed(compressor, half - public, k)
        x = half + 0.2 * (W - np.eye(6)) @ public
        assert gathered(agents, "x") == pytest.approx(x, abs=1e-12)


@pytest.mark.parametrize("compressor", [Quantised(3), TopK(3)])
def test_choco_gossip_is_as_fast_as_the_theorem_says(compressor):
    """e_t <= (1 - d^2 w / 82)^t e_0,  e_t = sum_i |x_i - mean|^2 + |x_i - ^x_i(t+1)|^2."""
    omega = compressor.omega(8)
    gamma = choco_gamma(WEIGHTS, omega)
    values = np.linalg.eigvalsh(W)
    d = 1.0 - np.sort(np.abs(values))[-2]
    beta = 1.0 - values[0]
    below = 16 * d + d**2 + 4 * beta**2 + 2 * d * beta**2 - 8 * d * omega
    assert gamma == pytest.approx(d**2 * omega / below)
    agents = team(GRAPH, lambda i, w: ChocoGossip(i, START[i], w, compressor, gamma))
    errors = []
    for _ in range(300):
        x = gathered(agents, "x")
        run_in_step(agents, GRAPH, 1)
        error = ((x - x.mean(axis=0)) ** 2).sum()
        errors.append(error + ((x - gathered(agents, "public")) ** 2).sum())
    bound = errors[0] * (1.0 - d**2 * omega / 82.0) ** np.arange(300)
    assert np.all(errors <= bound)
