import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm

from crazychoir.numerics import math3d
from crazychoir.numerics.kernels import kernel, memory, vector

ordinary = st.floats(-10.0, 10.0).map(lambda x: x if abs(x) > 1e-3 else 1e-3)
vectors = arrays(float, 3, elements=ordinary)
turns = arrays(float, 3, elements=st.floats(-1.8, 1.8))
angles = st.floats(-20.0, 20.0)


@given(vectors)
def test_projector_is_symmetric_idempotent_and_kills_its_direction(d):
    p = math3d.projector(d)
    np.testing.assert_allclose(p, p.T)
    np.testing.assert_allclose(p @ p, p, atol=1e-12)
    np.testing.assert_allclose(p @ d, 0.0, atol=1e-12 * np.abs(d).max())
    assert np.trace(p) == pytest.approx(2.0)


@given(vectors, vectors)
def test_skew_is_the_vector_product(a, b):
    np.testing.assert_allclose(math3d.skew(a) @ b, np.cross(a, b), atol=1e-12)


@given(turns)
def test_logarithm_undoes_exponential(r):
    if np.linalg.norm(r) < math.pi - 1e-6:
        np.testing.assert_allclose(
            math3d.rotation_logarithm(math3d.rotation_exponential(*r)), r, atol=1e-9
        )


@given(turns)
def test_both_signs_of_a_quaternion_have_the_same_short_logarithm(r):
    q = math3d.rotation_exponential(*r)
    opposite = tuple(-c for c in q)
    if abs(q[3]) > 1e-6:
        np.testing.assert_allclose(
            math3d.rotation_logarithm(q),
            math3d.rotation_logarithm(opposite),
            atol=1e-12,
        )


@given(turns, turns)
def test_the_product_of_quaternions_is_the_product_of_rotations(a, b):
    qa, qb = math3d.rotation_exponential(*a), math3d.rotation_exponential(*b)
    both = math3d.rotation(np.array(math3d.quaternion_product(qa, qb)))
    np.testing.assert_allclose(
        both, math3d.rotation(np.array(qa)) @ math3d.rotation(np.array(qb)), atol=1e-12
    )


@given(turns)
def test_exponential_is_the_matrix_exponential_of_skew(r):
    np.testing.assert_allclose(
        math3d.rotation(np.array(math3d.rotation_exponential(*r))),
        expm(math3d.skew(r)),
        atol=1e-10,
    )


@given(arrays(float, 3, elements=st.floats(-3.1, 3.1)))
def test_quaternion_undoes_rotation(r):
    q = np.array(math3d.rotation_exponential(*r))
    back = math3d.quaternion(math3d.rotation(q))
    np.testing.assert_allclose(back, q if q[3] >= 0.0 else -q, atol=1e-9)


@pytest.mark.parametrize("q", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
def test_quaternion_of_half_turns(q):
    back = math3d.quaternion(math3d.rotation(np.array(q, dtype=float)))
    np.testing.assert_allclose(np.abs(back), q, atol=1e-12)


@given(vectors, angles)
def test_flat_attitude_pushes_along_f_and_looks_towards_yaw(f, yaw):
    r = math3d.rotation_from_flat(f, yaw)
    np.testing.assert_allclose(r.T @ r, np.eye(3), atol=1e-9)
    assert np.linalg.det(r) == pytest.approx(1.0)
    np.testing.assert_allclose(r[:, 2], f / np.linalg.norm(f), atol=1e-12)
    heading = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    assert abs(r[:, 1] @ heading) < 1e-9
    assert r[:, 0] @ heading > -1e-9


@pytest.mark.parametrize("f", [[0, 0, 0], [1, 0, 0], [-1, 0, 0]])
def test_flat_attitude_is_a_rotation_where_it_is_singular(f):
    r = math3d.rotation_from_flat(np.array(f, dtype=float), 0.0)
    np.testing.assert_allclose(r.T @ r, np.eye(3), atol=1e-12)
    assert np.linalg.det(r) == pytest.approx(1.0)


@given(angles)
def test_wrap_keeps_the_angle_and_is_within_half_a_turn(a):
    w = math3d.wrap_angle(a)
    assert -math.pi <= w < math.pi
    assert math.cos(w) == pytest.approx(math.cos(a), abs=1e-9)
    assert math.sin(w) == pytest.approx(math.sin(a), abs=1e-9)


@given(st.floats(-3.1, 3.1))
def test_yaw_of_undoes_quaternion_of_yaw(yaw):
    assert math3d.yaw_of(math3d.quaternion_of_yaw(yaw)) == pytest.approx(yaw, abs=1e-12)


def test_saturate_keeps_the_direction():
    np.testing.assert_allclose(
        math3d.saturate(np.array([3.0, 4.0, 0.0]), 1.0), [0.6, 0.8, 0.0]
    )
    np.testing.assert_array_equal(
        math3d.saturate(np.array([0.3, 0.4, 0.0]), 1.0), [0.3, 0.4, 0.0]
    )


def test_a_kernel_takes_frozen_arrays_and_refuses_other_kinds():
    @kernel(vector, memory)
    def double(x, out):
        out[:] = 2.0 * x

    frozen = np.frombuffer(np.arange(3.0).tobytes())
    out = np.zeros(3)
    double(frozen, out)
    np.testing.assert_array_equal(out, [0.0, 2.0, 4.0])
    with pytest.raises(TypeError):
        double(np.arange(3, dtype=np.float32), out)
