"""crazyflow: s that a step of 10 ms of N drones takes, as one JSON line; its default model and control, at 500 Hz.

A program of its own, started by its path: crazyflow wants to be imported before everything that imports scipy.
"""

import importlib
import json
import statistics
import sys
import time

TICK = 0.01


def main(n: int, calls: int, repeats: int) -> None:
    """Steps once to compile, then the median over repeats of so many calls."""
    sim = importlib.import_module("crazyflow.sim").Sim(n_worlds=1, n_drones=n)
    sim.reset()

    def step() -> None:
        sim.step(max(1, round(TICK * sim.freq)))
        sim.data.states.pos.block_until_ready()

    step()
    took = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(calls):
            step()
        took.append((time.perf_counter() - start) / calls)
    sys.stdout.write(json.dumps({"seconds": statistics.median(took)}) + "\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
