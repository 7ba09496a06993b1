"""The drones that heartbeats reach before the start."""

from crazychoir.team import graph as graphs
from crazychoir.team.close_drones import (
    CLOSE_DRONES,
    DroneSearch,
    list_lowest,
    list_near,
)


def test_near_drones_are_the_neighbours_and_the_named_ones():
    assert list_near(graphs.ring(6), 3, 0, 3, 4) == (0, 2, 4)


def test_all_drones_of_a_small_swarm_are_among_the_lowest():
    ids = tuple(range(CLOSE_DRONES + 1))
    assert list_lowest(ids) == ids
    assert list_lowest((*ids, 99)) == ids


def test_a_search_goes_through_all_drones_and_begins_again():
    ids = tuple(range(CLOSE_DRONES + 5))
    search = DroneSearch(ids)

    first = search.take_turn()
    second = search.take_turn()

    assert first == ids[:CLOSE_DRONES]
    assert {*first, *second} == {*ids}
    assert len(second) == CLOSE_DRONES


def test_a_small_swarm_needs_no_turn():
    assert DroneSearch(tuple(range(CLOSE_DRONES + 1))).count_turns() == 0
    assert DroneSearch(tuple(range(CLOSE_DRONES + 2))).count_turns() == 1
