"""crazyflow: s of a step of 10 ms with N drones, as one JSON line.

It uses the default model and control of crazyflow, at 500 Hz.
This is a program of its own that is started by its path, because crazyflow must be imported
before everything that imports scipy.
"""

import importlib
import json
import statistics
import sys
import time

CRAZYFLOW_STEP = 0.01
"""Length of a step, s."""


def main(n: int, calls: int, repeats: int) -> None:
    """Step once to compile, then measure the median over repeats, each with `calls` steps.

    n: number of drones
    calls: steps of a repeat
    repeats: number of repeats
    """
    sim = importlib.import_module("crazyflow.sim").Sim(n_worlds=1, n_drones=n)
    sim.reset()

    def step() -> None:
        sim.step(max(1, round(CRAZYFLOW_STEP * sim.freq)))
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
