"""The answers of the processes of a team, without processes."""

import asyncio
import json

import pytest

from crazychoir.errors import ProcessFailed
from crazychoir.runtime.clock import run_virtual
from crazychoir.solve.solver_process import SolverProcess
from crazychoir.solve.team import SolverRun

SOLVED = {"solved": {"cost": 3.0}}


def report(number):
    return {"progress": {"0": ["clusters", number, 3.0, None]}}


class ScriptedGroup:
    """Processes that answer after given times, s; `answers` never really waits."""

    def __init__(self, script):
        self.script = list(script)

    def answers(self, count, patience, complaint):
        for _ in range(count):
            pause, answer = self.script.pop(0)
            if pause > patience:
                raise TimeoutError(f"1 of 1 processes {complaint} in {patience:g} s")
            yield 0, answer


def wait(script, patience=10.0):
    seen = []
    run = SolverRun(ScriptedGroup(script), [[0]], seen.append)
    return run.wait("solved", patience, "have no plan"), seen


def test_a_plan_is_kept_however_long_the_team_reports_progress():
    found, seen = wait([*((9.0, report(k)) for k in range(100)), (9.0, SOLVED)])
    assert found == [SOLVED["solved"]]
    assert seen[-1] == {0: ("clusters", 99, 3.0, None)}


def test_a_team_without_any_progress_is_given_up():
    with pytest.raises(ProcessFailed, match="have no plan in 10 s"):
        wait([(9.0, report(0)), (11.0, SOLVED)])


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
