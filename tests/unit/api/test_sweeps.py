"""Sweeps: one row a run, in the order of the sweep, from processes that fly many runs each."""

import os
import signal

import pytest

from crazychoir.api import sweep
from crazychoir.api.sweeps import plan_runs
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
    return {"height": height, "process": os.getpid(), "success": height < 0.35}
"""


@pytest.fixture
def mission(tmp_path):
    path = tmp_path / "rising.py"
    path.write_text(MISSION)
    return path


def watch_nothing(ended, count, row):
    """Show no progress."""


def test_a_sweep_has_a_row_a_run_in_order_whatever_processes_fly_it(mission, tmp_path):
    files = [tmp_path / "1.jsonl", tmp_path / "2.jsonl"]
    text = mission.read_text().replace('"process": os.getpid(), ', "")
    mission.write_text(text)
    tables = [
        sweep(
            mission,
            seeds=[1, 2],
            loss=[0, 0.5],
            options={"height": [0.3, 0.4]},
            drones=2,
            jobs=jobs,
            file=file,
            watch=watch_nothing,
        )
        for jobs, file in zip((1, 2), files, strict=True)
    ]
    assert tables[0].rows == tables[1].rows
    assert files[0].read_bytes() == files[1].read_bytes()
    rows = tables[0].rows
    inputs = [(row["height"], row["loss"], row["seed"]) for row in rows]
    assert inputs == [(h, p, s) for h in (0.3, 0.4) for p in (0.0, 0.5) for s in (1, 2)]
    assert [row["success"] for row in rows] == 4 * [True] + 4 * [False]
    assert rows[2]["messages_lost"] > 0
    assert len({row["digest"] for row in rows}) == 8


def test_a_process_flies_many_runs(mission):
    table = sweep(mission, seeds=range(3), drones=1, jobs=1, watch=watch_nothing)
    assert len(set(table.column("process"))) == 1
    assert table.column("process")[0] != os.getpid()


def test_an_interrupted_sweep_goes_on_where_it_was(mission, tmp_path):
    text = mission.read_text().replace('"process": os.getpid(), ', "")
    mission.write_text(text)
    values = {"seeds": range(4), "drones": 1, "jobs": 1}
    whole = tmp_path / "whole.jsonl"
    sweep(mission, **values, file=whole, watch=watch_nothing)
    flown = []

    def interrupt(ended, count, row):
        flown.append((ended, count))
        if ended == 2:
            os.kill(os.getpid(), signal.SIGINT)

    file = tmp_path / "a.jsonl"
    with pytest.raises(KeyboardInterrupt):
        sweep(mission, **values, file=file, watch=interrupt)
    assert 2 <= len(file.read_text().splitlines()) < 4
    flown.clear()
    sweep(mission, **values, file=file, watch=lambda *told: flown.append(told[:2]))
    assert flown in ([(3, 4), (4, 4)], [(4, 4)])
    assert file.read_bytes() == whole.read_bytes()


def test_a_process_that_ends_is_a_row_and_is_replaced(mission):
    options = {"ends": [False, True, False]}
    table = sweep(
        mission, seeds=3, drones=1, options=options, jobs=1, watch=watch_nothing
    )
    assert table.column("success") == [True, False, True]
    assert "its process has ended with code 3" in table.column("reason")[1]


def test_a_refused_run_is_a_row(mission):
    runs = plan_runs(str(mission), {"height": [0.3, "high"], "seed": [1]})
    assert [run.config is None for run in runs] == [False, True]
    assert "height" in runs[1].refusal


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"options": {"hight": [1]}}, "hight"),
        ({"seeds": []}, "seed: found no value"),
        ({"loss": 2}, "loss"),
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
