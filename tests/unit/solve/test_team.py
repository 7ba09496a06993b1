"""The answers of the processes of a team, without processes."""

import asyncio
import json
import sys
import time

import pytest

from crazychoir.errors import ProcessFailed
from crazychoir.runtime.clock import run_virtual
from crazychoir.solve.group import ProgramEnded, ProgramGroup
from crazychoir.solve.solver_process import SolverProcess
from crazychoir.solve.team import SolverRun

SOLVED = {"solved": {"cost": 3.0}}


def report(number):
    return {"progress": {"0": ["clusters", number, 3.0, None]}}


class ScriptedGroup:
    """Processes that answer after given times, s; `answers` never really waits."""

    def __init__(self, script):
        self.script = list(script)
        self.time = 0.0

    def now(self):
        return self.time

    def answers(self, count, patience, complaint):
        for _ in range(count):
            pause, answer, *number = self.script.pop(0)
            if pause > patience:
                raise TimeoutError(f"1 of 1 processes {complaint} in {patience:g} s")
            self.time += pause
            yield (*number, 0)[0], answer


def wait(script, patience=10.0, parts=((0,),), has_begun=True):
    seen = []
    group = ScriptedGroup(script)
    run = SolverRun(group, list(map(list, parts)), seen.append, group.now)
    if has_begun:
        run.expect_reports()
    return run.wait("solved", patience, "have no plan"), seen


def test_a_plan_is_kept_however_long_the_team_reports_progress():
    found, seen = wait([*((9.0, report(k)) for k in range(100)), (9.0, SOLVED)])
    assert found == [SOLVED["solved"]]
    assert seen[-1] == {0: ("clusters", 99, 3.0, None)}


def test_a_team_without_any_progress_is_given_up():
    with pytest.raises(ProcessFailed, match=r"robots 0: .*not reported for 10 s"):
        wait([(9.0, report(0)), (11.0, SOLVED)])


def test_one_silent_process_is_named_although_the_other_reports():
    script = [(4.0, report(k), 0) for k in range(4)]
    with pytest.raises(ProcessFailed, match=r"robots 1 to 2: .*not reported for 10 s"):
        wait(script, parts=[[0], [1, 2]])


def test_before_the_start_any_answer_keeps_the_team():
    loads = [(9.0, {"loads": True}, 0) for _ in range(50)]
    found, _ = wait(
        [*loads, (9.0, SOLVED, 0), (9.0, SOLVED, 1)], parts=[[0], [1]], has_begun=False
    )
    assert found == [SOLVED["solved"]] * 2
    with pytest.raises(ProcessFailed, match="have no plan in 10 s"):
        wait([*loads, (11.0, SOLVED)], has_begun=False)


def test_a_process_reports_during_a_step_that_takes_long(capsys):
    process = SolverProcess({"report_period": 10.0})

    async def work(clock):
        process._clock = clock
        process._go_ns = clock.now_ns() or 1
        reporting = asyncio.create_task(process._keep_reporting())
        await clock.sleep(45.0)
        reporting.cancel()

    run_virtual(work)
    lines = capsys.readouterr().out.splitlines()
    assert [json.loads(line) for line in lines] == [{"progress": {}}] * 4


def test_a_process_reports_while_it_loads_its_kernels(capsys):
    process = SolverProcess({"report_period": 10.0, "method": "columns"})

    class SlowClock:
        def __init__(self, clock):
            self.sleep = clock.sleep

        async def compute(self, load, problem, method):
            await self.sleep(45.0)

    async def work(clock):
        process._clock = SlowClock(clock)
        await process._load_kernels(None)

    run_virtual(work)
    lines = capsys.readouterr().out.splitlines()
    assert [json.loads(line) for line in lines] == [{"loads": True}] * 4


def test_the_end_of_a_program_is_noticed_although_its_output_stays_open():
    child = "import subprocess, sys; subprocess.Popen(['sleep', '60'])"
    began = time.perf_counter()
    with (
        ProgramGroup([[sys.executable, "-c", child]]) as group,
        pytest.raises(ProgramEnded),
    ):
        list(group.answers(1, 60.0, "do not answer"))
    assert time.perf_counter() - began < 30.0
