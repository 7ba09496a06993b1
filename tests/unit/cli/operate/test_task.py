"""crazychoir task: its requests, the drones that it asks, and its errors for wrong words."""

import pytest
from typer.testing import CliRunner

from crazychoir.cli.operate import task
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import Refused

SWARM = SwarmConfig.of(
    {
        "name": "named",
        "drones": [
            {"id": i, "name": f"cf{i}", "home": [0.5 * i, 0.0, 0.0]} for i in range(4)
        ],
    }
)


@pytest.fixture
def asked(monkeypatch):
    """Requests as they would go out; drone 0 refuses, drone 2 does as it is told, drone 3 says nothing."""
    requests = []
    answers = {
        0: (False, "refused: the mission is over"),
        2: (True, {"id": 10002, "note": "it waits"}),
        3: (
            False,
            "drone 3: no answer to 'task_add' within 5 s; is its agent running?",
        ),
    }

    class Window:
        config = SWARM

        async def find(self):
            return [0, 2, 3]

        async def request(self, verb, drones, **arguments):
            (i,) = drones
            requests.append((i, verb, arguments))
            return {i: answers[i]}

    def looking(swarm, work, as_json):
        program = work(Window())
        try:
            program.send(None)
        except StopIteration as end:
            return end.value
        raise AssertionError("it waits for something")

    monkeypatch.setattr(task, "run_as_operator", looking)
    return requests


def test_the_first_drone_that_takes_a_task_is_enough(asked):
    words = [
        "add",
        "--pickup",
        "1,2.5",
        "--delivery",
        "[3,4]",
        "--robots",
        "0,3",
        "--json",
    ]
    said = CliRunner().invoke(task.app, words)
    assert said.exit_code == 0
    assert '"id": 10002' in said.output
    arguments = {
        "pickup": [1.0, 2.5],
        "delivery": [3.0, 4.0],
        "load": 1.0,
        "robots": [0, 3],
    }
    assert asked == [(0, "task_add", arguments), (2, "task_add", arguments)]


def test_a_task_that_is_done_at_a_place_needs_no_delivery(asked):
    assert CliRunner().invoke(task.app, ["add", "--pickup", "1,2"]).exit_code == 0
    assert asked[0] == (
        0,
        "task_add",
        {"pickup": [1.0, 2.0], "delivery": None, "load": 1.0, "robots": []},
    )


@pytest.mark.parametrize("drone", ["0", "cf0"])
def test_a_drone_that_is_named_is_asked_alone(asked, drone):
    said = CliRunner().invoke(task.app, ["cancel", "7", "--drone", drone, "--json"])
    assert said.exit_code == 1
    assert "the mission is over" in said.output
    assert asked == [(0, "task_cancel", {"id": 7})]


@pytest.mark.parametrize(
    "words",
    [
        ["--pickup", "1"],
        ["--pickup", "a,b"],
        ["--pickup", "1,2,3"],
        ["--pickup", "1,2", "--robots", "x"],
    ],
)
def test_wrong_numbers_are_named(asked, words):
    said = CliRunner().invoke(task.app, ["add", "--delivery", "1,1", *words])
    assert said.exit_code == 2
    assert asked == []


def test_what_a_drone_adds_to_its_answer_is_said(asked):
    said = CliRunner().invoke(
        task.app, ["add", "--pickup", "1,2", "--delivery", "3,4", "--drone", "2"]
    )
    assert said.exit_code == 0
    assert "drone 2: task 10002: it waits" in said.output


def test_a_silent_drone_may_have_done_it_so_no_other_drone_is_asked(asked):
    said = CliRunner().invoke(task.app, ["cancel", "7", "--drone", "3"])
    assert said.exit_code == 1
    assert "drone 3: no answer" in said.output
    assert "drone 3: drone 3" not in said.output
    assert "It may have done it all the same" in said.output


def test_a_drone_that_is_not_there_is_named(asked):
    said = CliRunner().invoke(task.app, ["cancel", "7", "--drone", "1"])
    assert said.exit_code != 0
    assert "absent; there are 0, 2, 3" in str(said.exception)
    assert asked == []


def test_equal_refusals_of_several_drones_are_one_line():
    same = {
        i: (False, "refused: task: its load 9 is more than any drone can carry: 4")
        for i in (0, 1, 2)
    }
    assert task._lines(same) == [
        "drone 0, 1, 2: refused: task: its load 9 is more than any drone can carry: 4"
    ]


async def test_without_a_running_agent_it_says_what_to_start():
    class Window:
        async def find(self):
            raise Refused("swarm demo", "no agent found; is it running?")

    with pytest.raises(Refused, match="crazychoir run online_delivery") as found:
        await task._find_drones(Window())
    assert "status" not in str(found.value)
