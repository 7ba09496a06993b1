"""Drones that tell their paths: which path each may fly and chooses. Whole chains of messages, no flight."""

import math
from functools import partial

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.tables import CollisionTable
from crazychoir.flight.references import extrapolate_reference
from crazychoir.planning.figure import circle
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.collision.agreed.agreement import (
    NO_PATH,
    NO_REST_PLACE,
    PLAN_ANNOUNCEMENTS,
)
from crazychoir.safety.collision.agreed.obstacles import OBSTACLE_LIMITS
from crazychoir.safety.collision.agreed.path_limits import PLANNING_TIMES, PathLimits
from crazychoir.safety.collision.agreed.paths import (
    compute_end_place,
    compute_motion,
    compute_path_duration,
    find_peak_sideways_acceleration,
    plan_flight,
    plan_hold,
)
from crazychoir.safety.collision.agreed.planned import PlannedFlights
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import FullState, LinkStatus, Plan, State

FENCE = Fence.box((-3.0, -3.0, 0.25), (3.0, 3.0, 2.5))
TICK = 0.01
A, B = np.array([-1.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.0])


class Flier:
    """A drone that is always where its way says; it wants to be at `goal`."""

    def __init__(self, airspace, i, ids, at, goal=None, planners=None):
        planners = ids if planners is None else planners
        bus = airspace.bus
        port = bus.ports[i]
        self.port, self.id = port, i
        traffic = Neighbours(airspace, i, keeps_all=True)
        self.filter = PlannedFlights(
            port,
            CollisionTable(),
            traffic,
            planners,
            PathLimits(FENCE, a_max=2.0, v_max=1.0, ground=0.0),
        )
        self.at, self.goal = (
            np.array(at, dtype=float),
            np.array(at if goal is None else goal, dtype=float),
        )
        self.track, self.flies, self.v, self.lands = [], True, np.zeros(3), False

    def tick(self, now):
        self.filter.traffic.publish(State.at(self.at, self.v), 0.0)
        self.filter.traffic.airspace.step()
        if self.flies:
            wanted = FullState.at(self.goal)
            state = State.at(self.at, self.v)
            flown = self.filter.fly(
                state, self.wanted(), lambda later: wanted, 0.0, now, self.lands
            )
            self.at, self.v = flown.p.copy(), flown.v.copy()
        self.track.append(self.at.copy())

    def wanted(self):
        return FullState.at(self.goal)


def later_of(way, t, later):
    return way.sample(t + later)


def crowd(clock, *places, rules=(), planners=None):
    """Drones 0, 1 ... each from a place to another."""
    bus = Bus(clock, Impairment(3, [ImpairmentRule(effects) for effects in rules]))
    ids = list(range(len(places)))
    for i in ids:
        bus.port(i)
    bus.impairment.begin(0.0)
    alone = tuple(ids if planners is None else planners)
    airspace = Airspace(bus, ids, AirspaceRules(CollisionTable(), 1.0, 0.0, alone))
    return bus, [Flier(airspace, i, ids, *places[i], planners=planners) for i in ids]


async def fly(clock, drones, duration):
    for _ in range(round(duration / TICK)):
        await clock.sleep(TICK)
        for drone in drones:
            drone.tick(clock.now_ns() / NS_PER_SECOND)


def nearest(one, two):
    d = (np.array(one.track) - np.array(two.track)) * [1.0, 1.0, 0.4]
    return float(np.linalg.norm(d, axis=1).min())


def off_line(drone, a, b):
    """m by which it has been beside the straight line between two places."""
    along = (b - a) / np.linalg.norm(b - a)
    beside = (np.array(drone.track) - a) @ (np.eye(3) - np.outer(along, along))
    return float(np.linalg.norm(beside, axis=1).max())


def arrived(drone):
    """s, until it was at its goal for good."""
    there = np.linalg.norm(np.array(drone.track) - drone.goal, axis=1) < 0.05
    return TICK * (len(there) - int(np.argmin(there[::-1])))


@virtual
async def test_a_lone_drone_flies_straight_and_asks_no_other(clock):
    _, drones = crowd(clock, (A, B))
    await fly(clock, drones, 6.0)
    assert drones[0].at == pytest.approx(B, abs=1e-6)
    assert off_line(drones[0], A, B) < 1e-6
    assert arrived(drones[0]) < 4.9


@virtual
async def test_two_that_swap_their_places_keep_their_distance(clock):
    _, drones = crowd(clock, (A, B), (B, A))
    await fly(clock, drones, 15.0)
    assert [drone.at.round(3).tolist() for drone in drones] == [B.tolist(), A.tolist()]
    assert nearest(*drones) >= 0.335
    assert off_line(drones[0], A, B) + off_line(drones[1], A, B) > 0.3


@virtual
async def test_two_swap_their_places_although_messages_are_late_and_lost(clock):
    late = {"delay": 0.15, "jitter": 0.1, "loss": 0.1}
    _, drones = crowd(clock, (A,), (B,), rules=[late])
    await fly(clock, drones, 1.0)
    drones[0].goal = B.copy()
    drones[1].goal = A.copy()
    await fly(clock, drones, 15.0)
    assert [drone.at.round(3).tolist() for drone in drones] == [B.tolist(), A.tolist()]
    assert nearest(*drones) >= 0.335


@virtual
async def test_two_that_rest_on_each_others_goals_make_room_for_each_other(clock):
    await make_room(clock, 1.4)


@virtual
async def test_two_that_are_hardly_clear_make_room_for_each_other(clock):
    await make_room(clock, 0.5)


async def make_room(clock, apart):
    """For each alone it does not pay to go nearer to a goal that is taken; a third makes both ask, and wait."""
    left, right = np.array([-0.5 * apart, 0.0, 1.0]), np.array([0.5 * apart, 0.0, 1.0])
    _, drones = crowd(clock, ((0.0, 2.5, 1.0),), (left, right), (right, left))
    await fly(clock, drones, 8.0)
    for drone in drones:
        assert drone.at == pytest.approx(drone.goal, abs=1e-3)
    assert nearest(*drones[1:]) >= 0.335


@virtual
async def test_a_drone_that_is_at_its_goal_does_not_make_room(clock):
    _, drones = crowd(clock, (A,), (B, A))
    await fly(clock, drones, 8.0)
    assert drones[0].filter.agreement.awaited(clock.now())[0] == pytest.approx(A)
    assert drones[0].at == pytest.approx(A)
    await fly(clock, drones[:1], 2.0)
    assert drones[0].filter.agreement.awaited(clock.now()) == (), "it is silent"


@virtual
async def test_landing_drone_does_not_wait_for_a_free_place(clock):
    _, (one, waits) = crowd(clock, (A,), (B, A))
    await fly(clock, (one, waits), 8.0)
    assert waits.filter.agreement.awaits == pytest.approx(A)
    waits.filter.lands(
        FullState.at(waits.at), clock.now() + PLANNING_TIMES.check_interval
    )
    assert len(waits.filter.agreement.awaits) == 0


@virtual
async def test_a_way_a_little_behind_what_is_wanted_catches_up_gently(clock):
    _, drones = crowd(clock, (A,))
    await fly(clock, drones, 0.5)
    wanted, now = (
        FullState.at(A + np.array([0.04, 0.0, 0.0])),
        clock.now() + PLANNING_TIMES.check_interval,
    )
    drones[0].filter.fly(State.at(A), wanted, lambda later: wanted, 0.05, now)
    way = drones[0].filter.agreement.way
    assert compute_end_place(way) == pytest.approx(wanted.p)
    assert find_peak_sideways_acceleration(way) < 0.9


@virtual
async def test_a_stream_that_begins_at_full_speed_is_caught_up_with_gently(clock):
    _, drones = crowd(clock, (A,))
    await fly(clock, drones, 0.5)
    stream, now = (
        FullState.at(A, [0.8, 0.0, 0.0]),
        clock.now() + PLANNING_TIMES.check_interval,
    )
    drones[0].filter.fly(
        State.at(A), stream, partial(extrapolate_reference, stream), 0.0, now
    )
    way = drones[0].filter.agreement.way
    assert compute_end_place(way)[0] > A[0] + 0.8
    assert find_peak_sideways_acceleration(way) < 2.0, (
        "a harder one is flown less exactly than the others take it to be"
    )


@virtual
async def test_six_that_swap_across_a_circle_arrive_though_messages_are_lost_in_bursts(
    clock,
):
    angles = np.pi / 3.0 * np.arange(6)
    spots = np.column_stack(
        [1.5 * np.cos(angles), 1.5 * np.sin(angles), np.full(6, 1.0)]
    )
    burst = {"p_good_bad": 0.0278, "p_bad_good": 0.25}
    _, drones = crowd(
        clock, *((spots[k], spots[(k + 3) % 6]) for k in range(6)), rules=[burst]
    )
    await fly(clock, drones, 25.0)
    for k, drone in enumerate(drones):
        assert drone.at == pytest.approx(spots[(k + 3) % 6], abs=1e-3)
        assert all(nearest(drone, other) >= 0.335 for other in drones[:k])


@virtual
async def test_a_crossing_drone_starts_later_or_turns_aside_and_the_lower_id_does_not(
    clock,
):
    _, drones = crowd(clock, (A, B), ((0.0, -1.0, 1.0), (0.0, 1.0, 1.0)))
    await fly(clock, drones, 12.0)
    assert off_line(drones[0], A, B) < 1e-6
    assert arrived(drones[1]) > arrived(drones[0]) + 0.3
    assert nearest(*drones) >= 0.335


@virtual
async def test_without_an_answer_it_stays(clock):
    """The lower one hears, and what it says is lost: nothing is flown that it has not agreed to."""
    _, drones = crowd(clock, ((-1.0, 2.0, 1.0),), (A, B))
    await fly(clock, drones, 0.5)
    deaf = Impairment(1, [ImpairmentRule({"loss": 1.0}, edge=(0, 1), directed=True)])
    drones[0].port.bus.impairment = deaf
    deaf.begin(clock.now())
    away = drones[1].at.copy()
    drones[1].goal = A.copy()
    await fly(clock, drones, 2.0)
    assert np.linalg.norm(drones[1].at - away) < 1.0, "it came to rest"


@virtual
async def test_an_offer_that_is_not_agreed_to_in_time_is_forgotten(clock):
    _, drones = crowd(clock, (A,), (B,))
    await fly(clock, drones, 0.5)
    one = drones[1].filter.agreement
    now = clock.now()
    one.propose(plan_hold(A, 1.0), now + PLAN_ANNOUNCEMENTS.offer_lead_time)
    assert len(one.offer)
    one.settle(now + 0.9 * PLAN_ANNOUNCEMENTS.offer_lead_time)
    assert len(one.offer)
    one.settle(now + PLAN_ANNOUNCEMENTS.offer_lead_time)
    assert len(one.offer) == 0
    assert compute_end_place(one.way) == pytest.approx(B)


@virtual
async def test_late_messages_of_one_drone_lengthen_offers_to_it_however_many_others_talk(
    clock,
):
    """Only drones with lower ids are asked; a late drone with a higher id lengthens nothing."""
    crowded = [(-2.0 + 0.6 * k, 2.0, 1.0) for k in range(8)]
    _, drones = crowd(clock, (A,), (B,), *((place,) for place in crowded))
    late = Impairment(1, [ImpairmentRule({"delay": 0.2}, edge=(0, 1), directed=True)])
    drones[0].port.bus.impairment = late
    late.begin(clock.now())
    await fly(clock, drones, 1.0)
    leads = [drone.filter.agreement.lead_time for drone in drones]
    assert leads[1] == pytest.approx(
        0.2 + 0.2 + PLAN_ANNOUNCEMENTS.answer_time, abs=0.02
    )
    assert set(leads[:1] + leads[2:]) == {PLAN_ANNOUNCEMENTS.offer_lead_time}


@virtual
async def test_only_offers_that_are_clear_are_agreed_to(clock):
    _, drones = crowd(clock, (A,), (B,))
    await fly(clock, drones, 0.5)
    low, high = (drone.filter.agreement for drone in drones)
    for place, agreed in ((A, False), (np.array([0.0, 1.0, 1.0]), True)):
        high.propose(
            plan_flight(compute_motion(high.way, 9.0), place, 1.0, 2.0),
            clock.now() + 9.0,
        )
        high.tell(clock.now())
        drones[0].tick(clock.now())
        assert (low.others[1].allowed == high.number) is agreed


@virtual
async def test_what_was_agreed_to_is_kept_clear_of_until_it_is_heard_that_it_is_not_flown(
    clock,
):
    _, drones = crowd(clock, (A,), (B,))
    await fly(clock, drones, 0.5)
    low, high = (drone.filter.agreement for drone in drones)
    place = np.array([0.0, 1.0, 1.0])
    high.propose(plan_hold(place, 1.0), clock.now() + 0.1)
    high.tell(clock.now())
    drones[0].tick(clock.now())
    drones[0].goal = place.copy()
    await fly(clock, drones[:1], 2.0)
    assert np.linalg.norm(drones[0].at - place) > 0.33, (
        "nothing more is heard of it: it may be there"
    )
    assert low.may_be_flown(low.others[1])
    drones[1].filter.agreement.offer = NO_PATH
    await fly(clock, drones, 8.0)
    assert drones[0].at == pytest.approx(place, abs=1e-3)


@virtual
async def test_a_drone_that_tells_no_path_is_avoided_by_its_state(clock):
    _, drones = crowd(clock, (A, B), ((0.0, 0.0, 1.0),), planners=[0])
    drones[1].flies = False
    await fly(clock, drones, 10.0)
    assert drones[0].at == pytest.approx(B, abs=1e-3)
    assert nearest(*drones) >= 0.335


@virtual
async def test_a_drone_brakes_before_a_stranger_that_comes_in_its_way(clock):
    _, drones = crowd(clock, (A, B), ((0.0, 2.5, 1.0),), planners=[0])
    drones[1].flies = False
    await fly(clock, drones, 1.9)
    for k in range(100):
        drones[1].at = np.array([max(drones[0].at[0] + 0.6, 0.4 - 0.001 * k), 0.0, 1.0])
        await fly(clock, drones, TICK)
    assert (
        min(np.linalg.norm((np.array(drones[0].track) - drones[1].track)[190:], axis=1))
        > 0.3
    )


@virtual
async def test_a_landing_drone_does_not_wait_for_drones_that_it_does_not_hear(clock):
    _, drones = crowd(clock, (A,), (A + np.array([0.8, 0.0, 0.0]),))
    await fly(clock, drones, 0.5)
    lands, now = drones[1], clock.now()
    lands.goal = lands.at - [0.0, 0.0, 0.5]
    assert lands.filter.hears(State.at(A), now)
    assert not lands.filter.hears(State(State.at(A).flat, 1.0), now), (
        "a drone that is not seen does not know where it is"
    )
    await fly(clock, drones[1:], 1.5)
    now = clock.now()
    assert not lands.filter.hears(State.at(A), now)
    assert lands.filter.delayed
    assert lands.filter.lands(lands.wanted(), now).p.tolist() == lands.goal.tolist()
    assert not lands.filter.delayed
    lands.filter.lands(lands.wanted(), now + PLANNING_TIMES.check_interval)
    assert (
        math.dist(compute_end_place(lands.filter.agreement.way), lands.goal) < 0.01
    ), "that is what the others hear"


@virtual
async def test_a_silent_drone_is_avoided_wherever_on_its_path_it_may_be(clock):
    _, drones = crowd(clock, (A,), ((0.0, -1.0, 1.0), (0.0, 1.0, 1.0)))
    await fly(clock, drones, 1.0)
    await fly(clock, drones[:1], 0.7)
    drones[0].goal = B
    await fly(clock, drones[:1], 13.8)
    assert drones[0].at == pytest.approx(B, abs=1e-3)
    way = drones[1].filter.agreement.way
    for p in drones[0].track[-1400:]:
        for t in np.arange(1.0, compute_path_duration(way), 0.05):
            assert (
                np.linalg.norm((p - compute_motion(way, t)[0:3]) * [1.0, 1.0, 0.4])
                > 0.3
            )


@virtual
async def test_plans_that_are_none_are_not_believed(clock):
    bus, drones = crowd(clock, (A,), (B,))
    await fly(clock, drones, 0.3)
    heard = drones[0].filter.agreement.others[1].heard
    bad = np.full((1, 25), math.nan)
    for way in (bad, np.zeros((1, 24)), np.zeros(25), -np.ones((1, 25))):
        await clock.sleep(TICK)
        bus.ports[1].publish(
            DRONE_TOPICS.plan, Plan(way, 0.0, NO_PATH, 0.0, 1, {}, NO_REST_PLACE)
        )
    for place in (np.zeros(2), np.full(3, math.inf)):
        await clock.sleep(TICK)
        bus.ports[1].publish(
            DRONE_TOPICS.plan, Plan(plan_hold(B, 1.0), 0.0, NO_PATH, 0.0, 1, {}, place)
        )
    assert drones[0].filter.agreement.others[1].heard == heard


def parted(bus, clock, *edges):
    """From now on nothing that is said over these edges arrives."""
    deaf = Impairment(
        1, [ImpairmentRule({"loss": 1.0}, edge=edge, directed=True) for edge in edges]
    )
    bus.impairment = deaf
    deaf.begin(clock.now())


@virtual
async def test_however_long_two_are_parted_they_never_fly_through_each_other(clock):
    bus, drones = crowd(clock, (A,), (B,))
    await fly(clock, drones, 0.5)
    parted(bus, clock, (0, 1), (1, 0))
    drones[0].goal, drones[1].goal = B.copy(), A.copy()
    await fly(clock, drones, 12.0)
    assert drones[1].at == pytest.approx(B, abs=0.01), "it cannot ask: it stays"
    assert drones[1].filter.agreement.in_vain > 10.0
    assert drones[1].filter.agreement.lacking == 0
    parted(bus, clock)
    await fly(clock, drones, 12.0)
    assert [drone.at.round(3).tolist() for drone in drones] == [B.tolist(), A.tolist()]
    assert nearest(*drones) >= 0.33
    assert drones[1].filter.agreement.in_vain == 0.0


@virtual
async def test_a_drone_that_reports_that_it_is_on_the_ground_is_asked_no_more(clock):
    _, drones = crowd(clock, ((-1.0, 2.0, 1.0),), (A, B))
    await fly(clock, drones, 0.5)
    drones[0].flies = False
    await fly(clock, drones[1:], 1.0)
    assert drones[1].filter.agreement.mute(clock.now()) == 0
    drones[0].filter.rest(clock.now())
    await fly(clock, drones[1:], 6.0)
    assert not drones[1].filter.agreement.others[0].flies
    assert drones[1].at == pytest.approx(B, abs=1e-3)


@virtual
async def test_a_landing_drone_that_hears_nothing_waits_only_some_seconds_for_an_answer(
    clock,
):
    await lands_unanswered(clock, (0, 1))


@virtual
async def test_a_landing_drone_that_is_not_heard_waits_only_some_seconds_for_an_answer(
    clock,
):
    await lands_unanswered(clock, (1, 0))


async def lands_unanswered(clock, edge):
    bus, drones = crowd(clock, ((-1.0, 2.0, 1.0),), (A,))
    await fly(clock, drones, 0.5)
    parted(bus, clock, edge)
    await fly(clock, drones, 1.0)
    low = A - [0.0, 0.0, 0.03]
    drones[1].lands = True
    for k in range(round(OBSTACLE_LIMITS.answer_timeout + 4.0)):
        drones[1].goal = low - [0.0, 0.0, 0.025 * (drones[1].at[2] < low[2] + 0.02) * k]
        await fly(clock, drones, 1.0)
        if k < OBSTACLE_LIMITS.answer_timeout - 1:
            assert drones[1].at == pytest.approx(A, abs=0.01)
    assert drones[1].at[2] < low[2] + 0.01


@virtual
async def test_an_unanswered_landing_still_keeps_clear_of_known_drones(clock):
    bus, drones = crowd(clock, (A - [0.0, 0.0, 0.86],), (A,))
    await fly(clock, drones, 0.5)
    parted(bus, clock, (0, 1))
    drones[1].lands, drones[1].goal = True, A - [0.0, 0.0, 0.04]
    await fly(clock, drones, OBSTACLE_LIMITS.answer_timeout + 3.0)
    assert drones[1].at == pytest.approx(A, abs=0.01)
    assert drones[1].filter.choice.gives_way_to == 0


@virtual
async def test_what_an_earlier_agent_was_allowed_counts_no_more_when_it_is_started_again(
    clock,
):
    bus, drones = crowd(clock, (A,), (B,))
    await fly(clock, drones, 0.5)
    drones[1].goal = np.array([1.0, 1.0, 1.0])
    await fly(clock, drones, 3.0)
    allowed = drones[0].filter.agreement.others[1].allowed
    bus.port(1, incarnation=2**63 + 5)
    again = Flier(drones[1].filter.traffic.airspace, 1, [0, 1], drones[1].at)
    await fly(clock, [drones[0], again], 0.5)
    mine = again.filter.agreement
    for _ in range(20):
        mine.propose(
            plan_flight(compute_motion(mine.way, 9.0), A, 1.0, 2.0),
            clock.now() + PLAN_ANNOUNCEMENTS.offer_lead_time,
        )
        assert mine.number != allowed
        mine.tell(clock.now())
        drones[0].tick(clock.now())
        assert not drones[0].filter.agreement.may_be_flown(
            drones[0].filter.agreement.others[1]
        )
    assert mine.others[0].agreed[1] != mine.number


@virtual
async def test_a_place_beside_is_clear_of_standing_and_flying_drones(clock):
    _, drones = crowd(clock, ((0.0, 0.0, 1.0),), ((0.0, 0.0, 0.0),), ((0.5, 0.0, 1.0),))
    drones[1].flies = False
    await fly(clock, drones, 1.0)
    place = drones[0].filter.obstacles.beside(np.array([0.0, 0.0, 0.3]), FENCE)
    assert place[2] == 0.3
    assert np.linalg.norm(place[0:2]) == pytest.approx(0.4)
    assert np.linalg.norm(place[0:2] - [0.5, 0.0]) >= 0.58


@virtual
async def test_a_drone_behind_a_moving_reference_does_not_replan_all_the_time(clock):
    """Each new way begins slowly: it would never catch up."""
    _, drones = crowd(clock, ((-2.5, 0.0, 1.0),))
    await fly(clock, drones, 0.5)
    drone = drones[0]
    first = drone.filter.agreement.number
    for k in range(500):
        drone.leads = FullState.at(
            [min(-1.5 + 0.008 * k, 2.0), 0.0, 1.0], [0.8 * (k < 438), 0.0, 0.0]
        )
        await clock.sleep(TICK)
        now = clock.now_ns() / NS_PER_SECOND
        p, v = drone.leads.p, drone.leads.v
        flown = drone.filter.fly(
            State.at(drone.at, drone.v),
            drone.leads,
            lambda later, p=p, v=v: FullState.at(p + later * v, v),
            0.0,
            now,
        )
        drone.at, drone.v = flown.p.copy(), flown.v.copy()
    assert drone.filter.agreement.number - first <= 20
    assert drone.at[0] > 0.5


@virtual
async def test_what_waits_for_a_drone_that_rests_a_little_ahead_of_it_is_flown_on(
    clock,
):
    way = circle((0.0, 0.0, 1.0), 0.3, 8.0)
    for lead, others in ((0.2, ()), (0.3, ()), (0.4, ()), (0.3, ((1.2, 0.0, 1.0),))):
        _, (drone, *rest) = crowd(
            clock, (way.sample(6.0 + lead).p,), *([place] for place in others)
        )
        await fly(clock, [drone, *rest], 1.0)
        t = 6.0
        for _ in range(900):
            await fly(clock, rest, TICK) if rest else await clock.sleep(TICK)
            state, wanted = State.at(drone.at, drone.v), partial(later_of, way, t)
            drone.port.publish(DRONE_TOPICS.state, state)
            flown = drone.filter.fly(
                state, wanted(0.0), wanted, 0.0, clock.now(), waits=True
            )
            drone.at, drone.v = flown.p.copy(), flown.v.copy()
            t += 0.0 if drone.filter.delayed else TICK
        assert t > 12.0, (lead, others)


@virtual
async def test_a_drone_that_brakes_without_an_answer_plans_it_once(clock):
    bus, drones = crowd(
        clock, ((-1.0, 2.5, 1.0),), (A, B), ((0.0, 2.5, 2.0),), planners=[0, 1]
    )
    drones[2].flies = False
    await fly(clock, drones, 1.5)
    one = drones[1]
    parted(bus, clock, (0, 1), (1, 0))
    await fly(clock, drones, 0.8)
    assert one.v[0] > 0.3
    begun = {one.filter.agreement.began}
    for _ in range(10):
        drones[2].at = one.at + np.array([0.7, 0.0, 0.0])
        await fly(clock, drones, PLANNING_TIMES.check_interval)
        begun.add(one.filter.agreement.began)
    assert len(begun) == 2
    await fly(clock, drones, 2.0)
    assert np.linalg.norm(one.v) < 0.01


@virtual
async def test_a_drone_with_a_silent_radio_is_avoided_where_it_is_seen(
    clock,
):
    """It says that it rests at the side; the cameras see it in the middle."""
    for silence, clear in ((0.0, False), (1.0, True)):
        _, drones = crowd(clock, (A, B), ((0.0, 2.5, 1.0),))
        goes, elsewhere = drones
        goes.filter.traffic.airspace.take_link(1, LinkStatus("degraded", silence), 0.0)
        for _ in range(1000):
            await clock.sleep(TICK)
            elsewhere.tick(clock.now_ns() / NS_PER_SECOND)
            goes.filter.traffic.hear((1, State.at((0.0, 0.0, 1.0))), 0.0)
            goes.tick(clock.now_ns() / NS_PER_SECOND)
        d = np.linalg.norm(
            (np.array(goes.track) - [0.0, 0.0, 1.0]) * [1.0, 1.0, 0.4], axis=1
        ).min()
        assert bool(d > 0.3) is clear, d


class Follower(Flier):
    """A drone that follows a path from the time `began` on, which waits while the drone is delayed."""

    def __init__(self, airspace, i, ids, path, planners=None):
        super().__init__(airspace, i, ids, path.sample(0.0).p, planners=planners)
        self.path, self.t, self.delays = path, 0.0, 0

    def tick(self, now):
        state, wanted = State.at(self.at, self.v), partial(later_of, self.path, self.t)
        self.filter.traffic.publish(state, 0.0)
        self.filter.traffic.airspace.step()
        flown = self.filter.fly(state, wanted(0.0), wanted, 0.0, now, waits=True)
        self.at, self.v = flown.p.copy(), flown.v.copy()
        self.delays += self.filter.delayed
        self.t += 0.0 if self.filter.delayed else TICK
        self.track.append(self.at.copy())


def side_by_side(clock, spacing, count=6, rules=()):
    """Drones in rows of three, each on its own circle at 0.73 m/s and 0.77 m/s2."""
    bus = Bus(clock, Impairment(3, [ImpairmentRule(effects) for effects in rules]))
    ids = list(range(count))
    for i in ids:
        bus.port(i)
    bus.impairment.begin(0.0)
    airspace = Airspace(bus, ids, AirspaceRules(CollisionTable(), 1.0, 0.0, tuple(ids)))
    return [
        Follower(
            airspace,
            i,
            ids,
            circle((spacing * (i % 3) - 1.0, spacing * (i // 3) - 0.5, 1.0), 0.7, 6.0),
        )
        for i in ids
    ]


@virtual
async def test_drones_side_by_side_on_equal_fast_paths_do_not_delay_each_other(clock):
    drones = side_by_side(clock, 0.6)
    await fly(clock, drones, drones[0].path.duration)
    assert [drone.delays for drone in drones] == [0] * 6


@virtual
async def test_a_drone_that_brakes_on_its_trajectory_is_not_sent_on_at_full_speed(
    clock,
):
    bus = Bus(clock)
    for i in (0, 1):
        bus.port(i)
    airspace = Airspace(bus, [0, 1], AirspaceRules(CollisionTable(), 1.0, 0.0, (0, 1)))
    drones = [
        Follower(airspace, i, [0, 1], minimum_snap(ends, [0.0, 5.0]))
        for i, ends in enumerate(([A, B], [B, A]))
    ]
    speeds = [[], []]
    for _ in range(400):
        await fly(clock, drones, TICK)
        for drone, seen in zip(drones, speeds, strict=True):
            seen.append(drone.v)
    # At most 0.1 m/s from the reference to the path that brakes, beside the change in a tick.
    for seen in speeds:
        jumps = np.linalg.norm(np.diff(seen, axis=0), axis=1)
        assert jumps.max() < 0.1 + 2.0 * TICK


@virtual
async def test_late_messages_delay_no_drone_on_a_path_of_its_own(clock):
    drones = side_by_side(clock, 1.8, count=2, rules=[{"delay": 0.2}])
    await fly(clock, drones, drones[0].path.duration)
    assert [drone.delays for drone in drones] == [0, 0]
