"""What a drone hears of a neighbour does not depend on the other rows of the table."""

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.guidance.decision.hearing_rows import (
    HEARING_ROW,
    put_first_row,
    take_rows,
)
from crazychoir.guidance.neighbour_state import (
    PairedStateMailbox,
    StateMailbox,
    VelocitySum,
)
from crazychoir.runtime.clock import run_virtual
from crazychoir.types import State

H = 0.01
MS = 1_000_000  # ns


def mailbox(clock, is_paired, rows=None):
    """Return a mailbox for the states of one neighbour."""
    if is_paired:
        return PairedStateMailbox(clock, "state", H, rows)
    return StateMailbox(clock, "state", VelocitySum(40.0, H, H), rows)


def draw_state(random):
    return State(random.normal(size=13), 0.003, random.normal(size=3))


@virtual
async def test_a_row_gives_the_same_bits_alone_and_among_others(clock):
    random = np.random.default_rng(5)
    table = np.zeros(6, HEARING_ROW)
    kinds = [False, True, False, True, False, True]
    among = [mailbox(clock, kind, table[e : e + 1]) for e, kind in enumerate(kinds)]
    alone = [mailbox(clock, kind) for kind in kinds]
    for _ in range(400):
        await clock.sleep(H if random.uniform() < 0.98 else 0.3)
        for one, other in zip(alone, among, strict=True):
            for _ in range(random.choice([0, 1, 2], p=[0.3, 0.6, 0.1])):
                state = draw_state(random)
                one.put(state, 0.004)
                other.put(state, 0.004)
        held = int(random.choice([1, 1, 2]))
        told = [one.state(clock.now_ns(), held) for one in alone]
        take_rows(table, clock.now_ns(), held)
        for state, row in zip(told, table, strict=True):
            assert (state is not None) == row["is_heard"]
            if state is not None:
                assert state.flat.tobytes() == row["told"].tobytes()
                assert state.a.tobytes() == row["told_acceleration"].tobytes()
                assert state.age == row["told_age"]
    assert [one.stale for one in alone] == table["stale"].tolist()
    assert min(table["stale"]) > 0, "gaps were long enough"


@virtual
async def test_a_mailbox_goes_on_in_another_table(clock):
    await clock.sleep(1.0)
    box = mailbox(clock, is_paired=False)
    box.put(State.at((1.0, 2.0, 3.0)))
    table = np.zeros(2, HEARING_ROW)
    box.move_to(table[1:2])
    assert table[1]["state"][:3].tolist() == [1.0, 2.0, 3.0]
    box.put(State.at((4.0, 2.0, 3.0)))
    assert table["state"][:, 0].tolist() == [0.0, 4.0]
    assert (box.received, box.dropped) == (2, 1)
    box.clear()
    assert box.state(clock.now_ns(), 1) is None
    assert box.stale == 0


@pytest.mark.parametrize(
    "state",
    [
        State(np.zeros(12)),
        State(np.zeros(14)),
        State(np.zeros(13), 0.0, np.zeros(2)),
        State(np.array(["x"] * 13)),
    ],
)
def test_what_has_not_the_numbers_of_a_state_is_dropped(state):
    async def put(clock):
        box = mailbox(clock, is_paired=False)
        box.put(state)
        assert (box.received, box.dropped) == (1, 1)
        assert not box.is_fresh()

    run_virtual(put)


@virtual
async def test_arrays_of_another_type_are_converted(clock):
    box = mailbox(clock, is_paired=False)
    box.put(State(np.arange(13, dtype=np.float32), 0.0, np.arange(6.0)[::2]))
    told = box.state(clock.now_ns(), 1)
    assert told.flat.tolist() == list(range(13))
    assert told.a.tolist() == [0.0, 2.0, 4.0]


@pytest.mark.parametrize("age", [np.nan, np.inf])
def test_a_message_without_an_age_is_dropped(age):
    rows = np.zeros(1, HEARING_ROW)
    put_first_row(rows, np.zeros(13), np.zeros(3), 0.0, age, 5 * MS)
    assert (rows["version"], rows["dropped"]) == (0, 1)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e9])
@pytest.mark.parametrize("part", ["state", "acceleration"])
def test_a_state_that_is_no_number_is_dropped_and_the_one_before_stays(part, wrong):
    rows = np.zeros(1, HEARING_ROW)
    put_first_row(rows, np.full(13, 1.0), np.full(3, 2.0), 0.0, 0.0, 50 * MS)
    state, acceleration = np.full(13, 3.0), np.full(3, 4.0)
    {"state": state, "acceleration": acceleration}[part][2] = wrong
    put_first_row(rows, state, acceleration, 0.0, 0.0, 60 * MS)
    assert rows["state"][0].tolist() == 13 * [1.0]
    assert rows["acceleration"][0].tolist() == 3 * [2.0]
    assert (rows["received"], rows["dropped"]) == (2, 1)


def test_a_message_that_was_overtaken_is_dropped():
    rows = np.zeros(1, HEARING_ROW)
    put_first_row(rows, np.full(13, 1.0), np.zeros(3), 0.0, 0.0, 50 * MS)
    put_first_row(rows, np.full(13, 2.0), np.zeros(3), 0.0, 0.02, 55 * MS)
    assert rows["state"][0, 0] == 1.0
    assert rows["dropped"] == 1
    assert rows["born_ns"] == 50 * MS
