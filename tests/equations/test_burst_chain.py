"""The Gilbert-Elliott chain of bus/impairment/random_draws.py equals the chain walked step by step."""

import numpy as np
import pytest

from crazychoir.bus.impairment import random_draws as draws
from crazychoir.bus.impairment.random_draws import (
    RANDOM_DRAWS,
    bad_states,
    draw,
)


def states(key, count, p_good_bad, p_bad_good):
    blocks = [
        bad_states(key, block, p_good_bad, p_bad_good)
        for block in range(count // RANDOM_DRAWS.block_size)
    ]
    return np.frombuffer(b"".join(blocks), np.uint8)


@pytest.mark.parametrize(
    ("p_good_bad", "p_bad_good"), [(0.02, 0.2), (0.3, 0.7), (0.01, 0.02), (0.5, 0.05)]
)
def test_stationary_law_and_transitions(p_good_bad, p_bad_good):
    chain = states(77, 200 * RANDOM_DRAWS.block_size * 4, p_good_bad, p_bad_good)
    now, then = chain[:-1], chain[1:]
    good, bad = then[now == 0], then[now == 1]
    assert chain.mean() == pytest.approx(
        p_good_bad / (p_good_bad + p_bad_good), rel=0.1
    )
    assert good.mean() == pytest.approx(
        p_good_bad, abs=4.5 * np.sqrt(p_good_bad / len(good))
    )
    assert bad.mean() == pytest.approx(
        1 - p_bad_good, abs=4.5 * np.sqrt(p_bad_good / len(bad))
    )


@pytest.mark.parametrize(("p_good_bad", "p_bad_good"), [(0.02, 0.2), (0.001, 0.01)])
def test_bursts_are_geometric_across_blocks(p_good_bad, p_bad_good):
    chain = states(5, 4000 * RANDOM_DRAWS.block_size, p_good_bad, p_bad_good)
    edges = np.flatnonzero(np.diff(chain))
    runs = np.diff(edges)[int(chain[0] == 1) :: 2]
    mean = 1 / p_bad_good
    assert runs.mean() == pytest.approx(mean, abs=4.5 * mean / np.sqrt(len(runs)))
    assert runs.std() == pytest.approx(mean, rel=0.1)


def walked(key, count, p_good_bad, p_bad_good):
    """u < p_gb: bad; u >= 1 - p_bg: good; else as before."""
    state = draw(
        key ^ draws.DRAW_CONSTANTS.start_salt, 0, 0
    ) / RANDOM_DRAWS.range_size < p_good_bad / (p_good_bad + p_bad_good)
    for t in range(count):
        u = (draw(key ^ draws.DRAW_CONSTANTS.burst_salt, t, 0) >> 11) * 2.0**-53
        state = u < p_good_bad or (state and u < 1 - p_bad_good)
        yield int(state)


@pytest.mark.parametrize("key", [1, 2, 3])
def test_blocks_join_into_the_chain_that_is_walked(key):
    p_good_bad, p_bad_good = 0.003, 0.006
    count = 4 * RANDOM_DRAWS.earlier_blocks * RANDOM_DRAWS.block_size
    assert list(states(key, count, p_good_bad, p_bad_good)) == list(
        walked(key, count, p_good_bad, p_bad_good)
    )


def test_far_from_any_decision_the_state_has_the_stationary_law():
    found = [bad_states(key, 100, 1e-9, 3e-9)[0] for key in range(4000)]
    assert np.mean(found) == pytest.approx(0.25, abs=4.5 * np.sqrt(0.1875 / 4000))
