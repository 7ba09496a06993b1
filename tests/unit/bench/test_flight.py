from dataclasses import asdict

import pytest
from rich.console import Console

from crazychoir.bench import flight
from crazychoir.bench.flight import (
    FLIGHT_BENCH,
    FLIGHT_CASES,
    FlightChoice,
    choose_cases,
    measure_cases,
    measure_row,
    tables,
)
from crazychoir.bench.swarms import FlightCase

QUICK_CASE = FlightCase(5, window=0.1)


def test_the_default_rows_are_those_of_the_table():
    assert choose_cases(FlightChoice(), quick=False) == list(FLIGHT_CASES)


def test_chosen_numbers_of_drones_replace_the_rows():
    choice = FlightChoice(drones=(20, 400, 20), plant="motors", collision="off")
    cases = choose_cases(choice, quick=False)
    assert [(case.drones, case.plant, case.collision) for case in cases] == [
        (20, "motors", "off"),
        (400, "motors", "off"),
    ]
    assert [case.window for case in cases] == [
        FLIGHT_BENCH.window,
        FLIGHT_BENCH.short_window,
    ]


def test_rows_that_a_choice_makes_alike_are_flown_once():
    cases = choose_cases(FlightChoice(plant="motors"), quick=False)
    assert len(cases) == len(set(cases)) == len(FLIGHT_CASES) - 1


def test_a_row_is_measured_in_a_process_of_its_own():
    said = []
    row = measure_row(QUICK_CASE, 100.0, "1 of 1", said.append)
    assert row["note"] == ""
    assert row["windows"] == 3
    assert row["real_time_factor_cpu"] > 0.0
    ticks = round(100 * QUICK_CASE.window)
    seconds = row["us_per_drone_tick"] * 1e-6 * QUICK_CASE.drones * ticks
    assert seconds == pytest.approx(QUICK_CASE.window / row["real_time_factor_cpu"])
    assert row["filter_share"] == 0.0
    assert 50.0 < row["peak_memory_mb"] < 1000.0
    assert said[0] == "1 of 1: starting"
    assert "1 of 1: measuring, 3 of 3" in said


def test_a_row_that_takes_too_long_has_a_note():
    row = measure_row(QUICK_CASE, 0.2, "1 of 1", lambda text: None)
    assert row == {"note": "not measured: not done in 0 s (starting)"}


def test_a_row_that_fails_has_a_note_with_the_reason():
    case = FlightCase(5, collision="wall")
    row = measure_row(case, 100.0, "1 of 1", lambda text: None)
    assert row["note"].startswith("not measured: ")
    assert "wall" in row["note"]


def test_rows_of_the_default_table_share_its_time(monkeypatch):
    given = []

    def measure(case, seconds, title, say):
        given.append(seconds)
        return {"note": ""}

    times = iter([0.0, 0.0, FLIGHT_BENCH.table_time - 10.0, FLIGHT_BENCH.table_time])
    monkeypatch.setattr(flight, "measure_row", measure)
    monkeypatch.setattr(flight.time, "perf_counter", lambda: next(times))
    cases = [FlightCase(5), FlightCase(6), FlightCase(7)]
    rows = measure_cases(cases, False, lambda text: None)
    assert given == [FLIGHT_BENCH.row_time, 10.0]
    assert rows[2]["note"].startswith("not measured: ")


def test_the_table_shows_the_note_of_a_row_that_was_not_measured():
    case = FlightCase(5, shape="ring", law="python", collision="off")
    row = asdict(case) | {"note": "not measured: no time"}
    console = Console(width=120)
    with console.capture() as shown:
        console.print(tables({"rows": [row], "worlds": []}))
    described = "5 drones, ring, lightweight, law in Python, collision off"
    assert f"{described}: not measured: no time" in shown.get()
