import io
import json
import logging
import os
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from rich.console import Console
from rich.table import Table

from crazychoir.agent.drone import WAITING_TASK
from crazychoir.errors import ConfigError, Refused
from crazychoir.launch import console as show
from crazychoir.types import Acceleration, Status

RUN = {
    "mission": "m",
    "success": True,
    "drones": 4,
    "here": [0, 1, 2, 3],
    "reasons": {},
    "absent": [],
    "wall_s": 2.0,
    "messages": {"sent": 3},
}


def printed(table, width=200):
    console = Console(file=io.StringIO(), width=width)
    console.print(table)
    return console.file.getvalue()


@pytest.fixture
def screen(monkeypatch):
    """Standard error, as a terminal of 100 columns."""
    console = Console(file=io.StringIO(), width=100, force_terminal=True)
    monkeypatch.setattr(show, "ERROR_CONSOLE", console)
    return console.file


def test_an_error_is_one_object_and_a_text(screen, capsys):
    with pytest.raises(typer.Exit) as ended:
        show.exit_with_error(ConfigError("here", 3, "4"), as_json=True)
    assert ended.value.exit_code == 2
    said = {
        "success": False,
        "error": "here: found 3; allowed: 4.",
        "kind": "ConfigError",
    }
    assert json.loads(capsys.readouterr().out) == said
    assert "here: found 3; allowed: 4." in screen.getvalue()


def test_whatever_travels_is_printed_as_json(capsys):
    value = {
        1: np.arange(2.0),
        "me": Acceleration(np.zeros(3)),
        (0, 1): [np.float32(0.5), float("nan"), float("inf")],
    }
    show.write_json(value)
    assert json.loads(capsys.readouterr().out) == {
        "1": [0.0, 1.0],
        "me": {"a": [0.0, 0.0, 0.0], "yaw": 0.0},
        "(0, 1)": [0.5, None, None],
    }


def test_what_missions_and_their_programs_print_is_not_on_standard_output(capfd):
    with show.redirect_prints():
        print("of Python", flush=True)  # noqa: T201
        os.write(1, b"of a program\n")
    show.write_json({"success": True})
    said = capfd.readouterr()
    assert said.out == '{"success": true}\n'
    assert "of Python\n" in said.err
    assert "of a program\n" in said.err


def test_a_refusal_says_once_that_it_is_one(screen):
    with pytest.raises(typer.Exit):
        show.exit_with_error(Refused("swarm lab", "no agent found"), as_json=False)
    assert screen.getvalue().lower().count("refused") == 1
    assert "swarm lab: no agent found" in screen.getvalue()


def flying():
    """What an observer knows of six drones: one has not been heard, one has trouble, 4 and 5 are back on the ground."""
    usual = {
        "phase": "mission",
        "task": "planning: column generation",
        "round": 85,
        "cost": 32.6247,
        "sent": 52430,
        "lost": 10340,
        "resent": 11770,
    }
    statuses = {i: Status(**usual) for i in (1, 2, 3)} | {
        1: Status(
            **usual,
            suspect=[2],
            gone=[0, 4],
            note="pose 0.11 s old, limit 0.10 s: braking, " * 8,
        ),
        4: Status(**usual | {"phase": "on ground", "task": "done: 4 stops"}, gone=[5]),
        5: Status(**usual | {"phase": "on ground", "task": "landing"}, gone=[4]),
    }
    return SimpleNamespace(ids=tuple(range(6)), statuses=statuses)


@pytest.mark.parametrize("width", [80, 120])
def test_a_drone_of_the_live_table_takes_one_line_and_nothing_is_cut_but_notes(
    monkeypatch, width
):
    monkeypatch.setattr(show, "ERROR_CONSOLE", Console(file=io.StringIO(), width=width))
    lines = printed(show.build_status_table(flying()), width).splitlines()
    head, _, *rows = lines
    assert head.split()[:6] == [
        "drone",
        "phase",
        "task",
        "round",
        "cost",
        "sent" if width == 120 else "lost",
    ]
    assert [row[0] for row in rows[:6]] == list("012345")
    assert "not heard yet" in rows[0]
    assert rows[2].split()[:7] == [
        "2",
        "mission",
        "planning:",
        "column",
        "generation",
        "85",
        "32.625",
    ]
    assert [line for line in lines if "…" in line] == [rows[6]], "only a note is cut"
    assert rows[6].startswith("drone 1: pose 0.11 s old, limit 0.10 s: braking")
    assert max(map(len, lines)) <= width


def test_status_shows_the_name_of_a_drone_beside_its_id():
    rows = printed(show.build_status_table(flying(), {0: "cf231", 1: ""})).splitlines()
    assert rows[2].startswith("0 cf231 ")
    assert rows[3].split()[0] == "1"


def test_a_drone_that_is_back_on_the_ground_is_not_missed():
    rows = printed(show.build_status_table(flying())).splitlines()[2:]
    assert rows[1].rstrip().endswith("2?, 0!"), "not 4, which has ended"
    assert "!" not in rows[4] + rows[5]
    assert "? for a second" in rows[-1], "what the marks mean"
    waiting = Status("on ground", WAITING_TASK)
    score = flying()
    score.statuses[4] = waiting
    assert "4!" in printed(show.build_status_table(score)).splitlines()[3], (
        "a drone that has not begun is missed"
    )
    quiet = SimpleNamespace(ids=(0,), statuses={0: waiting})
    assert "silent:" not in printed(show.build_status_table(quiet)), (
        "nothing to explain"
    )


def test_a_line_a_pair_of_hosts_says_how_far_their_clocks_are_apart():
    there = {"hosts": ["a"], "offsets": [-1000.00012], "offset_errors": [0.0004]}
    here = {
        "hosts": ["b", "c"],
        "offsets": [1000.0001, -2.0],
        "offset_errors": [0.0003, 0.01],
    }
    statuses = {
        0: Status("x", host="a", **here),
        1: Status("x", host="a", **here),
        2: Status("x", host="b", **there),
    }
    lines = printed(
        show.build_status_table(SimpleNamespace(ids=(0, 1, 2), statuses=statuses))
    ).splitlines()
    assert [line.rstrip() for line in lines if "clock" in line] == [
        "the clock of host b is 1000.000100 s ahead of that of a, within 0.000300 s",
        "the clock of host c is 2.000000 s behind that of a, within 0.010000 s",
    ]


def test_faults_of_a_link_are_one_line_for_its_process():
    faulty = Status("x", process="0-a", link_faults=["full 12", "broken 1"])
    statuses = {0: faulty, 1: faulty, 2: Status("x", process="2-b")}
    score = SimpleNamespace(ids=(0, 1, 2), statuses=statuses)
    lines = printed(show.build_status_table(score)).splitlines()
    assert [line.rstrip() for line in lines if "link" in line] == [
        "link of process 0-a since its start: full 12; broken 1"
    ]


def test_a_run_says_which_drones_it_started_when_not_all():
    assert "started here" not in printed(show.build_summary_table(RUN))
    rows = printed(show.build_summary_table(RUN | {"here": [2, 3]})).splitlines()
    row = next(line for line in rows if "started here" in line)
    assert "2, 3" in row


def test_a_run_on_the_wall_clock_has_one_time():
    flown = RUN | {"simulated_s": 20.0, "real_time_factor": 1.0, "wall_s": 20.0}
    assert "simulated_s" in printed(show.build_summary_table(flown | {"digest": "ab"}))
    text = printed(show.build_summary_table(flown | {"digest": None}))
    assert "wall_s" in text
    assert "simulated_s" not in text
    assert "real_time_factor" not in text


def test_what_a_mission_reports_is_shown_if_it_is_figures_in_a_row_too():
    report = {
        "radii": [0.5, 0.51],
        "gaps": SimpleNamespace(tolist=lambda: [89.98]),
        "plan": [{"task": 3}],
        "left": [],
    }
    text = printed(show.build_summary_table(RUN | report | {"report": list(report)}))
    assert "0.5, 0.51" in text
    assert "89.98" in text
    assert "plan " not in text
    assert "left " not in text


def test_a_run_is_named_by_its_mission_and_the_swarm_that_has_a_file():
    there = RUN | {"mission": "/home/who/law.py"}
    assert "law.py: success" in printed(show.build_summary_table(there))
    assert "/home" not in printed(show.build_summary_table(there))
    assert "swarm lab, law.py: success" in " ".join(
        printed(show.build_summary_table(there | {"swarm": "lab"})).split()
    )


def test_a_summary_names_the_drones_that_failed():
    text = printed(
        show.build_summary_table(
            RUN | {"success": False, "reasons": {1: "drone 1: lost"}, "absent": [2]}
        )
    )
    assert "m: failed" in text
    assert text.count("drone 1") == 1, "its name is said once"
    assert "lost" in text
    text = printed(
        show.build_summary_table(RUN | {"success": False, "reason": "nobody came"})
    )
    assert "nobody came" in text
    assert "drone 1" not in text


def test_a_run_that_its_operator_has_landed_is_a_success_and_says_so():
    landed = {
        "success": True,
        "reasons": {},
        "ended": {0: "landed on command", 1: "drone 1: sent home on command"},
    }
    text = printed(show.build_summary_table(RUN | landed))
    assert "m: success, ended by its operator" in text
    assert "landed on command" in text
    assert text.count("drone 1") == 1, "its name is said once"
    failed = landed | {
        "success": False,
        "reasons": {1: "drone 1: lost"},
        "ended": {0: "landed on command"},
    }
    assert "m: failed" in printed(show.build_summary_table(RUN | failed))


def test_a_run_says_where_its_recording_is_and_what_it_lacks():
    whole = {"file": "a.mcap", "messages": 7, "lost": 0, "missed": 0, "error": ""}
    text = printed(show.build_summary_table(RUN | {"recording": whole}))
    assert "a.mcap: 7 messages" in text
    assert "lost" not in text
    text = printed(
        show.build_summary_table(
            RUN
            | {"recording": whole | {"lost": 2, "missed": 3, "error": "No space left"}}
        )
    )
    assert "a.mcap: 7 messages, 2 lost, 3 missed; ended early: No space left" in text
    assert "recording" not in printed(
        show.build_summary_table(RUN | {"recording": None})
    )


def test_progress_draws_a_few_times_a_second_and_says_lines(screen, monkeypatch):
    now, drawn = [100.0], []

    def table(seen):
        drawn.append(seen)
        return Table(f"seen {seen}")

    monkeypatch.setattr(show.time, "perf_counter", lambda: now[0])
    with show.LiveTable(table, enabled=True) as progress:
        for n in range(100):
            progress(n)
            now[0] += 1 / 64
        progress.say("a line")
        progress.live.refresh()
    assert drawn == [0, 16, 32, 48, 64, 80, 96]
    assert "seen 96" in screen.getvalue()
    assert "a line" in screen.getvalue()


def test_disabled_progress_draws_nothing(screen):
    with show.LiveTable(pytest.fail, enabled=False) as progress:
        progress(1)
        progress.say("a line")
    assert screen.getvalue() == "a line\n"


def test_what_fails_in_the_same_way_in_many_drones_is_traced_once(capfd):
    laws = [
        lambda: np.linalg.inv(np.zeros((2, 2))),
        lambda: np.linalg.inv(np.ones((2, 2))),
    ]
    root = logging.getLogger()
    before = root.handlers[:]
    try:
        show.set_up_logging()
        for drone, law in enumerate([0, 0, 1, 0]):
            try:
                laws[law]()
            except np.linalg.LinAlgError as error:
                logging.getLogger("crazychoir").error(
                    "drone %d failed", drone, exc_info=error
                )
    finally:
        root.handlers[:] = before
    said = capfd.readouterr().err
    assert [f"drone {i} failed" in said for i in range(4)] == [True] * 4
    assert said.count("Traceback") == 2, "both laws fail in the same line of numpy"
    assert said.index("drone 0") < said.index("np.zeros") < said.index("drone 1")
    assert said.index("drone 2") < said.index("np.ones") < said.index("drone 3")


def test_drones_that_fail_alike_share_a_row():
    same = {i: f"drone {i}: the fence is too small" for i in (0, 1, 2)}
    assert show.group_reasons(same | {5: "lost"}) == [
        ("drones 0 to 2", "the fence is too small"),
        ("drone 5", "lost"),
    ]
