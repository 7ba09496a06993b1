"""What an observer makes of a swarm, and how processes are started and ended."""

import asyncio
import contextlib
import json
import socket
import sys
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir import launch
from crazychoir.bus.local import OBSERVER, Bus
from crazychoir.bus.topics import LOG, STATUS, TRUTH
from crazychoir.guidance.base import LAW
from crazychoir.launch import SETTLED, Score, apart, attached, free_ports, observer, summary, swarm_file
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import run_virtual
from crazychoir.swarm.config import SwarmConfig, default_swarm
from crazychoir.types import State, Status

MISSION = SimpleNamespace(guidance=lambda i, config: None)
PERIOD = 1.0 / TRUTH.rate
STEP = 1.5
"""Periods that one look takes."""


class Sky:
    """Drones without anything, whose truth and status a test tells, and a score of them."""

    def __init__(self, clock, n=2, goal=None):
        self.clock = clock
        self.bus = Bus(clock)
        self.ports = [self.bus.port(i) for i in range(n)]
        self.score = Score(self.bus, tuple(range(n)), goal or {})

    def at(self, i, p, v=(0.0, 0.0, 0.0), age=0.0):
        self.ports[i].publish(TRUTH, State.at(p, v), age)

    def tells(self, i, phase, task=""):
        self.ports[i].publish(STATUS, Status(phase, task))

    async def looks(self, times=1):
        """The score looks so many times, and half a period goes by."""
        running = asyncio.create_task(self.score.run())
        await self.clock.sleep((times + 0.5) * PERIOD)
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


def seen(scene, **options):
    """The score after `scene(sky)` in virtual time."""

    async def main(clock):
        sky = Sky(clock, **options)
        await scene(sky)
        return sky.score

    return run_virtual(main)


# The score ------------------------------------------------------------------------------------------------------


def test_nothing_is_measured_before_everybody_was_seen():
    async def scene(sky):
        sky.at(0, (0, 0, 0))
        await sky.looks(3)

    score = seen(scene)
    assert score.min_separation == float("inf")
    assert score.formation() == {}


def test_the_smallest_distance_of_any_two_stays():
    async def scene(sky):
        for x in (3.0, 0.5, 2.0):
            sky.at(0, (0, 0, 0))
            sky.at(1, (5.0, 0, 0))
            sky.at(2, (x, 0, 0))
            await sky.looks()

    assert seen(scene, n=3).min_separation == pytest.approx(0.5)


def test_a_distance_is_between_places_at_one_time():
    """One truth is 0.2 s old when it comes, of a drone that has flown on at 1 m/s since."""

    async def scene(sky):
        sky.at(0, (0, 0, 0))
        sky.at(1, (1.0, 0, 0), (-1.0, 0, 0), age=0.2)
        await sky.looks()

    assert seen(scene).min_separation == pytest.approx(1.0 - 0.2 - PERIOD)


def test_one_drone_is_never_near_another():
    async def scene(sky):
        sky.at(0, (0, 0, 0))
        await sky.looks()

    assert seen(scene, n=1).min_separation == float("inf")


def test_lengths_flown_add_up():
    async def scene(sky):
        for p in ((0, 0, 0), (0, 0, 1), (3, 4, 1), (0, 0, 1)):
            sky.at(0, p)

    assert seen(scene).flown == {0: pytest.approx(11.0), 1: 0.0}


def test_a_formation_is_judged_from_the_first_law_to_the_first_landing():
    async def scene(sky):
        for far, phase, task in (
            (5.0, "taking off", ""), (2.0, "mission", LAW), (1.0, "mission", LAW), (0.001, "mission", LAW),
            (9.0, "landing", "landing"),
        ):  # fmt: skip
            sky.tells(0, phase, task)
            sky.at(0, (far, 0, 0))
            sky.at(1, (0, 1, 0))
            await sky.looks()

    found = seen(scene, goal={0: np.zeros(3), 1: np.array([0.0, 1.0, 0.0])}).formation()
    assert found["formation_error_m"] == pytest.approx(0.001)
    assert found["settling_s"] == pytest.approx((STEP + 1.0) * PERIOD)


@pytest.mark.parametrize(("phase", "task"), [("on ground", LAW), ("hovering", "waiting"), ("landing", "landing")])
def test_a_drone_that_flies_no_law_forms_nothing(phase, task):
    async def scene(sky):
        sky.tells(0, phase, task)
        sky.at(0, (1, 0, 0))
        sky.at(1, (0, 1, 0))
        await sky.looks(2)

    assert seen(scene, goal={0: np.zeros(3)}).formation() == {}


def test_a_score_does_not_grow_with_the_flight():
    async def scene(sky):
        sky.tells(0, "mission", LAW)
        for n in range(300):
            sky.at(0, (2.0 * SETTLED * (n % 3 == 0 and n < 200), 0, 0))
            sky.at(1, (1, 1, 0))
            sky.ports[0].publish(LOG, f"line {n}")
            await sky.looks()
        sky.score.log.extend(str(n) for n in range(2 * launch.LOGGED))

    score = seen(scene, goal={0: np.zeros(3)})
    assert len(score.errors) == 2
    assert score.formation()["settling_s"] == pytest.approx((198 * STEP + 1.0) * PERIOD), "the last time"
    assert score.formation()["formation_error_m"] == 0.0
    assert len(score.log) == launch.LOGGED
    assert score.log[-1] == str(2 * launch.LOGGED - 1), "the newest stay"


# The result of a run --------------------------------------------------------------------------------------------


def result_of(results, here=None, mission=MISSION):
    score = SimpleNamespace(
        min_separation=0.5, flown={0: 1.23456}, log=deque(["a line"]), statuses={0: Status("on ground", round=7)},
        messages=lambda: {"sent": 3}, formation=dict,
    )  # fmt: skip
    return summary(default_swarm(3), mission, results, score, 10.0, 2.0, here)


def test_a_run_succeeds_when_every_drone_does():
    result = result_of({i: {"success": True} for i in range(3)})
    assert result["success"] is True
    assert (result["drones"], result["here"], result["absent"], result["reasons"]) == (3, [0, 1, 2], [], {})
    assert (result["real_time_factor"], result["rounds"], result["flown_m"]) == (5.0, 7, {0: 1.2346})
    assert json.loads(json.dumps(result))["log"] == ["a line"]


def test_a_drone_that_fails_gives_its_reason():
    result = result_of({0: {"success": True}, 2: {"success": False}, 1: {"success": False, "reason": "lost"}})
    assert result["success"] is False
    assert result["reasons"] == {1: "lost", 2: "no result"}


def test_a_drone_without_result_is_absent():
    result = result_of({0: {"success": True}, 2: {"success": True}})
    assert result["success"] is False
    assert result["absent"] == [1]


def test_the_drones_that_were_started_here_decide():
    assert result_of({1: {"success": True}}, here=(1,))["success"] is True
    result = result_of({1: {"success": True}}, here=(1, 2))
    assert result["success"] is False
    assert (result["drones"], result["here"], result["absent"]) == (3, [1, 2], [2])


def test_a_mission_reports_on_all_or_not_at_all():
    mission = SimpleNamespace(report=lambda config, results: {"success": False, "cost": 3.0})
    every = {i: {"success": True} for i in range(3)}
    whole = result_of(every, mission=mission)
    assert (whole["success"], whole["cost"]) == (False, 3.0)
    part = result_of({1: {"success": True}}, here=(1,), mission=mission)
    assert part["success"] is True
    assert "cost" not in part


def test_a_report_that_is_content_does_not_hide_a_drone_that_failed_and_may_name_others():
    def report(config, results):
        return {"success": True, "reasons": {0: "too far", 2: "of the mission"}}

    results = {0: {"success": True}, 1: {"success": True}, 2: {"success": False, "reason": "lost"}}
    result = result_of(results, mission=SimpleNamespace(report=report))
    assert result["success"] is False
    assert result["reasons"] == {0: "too far", 2: "lost"}


# Names, ports, files --------------------------------------------------------------------------------------------


def test_two_runs_have_names_and_ports_of_their_own():
    config = default_swarm(4)
    one, other = apart(config, None), apart(config, 2)
    assert len({config.name, one.name, other.name}) == 3
    assert one.base_port != config.base_port
    assert (one.ids, one.groups()) == (config.ids, config.groups())
    assert other.groups() == ((0, 1), (2, 3))
    assert apart(config, 9).groups() == config.groups(), "no process without a drone"


def test_ports_in_use_are_left_alone(monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert not launch._free(port)
    assert launch._free(port)
    tried = []

    def free(port):
        tried.append(port)
        return len(tried) > 3

    monkeypatch.setattr(launch, "_free", free)
    base = free_ports([0, 2])
    assert tried[-2:] == [base, base + 2]
    monkeypatch.setattr(launch, "_free", lambda port: False)
    with pytest.raises(ValueError, match=r"base_port.*2 processes"):
        free_ports([0, 2])


def test_the_swarm_file_is_there_while_it_flies():
    config = default_swarm(3)
    with swarm_file(config) as path:
        assert SwarmConfig.load(path) == config
        assert config.name in str(path)
        assert path.parent.stat().st_mode & 0o077 == 0, "for nobody else"
    assert not path.parent.exists()


def test_observers_side_by_side_have_names_and_addresses_of_their_own():
    async def main(clock):
        return [observer(clock, default_swarm(2)).bus for _ in range(2)]

    one, other = run_virtual(main)
    assert one.process != other.process
    assert list(one.ports) != list(other.ports)
    assert min(*one.ports, *other.ports) > OBSERVER


def test_actors_work_while_the_link_is_open_and_stop_before_it():
    said = []

    class Part(Actor):
        def __init__(self, name):
            self.name = name

        async def run(self):
            said.append(f"{self.name} runs")
            await asyncio.Event().wait()

        async def on_stop(self):
            said.append(f"{self.name} stops")

    class Link(Part):
        def open(self):
            said.append("opens")

    async def main(clock):
        link = Link("link")
        link.bus = Bus(clock)
        async with attached(link, Part("score")):
            await clock.sleep(1.0)

    run_virtual(main)
    assert said == ["opens", "link runs", "score runs", "score stops", "link stops"]


# Processes ------------------------------------------------------------------------------------------------------


async def child(program):
    pipe = asyncio.subprocess.PIPE
    return await asyncio.create_subprocess_exec(sys.executable, "-c", program, stdout=pipe, stderr=pipe)


async def test_the_result_of_a_child_and_what_it_says_meanwhile():
    said = []
    program = "import sys; print('hello', file=sys.stderr); print('{\"results\": {\"3\": {\"success\": true}}}')"
    assert await launch._result(await child(program), said.append) == {"3": {"success": True}}
    assert said == ["hello"]


@pytest.mark.parametrize("out", ["", "nonsense", '{"success": false, "error": "no"}'])
async def test_a_child_without_a_result_has_none(out):
    assert await launch._result(await child(f"print({out!r})"), print) == {}


async def test_a_child_that_does_not_end_is_killed(monkeypatch):
    monkeypatch.setattr(launch, "GRACE", 0.3)
    deaf = await child("import signal; signal.signal(15, signal.SIG_IGN); print('on', flush=True); signal.pause()")
    ready = await child("import signal; signal.signal(15, lambda *_: exit(3)); print('on', flush=True); signal.pause()")
    for process in (deaf, ready):
        assert await process.stdout.readline() == b"on\n"
    await launch._end([deaf, ready])
    assert (deaf.returncode, ready.returncode) == (-9, 3)
