"""What a law is told: late steps, and lost, late or repeated messages leave no trace in the sum of velocities."""

import math

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.guidance.neighbour_state import (
    CORRECTION_STEPS,
    PairedStateMailbox,
    StateMailbox,
    VelocitySum,
)
from crazychoir.types import Pose, State

H = 0.01
CUTOFF = VelocityFilter().cutoff
NOISE = 0.0005


def seen(t, draw, age=0.0, noise=NOISE):
    """Return what cameras see at t of a drone that moves along a curve."""
    p = np.array(
        [np.sin(t), 0.5 * np.cos(0.7 * t), 1.0]
    ) + noise * draw.standard_normal(3)
    return Pose(np.array([*p, 0.0, 0.0, 0.0, 1.0]), age)


# The sum of the velocities -------------------------------------------------------------------------------------------


def drift(holds, told, ages=0.0):
    """Return by how many m, at most, a drone moves away when it flies each velocity for its hold.

    The velocities are told of a neighbour that stands still.
    holds: s from each step to the next;  ages: s, of each pose when it is seen.
    """
    draw, motion = np.random.default_rng(3), VelocityFilter()
    now, way, worst = 0.0, np.zeros(3), 0.0
    for hold, age in zip(holds, np.broadcast_to(ages, len(holds)), strict=True):
        state = motion.update(
            Pose(np.array([*(NOISE * draw.standard_normal(3)), 0, 0, 0, 1.0]), age),
            now + age,
        )
        way, now = way + hold * told(state, hold), now + hold
        worst = max(worst, float(np.abs(way).max()))
    return worst


def summed(holds):
    """What a VelocitySum tells, step by step."""
    sums, last = (
        VelocitySum(CUTOFF, H, H),
        iter([0, *(round(hold / H) for hold in holds)]),
    )

    def told(state, hold):
        held = next(last)
        return sums.told(state, state.age, held, held).v

    return told


def test_in_steps_on_time_it_tells_the_velocity_itself():
    draw, motion, sums = (
        np.random.default_rng(3),
        VelocityFilter(),
        VelocitySum(CUTOFF, H, H),
    )
    for k in range(500):
        state = motion.update(seen(H * k, draw), H * k)
        told = sums.told(state, state.age, int(k > 0), int(k > 0))
        assert told.flat is state.flat


@pytest.mark.parametrize("longest", [2, 5])
@pytest.mark.parametrize("late", [0.0, 0.003])
def test_late_steps_leave_no_trace_in_the_sum(longest, late):
    draw = np.random.default_rng(5)
    holds = H * np.where(
        draw.uniform(size=20_000) < 0.1, draw.integers(2, longest + 1, 20_000), 1
    )
    ages = draw.uniform(0.0, late, len(holds)) if late else 0.0
    assert drift(holds, summed(holds), ages) < 0.006
    assert drift(holds, lambda state, hold: state.v, ages) > 0.015, "what it is for"


@pytest.mark.parametrize("steps", [3, 15, 19])
def test_what_is_always_late_is_made_up_for_without_swinging(steps):
    holds = np.full(400, steps * H)
    assert drift(holds, summed(holds)) < 0.02


def test_what_is_owed_is_told_within_some_steps():
    sums, v = VelocitySum(CUTOFF, H, H), np.array([0.5, 0.0, 0.0])
    sums.told(State.at((0.0, 0.0, 1.0), v), 0.0, 0, 0)
    assert sums.told(State.at((0.01 + 0.01, 0.0, 1.0), v), 0.0, 2, 2).v[
        0
    ] == pytest.approx(0.5 + 0.01 / (CORRECTION_STEPS * H))
    owed = [
        sums.told(State.at((0.02 + 0.005 * k, 0.0, 1.0), v), 0.0, 1, 1).v[0] - 0.5
        for k in range(1, 200)
    ]
    assert H * sum(owed) == pytest.approx(0.009, abs=2e-7)
    assert owed[-1] == 0.0


def test_a_place_that_was_moved_on_counts_where_it_was_measured():
    sums, v = VelocitySum(CUTOFF, H, H), np.array([0.5, 0.2, 0.0])
    for k, age in enumerate((0.0, 0.004, 0.009, 0.001)):
        flat = State.at(v * (2 * H * k + age) + [0.0, 0.0, 1.0], v).flat
        assert sums.told(State(flat, age), age, 2, 2).v == pytest.approx(v)


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_what_is_no_number_is_forgotten(broken):
    sums = VelocitySum(CUTOFF, H, H)
    for x in (0.0, broken, 0.0, 0.0):
        told = sums.told(State.at((x, 0.0, 1.0), (0.1, 0.0, 0.0)), 0.0, 2, 2)
    assert np.isfinite(told.flat).all()


@pytest.mark.parametrize("held", [2 * round(CORRECTION_STEPS), 500])
def test_after_a_long_gap_it_starts_anew(held):
    sums = VelocitySum(CUTOFF, H, H)
    sums.told(State.at((0.0, 0.0, 1.0), (0.5, 0.0, 0.0)), 0.0, 0, 0)
    assert (
        sums.told(State.at((3.0, 0.0, 1.0), (0.5, 0.0, 0.0)), 0.0, held, held).v[0]
        == 0.5
    )


# A neighbour ---------------------------------------------------------------------------------------------------------


class Neighbor:
    """A drone that moves along a curve, seen by cameras with noise; and what is heard of it."""

    def __init__(self, clock, latency=0.0, noise=NOISE):
        self.clock, self.latency, self.noise = clock, latency, noise
        self.draw, self.filter = np.random.default_rng(3), VelocityFilter()
        self.hearing = StateMailbox(clock, "state", VelocitySum(CUTOFF, H, H))

    async def step(self, arrives=1):
        """Wait a period; return the state, which arrives so many times, and what a law is told of it."""
        await self.clock.sleep(H)
        now = self.clock.now()
        state = self.filter.update(
            seen(now - self.latency, self.draw, self.latency, self.noise), now
        )
        for _ in range(arrives):
            self.hearing.put(state, state.age)
        return state, self.hearing.state(self.clock.now_ns(), 1)


@virtual
async def test_without_loss_it_tells_what_it_hears(clock):
    neighbor = Neighbor(clock)
    for _ in range(50):
        state, told = await neighbor.step()
        assert told.flat == pytest.approx(state.flat, abs=1e-12)


@pytest.mark.parametrize("latency", [0.0, 0.005, 0.02])
@pytest.mark.parametrize("loss", [0.2, 0.5])
def test_the_sum_of_the_velocities_is_right_though_messages_are_lost(loss, latency):
    """`steady` is about how far it goes, `naive` how far it would."""

    @virtual
    async def flown(clock):
        neighbor, draw = Neighbor(clock, latency), np.random.default_rng(5)
        sent, told, naive = np.zeros(3), np.zeros(3), np.zeros(3)
        newest, steady, drifted = None, [], []
        for k in range(8000):
            arrives = k == 0 or draw.uniform() >= loss
            state, heard = await neighbor.step(arrives)
            newest = state if arrives else newest
            sent, told, naive = (
                sent + H * state.v,
                told + H * heard.v,
                naive + H * newest.v,
            )
            steady.append(np.abs(told - sent).max())
            drifted.append(np.abs(naive - sent).max())
        assert max(steady[100:]) < 0.012
        assert max(drifted) > 1.5 * max(steady), "what it is for"

    flown()


@virtual
async def test_messages_that_come_two_and_none_a_step_leave_no_trace(clock):
    neighbor, draw = Neighbor(clock), np.random.default_rng(5)
    await neighbor.step()
    sent, told, naive, waiting, worst, drifted = (
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
        0,
        0.0,
        0.0,
    )
    newest = None
    for _ in range(8000):
        late = draw.uniform() < 0.3
        state, heard = await neighbor.step(0 if late else 1 + waiting)
        waiting = int(late)
        newest = state if not late or newest is None else newest
        sent, told, naive = sent + H * state.v, told + H * heard.v, naive + H * newest.v
        worst, drifted = (
            max(worst, np.abs(told - sent).max()),
            max(drifted, np.abs(naive - sent).max()),
        )
    assert worst < 0.006
    assert drifted > 2.0 * worst, "what it is for"


@virtual
async def test_in_a_gap_the_state_is_moved_on_at_constant_velocity(clock):
    neighbor = Neighbor(clock, latency=0.02)
    for _ in range(20):
        last, _ = await neighbor.step()
    for k in range(1, 6):
        _, told = await neighbor.step(arrives=0)
        assert told.age == pytest.approx(0.02 + k * H)
        assert told.p == pytest.approx(last.p + k * H * last.v)
        assert told.flat[3:].tolist() == last.flat[3:].tolist()


@virtual
async def test_the_acceleration_that_was_heard_last_is_told_until_the_next_one_comes(
    clock,
):
    neighbor, draw = Neighbor(clock), np.random.default_rng(5)
    heard = None
    for k in range(200):
        await clock.sleep(H)
        now = clock.now()
        state = neighbor.filter.update(seen(now, draw), now)
        if k == 0 or draw.uniform() < 0.5:
            heard = np.array([0.1 * k, 0.0, -1.0])
            neighbor.hearing.put(
                State(state.flat, state.age, heard), state.age + 0.002 * (k % 3)
            )
        told = neighbor.hearing.state(clock.now_ns(), 1 + k % 2)
        assert told.a.tolist() == heard.tolist()


@virtual
async def test_what_is_stale_is_not_told_and_not_made_up_for(clock):
    neighbor = Neighbor(clock)
    for _ in range(20):
        await neighbor.step()
    told = [(await neighbor.step(arrives=0))[1] for _ in range(40)]
    assert [one is None for one in told] == [
        k * H > DRONE_TOPICS.state.max_age + 1e-9 for k in range(1, 41)
    ]
    state, heard = await neighbor.step()
    assert heard.flat.tolist() == state.flat.tolist()


# A neighbour's commands, together with where it was ------------------------------------------------------------------


def commanded(k):
    """Return the state of a drone that accelerates, seen in tick k: a was commanded in the tick before."""
    t = H * k
    return State(
        State.at((0.5 * t * t, -t, 1.0), (t, -1.0, 0.0)).flat,
        0.0,
        np.array([0.1 * (k - 1.0), 0.0, 0.0]),
    )


@pytest.mark.parametrize("delay", [0, 2])
def test_place_and_velocity_are_told_with_the_acceleration_of_their_tick(delay):
    @virtual
    async def flown(clock):
        paired, draw, pair, newest, lost = (
            PairedStateMailbox(clock, "state", H),
            np.random.default_rng(5),
            None,
            0,
            0,
        )
        await clock.sleep(1.0)
        for k in range(2, 300):
            await clock.sleep(H)
            if k < 4 or draw.uniform() >= 0.4:
                paired.put(commanded(k), delay * H)
                newest = k
            told = paired.state(clock.now_ns(), 1)
            assert told.age == pytest.approx((k - newest + delay) * H), "of the message"
            assert told.a.tolist() == commanded(newest).a.tolist()
            if k == 2:
                assert told.flat.tolist() == commanded(2).flat.tolist(), (
                    "nothing came before the first"
                )
            elif newest == k:
                pair, before = told, commanded(k - 1)
                np.testing.assert_allclose(told.v, before.v, atol=1e-12)
                np.testing.assert_allclose(told.p, before.p, atol=0.002)
            else:
                lost += 1
                np.testing.assert_array_equal(told.flat, pair.flat, "held together")
        assert lost > 50

    flown()


@virtual
async def test_pairs_that_are_stale_are_not_told_and_begin_anew(clock):
    paired = PairedStateMailbox(clock, "state", H)
    assert paired.state(clock.now_ns(), 1) is None
    for k in range(1, 4):
        await clock.sleep(H)
        paired.put(commanded(k))
        paired.state(clock.now_ns(), 1)
    await clock.sleep(DRONE_TOPICS.state.max_age + 2 * H)
    assert paired.state(clock.now_ns(), 1) is None
    assert paired.stale == 1
    paired.put(commanded(90))
    assert paired.state(clock.now_ns(), 1).flat.tolist() == commanded(90).flat.tolist()
