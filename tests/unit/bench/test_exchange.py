"""Which rows the benchmark of the exchange measures."""

import pytest

from crazychoir.bench import exchange
from crazychoir.bench.exchange import ExchangeChoice
from crazychoir.bench.harness import BENCH_GRAPHS, ProgramRow
from crazychoir.errors import ConfigError


@pytest.fixture
def measured(monkeypatch):
    """The rows that were measured: none is, each gets a figure."""
    rows = []

    def measure_in_turns(chosen, seconds, repeats, say):
        rows.extend(chosen)
        return [row.shown() for row in chosen]

    monkeypatch.setattr(exchange, "measure_in_turns", measure_in_turns)
    monkeypatch.setattr(exchange, "measure_trips", lambda *settings: ["a trip"])
    return rows


def list_teams(rows: list[ProgramRow]) -> set[tuple[str, str, int, int]]:
    return {(row.name, row.graph, row.agents, row.processes) for row in rows}


def test_the_usual_rows_divide_two_teams_on_both_graphs(measured):
    exchange.run()
    ours = {team[1:] for team in list_teams(measured) if team[0] == "crazychoir"}
    assert ours == {
        (graph, agents, processes)
        for graph in BENCH_GRAPHS
        for agents in (10, 30)
        for processes in (1, 2, agents)
    }


def test_a_choice_replaces_the_rows(measured):
    exchange.run(choice=ExchangeChoice((12,), (3, 12), ("ring",)))
    assert list_teams(measured) == {
        (name, "ring", 12, processes)
        for name in ("crazychoir", "plain sockets", "zenoh", "pyzmq", "cyclonedds")
        for processes in (3, 12)
    } | {("mpi4py-pickle", "ring", 12, 12)}


def test_more_processes_than_agents_are_refused(measured):
    with pytest.raises(ConfigError, match="at most as many processes as agents"):
        exchange.run(choice=ExchangeChoice((3,), (30,)))


def test_the_table_shows_what_was_sent_again():
    row = ProgramRow("crazychoir", "crazychoir_peer", "ring", 30, 30)
    row.rounds.append(100.0)
    row.resent.extend([0.01, 0.02, 0.5])
    shown = row.shown()
    assert shown["resent_per_message"] == 0.02
    table = exchange.exchange_table([shown])
    assert list(table.columns[-1].cells) == ["2.0%"]


def test_a_choice_leaves_out_the_round_trips(measured):
    assert exchange.run()["round_trips"] == ["a trip"]
    chosen = exchange.run(choice=ExchangeChoice((12,)))
    assert chosen["round_trips"] == []
    assert exchange.run_trips() | {"cores": 0} == {
        "rows": [],
        "round_trips": ["a trip"],
        "cores": 0,
        "seconds": 1.5,
        "repeats": 5,
    }
