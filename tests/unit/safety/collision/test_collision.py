import time
from types import SimpleNamespace

import numpy as np
import pytest
from avoiding import AvoidingDrone

from crazychoir.bus.port import Bus
from crazychoir.config.tables import CollisionTable
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.motion import predict_late_motion
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.collision.avoidance import (
    _constrain_all,
    _find_drone_in_the_way,
    make_nearest,
    make_planes,
)
from crazychoir.safety.collision.projection import project
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import FullState, State

GAINS = STANDARD_GAINS.position
FENCE = Fence.box((-4.0, -4.0, 0.0), (4.0, 4.0, 3.0))
METHODS = ("barrier", "cells")


class Sky:
    """Drone 0 with its filter among others, on one bus."""

    def __init__(self, method="barrier", others=1, alone=()):
        self.bus = Bus(SimpleNamespace(now_ns=lambda: 0, now=lambda: 0.0))
        self.ports = [self.bus.port(i) for i in range(1 + others)]
        settings = CollisionTable(method=method)
        rules = AirspaceRules(settings, 1.0, 0.0, tuple(alone))
        airspace = Airspace(self.bus, range(1 + others), rules)
        self.traffic = Neighbours(airspace, 0, keeps_all=True)
        self.drone = AvoidingDrone(settings, self.traffic, FENCE, GAINS)

    def hears(self, j, p, v=(0.0, 0.0, 0.0), age=0.0):
        self.traffic.hear((j, State.at(p, v)), age)

    def wants(self, me, to, now=0.0):
        return self.drone.fly_full_state(me, FullState.at(to).flat, now)


@pytest.mark.parametrize("method", METHODS)
def test_a_drone_with_no_other_near_flies_as_it_wants(method):
    sky = Sky(method)
    here = State.at((0.0, 0.0, 1.0))
    assert sky.wants(here, (0.5, 0.0, 1.0)) is None, "no drone was ever heard"
    sky.hears(1, (3.0, 0.0, 1.0))
    assert sky.wants(here, (0.5, 0.0, 1.0)) is None
    sky.hears(1, (0.5, 0.0, 1.0))
    assert sky.wants(here, (-0.5, 0.0, 1.0)) is None, "away from it"


@pytest.mark.parametrize("method", METHODS)
def test_a_drone_that_flies_at_another_brakes_and_turns_to_its_right(method):
    sky = Sky(method)
    sky.hears(1, (0.6, 0.0, 1.0), (-0.8, 0.0, 0.0))
    a = sky.wants(State.at((0.0, 0.0, 1.0), (0.8, 0.0, 0.0)), (3.0, 0.0, 1.0))
    assert a[0] < -1.0
    assert a[1] < -0.1, "n points to -x: e3 x n to -y"
    assert sky.drone.gives_way_to == 1


@pytest.mark.parametrize("method", METHODS)
def test_a_drone_gives_way_to_the_nearest_of_two_in_the_way(method):
    sky = Sky(method, others=2)
    sky.hears(1, (0.9, 0.0, 1.0), (-0.8, 0.0, 0.0))
    sky.hears(2, (0.6, 0.0, 1.0), (-0.8, 0.0, 0.0))
    sky.wants(State.at((0.0, 0.0, 1.0), (0.8, 0.0, 0.0)), (3.0, 0.0, 1.0))
    assert sky.drone.gives_way_to == 2
    assert list(sky.drone.near[:2, 1]) == [1.0, 0.0], "both are in the table"


@pytest.mark.parametrize("method", METHODS)
def test_ellipsoids_are_tall(method):
    sky = Sky(method)
    me = State.at((0.0, 0.0, 1.0))
    sky.hears(1, (0.0, 0.0, 1.55))
    assert sky.wants(me, (0.0, 0.0, 1.0))[2] < -0.1, "0.55 m below: it sinks"
    sky.hears(1, (0.55, 0.0, 1.0))
    assert sky.wants(me, (0.0, 0.0, 1.0)) is None, "beside each other that is far"


def test_a_drone_on_the_floor_obstructs_only_a_drone_that_comes_down_on_it():
    sky = Sky()
    sky.hears(1, (0.0, 0.0, 0.02))
    assert (
        sky.wants(State.at((0.0, 0.0, 0.4), (0.5, 0.0, 0.0)), (1.0, 0.0, 0.4)) is None
    ), "over it"
    assert (
        sky.wants(State.at((0.3, 0.0, 0.3), (0.0, 0.0, -0.3)), (0.3, 0.0, 0.2)) is None
    ), "down beside it"
    assert (
        sky.wants(State.at((0.02, 0.0, 0.25), (0.0, 0.0, -0.3)), (0.02, 0.0, 0.0))[2]
        > 0.1
    ), "down on it"
    assert sky.wants(State.at((0.2, 0.0, 0.0)), (0.2, 0.0, 1.0)) is None, "up beside it"


def test_a_drone_that_takes_off_gives_way_to_a_drone_that_flies_above():
    sky = Sky()
    sky.hears(1, (0.0, 0.0, 0.7))
    assert sky.wants(State.at((0.0, 0.0, 0.0)), (0.0, 0.0, 0.5))[2] <= 0.1


def test_a_drone_brakes_for_a_stale_near_neighbour_until_that_has_landed():
    sky = Sky()
    me = State.at((0.0, 0.0, 1.0), (0.5, 0.0, 0.0))
    sky.hears(1, (0.9, 0.0, 1.0))
    assert sky.wants(me, (1.0, 0.0, 1.0), now=0.8)[0] < -0.5
    sky.hears(1, (2.9, 0.0, 1.0))
    assert sky.wants(me, (0.2, 0.0, 1.0), now=0.8) is None, (
        "too far away to be here by now"
    )
    sky.hears(1, (0.9, 0.0, 1.0))
    for now in (3.5, 9.5):
        assert sky.wants(me, (1.0, 0.0, 1.0), now=now)[0] < -0.5, (
            "it may be anywhere near"
        )
    assert sky.wants(me, (1.0, 0.0, 1.0), now=NEIGHBOUR_AGES.gone) is None, (
        "it has landed"
    )
    sky.hears(1, (0.4, 0.0, 0.02))
    low = State.at((0.0, 0.0, 0.2), (0.5, 0.0, 0.0))
    assert sky.wants(low, (0.4, 0.0, 0.1), now=30.0) is not None, (
        "a drone that stood there still stands"
    )


@pytest.mark.parametrize(
    ("heard", "silent", "is_cut_off"),
    [(0, 1, True), (1, 1, False), (1, 2, True), (2, 2, False), (2, 3, True)],
)
def test_a_drone_that_hears_no_more_than_half_of_the_flying_drones_brakes(
    heard, silent, is_cut_off
):
    sky = Sky(others=heard + silent + 1)
    for j in range(1, 1 + heard + silent):
        sky.hears(j, (3.9, 0.5 * j - 1.5, 2.0), age=0.0 if j <= heard else 1.6)
    sky.hears(heard + silent + 1, (3.9, 3.9, 0.02))
    a = sky.wants(State.at((-3.0, 0.0, 1.0), (0.5, 0.0, 0.0)), (-2.0, 0.0, 1.0))
    assert sky.drone.is_cut_off is is_cut_off
    assert bool(a is not None and a[0] < -0.5) is is_cut_off


@pytest.mark.parametrize("method", METHODS)
def test_a_drone_keeps_beside_the_air_above_a_drone_on_the_floor_that_fell_silent(
    method,
):
    sky, goal = Sky(method), (3.0, 0.0, 2.0)
    me = State.at((0.0, 0.0, 2.0), (0.8, 0.0, 0.0))
    sky.hears(1, (0.5, 0.05, 0.02))
    assert sky.wants(me, goal, now=1.4) is None, "it stands there"
    assert sky.wants(me, goal, now=1.6)[0] < -0.5, "it may have taken off"
    assert sky.drone.gives_way_to == 1
    assert sky.wants(me, goal, now=NEIGHBOUR_AGES.gone) is None, "it is down again"
    beside = State.at((0.28, 0.05, 2.0))
    down = FullState.at((0.28, 0.05, 1.99)).flat
    assert sky.drone.fly_full_state(beside, down, 1.6)[0] < -0.05
    assert sky.drone.fly_full_state(beside, down, 1.6, lands=True) is None


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (0.0, 0.0, -1.0)])
def test_a_drone_exactly_above_a_silent_one_on_the_floor_goes_aside(velocity):
    sky = Sky()
    sky.hears(1, (1.0, 0.0, 0.02))
    for x in (1.0, 1.0 + 1e-9, 1.0 + 1e-4):
        me = State.at((x, 0.0, 2.0), velocity)
        a = sky.wants(me, (1.0, 0.0, 2.0), now=2.0)
        assert a[0] > 0.3, "to the side of x"
        assert np.isfinite(a).all()


def test_drones_at_homes_next_to_each_other_do_not_push_each_other_while_one_is_silent():
    sky = Sky()
    sky.hears(1, (0.25, 0.0, 0.02))
    for height in (0.3, 1.0):
        home = (0.0, 0.0, height)
        assert sky.wants(State.at(home), home, now=2.0) is None


def test_a_braking_drone_stays_where_it_came_to_rest():
    sky = Sky()
    sky.hears(1, (3.9, 3.9, 1.0), age=1.6)
    for x, v in ((0.0, 0.5), (0.1, 0.1), (0.2, 0.1)):
        a = sky.wants(State.at((x, 0.0, 1.0), (v, 0.0, 0.0)), (1.0, 0.0, 1.0))
    assert sky.drone.gives_way_to is None
    assert a[0] == pytest.approx(-4.0 * 0.1 - 4.0 * 0.1)


@pytest.mark.parametrize("method", METHODS)
def test_a_drone_that_flies_at_a_silent_one_turns_aside_while_it_brakes(
    method,
):
    sky = Sky(method)
    sky.hears(1, (1.5, 0.0, 1.0), (-1.0, 0.0, 0.0))
    a = sky.wants(State.at((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), (3.0, 0.0, 1.0), now=0.7)
    assert a[0] < -1.0
    assert a[1] < -0.1, "to the side to which it turns for a heard drone"


def test_a_state_that_is_not_finite_is_not_heard():
    sky, me = Sky(), State.at((0.0, 0.0, 1.0), (0.5, 0.0, 0.0))
    sky.hears(1, (0.7, 0.0, 1.0), (-0.5, 0.0, 0.0))
    before = sky.wants(me, (2.0, 0.0, 1.0))
    broken = State.at((0.7, 0.0, 1.0))
    broken.flat[6] = np.nan
    sky.traffic.hear((1, broken), 0.0)
    assert np.array_equal(sky.wants(me, (2.0, 0.0, 1.0)), before)


def test_the_touching_one_of_two_unavoidable_drones_counts_first():
    """A drone on the floor counts as smaller. Its centre is nearer, but the gap to it is wider."""
    sky = Sky(others=2)
    sky.hears(1, (0.0, 0.16, 0.02))
    sky.hears(2, (0.0, -0.31, 0.15))
    sky.wants(State.at((0.0, 0.0, 0.15), (0.0, 0.0, -0.2)), (0.0, 0.0, 0.0))
    assert list(sky.drone.near[:2, 1]) == [1.0, 0.0]


@pytest.mark.parametrize("seed", range(20))
def test_half_spaces_that_are_almost_parallel_are_relaxed_at_once(seed):
    """An inner problem that rounding had ended early cost millions of steps."""
    draw = np.random.default_rng(seed)
    box = np.array(
        [
            [s * (c == k) for c in range(3)] + [-3.0]
            for k in range(3)
            for s in (1.0, -1.0)
        ]
    )
    rows = []
    axis = draw.standard_normal(3)
    for _ in range(200):
        n = np.outer(draw.choice([-1.0, 1.0], 6), axis) + 1e-3 * draw.standard_normal(
            (6, 3)
        )
        planes = np.vstack(
            [
                box,
                np.column_stack(
                    [n / np.linalg.norm(n, axis=1)[:, None], draw.uniform(0.0, 3.4, 6)]
                ),
            ]
        )
        rows.append((draw.standard_normal(3) * 2.0, planes))
    for u, planes in rows:
        out, began = np.empty(3), time.thread_time()
        project(u, planes, out)
        assert time.thread_time() - began < 0.05
        assert np.all(planes[:, :3] @ out >= planes[:, 3] - 1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_landing_drone_does_not_brake_for_an_unheard_one(method):
    sky, me = Sky(method), State.at((0.0, 0.0, 1.0), (0.0, 0.0, -0.3))
    sky.hears(1, (0.7, 0.0, 1.0))
    down = FullState.at((0.0, 0.0, 0.99), (0.0, 0.0, -0.3)).flat
    assert sky.drone.fly_full_state(me, down, 0.8)[2] > 0.5, "it brakes"
    assert sky.drone.fly_full_state(me, down, 0.8, lands=True) is None
    assert sky.drone.fly_full_state(me, down, 0.8) is not None, (
        "the next one does not land"
    )


def test_an_old_state_keeps_it_farther_away():
    sky, me = Sky(), State.at((0.0, 0.0, 1.0), (0.3, 0.0, 0.0))
    sky.hears(1, (0.8, 0.0, 1.0))
    fresh, old = (
        sky.drone.fly_acceleration(me, np.array([3.0, 0.0, 0.0]), now)
        for now in (0.0, 0.3)
    )
    assert old[0] < fresh[0] - 0.3


@pytest.mark.parametrize("method", METHODS)
def test_a_drone_that_never_gives_way_is_avoided_more_strongly(method):
    shared, alone = Sky(method), Sky(method, alone=(1,))
    for sky in (shared, alone):
        sky.hears(1, (0.9, 0.0, 1.0), (-0.5, 0.0, 0.0))
    half, whole = (
        s.wants(State.at((0.0, 0.0, 1.0), (0.5, 0.0, 0.0)), (2.0, 0.0, 1.0))[0]
        for s in (shared, alone)
    )
    assert whole < half - 0.2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("beside", [0.0, 0.1, 0.2])
def test_a_drone_gets_out_of_the_way_of_a_drone_that_never_gives_way(method, beside):
    sky, p, v, near = (
        Sky(method, alone=(1,)),
        np.array([0.0, beside, 1.0]),
        np.zeros(3),
        [],
    )
    for k in range(500):
        other = np.array([0.008 * k - 1.5, 0.0, 1.0])
        sky.hears(1, other, (0.8, 0.0, 0.0))
        a = sky.wants(State.at(p, v), (0.0, beside, 1.0))
        v = v + 0.01 * (
            -GAINS[0] * (p - [0.0, beside, 1.0]) - GAINS[3] * v if a is None else a
        )
        p = p + 0.01 * v
        near.append(np.linalg.norm((p - other) * [1.0, 1.0, 0.4]))
    assert min(near) > 0.3
    assert p == pytest.approx([0.0, beside, 1.0], abs=0.05)


def test_out_of_a_pocket_between_two_that_stay_it_goes_the_other_way_round():
    """Against the clock round the nearer one leads between both, where there is no room."""
    sky, p, v = Sky(others=2), np.array([0.6, 0.15, 1.0]), np.zeros(3)
    goal = np.array([-0.35, -0.85, 1.0])
    tried = []
    for k in range(1500):
        for j, other in ((1, (-0.2, -0.26, 0.9)), (2, (-0.16, 0.29, 1.0))):
            sky.traffic.hear((j, State.at(other)), -0.01 * k)
        a = sky.wants(State.at(p, v), goal, now=0.01 * k)
        a = (
            np.clip(-GAINS[0] * (p - goal) - GAINS[3] * v, -2.0, 2.0)
            if a is None
            else a
        )
        v = v + 0.01 * a
        p = p + 0.01 * v
        tried.append(float(sky.drone.row["side"]))
    assert p == pytest.approx(goal, abs=0.02)
    assert min(tried) == -1.0, "a pocket it was"


@pytest.mark.parametrize("method", METHODS)
def test_between_too_many_it_keeps_above_the_floor(method):
    sky = Sky(method, others=3)
    for j, p in enumerate(
        [(0.0, 0.0, 0.75), (0.2, 0.1, 0.7), (-0.2, 0.0, 0.7)], start=1
    ):
        sky.hears(j, p, (0.0, 0.0, -0.5))
    a = sky.wants(State.at((0.0, 0.0, 0.2), (0.0, 0.0, -0.4)), (0.0, 0.0, 1.0))
    assert a[2] > 0.5


def test_the_fence_is_not_left_for_another():
    sky = Sky()
    sky.hears(1, (3.2, 0.0, 1.0), (0.5, 0.0, 0.0))
    a = sky.wants(State.at((3.8, 0.0, 1.0), (0.4, 0.0, 0.0)), (3.8, 0.0, 1.0))
    assert a[0] < 0.0


def find_obstacle(drone, now):
    """Return the id of the drone with the half space that forbids the wanted acceleration; -1: none.

    Also return whether a drone that may be near is not heard.

    It looks at the half spaces of all others, and not first whether the way is surely clear.
    """
    row, airspace = drone.row, drone.traffic.airspace
    listener = airspace.near.listeners[drone.traffic.listener]
    p, v = predict_late_motion(
        row["state"], row["acceleration"], row["lag"], row["delay"], np.inf
    )
    planes, near = make_planes(), make_nearest()
    count, is_blind = _constrain_all(
        row, listener, airspace.near.motions, now, p, v, planes, near
    )
    u = tuple(row["reference"][6:9].tolist())
    blocked = _find_drone_in_the_way(planes, near, count, u)
    if is_blind or blocked < 0.0:
        return -1, is_blind
    return int(airspace.near.motions[int(blocked)]["drone"]), is_blind


@pytest.mark.parametrize("method", METHODS)
def test_a_way_that_is_quickly_found_clear_is_clear(method):
    rng = np.random.default_rng(8)
    found = {"clear": 0, "blocked": 0, "blind": 0}
    for _ in range(400):
        others = int(rng.integers(1, 9))
        sky = Sky(method, others)
        for j in range(1, 1 + others):
            place = np.array([0.0, 0.0, 1.0]) + rng.uniform(-2.0, 2.0, 3)
            age = rng.choice([0.0, 0.1, 0.5, 1.2])
            sky.hears(j, place.clip(0.0), rng.uniform(-0.7, 0.7, 3), age)
        me = State.at((0.0, 0.0, 1.0), rng.uniform(-0.7, 0.7, 3))
        wanted = rng.uniform(-1.0, 1.0, 3)
        is_free = sky.drone.fly_acceleration(me, wanted, 0.0) is None
        obstacle, is_blind = find_obstacle(sky.drone, 0.0)
        is_cut_off = sky.drone.is_cut_off
        assert is_free == (obstacle < 0 and not is_blind and not is_cut_off)
        kind = "blind" if is_blind or is_cut_off else "clear" if is_free else "blocked"
        found[kind] += 1
    assert min(found.values()) > 40, f"all kinds must occur: {found}"
