"""The choice of a path, one look at a time, for one drone among others."""

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import CollisionTable
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.collision.agreed.agreement import NO_PATH
from crazychoir.safety.collision.agreed.path_choice import WantedFlight
from crazychoir.safety.collision.agreed.path_limits import (
    PathLimits,
    compute_hard_path_room,
)
from crazychoir.safety.collision.agreed.paths import compute_end_place, plan_hold
from crazychoir.safety.collision.agreed.planned import PlannedFlights
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import FullState, State

FENCE = Fence.box((-3.0, -3.0, 0.25), (3.0, 3.0, 2.5))
START = np.array([0.0, 0.0, 1.0])


def rests_at(place, stands=False):
    """The wanted reference stands still at a place."""
    return WantedFlight(lambda later: FullState.at(place), 0.0, stands)


def moves_from(place, v, stands=False):
    """The wanted reference moves with a constant velocity."""
    v = np.array(v)
    return WantedFlight(
        lambda later: FullState.at(place + later * v, v), 0.0, stands=stands
    )


def lone(clock, others=()):
    """Drone 0 hovers; no drone announces a path, but some stand where their states say."""
    bus = Bus(clock)
    port = bus.port(0)
    ids = range(len(others) + 1)
    airspace = Airspace(bus, ids, AirspaceRules(CollisionTable(), 1.0, 0.0, (0,)))
    traffic = Neighbours(airspace, 0, keeps_all=True)
    flights = PlannedFlights(
        port, CollisionTable(), traffic, [0], PathLimits(FENCE, 2.0, 1.0, 0.0)
    )
    for i, place in enumerate(others, 1):
        traffic.hear((i, State.at(place)), 0.0)
    flights.agreement.begin(plan_hold(START, 1.0), clock.now())
    flights.obstacles.look(clock.now())
    return flights.agreement, flights.choice


@virtual
async def test_a_drone_on_its_reference_keeps_its_path(clock):
    mine, choice = lone(clock)
    mine.in_vain = 2.0
    way = mine.way
    choice.decide(rests_at(START), clock.now(), alone=False)
    assert mine.way is way
    assert mine.in_vain == 0.0


@virtual
async def test_a_lone_drone_goes_to_where_its_reference_rests(clock):
    mine, choice = lone(clock)
    goal = START + np.array([1.0, 0.0, 0.0])
    choice.decide(rests_at(goal), clock.now(), alone=False)
    assert compute_end_place(mine.way) == pytest.approx(goal)
    assert choice.gives_way_to is None


@virtual
async def test_a_moving_goal_beyond_the_fence_is_cut_off_there(clock):
    _, choice = lone(clock)
    near = np.array([2.9, 0.0, 1.0])
    goal, moves = choice._goal(moves_from(near, [1.0, 0.0, 0.0]), 0.0)
    assert moves
    assert goal == pytest.approx([3.0, 0.0, 1.0])


@virtual
async def test_a_reference_that_stands_is_the_goal_itself(clock):
    _, choice = lone(clock)
    waiting = moves_from(START, [1.0, 0.0, 0.0], stands=True)
    goal, moves = choice._goal(waiting, 0.5)
    assert not moves
    assert goal == pytest.approx(START)


@virtual
async def test_a_known_end_is_the_goal(clock):
    _, choice = lone(clock)
    flight = WantedFlight(lambda later: FullState.at(START * later), 2.0, stands=False)
    goal, moves = choice._goal(flight, 0.5)
    assert not moves
    assert goal == pytest.approx(2.0 * START)


@virtual
async def test_a_drone_gives_way_to_a_drone_on_its_reference(clock):
    mine, choice = lone(clock, [START + np.array([0.9, 0.0, 0.0])])
    way = mine.way
    choice.decide(moves_from(START, [1.0, 0.0, 0.0]), clock.now(), alone=True)
    assert choice.gives_way_to == 1
    assert mine.way is way
    assert mine.offer is NO_PATH


@virtual
async def test_a_landing_drone_alone_flies_on_without_asking(clock):
    mine, choice = lone(clock)
    number = mine.number
    choice.decide(moves_from(START, [0.2, 0.0, 0.0]), clock.now(), alone=True)
    assert compute_end_place(mine.way)[0] > START[0]
    assert mine.number == number, "no offer was made"
    assert choice.gives_way_to is None


@virtual
async def test_the_time_left_and_the_end_of_a_path_are_known(clock):
    mine, _ = lone(clock)
    began = clock.now()
    assert mine.left(began) == 1.0
    assert mine.left(began + 0.25) == 0.75
    assert mine.left(began + 9.0) == 0.0
    assert mine.comes_to(START + np.array([0.0, 0.0, 0.04]))
    assert not mine.comes_to(START + np.array([0.0, 0.0, 0.06]))


def test_path_needs_more_room_the_harder_it_is():
    assert compute_hard_path_room(1.2) == 0.0
    assert compute_hard_path_room(1.6) == pytest.approx(0.2)
    assert compute_hard_path_room(2.0) == compute_hard_path_room(9.0) == 0.4
