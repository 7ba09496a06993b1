"""Ctrl-C during a solution: the best plan so far."""

import json
import signal

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.optimization.rounds.budget import BudgetSettings
from crazychoir.routing.distributed.member import RoutingSettings
from crazychoir.routing.instance.generate import random_instance
from crazychoir.solve import solving
from crazychoir.solve.interruption import Interruption
from crazychoir.solve.solve_options import SolveOptions

INSTANCE = random_instance(3, 8, seed=1)
FOR_LONG = SolveOptions(settings=RoutingSettings(budget=BudgetSettings(seconds=1e5)))
SOON = 12
"""Steps of robots before Ctrl-C."""


@pytest.fixture
def press():
    """A function that presses Ctrl-C at its twelfth call."""
    calls = []

    def count(team):
        calls.append(team)
        if len(calls) == SOON:
            signal.raise_signal(signal.SIGINT)

    return count


def test_ctrl_c_ends_a_search_with_the_best_plan(press):
    interruption = Interruption()
    before = signal.getsignal(signal.SIGINT)
    with interruption.caught():
        result = solving.solve_here(
            INSTANCE, FOR_LONG, watch=press, interruption=interruption
        )
    assert (result["ended_by"], result["feasible"]) == ("interrupted", True)
    assert signal.getsignal(signal.SIGINT) is before


def test_a_second_ctrl_c_is_a_keyboard_interrupt():
    interruption = Interruption()
    told = []
    with interruption.caught(), interruption.telling(lambda: told.append(1)):
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert told == [1]


def test_without_a_search_ctrl_c_is_a_keyboard_interrupt():
    with Interruption().caught(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_the_command_prints_the_best_plan_and_exits_with_130(
    press, tmp_path, monkeypatch
):
    solve_here = solving.solve_here

    def solve_and_press(*args, watch, **names):
        return solve_here(*args, watch=press, **names)

    monkeypatch.setattr(solving, "solve_here", solve_and_press)
    path = tmp_path / "instance.json"
    path.write_text(json.dumps(INSTANCE.to_json()))
    done = CliRunner().invoke(app, ["solve", str(path), "--seconds", "1e5", "--json"])
    assert done.exit_code == 130
    assert json.loads(done.stdout)["ended_by"] == "interrupted"
    assert done.stderr.endswith(
        "Ctrl-C: the search ends here, with the best plan so far\n"
    )
