"""The bench measures what it says; its figures are not tested."""

import importlib.util
import io

import pytest
from rich.console import Console

from crazychoir.bench import exchange as bench_exchange
from crazychoir.bench.harness import ProgramRow, measure
from crazychoir.bench.round_trips import TripRow, list_trips, measure_trip

pytestmark = [pytest.mark.system, pytest.mark.real_time]


@pytest.mark.parametrize(
    ("module", "extra", "processes"),
    [
        ("crazychoir", "", 1),
        ("crazychoir", "", 2),
        ("socket", "", 4),
        ("zenoh", "", 4),
        ("pyzmq", "zmq", 4),
        ("cyclonedds", "cyclonedds", 4),
        ("mpi4py", "mpi4py", 4),
    ],
)
def test_each_program_exchanges(module: str, extra: str, processes: int) -> None:
    if extra and importlib.util.find_spec(extra) is None:
        pytest.skip(f"the extra `bench` is not installed: no {extra}")
    packages = (extra,) if extra else ()
    row = ProgramRow(module, f"{module}_peer", "ring", 4, processes, packages)
    measure(row, 0.2)
    assert row.note == ""
    assert row.rounds[0] > 1.0
    assert row.cpu[0] > 0.1


@pytest.mark.parametrize("row", list_trips(), ids=lambda row: row.program.module)
def test_each_program_makes_round_trips(row: TripRow) -> None:
    for name in row.program.packages:
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"the extra `bench` is not installed: no {name}")
    measure_trip(row, 0.2)
    assert row.program.note == ""
    assert 1.0 < row.medians[0] <= row.p99s[0]


def test_a_missing_program_is_a_row_that_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows = [ProgramRow("absent", "absent_peer", "ring", 10, 10, ("no_such_module",))]
    monkeypatch.setattr(bench_exchange, "_rows", lambda graphs: rows)
    monkeypatch.setattr(bench_exchange, "_ratios", lambda rows: {})
    monkeypatch.setattr(bench_exchange, "measure_trips", lambda *settings: [])
    result = bench_exchange.run(quick=True)
    (row,) = result["rows"]
    assert row["rounds_per_s"] is None
    assert row["note"] == "not measured: pip install crazychoir[bench]"
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(bench_exchange.table(result))
    assert (
        "absent: not measured: pip install crazychoir[bench]" in console.export_text()
    )


def test_a_program_that_fails_is_a_row_that_says_so() -> None:
    row = ProgramRow("broken", "broken_peer", "ring", 4, 2)
    measure(row, 0.1)
    assert row.note.startswith("failed: a process has ended before its answer: ")
    assert "broken_peer" in row.note
    assert row.shown()["rounds_per_s"] is None
