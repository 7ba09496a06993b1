import sys

import pytest

from crazychoir.bench import harness
from crazychoir.bench.harness import (
    NOT_INSTALLED_NOTE,
    ProgramRow,
    ask_peers,
    measure_in_turns,
    share_agents,
)

READY_PROGRAM = """
import json, sys
print(json.dumps({"ready": True}), flush=True)
assert sys.stdin.readline() == "go\\n"
print(json.dumps({"number": int(sys.argv[1])}), flush=True)
sys.stdin.read()
"""


def program(number):
    return [sys.executable, "-c", READY_PROGRAM, str(number)]


def test_each_program_answers_after_go():
    found = ask_peers([program(3), program(4)], 2, 60.0, 60.0)
    assert sorted(answer["number"] for answer in found.answers) == [3, 4]
    assert 0.0 < found.start_s < 60.0


def test_a_program_that_is_not_ready_in_time_is_an_error():
    slow = [sys.executable, "-c", "import time; time.sleep(60)"]
    with pytest.raises(TimeoutError, match="do not find each other"):
        ask_peers([slow], 1, 0.2, 1.0)


@pytest.mark.parametrize("processes", [1, 2, 3, 7])
def test_processes_share_all_agents_in_contiguous_parts(processes):
    parts = [share_agents(7, processes, p) for p in range(processes)]
    assert [i for part in parts for i in part] == list(range(7))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_rows_are_measured_in_turns_and_missing_packages_are_noted(monkeypatch):
    measured = []
    monkeypatch.setattr(harness, "measure", lambda row, seconds: measured.append(row))
    first = ProgramRow("a", "a_peer", "ring", 4, 1)
    second = ProgramRow("b", "b_peer", "ring", 4, 2, options={"algorithm": "mean"})
    missing = ProgramRow("c", "c_peer", "ring", 4, 1, ("no_such_module",))
    said = []
    shown = measure_in_turns([first, second, missing], 0.1, 2, said.append)
    assert measured == [first, second, first, second]
    assert said[:2] == [
        "1/2: a, ring of 4, 1 process(es)",
        "1/2: b, mean, ring of 4, 2 process(es)",
    ]
    assert shown[2]["note"] == NOT_INSTALLED_NOTE
