"""The equations of the laws in agents/ that hold formations, and of what is asked before they fly."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crazychoir.agents.bearing_formation import BearingFormation
from crazychoir.agents.containment import Containment
from crazychoir.agents.distance_formation import HEIGHT_GAINS, DistanceFormation
from crazychoir.control.gains import AGILE_GAINS
from crazychoir.control.margin import InnerLoop, make_guidance_loop
from crazychoir.guidance.formation.bearing import (
    BearingLaw,
    build_bearing_laplacian,
    compute_equilibrium,
    normalise_laplacian,
)
from crazychoir.guidance.formation.modes import (
    FORMATION_DELAYS,
    NYQUIST_FREQUENCIES,
    AccelerationChain,
    _compute_attitude_response,
    compute_slowest_normalised_mode,
)
from crazychoir.guidance.formation.random_edges import RandomEdges
from crazychoir.guidance.formation.rigidity import (
    distance_to_hull,
    grounded_laplacian,
    rigidity_matrix,
)
from crazychoir.types import State

SQUARE = {0: (0, 0, 1), 1: (1, 0, 1), 2: (1, 1, 1), 3: (0, 1, 1)}
NEIGHBORS = {0: (1, 3), 1: (0, 2, 3), 2: (1, 3), 3: (0, 1, 2)}
KP, KV = 8.0, 4.5
numbers = arrays(float, (4, 9), elements=st.floats(-1.0, 1.0))


def states(x):
    """Return {i: the state with the p, v and a of row i}."""
    return {
        i: State(State.at(row[0:3], row[3:6]).flat, 0.0, row[6:9])
        for i, row in enumerate(x)
    }


def bearing(i, j):
    g = np.subtract(SQUARE[j], SQUARE[i]).astype(float)
    g /= np.linalg.norm(g)
    return np.eye(3) - np.outer(g, g)


@given(numbers)
def test_the_normalised_law_is_its_sum_over_neighbours(x):
    at = states(x)
    for i in (2, 3):
        p = {j: bearing(i, j) for j in NEIGHBORS[i]}
        wanted = sum(
            p[j] @ (-KP * (at[i].p - at[j].p) - KV * (at[i].v - at[j].v) + at[j].a)
            for j in NEIGHBORS[i]
        )
        law = BearingFormation(i, SQUARE, NEIGHBORS[i])
        u = law.step(at[i], {j: at[j] for j in NEIGHBORS[i]})
        np.testing.assert_allclose(
            u.a, np.linalg.solve(sum(p.values()), wanted), atol=1e-9
        )


@given(numbers)
def test_the_papers_law_is_its_sum_over_neighbours_with_less_in_height(x):
    at = states(x)
    for i in (2, 3):
        wanted = -sum(
            bearing(i, j) @ (KP * (at[i].p - at[j].p) + KV * (at[i].v - at[j].v))
            for j in NEIGHBORS[i]
        )
        law = BearingFormation(
            i, SQUARE, NEIGHBORS[i], BearingLaw("paper", KP, KV, 0.5)
        )
        u = law.step(at[i], {j: at[j] for j in NEIGHBORS[i]})
        np.testing.assert_allclose(u.a, wanted * [1.0, 1.0, 0.5], atol=1e-9)


def test_the_normalised_law_wants_places_of_the_tick_of_the_acceleration_unless_leaders_move():
    assert BearingFormation(2, SQUARE, NEIGHBORS[2]).paired
    assert not BearingFormation(2, SQUARE, NEIGHBORS[2], moving=True).paired
    assert not BearingFormation(2, SQUARE, NEIGHBORS[2], BearingLaw("paper")).paired


def test_where_a_drone_is_on_its_way_to_changes_less_than_where_it_is():
    """E = a + kv v + kp p does not change while a drone flies the law: what is held of it stays right."""
    x, target = np.array([0.7, -0.2]), 0.1
    held = -KP * (x[0] - target) - KV * x[1] + KV * x[1] + KP * x[0]
    for _ in range(100):
        a = -KP * (x[0] - target) - KV * x[1]
        assert a + KV * x[1] + KP * x[0] == pytest.approx(held)
        x += 0.01 * np.array([x[1], a])
    assert abs(x[0] - 0.7) > 0.3, "it has moved"


def test_all_modes_of_the_normalised_law_are_alike():
    """What the followers command, once it has gone round, is - kp (p - p*) - kv v for each of them alone."""
    draw = np.random.default_rng(3)
    x = np.array([[*SQUARE[i], *np.zeros(6)] for i in SQUARE])
    x[2:, :6] += draw.normal(size=(2, 6))
    laws = {i: BearingFormation(i, SQUARE, NEIGHBORS[i]) for i in (2, 3)}
    for _ in range(400):
        at = states(x)
        for i, law in laws.items():
            x[i, 6:9] = law.step(at[i], {j: at[j] for j in NEIGHBORS[i]}).a
    for i in (2, 3):
        np.testing.assert_allclose(
            x[i, 6:9], -KP * (x[i, 0:3] - SQUARE[i]) - KV * x[i, 3:6], atol=1e-9
        )


def test_the_normalised_matrix_has_the_sums_of_the_laws_weights():
    b_ff, b_fl, followers = build_bearing_laplacian(SQUARE, NEIGHBORS, [0, 1])
    m = normalise_laplacian(b_ff, followers).toarray()
    np.testing.assert_allclose(m[0:3, 0:3], np.eye(3), atol=1e-12)
    law = BearingFormation(2, SQUARE, NEIGHBORS[2])
    np.testing.assert_allclose(m[0:3, 3:6], -law.weights[3], atol=1e-12)
    assert np.linalg.eigvals(m).real.min() == pytest.approx(0.13397, abs=1e-4)
    assert b_fl.shape == (6, 6)


def test_the_slowest_mode_is_that_of_the_law_or_of_the_way_through_the_graph():
    assert compute_slowest_normalised_mode([1.0], KP, KV) == pytest.approx(0.5 * KV)
    for share in (0.002, 0.01):
        x, steps = 1.0, 0
        while (
            x > np.exp(-1.0)
        ):  # what a neighbour commanded goes on, a tick later, all but its share of the leaders
            x, steps = (1.0 - share) * x, steps + 1
        assert compute_slowest_normalised_mode([share], KP, KV) == pytest.approx(
            1.0 / (steps * FORMATION_DELAYS.state_delay), rel=0.02
        )


def test_the_attitude_in_the_ages_margin_is_that_of_the_guidance_loop():
    chain = AccelerationChain(AGILE_GAINS)
    s = 1j * NYQUIST_FREQUENCIES
    num, den = make_guidance_loop(
        KP, KV, InnerLoop(AGILE_GAINS.kr[0], lead=AGILE_GAINS.lead)
    )
    outer = (KP + KV * s * 50.0 / (s + 50.0)) / s**2
    found = outer * _compute_attitude_response(chain) * np.exp(0.005 * s)
    np.testing.assert_allclose(
        found, np.polyval(num, s) / np.polyval(den, s), rtol=1e-9
    )


@given(st.floats(0.5, 3.0), arrays(float, 3, elements=st.floats(-2.0, 2.0)))
def test_the_equilibrium_is_the_shape_moved_and_scaled_with_its_leaders(scale, offset):
    at = {i: scale * np.array(p) + offset for i, p in SQUARE.items()}
    found = compute_equilibrium(SQUARE, NEIGHBORS, {i: at[i] for i in (0, 1)})
    for i, p in at.items():
        np.testing.assert_allclose(found[i], p, atol=1e-9)


@given(numbers)
def test_the_distance_law_goes_down_its_gradient_and_brakes(x):
    at, d, k, kv = states(x), {j: 1.0 + 0.1 * j for j in (0, 1, 3)}, 0.7, 1.3
    u = DistanceFormation(d, k, kv, None).step(at[2], {j: at[j] for j in d}).a

    def potential(p):
        return 0.25 * k * sum((np.sum((p - at[j].p) ** 2) - d[j] ** 2) ** 2 for j in d)

    h = 1e-5
    gradient = np.array(
        [
            (potential(at[2].p + h * e) - potential(at[2].p - h * e)) / (2 * h)
            for e in np.eye(3)
        ]
    )
    brake = kv * sum(at[2].v - at[j].v for j in d)
    np.testing.assert_allclose(u, -gradient - brake, atol=1e-6)
    flat = DistanceFormation(d, k, kv, 1.0).step(at[2], {j: at[j] for j in d}).a
    assert flat[2] == pytest.approx(
        HEIGHT_GAINS[0] * (1.0 - at[2].p[2]) - HEIGHT_GAINS[1] * at[2].v[2]
    )


@given(arrays(float, (4, 3), elements=st.floats(-2.0, 2.0)))
def test_the_rigidity_matrix_is_the_derivative_of_the_distances(p):
    edges, h = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)], 1e-6
    r, followers = rigidity_matrix(dict(enumerate(p)), edges, [0])
    assert followers == [1, 2, 3]

    def halves(q):
        return np.array([0.5 * np.sum((q[i] - q[j]) ** 2) for i, j in edges])

    for n, i in enumerate(followers):
        for c in range(3):
            step = np.zeros((4, 3))
            step[i, c] = h
            np.testing.assert_allclose(
                r[:, 3 * n + c],
                (halves(p + step) - halves(p - step)) / (2 * h),
                atol=1e-6,
            )


def pulled(law, me, heard, k):
    """Return the acceleration of containment in tick k of the team's time."""
    clock = SimpleNamespace(epoch_ns=10_000_000 * k, now_ns=lambda: 5_000_000)
    law.member = SimpleNamespace(clock=clock)
    return law.step(me, heard).a


@given(numbers)
def test_containment_is_its_mean_over_neighbours(x):
    at, kp, kv = states(x), 0.8, 1.6
    law = Containment(RandomEdges(3, (0, 1, 2), 1.0, 0), kp, kv)
    u = pulled(law, at[3], {j: at[j] for j in (0, 1, 2)}, 0)
    wanted = (
        -sum(kp * (at[3].p - at[j].p) + kv * (at[3].v - at[j].v) for j in (0, 1, 2))
        / 3.0
    )
    np.testing.assert_allclose(u, wanted, atol=1e-12)


def test_random_edges_count_at_both_ends_or_at_none_and_change_nothing_on_average():
    ends = (
        RandomEdges(3, (5,), 0.5, 7),
        RandomEdges(5, (3,), 0.5, 7),
    )
    counted = np.array(
        [(ends[0].counts(5, k), ends[1].counts(3, k)) for k in range(4000)]
    )
    assert np.all(counted[:, 0] == counted[:, 1])
    assert counted[:, 0].mean() == pytest.approx(0.25, abs=0.02)
    law, here, there = (
        Containment(RandomEdges(3, (5,), 0.5, 8), 1.0, 0.0),
        State.at((1.0, 0.0, 1.0)),
        State.at((0.0, 0.0, 1.0)),
    )
    mean = np.mean([pulled(law, here, {5: there}, k) for k in range(4000)], axis=0)
    np.testing.assert_allclose(mean, [-1.0, 0.0, 0.0], atol=0.1)


def test_a_grounded_laplacian_is_at_rest_at_the_mean_of_the_neighbours():
    neighbors, leaders = {0: (2,), 1: (3,), 2: (0, 3), 3: (1, 2)}, {0: 0.0, 1: 3.0}
    l_ff, l_fl = grounded_laplacian(neighbors, leaders)
    np.testing.assert_allclose(-np.linalg.solve(l_ff, l_fl @ [0.0, 3.0]), [1.0, 2.0])


@pytest.mark.parametrize(
    ("p", "far"),
    [((0.2, 0.3), 0.0), ((1.5, 0.5), 0.5), ((-3.0, -4.0), 5.0), ((1.0, 1.0), 0.0)],
)
def test_the_distance_to_a_square(p, far):
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    assert distance_to_hull(corners, np.array(p)) == pytest.approx(far, abs=1e-5)
