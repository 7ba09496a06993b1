"""Pickup and delivery while tasks and drones come and go: in virtual time, and over processes with kill -9."""

import asyncio
import signal
from functools import partial

import pytest
from system.agents import CRAZYCHOIR, Program, flying, results, until
from system.online import carried, crash, drawn, fly_online, killed_at, wilson

from crazychoir.bus.commands import Commander
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.errors import SolverError
from crazychoir.guidance.delivery import replanning
from crazychoir.guidance.delivery.plan_notes import NO_PLAN_REASON
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.task_book import Fate, Task
from crazychoir.guidance.tasks.task_source import FIRST_ADDED_ID
from crazychoir.launch.network import isolate_swarm
from crazychoir.routing.distributed.pickup_delivery import PickupDelivery
from crazychoir.routing.search.parallel_auction import run_parallel_auction

pytestmark = pytest.mark.system
SECONDS = 1e9
KINDS = "pickup", "delivery"


def whole(seed, kills=2, loss=0.2, **options):
    config = drawn(seed, loss, **options)
    return fly_online(config, killed_at(config, kills))


@pytest.mark.slow
def test_all_that_the_living_can_serve_is_served_though_two_are_killed():
    outcome = whole(1000)
    assert outcome.reasons == []
    assert len(outcome.fates) == 20
    assert (
        max(result.get("longest_wait_s", 0.0) for result in outcome.results.values())
        < 2.0
    )


@pytest.mark.slow
def test_a_drone_that_falls_past_another_is_told_apart_from_two_that_fly():
    """Drone 0 is killed above drone 1, which stands at its home; the living drones still serve what they can."""
    over_home_1 = {
        "t": 3.0,
        "pickup": [0.0, 6.3],
        "delivery": [0.0, 2.5],
        "robots": [0],
    }
    outcome = fly_online(drawn(1, drones=3, tasks=1, appear=[over_home_1]), {0: 18.05})
    assert outcome.reasons == []
    assert outcome.touching == {}
    ((pair, gap),) = outcome.struck.items()
    assert (pair, gap < SWARM_LIMITS.touching_distance) == ((0, 1), True)


def test_drones_do_not_go_where_none_can_stand_and_fly_on():
    """A place outside the fence was flown to by one drone after the other, and each came down there."""
    config = drawn(5, 0.2, drones=4, tasks=4, later=0, until=10.0)

    def prepare(agent):
        def learn():
            for j, place in (
                (FIRST_ADDED_ID, (40.0, 1.0)),
                (FIRST_ADDED_ID + 1, config.drone(2).home[:2]),
            ):
                agent.drones[1].guidance.news.book.learn(
                    Task(j, 0, False, place, (2.0, 2.0))
                )

        agent.clock.call_at(round(6 * SECONDS), learn)

    outcome = fly_online(config, {}, prepare)
    assert outcome.touching == {}
    assert all(result["success"] for result in outcome.results.values())
    assert {
        j: fate for j, (fate, _) in outcome.fates.items() if j >= FIRST_ADDED_ID
    } == {
        FIRST_ADDED_ID: "open",
        FIRST_ADDED_ID + 1: "open",
    }
    assert {fate for j, (fate, _) in outcome.fates.items() if j < FIRST_ADDED_ID} == {
        "delivered"
    }
    for result in outcome.results.values():
        assert "outside the fence" in result["unserved"][str(FIRST_ADDED_ID)]
        assert "from the home of drone 2" in result["unserved"][str(FIRST_ADDED_ID + 1)]
    report = load_mission("online_delivery").report(config, outcome.results)
    assert not report["success"]
    assert (
        f"task {FIRST_ADDED_ID}: its pickup [40, 1] is outside the fence"
        in report["reasons"][0]
    )


@pytest.mark.slow
@pytest.mark.timeout(14_400)
def test_all_that_the_living_can_serve_is_served_over_200_seeds():
    """Ten drones, 15 tasks, five more appear, two drones are killed, 20 % of all messages are lost."""
    failed, struck, waits, plannings = {}, {}, [], []
    for seed in range(200):
        outcome = whole(seed)
        failed |= {seed: outcome.reasons} if outcome.reasons else {}
        struck |= {seed: outcome.struck} if outcome.struck else {}
        waits.append(
            max(outcome.results[i].get("longest_wait_s", 0.0) for i in outcome.living)
        )
        plannings += [
            s for i in outcome.living for s in outcome.results[i].get("plannings_s", [])
        ]
    low, high = wilson(200 - len(failed), 200)
    print(  # noqa: T201
        f"success {200 - len(failed)} of 200, Wilson 95 % [{low:.3f}, {high:.3f}]; planning: median "
        f"{sorted(plannings)[len(plannings) // 2]:.2f} s, longest {max(plannings):.2f} s; "
        f"longest wait in the air {max(waits):.2f} s; failed: {failed}; "
        f"near enough to one that fell to be hit by it: {struck}"
    )
    assert not failed
    assert low > 0.95


# A drone that is killed at a stop ------------------------------------------------------------------------------

MOMENTS = [
    0.0,
    0.9,
    *(pytest.param(s, marks=pytest.mark.slow) for s in (0.1, 0.25, 0.5, 1.3)),
]
"""s after it has announced a stop."""


def killed_at_stop(kind, after, **options):
    """Four drones, four tasks; the first that announces a stop of this kind is killed so many s later."""
    config = drawn(3, 0.2, drones=4, tasks=4, later=0, **options)
    victims = []

    def prepare(agent):
        def watched(drone):
            bind = drone.guidance.bind

            def bound(member):
                bind(member)
                commitments = drone.guidance.commitments
                commitments.announce = partial(announced, commitments.announce)

            def announced(announce, stop):
                number = announce(stop)
                if stop.kind == kind and not victims:
                    victims.append((drone.id, stop.task))
                    now_ns = agent.clock.now_ns()
                    agent.clock.call_at(now_ns + round(after * SECONDS), kill, drone.id)
                return number

            drone.guidance.bind = bound

        def kill(i):
            killed[i] = carried(agent, i)
            crash(agent, i)

        for drone in agent.drones.values():
            watched(drone)

    killed = {}
    outcome = fly_online(config, {}, prepare, killed)
    ((_, task),) = victims
    return outcome, task


@pytest.mark.parametrize("recover", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("after", MOMENTS)
def test_goods_are_not_picked_up_before_another_drone_has_heard_of_it(after, recover):
    outcome, task = killed_at_stop("pickup", after, recover=recover)
    assert outcome.reasons == []
    fate = Fate(outcome.fates[task][0])
    if recover or after == 0.0:
        assert fate is Fate.DELIVERED
    elif after >= 0.9:
        assert fate is Fate.LOST, "it had left with them"
    else:
        assert fate in (Fate.DELIVERED, Fate.LOST)


@pytest.mark.parametrize("recover", [False, True])
@pytest.mark.parametrize("after", MOMENTS)
def test_goods_are_not_delivered_twice_even_if_their_carrier_is_killed(after, recover):
    outcome, task = killed_at_stop("delivery", after, recover=recover)
    assert outcome.reasons == []
    fate, robot = outcome.fates[task]
    assert fate == "delivered" or (after < 0.5 and fate == "lost")
    if after >= 0.9:
        assert robot in outcome.aboard


# Tasks that come and go ----------------------------------------------------------------------------------------


def test_a_cancelled_task_is_not_picked_up_but_goods_aboard_are_delivered():
    config = drawn(
        4,
        0.2,
        drones=5,
        tasks=6,
        later=0,
        cancel=[{"t": 1.0, "task": j} for j in range(5)],
    )
    outcome = fly_online(config, {})
    assert outcome.reasons == []
    assert [outcome.fates[j][0] for j in range(5)] == ["cancelled"] * 5
    assert outcome.fates[5][0] == "delivered"
    late = fly_online(
        drawn(
            4,
            0.2,
            drones=5,
            tasks=6,
            later=0,
            cancel=[{"t": 12.0, "task": j} for j in range(6)],
        ),
        {},
    )
    assert late.reasons == []
    fates = [fate for fate, _ in late.fates.values()]
    assert "delivered" in fates, "what was aboard by then"
    assert "cancelled" in fates


def test_an_operator_adds_a_task_and_cancels_one():
    config, said = drawn(5, 0.3, drones=4, tasks=4, later=0, until=12.0), {}

    def prepare(agent):
        async def operate():
            commander = Commander(agent.bus.port(PORT_ADDRESSES.first_observer + 7))
            while agent.clock.now() < 4.0:
                await agent.clock.sleep(0.5)
            task = {"pickup": [1.0, 1.0], "delivery": [3.0, 3.0]}
            said["added"] = await commander.request(2, "task_add", **task)
            said["no place"] = await commander.request(
                2, "task_add", pickup=[1.0], delivery=[3.0, 3.0]
            )
            said["no such"] = await commander.request(1, "task_cancel", id=77)
            other = await commander.request(1, "task_add", **task)
            said["cancelled"] = await commander.request(3, "task_cancel", id=0)
            said["other"] = other

        agent.operator = asyncio.ensure_future(operate())

    outcome = fly_online(config, {}, prepare)
    assert [
        said[what].kind
        for what in ("added", "other", "cancelled", "no place", "no such")
    ] == [
        "done",
        "done",
        "done",
        "refused",
        "refused",
    ]
    assert "pickup" in said["no place"].detail or "length 2" in said["no place"].detail
    ids = {said["added"].detail["id"], said["other"].detail["id"]}
    assert len(ids) == 2
    assert {outcome.fates[j][0] for j in ids} == {"delivered"}
    assert outcome.fates[0][0] in ("cancelled", "delivered")
    assert all(result["success"] for result in outcome.results.values())


# Drones that fall behind, fail, are cut off --------------------------------------------------------------------


def test_others_take_over_from_a_drone_that_is_held_on_its_way():
    config, held = drawn(6, 0.0, drones=4, tasks=8, later=0), []

    def prepare(agent):
        def hold():
            busy = max(
                agent.ids, key=lambda i: len(agent.drones[i].guidance.commitments.route)
            )
            held.append((busy, len(agent.drones[busy].guidance.commitments.route)))
            agent.drones[busy].pilot.hold(True)
            agent.clock.call_at(
                agent.clock.now_ns() + round(25 * SECONDS),
                agent.drones[busy].pilot.hold,
                False,
            )

        agent.clock.call_at(round(8 * SECONDS), hold)

    outcome = fly_online(config, {}, prepare)
    assert outcome.reasons == []
    ((i, left),) = held
    assert left > 2
    assert sum(i in by for by in outcome.delivered.values()) < 8 - left // 2


def test_a_drone_that_is_landed_by_its_operator_leaves_its_tasks_to_the_others():
    config, landed = drawn(7, 0.2, drones=4, tasks=5, later=0, recover=True), []

    def prepare(agent):
        def land():
            busy = max(
                agent.ids, key=lambda i: len(agent.drones[i].guidance.commitments.route)
            )
            landed.append(busy)
            agent.drones[busy].pilot.land("landing on command")
            agent.runners[busy].abort("landed on command")

        agent.clock.call_at(round(9 * SECONDS), land)

    outcome = fly_online(config, {}, prepare)
    others = [i for i in outcome.config.ids if i != landed[0]]
    assert all(outcome.results[i]["success"] for i in others), outcome.results
    assert {fate for fate, _ in outcome.results[others[0]]["tasks"].values()} == {
        "delivered"
    }
    assert all(len(by) == 1 for by in outcome.delivered.values())


BROKEN = [("commitments", "next"), ("news", "letter"), ("forecast", "seconds")]
"""What is broken in flight: where it goes, what it says, what it plans."""


@pytest.mark.parametrize(("part", "name"), BROKEN)
def test_a_mission_that_raises_alone_leaves_its_tasks_to_the_others(part, name):
    """The others come for its goods without touching it. They learn of its failure even if it cannot tell them."""
    config, failed = drawn(7, 0.2, drones=4, tasks=5, later=0, recover=True), []

    def prepare(agent):
        def fail():
            busy = max(
                agent.ids, key=lambda i: len(agent.drones[i].guidance.commitments.route)
            )
            failed.append(busy)
            guidance = agent.drones[busy].guidance
            setattr(getattr(guidance, part, guidance), name, broken)

        agent.clock.call_at(round(9 * SECONDS), fail)

    def broken(*_args):
        raise RuntimeError("broken")

    outcome = fly_online(config, {}, prepare)
    (i,), others = failed, [i for i in config.ids if i not in failed]
    assert "guidance failed: RuntimeError: broken" in outcome.results[i]["reason"]
    assert all(outcome.results[i]["success"] for i in others), outcome.results
    fates = outcome.results[others[0]]["tasks"]
    assert all(outcome.results[i]["tasks"] == fates for i in others)
    assert {fate for fate, _ in fates.values()} == {"delivered"}
    assert all(len(by) == 1 for by in outcome.delivered.values())
    assert outcome.touching == {}


@pytest.mark.parametrize(
    ("who", "recover"),
    [
        (0, True),
        (3, False),
        *(
            pytest.param(*both, marks=pytest.mark.slow)
            for both in ((0, False), (3, True))
        ),
    ],
)
@pytest.mark.parametrize("until", [10.0, pytest.param(18.0, marks=pytest.mark.slow)])
def test_a_drone_that_is_cut_off_and_comes_back_serves_nothing_that_others_serve(
    who, recover, until
):
    """The drone that is cut off waits where it is, and lands after 5.5 s."""
    config = drawn(8, 0.2, drones=4, tasks=6, later=0, recover=recover, until=40.0)
    config = config.replace(
        network={
            "loss": 0.2,
            "partitions": [{"at": 6.0, "until": until, "groups": [[who]]}],
        }
    )
    outcome = fly_online(config, {})
    why = outcome.results[who].get("reason", "")
    assert "hears no more than half" in why or "cut off" in why or until < 12.0, why
    others = [i for i in config.ids if i != who]
    assert all(outcome.results[i]["success"] for i in others), outcome.results
    fates = outcome.results[others[0]]["tasks"]
    assert all(outcome.results[i]["tasks"] == fates for i in others)
    lost = [fate for fate, _ in fates.values() if fate != "delivered"]
    assert lost == ([] if recover or until < 12.0 else len(lost) * ["lost"]), fates
    assert len(lost) <= 1, "it had one aboard at most"
    assert all(len(by) <= 1 for by in outcome.delivered.values()), outcome.delivered
    assert outcome.touching == {}


@pytest.mark.parametrize("recover", [False, True])
def test_drones_left_alone_by_a_crash_and_a_cut_link_end_their_mission(
    recover,
):
    """A drone that is cut off with nothing to do does not wait for ever until the others are done."""
    config = drawn(8, 0.0, drones=3, tasks=2, later=0, recover=recover, until=40.0)
    config = config.replace(
        network={"partitions": [{"at": 20.0, "until": 400.0, "groups": [[2]]}]}
    )
    outcome = fly_online(config, {0: 24.0})
    assert outcome.simulated < 150.0
    for i in (1, 2):
        assert (
            "cut off from more than half of the team for 30 s"
            in outcome.results[i]["reason"]
        )
        assert not outcome.results[i]["success"]


@pytest.mark.parametrize("drones", [1, 2])
def test_a_team_without_a_flying_drone_ends_its_mission(drones):
    """Each drone ends when it hears no flying drone any more; it does not wait for the others for ever."""

    def prepare(agent):
        def land():
            for drone in agent.drones.values():
                drone.pilot.land("the battery is empty")

        agent.clock.call_at(round(9 * SECONDS), land)

    outcome = fly_online(drawn(7, 0.2, drones=drones, tasks=5, later=0), {}, prepare)
    assert outcome.simulated < 100.0
    for result in outcome.results.values():
        assert not result["success"]
        assert "no drone that it hears flies any more for 30 s" in result["reason"]
    assert any(
        "the battery is empty" in result["reason"]
        for result in outcome.results.values()
    )


def test_a_drone_that_is_sent_elsewhere_at_full_speed_stays_in_its_room():
    """A task comes up behind a drone that flies home at 1 m/s, out of the way."""
    outcome = fly_online(drawn(90), {})
    assert outcome.reasons == []


def test_a_method_of_pickup_delivery_plans_in_flight_too():
    config = drawn(2, 0.2, drones=3, tasks=4, later=1, method="resource-columns")
    outcome = fly_online(config, {2: 9.0})
    assert outcome.reasons == []


# Plannings that raise ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("who", [(1,), (0, 1, 2)])
def test_a_method_that_raises_in_flight_is_replaced_by_the_auction(
    monkeypatch, caplog, who
):
    """The error does not end the mission: the drones serve all tasks."""
    step = PickupDelivery.step

    def broken(self, heard):
        step(self, heard)
        if self._member.place.robot in who and self.k == 3:
            raise SolverError("columns", "no plan found")

    monkeypatch.setattr(PickupDelivery, "step", broken)
    config = drawn(2, 0.2, drones=3, tasks=4, later=1, method="columns")
    outcome = fly_online(config, {})
    assert outcome.reasons == []
    fallbacks = [outcome.results[i]["fallbacks"] for i in config.ids]
    assert fallbacks[0] == fallbacks[1] == fallbacks[2]
    why = f"robot {who[0]}: SolverError: columns: the solver ended with status no plan found"
    told = {
        "planning": 1,
        "method": "columns",
        "why": why,
        "instead": "planned by parallel-auction",
    }
    assert fallbacks[0][0] == told
    assert (
        load_mission("online_delivery").report(config, outcome.results)["fallbacks"]
        == fallbacks[0]
    )
    assert caplog.text.count(f"planning 1: columns: {why}") == 1


def test_a_team_that_finds_no_plan_at_all_delivers_what_is_aboard_and_comes_home(
    monkeypatch,
):
    """Every planning fails from 12 s on. A drone that is bound to goods, or has goods aboard, goes on with them."""
    now = []

    def broken(robot, *args):
        if robot == 1 and now[0]() > 12.0:
            raise SolverError("auction", "broken")
        return (yield from run_parallel_auction(robot, *args))

    monkeypatch.setattr(replanning, "run_parallel_auction", broken)
    config = drawn(
        4,
        0.2,
        drones=3,
        tasks=6,
        appear=[{"t": 12.0, "pickup": [1, 1], "delivery": [2, 2]}],
    )
    outcome = fly_online(config, {}, lambda agent: now.append(agent.clock.now))
    assert all(result["success"] for result in outcome.results.values()), (
        outcome.results
    )
    assert outcome.touching == {}
    fates = [fate for fate, _ in outcome.fates.values()]
    assert set(fates) == {"delivered", "open"}
    assert all(len(by) == 1 for by in outcome.delivered.values())
    for i in config.ids:
        picked, dropped = (
            [s["task"] for s in outcome.results[i]["served"] if s["kind"] == kind]
            for kind in KINDS
        )
        assert sorted(picked) == sorted(dropped)
        assert outcome.results[i]["fallbacks"][0]["instead"] == NO_PLAN_REASON
    report = load_mission("online_delivery").report(config, outcome.results)
    assert not report["success"]
    assert (
        f"task 6: {NO_PLAN_REASON}: robot 1: SolverError: auction"
        in report["reasons"][0]
    )


# Over processes ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.timeout(360)
async def test_a_process_is_killed_in_flight_and_comes_back_while_an_operator_adds_a_task(
    tmp_path, compiled
):
    """What the killed drone carried is fetched from where it fell; started again it is a member as any other."""
    config = drawn(9, 0.2, drones=5, tasks=8, later=0, recover=True, until=30.0)
    config = isolate_swarm(config.replace(lease=1.0), None)
    async with flying(config, tmp_path) as team:
        await until(lambda: busiest(team) is not None, 120.0, lambda: team.text)
        victim = busiest(team)
        team.agents[victim].signal(signal.SIGKILL)
        await team.agents[victim].process.wait()
        await team.start((victim,))
        said = await Program.start(
            *CRAZYCHOIR,
            "task",
            "add",
            "--pickup",
            "1,1",
            "--delivery",
            "4,3.5",
            "--swarm",
            team.path,
            "--json",
        )
        added = (await said.end(30.0))["id"]
        ended = await team.end(180.0)
    found = results(ended)
    fates = found[victim]["tasks"]
    assert {fate for fate, _ in fates.values()} == {"delivered"}, fates
    assert str(added) in fates
    assert all(
        found[i]["success"] and found[i]["tasks"] == fates for i in config.ids
    ), found
    stops = [
        stop["task"]
        for i in config.ids
        for stop in found[i]["served"]
        if stop["kind"] == "delivery"
    ]
    assert len(stops) == len(set(stops))


def busiest(team):
    """Return a drone with goods aboard and stops to do; None if there is none."""
    for i in team.config.ids:
        told = [status["task"] for status in team.statuses(i)]
        if told and " aboard" in told[-1]:
            left, aboard = (int(part.split()[0]) for part in told[-1].split(", ")[-2:])
            if aboard and left:
                return i
    return None
