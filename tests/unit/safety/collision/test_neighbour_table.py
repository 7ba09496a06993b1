"""What a drone knows of the others: what they say, and where cameras see the silent ones."""

import numpy as np
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.safety.collision.neighbour_table import NEIGHBOUR_ROW, NeighbourTable
from crazychoir.types import LinkStatus, State


@virtual
async def test_where_the_cameras_see_a_drone_counts_while_nothing_is_heard_of_it(clock):
    traffic = NeighbourTable(Bus(clock).port(0), [0, 1])
    traffic.seen(1, State.at((1.0, 0.0, 1.0)), 0.0)
    row = traffic.row(1)
    assert (row[0], row[NEIGHBOUR_ROW.share]) == (1.0, 1.0), (
        "a drone that is not heard gives way to no other"
    )
    assert row[NEIGHBOUR_ROW.heard_time] == -np.inf, "it is not heard for that"
    traffic.hear((1, State.at((2.0, 0.0, 1.0))), 0.0)
    assert (row[0], row[NEIGHBOUR_ROW.share]) == (2.0, 0.5)
    traffic.seen(1, State.at((3.0, 0.0, 1.0)), 0.0)
    assert row[0] == 2.0, "its own word counts while it is new"
    await clock.sleep(0.25)
    traffic.seen(1, State.at((3.0, 0.0, 1.0)), 0.0)
    assert (row[0], row[NEIGHBOUR_ROW.share]) == (3.0, 1.0)
    traffic.seen(7, State.at((3.0, 0.0, 1.0)), 0.0)


@virtual
async def test_a_drone_with_a_silent_radio_gives_way_to_no_other(
    clock,
):
    traffic = NeighbourTable(Bus(clock).port(0), [0, 1])
    for silence, age, share in (
        (0.1, 0.1, 0.5),
        (0.2, 0.15, 1.0),
        (2.0, 0.0, 1.0),
        (0.0, 0.05, 0.5),
    ):
        traffic.linked(1, LinkStatus("up", silence), age)
        traffic.linked(7, LinkStatus("up", silence), age)
        traffic.linked(1, None, 9.0)
        traffic.hear((1, State.at((2.0, 0.0, 1.0))), 0.0)
        assert (traffic.row(1)[NEIGHBOUR_ROW.share], traffic.deaf(1)) == (
            share,
            share == 1.0,
        )
