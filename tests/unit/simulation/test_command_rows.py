"""Commands as rows act as commands by links: to the bit, with and without delay, in every world that takes them."""

from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.platforms import (
    CRAZYFLIE_21,
    CRAZYFLIE_21_BRUSHLESS,
    PAPER_PLATFORM,
)
from crazychoir.simulation.command_rows import CommandRows, RowLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.owner import DelayedLink
from crazychoir.types import FPQR, FRPY, XYZ

IDS = (3, 0, 7)
IN_THE_AIR = np.array([0.0, 0.0, 3.0])
LANDING = XYZ("land", np.array([0.0, 0.0, 0.0, 0.0, 1.0]))
PLACES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])


def lightweight(inputs):
    return CFIntegrator(IDS, PLACES + IN_THE_AIR, inputs=inputs)


def motors():
    platforms = [CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS, CRAZYFLIE_21]
    world = CrazyflieWorld(IDS, PLACES, None, platforms, seed=2)
    for _ in range(30):  # the firmware starts
        world.step()
    return world


WORLDS = {
    "rates": (lambda: lightweight("rates"), FPQR, PAPER_PLATFORM.weight),
    "euler": (lambda: lightweight("euler"), FPQR, PAPER_PLATFORM.weight),
    "motors fpqr": (motors, FPQR, 1.3 * CRAZYFLIE_21.weight),
    "motors frpy": (motors, FRPY, 1.3 * CRAZYFLIE_21.weight),
}


class Recorder:
    """A world that keeps the commands that it takes."""

    ids = IDS
    takes_rows = ("fpqr",)

    def __init__(self):
        self.taken = []

    def take_commands(self, inputs, is_new):
        rows = np.flatnonzero(is_new).tolist()
        self.taken.append({row: inputs[row, 0] for row in rows})


def write(rows, row, thrust):
    rows.inputs[row] = thrust
    rows.is_new[row] = 1


@pytest.mark.parametrize("delay", [0, 3])
@pytest.mark.parametrize("case", WORLDS)
def test_rows_fly_as_links_to_the_bit(case, delay):
    make, command_type, weight = WORLDS[case]
    kind = command_type.__name__.lower()
    by_rows = make()
    by_links = make()
    rows = CommandRows(by_rows, delay)
    assert kind in rows.kinds
    for i in IDS:
        by_rows.link(i, kind)
    links = [DelayedLink(by_links.link(i, kind), delay) for i in IDS]
    draw = np.random.default_rng(4)
    for step in range(120):
        for row, link in enumerate(links):
            flat = 0.2 * draw.standard_normal(4) * [0.1, 1.0, 1.0, 1.0]
            flat[0] += weight
            if draw.uniform() < 0.2:
                continue  # no new command
            if draw.uniform() < 0.05:
                flat[draw.integers(4)] = draw.choice([np.nan, np.inf, -5.0])
            link.send(command_type(flat))
            rows.inputs[row] = flat
            rows.is_new[row] = 1
        if step == 100:
            links[1].cut()
            RowLink(rows, 1, by_rows.link(IDS[1], kind), (command_type,)).cut()
        for link in links:
            link.advance()
        rows.advance()
        by_links.step()
        by_rows.step()
        np.testing.assert_array_equal(by_rows.states, by_links.states)
    assert np.ptp(by_rows.states[:, 2]) > 0.0
    assert not rows.is_new.any()


def test_a_row_is_the_same_alone_and_among_others():
    alone = CFIntegrator([7], PLACES[2:] + IN_THE_AIR, inputs="euler")
    among = lightweight("euler")
    for world in (alone, among):
        rows = CommandRows(world)
        for step in range(50):
            rows.inputs[:] = [PAPER_PLATFORM.weight, 0.3, -0.2, 0.01 * step]
            rows.is_new[:] = 1
            rows.advance()
            world.step()
    np.testing.assert_array_equal(alone.states[0], among.states[2])


def test_a_command_takes_effect_once_after_its_delay():
    world = Recorder()
    rows = CommandRows(world, 2)
    write(rows, 0, 1.0)
    rows.advance()
    write(rows, 1, 2.0)
    write(rows, 1, 3.0)
    for _ in range(3):
        rows.advance()
    assert world.taken == [{}, {}, {0: 1.0}, {1: 3.0}]


def test_a_cut_discards_what_is_on_its_way():
    world = Recorder()
    rows = CommandRows(world, 2)
    cuts = []
    body = SimpleNamespace(
        cut=lambda: cuts.append("cut"), send=lambda command: cuts.append(command)
    )
    write(rows, 0, 1.0)
    rows.advance()
    link = RowLink(rows, 0, body, (FPQR,))
    link.send(FPQR(np.ones(4)))
    link.send(LANDING)
    write(rows, 1, 2.0)
    link.cut()
    for _ in range(4):
        rows.advance()
    assert cuts == ["cut"]
    assert world.taken == [{}, {}, {}, {1: 2.0}, {}]


@pytest.mark.parametrize("delay", [0, 2])
def test_a_command_of_another_kind_keeps_its_place_in_the_order(delay):
    world = Recorder()
    rows = CommandRows(world, delay)
    body = SimpleNamespace(send=world.taken.append)
    link = RowLink(rows, 0, body, (FPQR,))
    link.send(FPQR(np.ones(4)))
    rows.advance()
    link.send(FPQR(np.full(4, 2.0)))
    link.send(LANDING)
    rows.advance()
    link.send(LANDING)
    link.send(FPQR(np.full(4, 3.0)))
    for _ in range(delay + 1):
        rows.advance()
    began = [{}] * delay
    assert world.taken == [*began, {0: 1.0}, LANDING, {}, LANDING, {0: 3.0}]


def test_a_world_without_rows_takes_commands_by_links_only():
    rows = CommandRows(SimpleNamespace(ids=IDS))
    assert rows.kinds == ()
    rows.advance()
