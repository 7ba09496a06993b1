"""What operators command in flight, in virtual time: whole drones, and an operator at an address of an observer."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest
from operators import play_scene

from crazychoir.agent.command_arguments import path_message
from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance import guidance as base
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.spline import fit_spline
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Acceleration

FLIGHT = {
    "takeoff_height": 0.4,
    "speed_limit": 2.0,
    "acceleration_limit": 4.0,
    "landing_speed": 0.6,
    "operator": True,
}


class Stay(CFDistributedFeedback):
    duration = 1.5

    def height(self):
        return 0.3 + 0.1 * self.id

    def step(self, me, heard):
        return Acceleration(-2.0 * me.v)


class Rests(CFDistributedFeedback):
    """Wants to hover, in each of its steps."""

    duration = 30.0

    def step(self, me, heard):
        return None


class There(CFGuidance):
    """To a place beside its home, and to another one for long."""

    async def mission(self):
        home = np.array(self.member.config.drone(self.id).home)
        await self.take_off()
        await self.go_to(home + np.array([0.0, 1.5, 0.8]))
        await self.sleep(30.0)
        await self.land()
        return {"there": True}


class Fails(CFGuidance):
    """Some time after its start."""

    async def mission(self):
        await self.take_off()
        await self.sleep(6.0)
        raise RuntimeError("no idea")


class Itself(CFGuidance):
    """Takes off by itself, and only drone 0 does."""

    async def mission(self):
        await self.wait_for_start()
        began = self.member.clock.now()
        if self.id == 0:
            await self.take_off()
            await self.land()
        return {"began": began}


def config_of(n=3, **flight):
    drones = [{"id": i, "home": [1.0 * i, 0.0, 0.0]} for i in range(n)]
    fence = {"min": [-2.0, -2.0, 0.0], "max": [4.0, 4.0, 3.0]}
    return SwarmConfig.of(
        {"name": "a", "drones": drones, "flight": {**FLIGHT, **flight}, "fence": fence}
    )


def play(guidance, scene, config=None):
    mission = SimpleNamespace(guidance=lambda i, config: guidance())
    return play_scene(mission, scene, config_of() if config is None else config)


def test_a_run_waits_on_the_ground_for_its_take_off_and_in_the_air_for_its_start():
    async def scene(operator):
        refused = await operator.order("start")
        assert refused[0] == (
            ANSWER_TEXTS.refused,
            "it waits for its operator: take-off",
        )
        assert operator.task(0) == "waits for its operator: take-off"
        await operator.clock.sleep(5.0)
        assert await operator.order("arm") == dict.fromkeys(
            range(3), (ANSWER_TEXTS.done, "ready")
        )
        operator.pilot(1).body.list_problems = lambda: ["battery at 3.10 V"]
        assert await operator.order("arm", 1) == (
            ANSWER_TEXTS.refused,
            "battery at 3.10 V: no take-off",
        )
        operator.pilot(1).body.list_problems = list
        assert operator.modes() == [Mode.GROUND] * 3
        assert await operator.order("take-off") == dict.fromkeys(
            range(3), (ANSWER_TEXTS.done, "hovering")
        )
        for verb in ("arm", "take-off"):
            assert await operator.order(verb, 1) == (
                ANSWER_TEXTS.refused,
                "it is in the air already",
            )
        await operator.clock.sleep(5.0)
        assert operator.modes() == [Mode.HOVER] * 3
        assert operator.task(0) == "waits for its operator: start, or lands in 294 s"
        assert [operator.pilot(i).state.p[2] for i in range(3)] == pytest.approx(
            [0.3, 0.4, 0.5], abs=0.02
        )
        assert await operator.order("start") == dict.fromkeys(
            range(3), (ANSWER_TEXTS.done, "its mission goes on")
        )
        await operator.clock.sleep(1.0)
        assert operator.modes() == [Mode.FOLLOW] * 3
        assert await operator.order("start", 0) == (
            ANSWER_TEXTS.refused,
            "its mission has started",
        )

    results = play(Stay, scene)
    assert all(
        result["success"] and result["references"] > 100 for result in results.values()
    ), results


def test_a_drone_that_is_started_later_joins_the_mission():
    async def scene(operator):
        await operator.order("take-off", 0)
        await operator.order("start", 0)
        await operator.clock.sleep(61.0)
        assert operator.modes() == [Mode.HOVER, Mode.GROUND]
        await operator.order("take-off", 1)
        assert await operator.order("start", 1) == (
            ANSWER_TEXTS.done,
            "its mission goes on",
        )

    assert all(result["success"] for result in play(Stay, scene, config_of(2)).values())


def test_a_mission_that_takes_off_by_itself_waits_on_the_ground_for_its_start():
    async def scene(operator):
        assert await operator.order("take-off", 0) == (
            ANSWER_TEXTS.refused,
            "it waits for its operator: start",
        )
        await operator.clock.sleep(10.0)
        await operator.order("start", 0)
        await operator.clock.sleep(5.0)
        assert operator.modes() == [Mode.GROUND] * 3
        await operator.order("start", 1, 2)

    results = play(Itself, scene)
    assert all(
        result["success"] and 15.9 < result["began"] < 16.5
        for result in results.values()
    ), results


def test_without_an_operator_the_run_ends_on_the_ground_or_lands(
    monkeypatch,
):
    monkeypatch.setattr(base, "COMMAND_TIMEOUT", 5.0)
    monkeypatch.setattr(base, "HELD_FLIGHT_PATIENCE", 8.0)

    async def take_off_one(operator):
        await operator.order("take-off", 1)

    results = play(Stay, take_off_one, config_of(2))
    assert results[0]["reason"] == "drone 0: no take-off by its operator within 5 s"
    assert results[1]["reason"] == "drone 1: no start by its operator within 8 s"


def test_hold_freezes_and_go_frees():
    async def scene(operator):
        await operator.order("take-off")
        await operator.order("start")
        await operator.clock.sleep(0.7)
        assert operator.modes() == [Mode.FOLLOW] * 3
        assert await operator.order("hold", 0) == (ANSWER_TEXTS.done, "held")
        assert [drone.status().note for drone in operator.agent.drones.values()] == [
            "held by its operator",
            "",
            "",
        ]
        await operator.clock.sleep(5.0)
        assert operator.pilot(0).state.p[1] < 1.0
        assert operator.pilot(1).state.p[1] == pytest.approx(1.5, abs=0.05)
        said = {
            0: (ANSWER_TEXTS.done, "goes on"),
            1: (ANSWER_TEXTS.done, "was not held"),
            2: (ANSWER_TEXTS.done, "was not held"),
        }
        assert await operator.order("go") == said
        await operator.clock.sleep(5.0)
        assert operator.pilot(0).state.p[1] == pytest.approx(1.5, abs=0.05)
        assert await operator.order("land", 0, deadline=0.5) == (
            ANSWER_TEXTS.accepted,
            "not done within 0.5 s",
        )
        assert await operator.order("hold", 0) == (
            ANSWER_TEXTS.refused,
            "it is landing",
        )

    results = play(There, scene)
    assert (results[0]["success"], results[0]["reason"]) == (True, "landed on command")
    assert results[1] == {"success": True, "there": True}


def test_home_is_above_the_others_each_at_its_level_and_lands_where_it_took_off():
    async def scene(operator):
        await operator.order("take-off")
        await operator.order("start")
        await operator.clock.sleep(6.0)
        returning = asyncio.create_task(operator.order("home"))
        highest = dict.fromkeys(range(3), 0.0)
        while not returning.done():
            await operator.clock.sleep(0.05)
            for i in highest:
                highest[i] = max(highest[i], operator.pilot(i).state.p[2])
        assert await returning == dict.fromkeys(
            range(3), (ANSWER_TEXTS.done, "on ground")
        )
        assert list(highest.values()) == pytest.approx([0.8, 1.4, 2.0], abs=0.05)
        places = [operator.pilot(i).state.p for i in range(3)]
        assert np.array(places) == pytest.approx(
            np.array([[i, 0.0, 0.0] for i in range(3)]), abs=0.05
        )
        assert await operator.order("home", 0) == (
            ANSWER_TEXTS.refused,
            "it is on the ground",
        )

    assert {r["reason"] for r in play(There, scene).values()} == {
        "sent home on command"
    }


def test_a_return_may_be_held_and_goes_on():
    async def scene(operator):
        await operator.order("take-off", 0)
        await operator.order("start", 0)
        await operator.clock.sleep(6.0)
        returning = asyncio.create_task(operator.order("home", 0))
        await operator.clock.sleep(0.9)
        assert operator.modes()[0] is Mode.RETURN
        await operator.order("hold", 0)
        await operator.clock.sleep(35.0)
        assert operator.modes()[0] is Mode.HOVER, "longer than a landing may take"
        assert operator.pilot(0).state.p[1] > 0.2
        await operator.order("go", 0)
        assert operator.modes()[0] is Mode.RETURN
        assert await returning == (ANSWER_TEXTS.done, "on ground")
        assert operator.pilot(0).state.p == pytest.approx(np.zeros(3), abs=0.05)

    play(There, scene, config_of(1))


def test_without_an_operator_missions_fly_by_themselves_and_say_so():
    async def scene(operator):
        for verb in ("take-off", "start"):
            kind, why = await operator.order(verb, 0)
            assert kind == ANSWER_TEXTS.refused
            assert "it is in the air already" in why or "crazychoir run --wait" in why
        await operator.order("land")

    play(There, scene, config_of(1, operator=False))


def test_what_is_over_does_not_begin_again():
    async def scene(operator):
        assert (await operator.order("land", 0)) == (ANSWER_TEXTS.done, "on ground")
        assert await operator.order("take-off", 0) == (
            ANSWER_TEXTS.refused,
            "its mission is over: landed on command",
        )
        await operator.order("land")

    assert play(Stay, scene)[0] == {
        "success": True,
        "reason": "landed on command",
        "ended": "landed on command",
    }


# Flights on command ---------------------------------------------------------------------------------------------


def way(*places, seconds=4.0):
    """What a drone is told of a path through places."""
    return path_message(
        fit_spline(
            np.linspace(0.0, seconds, len(places)),
            np.array(places, dtype=float),
            degree=7,
        )
    )


async def told(operator, verb, i, deadline=60.0, **arguments):
    answer = await operator.commander.request(i, verb, deadline, **arguments)
    return answer.kind, answer.detail


def test_a_drone_that_waits_flies_where_its_operator_wants_and_then_its_mission():
    async def scene(operator):
        assert await told(operator, "go-to", 1, p=[1.0, 1.0, 0.6]) == (
            ANSWER_TEXTS.refused,
            "it is on ground",
        )
        await operator.order("take-off")
        assert await told(operator, "go-to", 1, p=[1.0, 1.0, 0.6], yaw=0.5) == (
            ANSWER_TEXTS.done,
            "there",
        )
        assert operator.pilot(1).state.p == pytest.approx([1.0, 1.0, 0.6], abs=0.03)
        assert yaw_of(operator.pilot(1).state.q) == pytest.approx(0.5, abs=0.05)
        message = way((1.0, 1.0, 0.6), (1.3, 1.5, 0.9), (1.0, 2.0, 0.6))
        assert await told(operator, "fly", 1, **message) == (ANSWER_TEXTS.done, "flown")
        assert operator.pilot(1).state.p == pytest.approx([1.0, 2.0, 0.6], abs=0.03)
        assert operator.modes() == [Mode.HOVER] * 3
        await operator.order("start")
        await operator.clock.sleep(0.5)
        kind, why = await told(operator, "go-to", 1, p=[1.0, 1.0, 0.6])
        assert (kind, why) == (
            ANSWER_TEXTS.refused,
            "its mission controls it: hold the drone first",
        )

    results = play(Stay, scene)
    assert all(result["success"] for result in results.values()), results


def test_a_drone_that_is_held_flies_on_command_and_goes_on_with_its_mission():
    async def scene(operator):
        await operator.order("take-off")
        await operator.order("start")
        await operator.clock.sleep(1.0)
        assert (await told(operator, "fly", 0, **way((0, 0, 1.0), (0, 1, 1.0))))[
            1
        ].startswith("its mission controls")
        await operator.order("hold", 0)
        assert await told(operator, "go-to", 0, p=[-1.0, -1.0, 1.0]) == (
            ANSWER_TEXTS.done,
            "there",
        )
        await operator.order("go", 0)
        await operator.clock.sleep(10.0)
        assert operator.pilot(0).state.p == pytest.approx([0.0, 1.5, 0.8], abs=0.05)
        await operator.order("land")

    play(There, scene)


def occluded(operator, i, seconds):
    """Its cameras do not see it for so long."""
    (owner,) = operator.agent.owners
    sample = owner.cameras.sample
    ends = operator.clock.now() + seconds

    def sample_others(x, k):
        frame = sample(x, k)
        if frame is not None and operator.clock.now() < ends:
            frame.seen[owner.world.ids.index(i)] = False
        return frame

    owner.cameras.sample = sample_others


async def held_in_its_mission(operator):
    """Drone 0, by its operator; the others go on."""
    await operator.order("take-off")
    await operator.order("start")
    await operator.clock.sleep(1.0)
    await operator.order("hold", 0)


def test_a_flight_on_command_begins_as_soon_as_the_safety_table_lets_it():
    async def scene(operator):
        await operator.order("take-off")
        occluded(operator, 0, 0.15)
        await operator.clock.sleep(0.2)
        assert operator.pilot(0).guard.acts
        assert await told(operator, "go-to", 0, p=[0.0, 1.0, 0.6]) == (
            ANSWER_TEXTS.done,
            "there",
        )
        occluded(operator, 0, 0.15)
        await operator.clock.sleep(0.2)
        waiting = asyncio.create_task(told(operator, "go-to", 0, p=[0.0, 3.0, 0.6]))
        await operator.clock.sleep(0.1)
        assert operator.pilot(0).guard.acts
        await operator.order("hold", 0)
        assert await waiting == (ANSWER_TEXTS.refused, "it was held on its way")
        await operator.clock.sleep(3.0)
        assert operator.pilot(0).state.p == pytest.approx([0.0, 1.0, 0.6], abs=0.05)
        await operator.order("land")

    play(There, scene)


def test_a_law_that_wants_to_hover_does_not_end_a_flight_on_command():
    async def scene(operator):
        await held_in_its_mission(operator)
        assert await told(operator, "go-to", 0, p=[-1.0, 1.0, 0.8]) == (
            ANSWER_TEXTS.done,
            "there",
        )
        assert await told(
            operator, "fly", 0, **way((-1.0, 1.0, 0.8), (-1.0, 2.0, 0.8))
        ) == (ANSWER_TEXTS.done, "flown")
        await operator.order("land")

    play(Rests, scene)


def test_the_newer_command_counts_and_a_hold_ends_a_flight():
    async def scene(operator):
        await operator.order("take-off")
        first = asyncio.create_task(told(operator, "go-to", 0, p=[0.0, 3.0, 0.6]))
        await operator.clock.sleep(1.0)
        assert await told(operator, "go-to", 0, p=[-1.0, 0.0, 0.6]) == (
            ANSWER_TEXTS.done,
            "there",
        )
        assert await first == (ANSWER_TEXTS.refused, "it does what was commanded later")
        flying = asyncio.create_task(
            told(operator, "fly", 0, **way((-1, 0, 0.6), (-1, 2, 0.6), seconds=8.0))
        )
        await operator.clock.sleep(4.0)
        await operator.order("hold", 0)
        assert await flying == (ANSWER_TEXTS.refused, "it was held on its way")
        landing = asyncio.create_task(told(operator, "go-to", 0, p=[0.0, 3.0, 0.6]))
        await operator.clock.sleep(0.5)
        await operator.order("land")
        assert (await landing)[0] == ANSWER_TEXTS.refused
        assert operator.modes() == [Mode.GROUND] * 3

    play(There, scene)


def test_a_flight_on_command_ends_when_guidance_has_failed_and_says_so():
    async def scene(operator):
        await held_in_its_mission(operator)
        kind, why = await told(operator, "go-to", 0, p=[0.0, 3.0, 0.6], duration=20.0)
        assert (
            kind,
            why.startswith("its guidance has failed: RuntimeError: no idea"),
        ) == (ANSWER_TEXTS.refused, True), why
        y = operator.pilot(0).state.p[1]
        assert (await told(operator, "go-to", 0, p=[0.0, 3.0, 0.6]))[1].startswith(
            "its guidance has failed: "
        )
        await operator.clock.sleep(1.8)
        assert operator.pilot(0).mode is Mode.HOVER
        assert operator.pilot(0).state.p[1] - y < 0.2

    assert not any(result["success"] for result in play(Fails, scene).values())


def test_nothing_is_flown_on_command_while_a_stop_is_in_force():
    async def scene(operator):
        await operator.order("take-off")
        flying = asyncio.create_task(told(operator, "go-to", 0, p=[0.0, 3.0, 0.6]))
        await operator.clock.sleep(0.5)
        operator.agent.bus.stopped = (
            True  # the swarm is stopped; the stop has not reached these motors yet
        )
        for verb, arguments in (
            ("go-to", {"p": [0.0, 1.0, 0.6]}),
            ("fly", way((0, 0, 1), (0, 1, 1))),
        ):
            kind, why = await told(operator, verb, 1, **arguments)
            assert (kind, why.startswith("emergency stop in force")) == (
                ANSWER_TEXTS.refused,
                True,
            ), why
        assert (await flying)[1].startswith("emergency stop in force")
        operator.agent.bus.stopped = False
        assert await told(operator, "go-to", 1, p=[1.0, 1.0, 0.6]) == (
            ANSWER_TEXTS.done,
            "there",
        )
        await operator.order("land")

    play(There, scene)


def test_what_cannot_be_flown_is_refused_before_anything_moves():
    async def scene(operator):
        await operator.order("take-off")
        before = operator.pilot(0).state.p.copy()
        fast, out = (
            way((0, 0, 1), (0, 3, 1), seconds=0.5),
            way((0, 0, 1), (0, 9, 1), seconds=60.0),
        )
        for arguments, words in (
            (fast, "Give it more time"),
            (out, "fence"),
            ({}, "coefficients"),
            (fast | {"durations": "x"}, "float"),
        ):
            kind, why = await told(operator, "fly", 0, **arguments)
            assert (kind, words in why) == (ANSWER_TEXTS.refused, True), why
        for arguments in (
            {"p": [0.0, 1.0]},
            {"p": [0.0, 1.0, float("nan")]},
            {"p": [0, 0, 1], "haste": 3},
            {},
        ):
            kind, why = await told(operator, "go-to", 0, **arguments)
            assert (kind, "go-to" in why) == (ANSWER_TEXTS.refused, True), why
        await operator.clock.sleep(1.0)
        assert operator.pilot(0).state.p == pytest.approx(before, abs=0.01)
        await operator.order("land")

    play(There, scene)


def test_a_drone_says_what_each_of_its_links_has_lost_and_what_is_simulated():
    async def scene(operator):
        kind, said = await told(operator, "overview", 0)
        assert (kind, said["links"], said["network"]["rules"], said["route"]) == (
            ANSWER_TEXTS.done,
            {},
            [],
            [],
        )
        await told(operator, "impair", 0, loss=0.5)
        await operator.order("take-off")
        kind, said = await told(operator, "overview", 0)
        assert (kind, sorted(said["links"]), said["network"]["rules"]) == (
            ANSWER_TEXTS.done,
            [1, 2],
            [{"loss": 0.5}],
        )
        for sent, lost in said["links"].values():
            assert sent > 10
            assert 0.2 < lost / sent < 0.8
        await operator.order("land")

    play(There, scene)


def test_a_flight_on_command_puts_off_the_end_of_waiting(monkeypatch):
    monkeypatch.setattr(base, "HELD_FLIGHT_PATIENCE", 6.0)

    async def scene(operator):
        await operator.order("take-off", 0)
        for y in (2.0, 0.0, 2.0):
            assert await told(operator, "go-to", 0, p=[0.0, y, 0.6], duration=4.0) == (
                ANSWER_TEXTS.done,
                "there",
            )
        assert operator.pilot(0).mode is Mode.HOVER
        await operator.clock.sleep(5.0)
        assert operator.pilot(0).mode is Mode.HOVER
        await operator.clock.sleep(5.0)
        assert operator.pilot(0).mode is Mode.GROUND
        await operator.order("land")

    play(There, scene)


# Ends on command ------------------------------------------------------------------------------------------------


class Exchanges(CFGuidance):
    """Talks with its neighbours for long: none can go on without the others."""

    async def mission(self):
        await self.take_off()
        for k in range(10_000):
            await self.neighbors_exchange(k)
            await self.sleep(0.01)


class BreaksAtItsEnd(CFGuidance):
    """Has a mistake in the code that runs when it is ended."""

    async def mission(self):
        try:
            await self.take_off()
            await self.sleep(60.0)
        finally:
            raise ZeroDivisionError("in the clean-up")


async def in_flight(operator, *verbs, drone=0):
    """Wait until the drones fly, then command drone `drone` one verb after the other."""
    await operator.clock.sleep(4.0)
    for verb in verbs:
        if verb == "stop":
            operator.pilot(drone).cut("emergency stop")
        else:
            await operator.order(verb, drone)


@pytest.mark.parametrize(
    ("verb", "words"), [("land", "landed on command"), ("home", "sent home on command")]
)
def test_a_mission_that_its_operator_ends_in_flight_is_a_success_and_says_so(
    verb, words
):
    results = play(
        There, lambda operator: in_flight(operator, verb), config_of(1, operator=False)
    )
    assert results == {0: {"success": True, "reason": words, "ended": words}}


def test_landing_a_needed_drone_ends_the_others_as_a_success_too():
    results = play(
        Exchanges,
        lambda operator: in_flight(operator, "land", drone=1),
        config_of(3, operator=False),
    )
    assert [result["success"] for result in results.values()] == [True] * 3, results
    assert results[1]["ended"] == "landed on command"
    assert {results[i]["ended"] for i in (0, 2)} == {
        "drone 1: landed on command, and with it the team"
    }


@pytest.mark.parametrize("verbs", [("land", "stop"), ("stop", "land"), ("stop",)])
def test_an_operator_that_cuts_the_motors_does_not_make_a_success(verbs):
    async def scene(operator):
        await operator.clock.sleep(4.0)
        if verbs[0] == "land":
            landing = asyncio.create_task(operator.order("land", 0))
            await operator.clock.sleep(0.2)
            operator.pilot(0).cut("emergency stop")
            await landing
        else:
            await in_flight(operator, *verbs)
        await operator.order("land", 0)

    result = play(There, scene, config_of(1, operator=False))[0]
    assert (result["success"], "ended" in result) == (False, False), result
    assert "emergency stop" in result["reason"]


def test_a_drone_that_the_safety_table_lands_is_no_success_though_its_operator_lands_it_too():
    async def scene(operator):
        await operator.clock.sleep(4.0)
        operator.pilot(0).guard.tell("empty", 0.5, "3.0")
        await operator.clock.sleep(0.1)
        assert operator.pilot(0).mode is Mode.LAND
        await operator.order("land", 0)

    result = play(There, scene, config_of(1, operator=False))[0]
    assert (result["success"], "ended" in result) == (False, False), result
    assert "battery" in result["reason"]


def test_a_drone_that_breaks_while_its_operator_lands_it_is_no_success():
    async def scene(operator):
        operator.agent.drones[0].harm = lambda: "hit the floor at 3 m/s"
        await in_flight(operator, "land")

    result = play(There, scene, config_of(1, operator=False))[0]
    assert (result["success"], result["reason"]) == (
        False,
        "drone 0: hit the floor at 3 m/s",
    )


def test_a_mission_that_raises_when_its_operator_ends_it_has_failed():
    result = play(
        BreaksAtItsEnd,
        lambda operator: in_flight(operator, "land"),
        config_of(1, operator=False),
    )[0]
    assert not result["success"]
    assert result["reason"].startswith(
        "landed on command; drone 0: guidance failed: ZeroDivisionError: in the clean"
    )


def test_a_landing_by_anything_else_than_an_operator_is_no_success():
    async def scene(operator):
        await operator.clock.sleep(4.0)
        operator.agent.land_all("Ctrl-C (SIGINT): landing")

    result = play(There, scene, config_of(1, operator=False))[0]
    assert result == {"success": False, "reason": "Ctrl-C (SIGINT): landing"}
