"""What the benchmark of round trips shows."""

import io

import pytest
from rich.console import Console

from crazychoir.bench import round_trips
from crazychoir.bench.harness import NOT_INSTALLED_NOTE, ProgramRow
from crazychoir.bench.round_trips import TripRow, measure_trips, trip_table


@pytest.fixture
def rows(monkeypatch):
    """Two programs; the second one is not installed."""
    team = round_trips.TRIP_TEAM
    made = [
        TripRow(ProgramRow("fast", "trips.fast", *team)),
        TripRow(ProgramRow("absent", "trips.absent", *team, ("no_such_module",))),
    ]
    monkeypatch.setattr(round_trips, "list_trips", lambda: made)
    return made


def test_a_row_shows_the_medians_of_its_windows(rows, monkeypatch):
    windows = iter([(30.0, 90.0), (10.0, 70.0), (20.0, 80.0)])

    def ask_row(program, seconds):
        median, p99 = next(windows)
        return [{"median_us": median, "p99_us": p99}, {}]

    monkeypatch.setattr(round_trips, "ask_row", ask_row)
    said = []
    shown = measure_trips(1.0, 3, said.append)
    assert said == [f"{turn}/3: round trips of fast" for turn in (1, 2, 3)]
    assert shown == [
        {"name": "fast", "median_us": 20.0, "p99_us": 80.0},
        {
            "name": "absent",
            "median_us": None,
            "p99_us": None,
            "note": NOT_INSTALLED_NOTE,
        },
    ]
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(trip_table(shown))
    text = console.export_text()
    assert "20.0" in text
    assert f"absent: {NOT_INSTALLED_NOTE}" in text
