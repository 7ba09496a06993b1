"""Commands that are late by whole steps: as late as in the lightweight world's own model, and in its order."""

import numpy as np
import pytest

from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.simulation.delay import DelayedLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.types import FPQR


class Kept:
    """In a drone's place: what arrives."""

    def __init__(self):
        self.got = []

    def send(self, command):
        self.got.append(command)

    def cut(self):
        self.got.append("cut")


def world(**options):
    return CFIntegrator([0], np.array([[0.0, 0.0, 1.0]]), rate_lag=0.03, **options)


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_link_that_is_late_is_the_same_as_a_plant_that_is(steps):
    late, plain = world(command_delay=0.01 * steps), world()
    link = DelayedLink(plain.link(0), steps)
    draw = np.random.default_rng(1)
    for _ in range(60):
        command = FPQR(
            np.array([PAPER_PLATFORM.weight, 0.0, 0.0, 0.0])
            + 0.05 * draw.standard_normal(4)
        )
        late.link(0).send(command)
        link.send(command)
        link.advance()
        plain.step()
        late.step()
        assert np.array_equal(plain.states, late.states)


def test_all_that_is_on_its_way_arrives_once_and_in_order():
    kept = Kept()
    link = DelayedLink(kept, 2)
    for command in ("a", "b"):
        link.send(command)
    link.advance()
    link.send("c")
    assert kept.got == []
    link.advance()
    link.advance()
    assert kept.got == ["a", "b"]
    link.advance()
    assert kept.got == ["a", "b", "c"]


def test_a_cut_overtakes_what_is_on_its_way():
    kept = Kept()
    link = DelayedLink(kept, 2)
    link.send("a")
    link.cut()
    for _ in range(5):
        link.advance()
    assert kept.got == ["cut"]
