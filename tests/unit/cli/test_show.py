import io
import json
import os
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from rich.console import Console
from rich.table import Table

from crazychoir.cli import show
from crazychoir.errors import ConfigError
from crazychoir.types import Acceleration, Status

RUN = {
    "mission": "m", "success": True, "drones": 4, "here": [0, 1, 2, 3], "reasons": {}, "absent": [], "wall_s": 2.0,
    "messages": {"sent": 3},
}  # fmt: skip


def printed(table):
    console = Console(file=io.StringIO(), width=200)
    console.print(table)
    return console.file.getvalue()


@pytest.fixture
def screen(monkeypatch):
    """Standard error, as a terminal of 100 columns."""
    console = Console(file=io.StringIO(), width=100, force_terminal=True)
    monkeypatch.setattr(show, "STDERR", console)
    return console.file


def test_an_error_is_one_object_and_a_text(screen, capsys):
    with pytest.raises(typer.Exit) as ended:
        show.fail(ConfigError("here", 3, "4"), as_json=True)
    assert ended.value.exit_code == 2
    said = {"success": False, "error": "here: found 3; allowed: 4.", "kind": "ConfigError"}
    assert json.loads(capsys.readouterr().out) == said
    assert "here: found 3; allowed: 4." in screen.getvalue()


def test_whatever_travels_is_printed_as_json(capsys):
    value = {1: np.arange(2.0), "me": Acceleration(np.zeros(3)), (0, 1): [np.float32(0.5), float("nan"), float("inf")]}
    show.write_json(value)
    assert json.loads(capsys.readouterr().out) == {
        "1": [0.0, 1.0], "me": {"a": [0.0, 0.0, 0.0], "yaw": 0.0}, "(0, 1)": [0.5, None, None],
    }  # fmt: skip


def test_what_missions_and_their_programs_print_is_not_on_standard_output(capfd):
    with show.prints_aside():
        print("of Python", flush=True)  # noqa: T201
        os.write(1, b"of a program\n")
    show.write_json({"success": True})
    said = capfd.readouterr()
    assert said.out == '{"success": true}\n'
    assert "of Python\n" in said.err
    assert "of a program\n" in said.err


def test_a_swarm_shows_who_has_not_been_heard_and_who_is_silent():
    score = SimpleNamespace(ids=(0, 1), statuses={0: Status("hovering", "law", 3, 0.25, suspect=[1], gone=[2])})
    text = printed(show.status_table(score))
    first, second = (line for line in text.splitlines() if line.startswith(("│ 0", "│ 1")))
    assert [word.strip() for word in first.split("│")][1:6] == ["0", "hovering", "law", "3", "0.250"]
    assert "1?, 2!" in first
    assert "not heard yet" in second


def test_a_run_says_which_drones_it_started_when_not_all():
    assert "started here" not in printed(show.summary_table(RUN))
    rows = printed(show.summary_table(RUN | {"here": [2, 3]})).splitlines()
    row = next(line for line in rows if "started here" in line)
    assert "2, 3" in row


def test_a_run_says_who_failed_and_who_is_absent():
    text = printed(show.summary_table(RUN | {"success": False, "reasons": {1: "lost"}, "absent": [2]}))
    assert "m: failed" in text
    assert "drone 1" in text
    assert "lost" in text
    assert "[2]" in text


def test_progress_draws_a_few_times_a_second_and_says_lines(screen, monkeypatch):
    now, drawn = [100.0], []

    def table(seen):
        drawn.append(seen)
        return Table(f"seen {seen}")

    monkeypatch.setattr(show.time, "perf_counter", lambda: now[0])
    with show.Progress(table, enabled=True) as progress:
        for n in range(100):
            progress(n)
            now[0] += 1 / 64
        progress.say("a line")
        progress.live.refresh()
    assert drawn == [0, 16, 32, 48, 64, 80, 96]
    assert "seen 96" in screen.getvalue()
    assert "a line" in screen.getvalue()


def test_progress_that_nobody_sees_draws_nothing(screen):
    with show.Progress(pytest.fail, enabled=False) as progress:
        progress(1)
        progress.say("a line")
    assert screen.getvalue() == "a line\n"
