"""The answers of the processes of a team, without processes."""

import pytest

from crazychoir.errors import ProcessFailed
from crazychoir.solve.team import SolverRun

SOLVED = {"solved": {"cost": 3.0}}


def report(number):
    return {"progress": {"0": ["clusters", number, 3.0]}}


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
    assert seen[-1] == {0: ("clusters", 99, 3.0)}


def test_a_team_without_any_progress_is_given_up():
    with pytest.raises(ProcessFailed, match="have no plan in 10 s"):
        wait([(9.0, report(0)), (11.0, SOLVED)])
