import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.filters.velocity import VelocityFilter
from crazychoir.numerics.math3d import quaternion_product, rotation_exponential
from crazychoir.types import Pose


def pose(p=(0, 0, 0), q=(0, 0, 0, 1), age=0.0):
    return Pose(np.array([*p, *q], dtype=float), age)


def run(f, p, times, age=0.0):
    return [f.update(pose((p(t - age), 0.0, 0.0), age=age), t) for t in times]


@given(st.floats(5.0, 80.0), st.floats(0.002, 0.05))
def test_a_ramp_is_met_as_the_first_order_filter_meets_it_at_any_rate(cutoff, h):
    times = h * np.arange(40)
    states = run(VelocityFilter(cutoff), lambda t: 0.7 * t, times)
    np.testing.assert_allclose(
        [s.v[0] for s in states], 0.7 * (1.0 - np.exp(-cutoff * times)), atol=1e-9
    )


@given(st.lists(st.floats(0.001, 0.2), min_size=2, max_size=30))
def test_uneven_samples_of_a_ramp_give_the_same_as_even_ones(steps):
    t = np.cumsum([0.0, *steps])
    last = run(VelocityFilter(20.0), lambda s: 1.3 * s, t)[-1]
    assert last.v[0] == pytest.approx(1.3 * (1.0 - math.exp(-20.0 * t[-1])), abs=1e-9)


def test_a_sine_is_filtered_as_the_transfer_function_says():
    w, cutoff, h = 3.0, 50.0, 0.001
    states = run(VelocityFilter(cutoff), lambda t: math.sin(w * t), h * np.arange(3000))
    t = 2.999
    gain = 1j * w * cutoff / (1j * w + cutoff)
    assert states[-1].v[0] == pytest.approx(
        (gain * np.exp(1j * w * t)).imag, abs=2e-2 * w * h + 1e-4
    )


def test_a_constant_body_rate_is_found_across_the_wrap_of_yaw():
    f, w, h = VelocityFilter(50.0), np.array([0.3, -0.2, 3.0]), 0.01
    q, rates = (0.0, 0.0, 0.0, 1.0), []
    for k in range(400):
        sign = -1.0 if k % 2 else 1.0  # motion capture may give either sign
        rates.append(f.update(pose(q=[sign * c for c in q]), k * h).w)
        q = quaternion_product(q, rotation_exponential(*(h * w)))
    np.testing.assert_allclose(rates[100:], np.tile(w, (300, 1)), atol=1e-9)


def test_the_latency_of_the_pose_is_bridged_at_constant_velocity():
    late = run(
        VelocityFilter(50.0), lambda t: 0.5 * t, 0.01 * np.arange(100), age=0.03
    )[-1]
    assert late.p[0] == pytest.approx(0.5 * 0.99, abs=1e-9)
    assert late.age == pytest.approx(0.03)
