"""Compressed trajectories: the power basis is the Bezier curve; segments join."""

import math

import numpy as np
import pytest

from crazychoir.simulation.onboard.bezier import (
    COMPRESSED_FORMAT,
    convert_to_power_basis,
    expand_segments,
)


def _bezier(points, s):
    """sum_i C(n, i) (1 - s)^(n - i) s^i P_i."""
    n = len(points) - 1
    return sum(
        math.comb(n, i) * (1.0 - s) ** (n - i) * s**i * p for i, p in enumerate(points)
    )


@pytest.mark.parametrize("degree", [0, 1, 3, 7])
def test_the_coefficients_are_those_of_the_curve(degree):
    points, duration = np.random.default_rng(degree).normal(size=degree + 1), 1.7
    c = convert_to_power_basis(points, duration)
    for s in np.linspace(0.0, 1.0, 11):
        assert np.polynomial.polynomial.polyval(s * duration, c) == pytest.approx(
            _bezier(points, s), abs=1e-9
        )


def _packed(start, *segments):
    """start: 4 numbers;  segments: (ms, points of x, y, z, yaw), each 0, 1, 3 or 7."""
    raw = np.array(start, "<i2").tobytes()
    for ms, *axes in segments:
        kinds = sum(
            {0: 0, 1: 1, 3: 2, 7: 3}[len(points)] << 2 * k
            for k, points in enumerate(axes)
        )
        raw += bytes([kinds]) + ms.to_bytes(2, "little")
        raw += b"".join(np.array(points, "<i2").tobytes() for points in axes)
    return np.frombuffer(raw.ljust(400, b"\0"), np.uint8)


def test_segments_go_on_where_the_last_one_has_ended():
    first, second = (
        (1500, [200, 300, 400], [10], [], [0]),
        (500, [], [20, 20, 20, 30, 30, 30, 40], [7], []),
    )
    memory = _packed([100, 0, -50, 900], first, second)
    rows = expand_segments(memory, 9)
    assert rows.shape == (2, 33)
    assert rows[:, -1].tolist() == [1.5, 0.5]

    def at(k, axis, t):
        return np.polynomial.polynomial.polyval(
            t, rows[k, 8 * axis : 8 * axis + 8].astype(float)
        )

    assert [at(0, axis, 0.0) for axis in range(4)] == pytest.approx(
        [0.1, 0.0, -0.05, 900 * COMPRESSED_FORMAT.angle_unit]
    )
    assert [at(0, axis, 1.5) for axis in range(4)] == pytest.approx(
        [0.4, 0.01, -0.05, 0.0], abs=1e-5
    )
    assert [at(1, axis, 0.0) for axis in range(4)] == pytest.approx(
        [0.4, 0.01, -0.05, 0.0], abs=1e-5
    )
    assert [at(1, axis, 0.5) for axis in range(4)] == pytest.approx(
        [0.4, 0.04, 0.007, 0.0], abs=1e-5
    )
    assert at(0, 0, 0.75) == pytest.approx(
        1e-3 * _bezier([100, 200, 300, 400], 0.5), abs=1e-6
    )


def test_it_ends_at_so_many_segments_and_where_the_memory_does():
    memory = _packed([0] * 4, (100, [1], [], [], []), (100, [2], [], [], []))
    assert len(expand_segments(memory, 1)) == 1
    assert len(expand_segments(memory, 5)) == 2
    assert len(expand_segments(memory[: 8 + 5 + 4], 5)) == 1
    assert expand_segments(memory[:3].repeat(4), 0).shape == (0, 33)
