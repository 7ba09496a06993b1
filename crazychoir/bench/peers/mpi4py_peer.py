"""MPI: one rank an agent, pickled isend and recv with each neighbour, as in DISROPT."""

import importlib

import numpy as np

from crazychoir.bench.peers.peers import report, say, specification


def main() -> None:
    """Meet at a barrier, then exchange until killed."""
    importlib.import_module("mpi4py").rc.thread_level = "funneled"
    world = importlib.import_module("mpi4py.MPI").COMM_WORLD
    wait_all = importlib.import_module("mpi4py.MPI").Request.waitall
    spec = specification()
    i = world.rank
    neighbors = spec["neighbors"][i]
    x = np.zeros(6)
    rounds = {i: 0}
    world.Barrier()
    say({"ready": True})
    report(rounds, spec)
    while True:
        requests = [world.isend(x, dest=j) for j in neighbors]
        for j in neighbors:
            world.recv(source=j)
        wait_all(requests)
        rounds[i] += 1


if __name__ == "__main__":
    main()
