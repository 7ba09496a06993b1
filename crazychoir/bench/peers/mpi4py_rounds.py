"""DISROPT's pattern: one MPI rank an agent, dill, Isend to the neighbours, and a probing loop.

The loop probes until all messages have come. It yields its processor between two probes.
DISROPT's own loop does not, but its MPI does where ranks share processors. Without it, a run
with more ranks than processors makes no progress.
"""

import importlib
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from crazychoir.bench.peers.optimization import DUAL_STEP_SIZE, problem, start, weights
from crazychoir.bench.peers.peers import report, say, specification
from crazychoir.types import Vec

Neighbors = tuple[int, ...]
Exchange = Callable[..., dict[int, Any]]


def communicator(neighbors: Neighbors) -> Exchange:
    """Return a function that sends data to the neighbours and returns what has come from each.

    With `each` the data of each neighbour differs; without it the data is serialised once for all.
    """
    mpi = importlib.import_module("mpi4py.MPI")
    dill = importlib.import_module("dill")
    world = mpi.COMM_WORLD

    def exchange(data: Any, each: bool = False) -> dict[int, Any]:
        dumped = (
            {j: dill.dumps(data[j]) for j in neighbors}
            if each
            else dict.fromkeys(neighbors, dill.dumps(data))
        )
        sent = [world.Isend([dumped[j], mpi.BYTE], dest=j) for j in neighbors]
        heard: dict[int, Any] = {}
        status = mpi.Status()
        while len(heard) < len(neighbors):
            for j in neighbors:
                if j not in heard and world.Iprobe(source=j, status=status):
                    buffer = bytearray(status.Get_count(mpi.BYTE))
                    world.Recv([buffer, mpi.BYTE], source=j)
                    heard[j] = dill.loads(bytes(buffer))
            os.sched_yield()
        mpi.Request.Waitall(sent)
        return heard

    return exchange


def consensus(
    i: int, neighbors: dict[int, Neighbors], exchange: Exchange
) -> Callable[[], None]:
    """Return a step of consensus, x_i <- sum_j w_ij x_j."""
    row = weights(neighbors, i)
    x = start(i)

    def step() -> None:
        nonlocal x
        heard = exchange(x)
        x = row[i] * x + sum(row[j] * heard[j] for j in neighbors[i])

    return step


def dual_decomposition(
    i: int, neighbors: dict[int, Neighbors], exchange: Exchange
) -> Callable[[], None]:
    """Return a step of dual decomposition with multipliers on edges, in two exchanges.

    x_i = argmin f_i + x'sum_j (l_ij - l_ji),  l_ij += a (x_i - x_j)
    """
    local = problem(i)
    multipliers: dict[int, Vec] = {j: np.zeros(local.n) for j in neighbors[i]}

    def step() -> None:
        theirs = exchange(multipliers, each=True)
        x = local.argmin(
            sum((multipliers[j] - theirs[j] for j in neighbors[i]), np.zeros(local.n))
        )
        heard = exchange(x)
        for j in neighbors[i]:
            multipliers[j] = multipliers[j] + DUAL_STEP_SIZE * (x - heard[j])

    return step


def main() -> None:
    """Meet at a barrier, then run until killed."""
    importlib.import_module("mpi4py").rc.thread_level = "funneled"
    world = importlib.import_module("mpi4py.MPI").COMM_WORLD
    spec = specification()
    i = world.rank
    neighbors = spec["neighbors"]
    rounds = {world.rank: 0}
    make = consensus if spec["algorithm"] == "consensus" else dual_decomposition
    step = make(i, neighbors, communicator(neighbors[i]))
    world.Barrier()
    say({"ready": True})
    report(rounds, spec)
    while True:
        step()
        rounds[i] += 1


if __name__ == "__main__":
    main()
