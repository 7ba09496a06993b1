"""Sweeps: one row a run, in the order of the sweep, from processes that fly many runs each."""

import os
import signal

import pytest

from crazychoir.api import sweep
from crazychoir.api.sweeps import SweepInterrupted, plan_runs
from crazychoir.errors import ConfigError

MISSION = """
import os
from crazychoir import CFGuidance
from crazychoir.guidance.mission_options import Length, given
from crazychoir.config.tables import SwarmTable

class Options(SwarmTable, frozen=True, kw_only=True):
    height: Length = 0.3
    ends: bool = False

class Rising(CFGuidance):
    def __init__(self, options):
        self.options = options

    async def mission(self):
        if self.options.ends:
            os._exit(3)
        await self.take_off(self.options.height)
        await self.land()

def guidance(i, config):
    return Rising(given(config, Options))

def check(config, force):
    given(config, Options)
    return []

def report(config, results):
    print("a mission may print")
    height = given(config, Options).height
    return {"height": height, "success": height < 0.35}
"""


@pytest.fixture
def mission(tmp_path):
    path = tmp_path / "rising.py"
    path.write_text(MISSION)
    return path


def watch_nothing(ended, count, row):
    """Show no progress."""


@pytest.fixture
def interrupts():
    """SIGINT interrupts, also where a shell has started pytest in the background, with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_sweep_has_the_same_rows_interrupted_or_not_by_any_number_of_processes(
    mission, tmp_path, interrupts
):
    values = {"seeds": [1, 2], "loss": [0, 0.5], "options": {"height": [0.3, 0.4]}}
    whole = tmp_path / "whole.jsonl"
    table = sweep(mission, **values, drones=2, jobs=2, file=whole, watch=watch_nothing)
    inputs = [(row["height"], row["loss"], row["seed"]) for row in table.rows]
    assert inputs == [(h, p, s) for h in (0.3, 0.4) for p in (0.0, 0.5) for s in (1, 2)]
    assert table.column("success") == 4 * [True] + 4 * [False]
    assert table.rows[2]["messages_lost"] > 0
    assert len(set(table.column("digest"))) == 8

    def interrupt(ended, count, row):
        if ended == 3:
            os.kill(os.getpid(), signal.SIGINT)

    file = tmp_path / "a.jsonl"
    with pytest.raises(SweepInterrupted) as end:
        sweep(mission, **values, drones=2, jobs=1, file=file, watch=interrupt)
    ended_before = len(file.read_text().splitlines())
    assert len(end.value.table) == ended_before
    assert 3 <= ended_before < 8
    told = []
    again = sweep(
        mission, **values, drones=2, jobs=1, file=file, watch=lambda *x: told.append(x)
    )
    assert [(ended, count) for ended, count, _ in told] == [
        (k, 8) for k in range(ended_before + 1, 9)
    ]
    assert again.rows == table.rows
    assert file.read_bytes() == whole.read_bytes()


def test_failed_runs_are_rows_and_a_process_flies_until_it_ends(mission):
    mission.write_text(MISSION.replace('"height": height', '"process": os.getpid()'))
    options = {"ends": [False, True], "height": [0.3, "high"]}
    table = sweep(
        mission, seeds=[1, 2], drones=1, options=options, jobs=1, watch=watch_nothing
    )
    assert table.column("success") == [True, True] + 6 * [False]
    first, second = table.column("process")[:2]
    assert first == second != os.getpid()
    reasons = table.column("reason")
    assert all("height" in reason for reason in reasons[2:4] + reasons[6:8])
    assert reasons[4:6] == 2 * ["its process has ended with code 3"]


def test_a_process_that_does_not_start_fails_its_runs(mission, monkeypatch):
    def start(words):
        raise BlockingIOError("too many processes")

    monkeypatch.setattr("crazychoir.api.worker_pool._start", start)
    table = sweep(mission, seeds=[1, 2], drones=1, jobs=1, watch=watch_nothing)
    assert table.column("success") == 2 * [False]
    assert table.column("reason") == 2 * [
        "its process does not start: too many processes"
    ]


def test_a_value_that_the_swarm_does_not_take_refuses_its_runs_alone(mission):
    runs = plan_runs(str(mission), {"network.delay": [0.0, -1.0], "seed": [1]})
    assert [run.config is None for run in runs] == [False, True]
    assert "delay" in runs[1].refusal


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"options": {"hight": [1]}}, "hight"),
        ({"seeds": []}, "seed: found no value"),
        ({"loss": 2}, "loss"),
        ({"jobs": 0}, "jobs: found 0; allowed: 1 or more"),
        ({"jobs": -1}, "jobs: found -1; allowed: 1 or more"),
    ],
)
def test_a_sweep_without_any_run_is_refused(mission, values, said):
    with pytest.raises(ConfigError, match=said):
        sweep(mission, **values)


def test_a_class_is_no_mission_of_a_sweep(rising):
    with pytest.raises(ConfigError, match="writefile"):
        sweep(rising)


def test_a_changed_mission_is_another_sweep(mission):
    grid = {"seed": [1]}
    (before,) = plan_runs(str(mission), grid)
    assert plan_runs(str(mission), grid)[0].key == before.key
    mission.write_text(MISSION + "\n# changed\n")
    assert plan_runs(str(mission), grid)[0].key != before.key
