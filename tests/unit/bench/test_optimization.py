"""What `bench optimization` makes of its rows; and that both programs run the same algorithm."""

import io
import queue
import threading

import numpy as np
import pytest
from rich.console import Console

from crazychoir.bench import optimization as bench_optimization
from crazychoir.bench.optimization import DISROPT_PATTERN, ratios
from crazychoir.bench.peers import mpi4py_rounds as peers_mpi4py_rounds
from crazychoir.bench.peers import optimization as peers_optimization
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import ring

NEIGHBORS = {i: ring(5).in_neighbors(i) for i in range(5)}


def row(name, algorithm, agents, rate):
    return {
        "name": name,
        "algorithm": algorithm,
        "agents": agents,
        "rounds_per_s": rate,
    }


def test_ratios_take_the_better_of_ours():
    rows = [
        row("crazychoir", "consensus", 10, 300.0),
        row("crazychoir", "consensus", 10, 500.0),
        row(DISROPT_PATTERN, "consensus", 10, 50.0),
        row("crazychoir", "dual decomposition", 20, 90.0),
        row(DISROPT_PATTERN, "dual decomposition", 20, None),
    ]
    assert ratios(rows) == [
        {"agents": 10, "algorithm": "consensus", "ratio": 10.0, "promised": 10.0},
        {
            "agents": 20,
            "algorithm": "dual decomposition",
            "ratio": None,
            "promised": 3.0,
        },
    ]


def test_the_table_fits_into_80_columns_a_line_a_row():
    rows = [
        row(name, "dual decomposition", 20, 12345.6)
        | {"processes": 20, "cpu_us_per_message": 1234.5}
        for name in ("crazychoir", DISROPT_PATTERN)
    ]
    console = Console(width=80, file=io.StringIO())
    console.print(bench_optimization.table({"rows": rows, "ratios": ratios(rows)}))
    lines = console.file.getvalue().splitlines()
    assert [line.split() for line in lines[3:5]] == [
        ["dual", "decomposition", "20", "crazychoir", "20", "12,345.6", "1,234.5"],
        [
            "dual",
            "decomposition",
            "20",
            "DISROPT's",
            "pattern",
            "20",
            "12,345.6",
            "1,234.5",
        ],
    ]
    assert (
        lines[-1].rstrip() == "dual decomposition, 20 agents: 1 times DISROPT's pattern"
    )


@pytest.mark.parametrize("name", ["consensus", "dual decomposition"])
def test_both_programs_come_to_the_same_point(name):
    """The pattern's agents in threads, with mailboxes for MPI."""
    boxes = {(i, j): queue.Queue() for i in NEIGHBORS for j in NEIGHBORS[i]}
    make = (
        peers_mpi4py_rounds.consensus
        if name == "consensus"
        else peers_mpi4py_rounds.dual_decomposition
    )
    last = {}

    def run(i):
        def exchange(data, each=False):
            sent = data if each else dict.fromkeys(NEIGHBORS[i], data)
            last[i] = sent[NEIGHBORS[i][0]]
            for j in NEIGHBORS[i]:
                boxes[i, j].put(np.array(sent[j]))
            return {j: boxes[j, i].get(timeout=20.0) for j in NEIGHBORS[i]}

        step = make(i, NEIGHBORS, exchange)
        for _ in range(200):
            step()

    threads = [threading.Thread(target=run, args=(i,)) for i in NEIGHBORS]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    agents = {i: peers_optimization.algorithm(name, NEIGHBORS, i) for i in NEIGHBORS}
    ours = simulate(agents, ring(5), rounds=200).last("x")
    for i in NEIGHBORS:
        assert last[i] == pytest.approx(ours[i], abs=1e-3)
    assert np.ptp([ours[i] for i in NEIGHBORS], axis=0) == pytest.approx(0.0, abs=1e-2)
