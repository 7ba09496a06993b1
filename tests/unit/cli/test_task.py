"""crazychoir task: what it asks, of whom, and what it says of wrong words."""

import pytest
from typer.testing import CliRunner

from crazychoir.cli import task


@pytest.fixture
def asked(monkeypatch):
    """Requests as they would go out; drone 0 refuses, drone 2 does as it is told."""
    requests = []

    class Window:
        def check(self, option, ids):
            pass

        async def find(self):
            return [0, 2, 3]

        async def request(self, verb, drones, **arguments):
            (i,) = drones
            requests.append((i, verb, arguments))
            return {i: (i != 0, "refused: the mission is over" if i == 0 else {"id": 10002})}

    def looking(swarm, work, as_json):
        program = work(Window())
        try:
            program.send(None)
        except StopIteration as end:
            return end.value
        raise AssertionError("it waits for something")

    monkeypatch.setattr(task, "looking", looking)
    return requests


def test_the_first_drone_that_takes_a_task_is_enough(asked):
    words = ["add", "--pickup", "1,2.5", "--delivery", "[3,4]", "--robots", "0,3", "--json"]
    said = CliRunner().invoke(task.app, words)
    assert said.exit_code == 0
    assert '"id": 10002' in said.output
    arguments = {"pickup": [1.0, 2.5], "delivery": [3.0, 4.0], "load": 1.0, "robots": [0, 3]}
    assert asked == [(0, "task_add", arguments), (2, "task_add", arguments)]


def test_a_drone_that_is_named_is_asked_alone(asked):
    said = CliRunner().invoke(task.app, ["cancel", "7", "--drone", "0", "--json"])
    assert said.exit_code == 1
    assert "the mission is over" in said.output
    assert asked == [(0, "task_cancel", {"id": 7})]


@pytest.mark.parametrize(
    "words", [["--pickup", "1"], ["--pickup", "a,b"], ["--pickup", "1,2,3"], ["--pickup", "1,2", "--robots", "x"]]
)
def test_wrong_numbers_are_named(asked, words):
    said = CliRunner().invoke(task.app, ["add", "--delivery", "1,1", *words])
    assert said.exit_code == 2
    assert asked == []
