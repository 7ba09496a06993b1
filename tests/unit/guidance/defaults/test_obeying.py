"""A mission that obeys its operator from the take-off to the landing, in virtual time."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from operators import play_scene

from crazychoir.agent import steering
from crazychoir.agent.command_arguments import path_message
from crazychoir.agents import operator as mission
from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.guidance.defaults import obeying
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.spline import fit_spline
from crazychoir.safety.rules.modes import Mode

DONE = ANSWER_TEXTS.done
REFUSED = ANSWER_TEXTS.refused


def fly(scene, drones=1, **options):
    config = mission.swarm(drones).replace(mission_options=options)
    made = SimpleNamespace(guidance=mission.guidance)
    return play_scene(made, scene, config)


def test_drone_takes_off_to_the_height_of_the_command_and_ends_well_when_it_has_landed():
    async def scene(operator):
        assert operator.task(0) == "waits for its operator: take-off"
        began = operator.clock.now()
        assert await operator.order("take-off", height=0.8, duration=4.0) == {
            0: (DONE, "hovering"),
            1: (DONE, "hovering"),
        }
        assert operator.clock.now() - began == pytest.approx(4.0, abs=0.2)
        assert operator.pilot(0).state.p[2] == pytest.approx(0.8, abs=0.03)
        assert operator.task(0) == "obeys its operator, or lands in 296 s"
        assert await operator.order("start", 0) == (
            REFUSED,
            "it obeys its operator, or lands in 296 s",
        )
        began = operator.clock.now()
        assert await operator.order("land", 0, duration=6.0) == (DONE, "on ground")
        assert operator.clock.now() - began == pytest.approx(6.0, abs=0.5)
        assert operator.modes() == [Mode.GROUND, Mode.HOVER]
        assert await operator.order("home", 1) == (DONE, "on ground")

    results = fly(scene, drones=2)
    assert all(result["success"] for result in results.values()), results
    assert "ended" not in results[0]
    assert results[1]["place"] == pytest.approx([0.6, 0.0, 0.0], abs=0.06)


def test_drone_takes_off_without_a_command_if_its_options_say_so():
    async def scene(operator):
        await operator.clock.sleep(8.0)
        assert operator.modes() == [Mode.HOVER]
        assert await operator.order("go-to", 0, p=[0.5, 0.0, 1.0]) == (DONE, "there")
        await operator.order("land", 0)

    assert fly(scene, at_once=True)[0]["success"]


def test_relative_moves_start_at_the_set_point():
    async def scene(operator):
        await operator.order("take-off", 0, height=0.5)
        for _ in range(2):
            assert await operator.order(
                "go-to", 0, p=[0.5, 0.0, 0.25], yaw=0.5, relative=True, duration=2.0
            ) == (DONE, "there")
        assert operator.pilot(0).state.p == pytest.approx([1.0, 0.0, 1.0], abs=0.05)
        assert yaw_of(operator.pilot(0).state.q) == pytest.approx(1.0, abs=0.05)
        kind, why = await operator.order("go-to", 0, p=[0, 0, 5], relative=True)
        assert kind == REFUSED
        assert why.startswith("go-to = [1.0")
        assert "outside the fence" in why
        await operator.order("land", 0)

    fly(scene)


def test_speed_of_a_command_bounds_the_speed_of_the_flight():
    async def scene(operator):
        await operator.order("take-off", 0)
        began = operator.clock.now()
        await operator.order("go-to", 0, p=[1.0, 0.0, 0.0], relative=True, speed=0.25)
        assert operator.clock.now() - began == pytest.approx(35.0 / 4.0, abs=0.3)
        await operator.order("land", 0)

    fly(scene)


def test_drone_flies_with_a_velocity_and_comes_to_rest():
    async def scene(operator):
        await operator.order("take-off", 0, height=0.5)
        assert await operator.order(
            "velocity", 0, v=[0.4, 0.0, 0.1], yaw_rate=0.5, duration=2.0
        ) == (DONE, "flown")
        await operator.clock.sleep(2.0)
        x, y, z = operator.pilot(0).state.p
        assert 0.7 < x < 1.0
        assert abs(y) < 0.05
        assert 0.65 < z < 0.8
        assert np.linalg.norm(operator.pilot(0).state.v) < 0.05
        assert yaw_of(operator.pilot(0).state.q) == pytest.approx(1.0, abs=0.2)
        assert operator.modes() == [Mode.HOVER]
        await operator.order("land", 0)

    assert fly(scene)[0]["success"]


def test_velocity_does_not_leave_the_fence():
    async def scene(operator):
        await operator.order("take-off", 0, height=0.5)
        for _ in range(2):
            await operator.order("velocity", 0, v=[0.0, -1.0, 0.0], duration=7.0)
        low = operator.pilot(0).setup.fence.low[1]
        assert low < operator.pilot(0).state.p[1] < low + 0.5
        await operator.order("land", 0)

    fly(scene)


def test_newer_velocity_replaces_the_older_one_and_a_hold_ends_it():
    async def scene(operator):
        await operator.order("take-off", 0)
        first = operator.begin("velocity", 0, v=[0.3, 0.0, 0.0], duration=10.0)
        await operator.clock.sleep(0.5)
        second = operator.begin("velocity", 0, v=[0.0, 0.3, 0.0], duration=10.0)
        assert await first == (REFUSED, "it does what was commanded later")
        await operator.clock.sleep(0.5)
        assert await operator.order("hold", 0) == (DONE, "held")
        assert await second == (REFUSED, "it was held on its way")
        await operator.order("land", 0)

    fly(scene)


def test_path_is_flown_from_here_slower_and_from_its_end():
    path = fit_spline(
        [0.0, 2.0, 4.0], [[5.0, 5.0, 0.0], [5.5, 5.2, 0.0], [6.0, 5.0, 0.2]]
    )

    async def scene(operator):
        await operator.order("take-off", 0, height=0.5)
        began = operator.clock.now()
        assert await operator.order(
            "fly", 0, **path_message(path, relative=True, timescale=2.0)
        ) == (DONE, "flown")
        assert operator.clock.now() - began == pytest.approx(8.0, abs=0.5)
        assert operator.pilot(0).state.p == pytest.approx([1.0, 0.0, 0.7], abs=0.05)
        assert await operator.order(
            "fly", 0, **path_message(path, relative=True, reverse=True)
        ) == (DONE, "flown")
        assert operator.pilot(0).state.p == pytest.approx([0.0, 0.0, 0.5], abs=0.05)
        kind, why = await operator.order("fly", 0, **path_message(path))
        assert kind == REFUSED
        assert "outside the fence" in why
        await operator.order("land", 0)

    fly(scene)


class SlowFirmware:
    """A link to a firmware that takes 2 s for the request of this verb."""

    def __init__(self, clock, verb):
        self.clock = clock
        self.verb = verb

    async def request(self, verb, seconds, **arguments):
        if verb == self.verb:
            await self.clock.sleep(2.0)


@pytest.mark.parametrize("verb", ["trajectory_upload", "trajectory_start"])
def test_hold_ends_a_flight_that_waits_for_the_firmware(monkeypatch, verb):
    path = fit_spline([0.0, 3.0, 6.0], [[0, 0, 0], [0.5, 0.3, 0], [1.0, 0, 0]])
    told = path_message(path, relative=True, on_board={})

    async def scene(operator):
        firmware = SlowFirmware(operator.clock, verb)
        monkeypatch.setattr(steering, "require_firmware", lambda drone: firmware)
        await operator.order("take-off", 0, height=0.5)
        flying = operator.begin("fly", 0, **told)
        await operator.clock.sleep(1.5)
        assert await operator.order("hold", 0) == (DONE, "held")
        assert await flying == (REFUSED, "it was held on its way")
        await operator.order("land", 0)

    fly(scene)


def test_drone_lands_on_a_table():
    async def scene(operator):
        await operator.order("take-off", 0, height=0.8)
        await operator.order("land", 0, height=0.3)
        # There is no table: the drone falls from there.
        assert 0.15 < operator.pilot(0).state.p[2] < 0.36

    fly(scene)


@pytest.mark.parametrize(
    ("verb", "wrong", "why"),
    [
        ("take-off", {"height": 50.0}, "to 3 m above the ground"),
        ("take-off", {"speed": 1.0}, "the arguments height, duration"),
        ("take-off", {"height": math.nan}, "allowed"),
        ("hold", {"height": 1.0}, "the arguments none"),
        ("velocity", {"v": [1.0, 0.0]}, "the arguments v, yaw_rate, duration"),
        ("velocity", {"v": [1.0, 0.0, 0.0], "duration": 10.1}, "<= 10.0"),
        ("go-to", {"p": "there"}, "the arguments p, yaw, duration, relative, speed"),
        ("fly", {"coefficients": 1.0}, "coefficients (k, 4, 8) and durations (k,)"),
    ],
)
def test_wrong_arguments_are_refused(verb, wrong, why):
    async def scene(operator):
        kind, said = await operator.order(verb, 0, **wrong)
        assert kind == REFUSED
        assert why in said
        await operator.order("take-off", 0)
        await operator.order("land", 0)

    assert fly(scene)[0]["success"]


def test_drone_without_commands_lands_and_says_why(monkeypatch):
    monkeypatch.setattr(obeying, "HELD_FLIGHT_PATIENCE", 5.0)

    async def scene(operator):
        await operator.order("take-off", 0)
        await operator.order("velocity", 0, v=[0.05, 0.0, 0.0], duration=8.0)
        assert operator.modes() == [Mode.HOVER]

    result = fly(scene)[0]
    assert not result["success"]
    assert result["reason"] == "drone 0: no command by its operator within 5 s"


def test_path_that_the_safety_table_brakes_is_continued():
    path = fit_spline([0.0, 3.0, 6.0], [[0, 0, 0], [0.5, 0.3, 0], [1.0, 0, 0]])

    async def scene(operator):
        await operator.order("take-off", 0, height=0.5)
        flying = operator.begin("fly", 0, **path_message(path, relative=True))
        await operator.clock.sleep(2.5)
        pilot = operator.pilot(0)
        cameras = operator.agent.owners[0].cameras
        sample = cameras.sample
        cameras.sample = lambda x, k: None
        await operator.clock.sleep(0.3)
        cameras.sample = sample
        assert pilot.judge.braked == 1
        assert await flying == (DONE, "flown")
        assert pilot.state.p == pytest.approx([1.0, 0.0, 0.5], abs=0.05)
        await operator.order("land", 0)

    fly(scene)
