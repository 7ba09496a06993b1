"""The object that a run prints."""

import importlib.util
import json
import time
from collections import deque
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from crazychoir.agent.drone import WAITING_TASK
from crazychoir.cli.main import app
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import ConfigError
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.launch import flight
from crazychoir.launch.flight import (
    MISSION_REASONS,
    NO_REASONS,
    NO_RESULT,
    do_all_wait,
    fly_fast,
    list_owners,
    require_extras,
    summarise_flight,
)
from crazychoir.launch.processes import Owner
from crazychoir.launch.virtual_bodies import add_crashes, explain_absent
from crazychoir.types import Status


def starts_world(config, started):
    return [owner.name for owner in list_owners(config, started)] == ["world"]


MISSION = SimpleNamespace(guidance=lambda i, config: None)


def result_of(results, here=None, mission=MISSION, touching=None):
    score = SimpleNamespace(
        min_separation=0.5,
        touching=touching or {},
        flown={0: 1.23456},
        log=deque(["a line"]),
        statuses={0: Status("on ground", round=7)},
        messages=lambda: {"sent": 3},
        formation=dict,
        tracks={},
    )
    return summarise_flight(default_swarm(3), mission, results, score, 10.0, 2.0, here)


def test_a_run_succeeds_when_every_drone_does():
    result = result_of({i: {"success": True} for i in range(3)})
    assert result["success"] is True
    assert (result["drones"], result["here"], result["absent"], result["reasons"]) == (
        3,
        [0, 1, 2],
        [],
        {},
    )
    assert (result["real_time_factor"], result["rounds"], result["flown_m"]) == (
        5.0,
        7,
        {0: 1.2346},
    )
    assert json.loads(json.dumps(result))["log"] == ["a line"]


def test_a_fall_is_a_reason_whether_or_not_the_agent_of_the_drone_has_a_result():
    crashes = {0: "crashed", 1: "crashed"}
    results = add_crashes({i: {"success": True} for i in (0, 2)}, crashes)
    told = result_of(results)
    explain_absent(told, crashes)
    assert told["success"] is False
    assert told["reasons"] == {0: "drone 0: crashed", 1: f"{NO_RESULT}; crashed"}
    assert told["results"][0] == {"success": False, "reason": "drone 0: crashed"}


def test_a_drone_that_fails_gives_its_reason():
    result = result_of(
        {
            0: {"success": True},
            2: {"success": False},
            1: {"success": False, "reason": "lost"},
        }
    )
    assert result["success"] is False
    assert result["reasons"] == {1: "lost", 2: MISSION_REASONS.unsaid}


def test_a_drone_without_result_is_absent():
    result = result_of({0: {"success": True}, 2: {"success": True}})
    assert result["success"] is False
    assert result["absent"] == [1]
    assert result["reasons"] == {1: NO_RESULT}
    assert result["reasons"] == {1: NO_RESULT}


def test_the_drones_that_were_started_here_decide():
    assert result_of({1: {"success": True}}, here=(1,))["success"] is True
    result = result_of({1: {"success": True}}, here=(1, 2))
    assert result["success"] is False
    assert (result["drones"], result["here"], result["absent"]) == (3, [1, 2], [2])


def test_a_mission_reports_on_all_or_not_at_all():
    mission = SimpleNamespace(
        report=lambda config, results: {"success": False, "cost": 3.0}
    )
    every = {i: {"success": True} for i in range(3)}
    whole = result_of(every, mission=mission)
    assert (whole["success"], whole["cost"]) == (False, 3.0)
    part = result_of({1: {"success": True}}, here=(1,), mission=mission)
    assert part["success"] is True
    assert "cost" not in part


def test_a_report_that_is_content_does_not_hide_a_drone_that_failed_and_may_name_others():
    def report(config, results):
        return {"success": True, "reasons": {0: "too far", 2: "of the mission"}}

    results = {
        0: {"success": True},
        1: {"success": True},
        2: {"success": False, "reason": "lost"},
    }
    result = result_of(results, mission=SimpleNamespace(report=report))
    assert result["success"] is False
    assert result["reasons"] == {0: "too far", 2: "lost"}


def test_a_report_without_reasons_blames_only_the_drones_that_failed():
    mission = SimpleNamespace(report=lambda config, results: {"success": False})
    every = {i: {"success": True} for i in range(3)}
    result = result_of(every, mission=mission)
    assert (result["success"], result["reason"], result["reasons"]) == (
        False,
        NO_REASONS,
        {},
    )
    result = result_of(
        every | {1: {"success": False, "reason": "lost"}}, mission=mission
    )
    assert (result["success"], result["reason"], result["reasons"]) == (
        False,
        None,
        {1: "lost"},
    )
    result = result_of(
        every,
        mission=SimpleNamespace(
            report=lambda *_: {"success": False, "reason": "too slow"}
        ),
    )
    assert (result["reason"], result["reasons"]) == ("too slow", {})
    assert result_of(every)["reason"] is None


def test_reasons_name_what_has_kept_a_drone_from_where_it_wanted_to_be():
    results = {
        0: {"success": True, "kept_clear_s": 2.5},
        1: {"success": True, "at_fence_s": 3.0},
        2: {"success": True},
    }
    result = result_of(
        results,
        mission=SimpleNamespace(
            report=lambda *_: {"success": False, "reasons": {1: "far"}}
        ),
    )
    assert result["reasons"] == {1: "far; held at the fence for 3 s"}
    assert (result["kept_clear_s"], result["at_fence_s"]) == ({0: 2.5}, {1: 3.0})
    result = result_of(
        results, mission=SimpleNamespace(report=lambda *_: {"success": False})
    )
    filtered = "drone 0: the collision filter has flown it for 2.5 s"
    assert (
        result["reason"]
        == f"{NO_REASONS}; {filtered}; drone 1: held at the fence for 3 s"
    )


def test_the_reason_of_a_report_stands_beside_those_of_drones_that_failed_and_these_say_what_held_them():
    results = {
        0: {"success": True, "kept_clear_s": 2.5},
        1: {"success": False, "reason": "lost", "kept_clear_s": 4.0, "at_fence_s": 3.0},
        2: {"success": True},
    }
    report = {"success": False, "reason": "too slow"}
    result = result_of(results, mission=SimpleNamespace(report=lambda *_: dict(report)))
    assert result["reasons"] == {
        1: "lost; the collision filter has flown it for 4 s; held at the fence for 3 s"
    }
    assert (
        result["reason"]
        == "too slow; drone 0: the collision filter has flown it for 2.5 s"
    )
    assert result_of(results)["reason"] is None, (
        "no report gave a reason for the whole run"
    )


def test_drones_that_came_near_enough_to_touch_have_failed():
    every = {i: {"success": True} for i in range(3)}
    result = result_of(every, touching={(0, 2): 0.002})
    assert result["success"] is False
    assert result["reasons"] == {
        0: "came within 0.002 m of drone 2, and may have touched it: allowed 0.137 m",
        2: "came within 0.002 m of drone 0, and may have touched it: allowed 0.137 m",
    }
    failed = {**every, 2: {"success": False, "reason": "lost"}}
    assert result_of(failed, touching={(0, 2): 0.002})["reasons"][2].startswith(
        "lost; came within 0.002 m of drone 0"
    )
    part = result_of(
        {1: {"success": True}, 2: {"success": True}},
        here=(1, 2),
        touching={(0, 2): 0.002},
    )
    assert list(part["reasons"]) == [2], "only of drones that were started here"
    assert (
        result_of({1: {"success": True}}, here=(1,), touching={(0, 2): 0.002})[
            "success"
        ]
        is True
    )


def test_a_report_adds_figures_and_changes_none_of_the_run():
    report = {"cost": 3.0, "drones": 99, "rounds": 99, "log": [], "results": None}
    result = result_of(
        {i: {"success": True} for i in range(3)},
        mission=SimpleNamespace(report=lambda *_: report),
    )
    assert (result["success"], result["cost"]) == (True, 3.0)
    assert (
        result["drones"],
        result["rounds"],
        result["log"],
        len(result["results"]),
    ) == (3, 7, ["a line"], 3)


def test_drones_that_swap_places_have_failed_though_nothing_in_their_missions_saw_it():
    class Swaps(CFGuidance):
        async def mission(self):
            await self.take_off()
            x, y, _ = self.member.config.drone(1 - self.id).home
            await self.go_to((x, y, 1.0))
            await self.land()

    mission = SimpleNamespace(guidance=lambda i, config: Swaps())
    result = fly_fast(
        default_swarm(2).replace(mission="swap", collision={"method": "off"}), mission
    )
    assert result["success"] is False
    assert result["min_separation_m"] < 0.05
    assert list(result["reasons"]) == [0, 1]
    assert all("may have touched" in reason for reason in result["reasons"].values())


def test_compiling_before_the_flight_is_not_part_of_its_time():
    class Slow(CFGuidance):
        def foresee(self, member):
            time.sleep(0.2)

        async def mission(self):
            return {}

    result = fly_fast(
        default_swarm(2), SimpleNamespace(guidance=lambda i, config: Slow())
    )
    assert result["startup_s"] > 0.4
    assert result["wall_s"] < 0.4


def test_all_wait_until_one_has_begun_and_a_start_with_fewer_does_not_wait():
    config, score = (
        default_swarm(3),
        SimpleNamespace(statuses={0: Status("on ground", WAITING_TASK)}),
    )
    assert do_all_wait(config, score)
    assert not do_all_wait(config.replace(start=2), score)
    score.statuses[1] = Status("on ground", "")
    assert not do_all_wait(config, score)


def test_the_world_is_started_once_with_all_drones_or_with_the_lowest_of_its_host():
    def config(world, *hosts):
        drones = [
            {"id": i, "home": [float(i), 0.0, 0.0], "host": host}
            for i, host in enumerate(hosts)
        ]
        named = (
            {"lab": "10.0.0.1", "desk": "10.0.0.2", "rack": "10.0.0.3"}
            if any(hosts)
            else {}
        )
        raw = {
            "name": "a",
            "drones": drones,
            "hosts": named,
            "world": world,
            "security": {"insecure": True},
        }
        return SwarmConfig.of(raw)

    assert not starts_world(config({}, None, None), None)
    here = config({"owned": True}, None, None)
    assert [starts_world(here, started) for started in (None, (0, 1), (0,), (1,))] == [
        True,
        True,
        True,
        False,
    ]
    there = config({"host": "desk"}, "lab", "desk", "desk")
    assert [
        starts_world(there, started) for started in ((0,), (1,), (2,), (0, 1, 2))
    ] == [False, True, False, True]
    alone = config({"host": "rack"}, "lab", "desk")
    assert [starts_world(alone, started) for started in ((0,), (1,), (0, 1))] == [
        False,
        False,
        True,
    ]


def test_owners_of_cameras_and_dongles_start_with_the_drones_of_their_host():
    drones = [
        {
            "id": i,
            "home": [i, 0, 0],
            "uri": f"udp://10.0.0.9:{i + 1}",
            "dongle": i % 2,
            "host": host,
        }
        for i, host in enumerate(("lab", "desk", "lab"))
    ]
    raw = {
        "name": "a",
        "drones": drones,
        "hosts": {"lab": "10.0.0.1", "desk": "10.0.0.2"},
    }
    raw |= {"security": {"insecure": True}}
    rows = [{"dongle": 0, "host": "lab"}, {"dongle": 1, "host": "desk"}]
    raw |= {"mocap": {"host": "desk"}, "radio": {"dongles": rows}}
    config = SwarmConfig.of(raw)
    names = {
        here: [owner.name for owner in list_owners(config, here)]
        for here in ((0, 1, 2), (0,), (2,), (1,))
    }
    assert names == {
        (0, 1, 2): ["mocap", "dongle 0", "dongle 1"],
        (0,): ["dongle 0"],
        (2,): [],
        (1,): ["mocap", "dongle 1"],
    }
    assert list_owners(config, None)[1].options == ("--dongle", "0")


# What an operator has ended -----------------------------------------------------------------------------------------


LANDED = {"success": True, "reason": "landed on command", "ended": "landed on command"}
DONE = {"success": True}


def reporting(report):
    return SimpleNamespace(report=lambda config, results: dict(report(results)))


def test_a_run_that_its_operator_has_ended_is_a_success_and_names_the_drones():
    result = result_of({0: LANDED, 1: DONE, 2: LANDED})
    assert (result["success"], result["reasons"], result["reason"]) == (True, {}, None)
    assert result["ended"] == {0: "landed on command", 2: "landed on command"}
    assert result_of(dict.fromkeys(range(3), DONE))["ended"] == {}


def test_a_report_that_lacks_only_what_the_operator_has_ended_is_a_success():
    def undone(results):
        return {
            "success": False,
            "reasons": {
                i: "2 of 5 places" for i, r in results.items() if not r["success"]
            },
        }

    result = result_of({0: LANDED, 1: DONE, 2: DONE}, mission=reporting(undone))
    assert (result["success"], result["reasons"]) == (True, {})
    assert result["ended"] == {0: "landed on command; 2 of 5 places"}
    result = result_of(
        {0: LANDED, 1: DONE, 2: DONE},
        mission=reporting(lambda results: {"success": False}),
    )
    assert (result["success"], result["reason"]) == (True, None)


def test_what_else_has_failed_stays_a_failure_beside_an_operators_end():
    off = reporting(
        lambda results: {
            "success": False,
            "reasons": {0: "undone", 1: "0.3 m from its place"},
        }
    )
    result = result_of({0: LANDED, 1: DONE, 2: DONE}, mission=off)
    assert (result["success"], result["reasons"]) == (
        False,
        {1: "0.3 m from its place"},
    )
    result = result_of(
        {0: LANDED, 1: DONE, 2: DONE},
        mission=reporting(lambda _: {"success": False, "reason": "late"}),
    )
    assert (result["success"], result["reason"]) == (False, "late")
    result = result_of({0: LANDED, 1: {"success": False, "reason": "lost"}, 2: DONE})
    assert (result["success"], result["reasons"]) == (False, {1: "lost"})
    assert not result_of(dict.fromkeys(range(3), LANDED), touching={(0, 1): 0.05})[
        "success"
    ]
    assert not result_of({0: LANDED, 1: LANDED})["success"], (
        "the process of drone 2 has ended without a result"
    )


def test_a_run_that_fails_never_has_an_empty_reason():
    for empty in ("", " ", None):
        assert result_of({0: {"success": False, "reason": empty}, 1: DONE, 2: DONE})[
            "reasons"
        ] == {0: MISSION_REASONS.unsaid}
        every = dict.fromkeys(range(3), DONE)
        mission = reporting(lambda _, empty=empty: {"success": False, "reason": empty})
        assert result_of(every, mission=mission)["reason"] == NO_REASONS
        mission = reporting(
            lambda _, empty=empty: {"success": False, "reasons": {1: empty}}
        )
        assert result_of(every, mission=mission)["reasons"] == {
            1: MISSION_REASONS.unsaid
        }


WORLD = Owner("world", "crazychoir.cli.fly.world")
MOCAP = Owner("mocap", "crazychoir.cli.fly.mocap")


@pytest.fixture
def nothing_installed(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: None)


def swarm_of_four(uri="mujoco://", **tables):
    drones = [
        {"id": i, "home": [1.0 * i, 0.0, 0.0], "uri": uri.format(19850 + i)}
        for i in range(4)
    ]
    return SwarmConfig.of(
        {
            "name": "four",
            "mission": "figure",
            "graph": "empty",
            "drones": drones,
            **tables,
        }
    )


@pytest.mark.parametrize(
    ("config", "owners", "fast", "words"),
    [
        (
            swarm_of_four(),
            [WORLD],
            False,
            "drone 0: uri = .mujoco://.: found no module mujoco; .*'crazychoir.mujoco.'",
        ),
        (swarm_of_four(), [], True, "no module mujoco"),
        (
            swarm_of_four("udp://127.0.0.1:{}", mocap={"source": "vicon"}),
            [MOCAP],
            False,
            "source = .vicon.*'crazychoir.mocap.'",
        ),
    ],
)
def test_what_a_run_needs_here_is_named_with_how_to_install_it(
    nothing_installed, config, owners, fast, words
):
    with pytest.raises(ConfigError, match=words):
        require_extras(config, owners, fast)


def test_what_other_machines_run_or_nothing_needs_is_not_asked_for(nothing_installed):
    require_extras(swarm_of_four(), [], fast=False)
    require_extras(swarm_of_four("sim://"), [WORLD], fast=True)
    require_extras(swarm_of_four("udp://127.0.0.1:{}"), [MOCAP], fast=False)


def test_a_run_says_it_once_and_starts_no_process(
    nothing_installed, monkeypatch, tmp_path
):
    started = []
    monkeypatch.setattr(flight, "run_children", lambda *words: started.append(words))
    file = tmp_path / "four.json"
    file.write_text(swarm_of_four().dumps())
    said = CliRunner().invoke(app, ["run", str(file)])
    assert (said.exit_code, started) == (2, [])
    assert said.stderr.count("pip install 'crazychoir[mujoco]'") == 1
