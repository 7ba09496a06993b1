"""Hearing: what a lost message leaves behind in a law; nothing."""

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.topics import STATE
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.guidance.hearing import Hearing
from crazychoir.runtime.mailbox import Latest
from crazychoir.types import Pose, State

H = 0.01


class Neighbor:
    """One that moves along a curve, seen by cameras with noise; and what is heard of it."""

    def __init__(self, clock, latency=0.0, noise=0.0005):
        self.clock, self.latency, self.noise = clock, latency, noise
        self.draw, self.filter = np.random.default_rng(3), VelocityFilter()
        self.box = Latest(clock, "state", STATE.max_age)
        self.hearing = Hearing(self.box, H, self.filter.cutoff, H, latency)

    async def step(self, arrives=True):
        """A period goes by; its state, and what a law is told of it."""
        await self.clock.sleep(H)
        t = self.clock.now() - self.latency
        p = np.array([np.sin(t), 0.5 * np.cos(0.7 * t), 1.0]) + self.noise * self.draw.standard_normal(3)
        state = self.filter.update(Pose(np.array([*p, 0.0, 0.0, 0.0, 1.0]), self.latency), self.clock.now())
        if arrives:
            self.box.put(state, state.age)
        return state, self.hearing.state()


@virtual
async def test_without_loss_it_tells_what_it_hears(clock):
    neighbor = Neighbor(clock)
    for _ in range(50):
        state, told = await neighbor.step()
        assert told.flat is state.flat


@pytest.mark.parametrize("latency", [0.0, 0.02])
@pytest.mark.parametrize("loss", [0.2, 0.5])
def test_the_sum_of_the_velocities_is_right_again_after_each_gap(loss, latency):
    @virtual
    async def flown(clock):
        neighbor, draw = Neighbor(clock, latency), np.random.default_rng(5)
        await neighbor.step()
        sent, told, naive = np.zeros(3), np.zeros(3), np.zeros(3)
        newest = None
        for _ in range(1000):
            arrives = draw.uniform() >= loss
            state, heard = await neighbor.step(arrives)
            newest = state if arrives or newest is None else newest
            sent, told, naive = sent + H * state.v, told + H * heard.v, naive + H * newest.v
            if arrives:
                assert told == pytest.approx(sent, abs=1e-9)
        assert np.abs(naive - sent).max() > 0.002, "what it is for"

    flown()


@virtual
async def test_in_a_gap_the_state_is_moved_on_at_constant_velocity(clock):
    neighbor = Neighbor(clock)
    for _ in range(20):
        last, _ = await neighbor.step()
    for k in range(1, 6):
        _, told = await neighbor.step(arrives=False)
        assert told.age == pytest.approx(k * H)
        assert told.p == pytest.approx(last.p + k * H * last.v)
        assert told.flat[3:].tolist() == last.flat[3:].tolist()


@virtual
async def test_what_is_stale_is_not_told_and_not_made_up_for(clock):
    neighbor = Neighbor(clock)
    for _ in range(20):
        await neighbor.step()
    told = [(await neighbor.step(arrives=False))[1] for _ in range(40)]
    assert [one is None for one in told] == [k * H > STATE.max_age + 1e-9 for k in range(1, 41)]
    state, heard = await neighbor.step()
    assert heard.flat is state.flat


@virtual
async def test_steps_that_were_left_out_are_not_made_up_for(clock):
    box = Latest(clock, "state", STATE.max_age)
    hearing = Hearing(box, H, 50.0, H)
    for _ in range(2):
        box.put(State.at((0.0, 0.0, 1.0), (0.5, 0.0, 0.0)))
        hearing.state()
    for k in range(50):
        box.put(State.at((0.005 * k, 0.0, 1.0), (0.5, 0.0, 0.0)))
    hearing.start()
    assert hearing.state().v.tolist() == [0.5, 0.0, 0.0]
