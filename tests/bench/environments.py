"""Time of a step of the gymnasium environments, beside those of crazyflow, in turns.

    pip install crazyflow                                   # in another environment: it needs jax
    python tests/bench/environments.py --python other/bin/python --drones 64

Both fly to places in the air, and both start drones anew when their episodes end. Each row is one length of
a step; both environments make the same one. crazyflow integrates at 500 Hz, the lightweight world with steps of
at most 10 ms (Runge-Kutta of order 4), the motor level at 1 kHz with the firmware on board.
"""

import argparse
import statistics
import subprocess
import sys
import time

import numpy as np

REPEATS = 9
"""Turns; the median of each environment counts."""
STEPS = 200
"""Steps in a turn."""
FREQUENCIES = (50, 100, 500)
"""Hz: steps of the environments."""
PEER = """
import sys, time
import numpy as np
import jax
from crazyflow.envs import ReachPosEnv
drones, steps, frequency = map(int, sys.argv[1:])
envs = ReachPosEnv(num_envs=drones, freq=frequency)
envs.reset(seed=1)
low, high = envs.action_space.low, envs.action_space.high
actions = np.zeros((drones, 4), np.float32)
actions[:, 3] = 0.32
def turn():
    for _ in range(steps):
        result = envs.step(actions)
        jax.block_until_ready(result[:4])
turn()
print("ready", flush=True)
for line in sys.stdin:
    began = time.perf_counter()
    turn()
    print(time.perf_counter() - began, flush=True)
"""
"""The program that steps crazyflow's environment, one turn for each line that it gets."""


class Peer:
    """crazyflow's environment in a process of its own."""

    def __init__(self, python, drones, frequency):
        words = [python, "-c", PEER, *map(str, (drones, STEPS, frequency))]
        self.process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for line in self.process.stdout:  # jax says what it did not find
            if line.strip() == "ready":
                break

    def turn(self):
        """Return the seconds of one turn."""
        self.process.stdin.write("turn\n")
        self.process.stdin.flush()
        return float(self.process.stdout.readline())

    def close(self):
        self.process.stdin.close()
        self.process.wait()


class Ours:
    """An environment of crazychoir in this process."""

    def __init__(self, drones, frequency, world):
        from crazychoir.api.env import DroneModel, DroneVectorEnv

        model = DroneModel(world=world, command="fpqr")
        self.envs = DroneVectorEnv(drones, model, frequency=frequency)
        self.envs.reset(seed=1)
        hover = np.tile([0.0319 * 9.81, 0.0, 0.0, 0.0], (drones, 1))
        self.actions = self.envs.command_range.to_actions(hover)
        self.turn()

    def turn(self):
        """Return the seconds of one turn."""
        began = time.perf_counter()
        for _ in range(STEPS):
            self.envs.step(self.actions)
        return time.perf_counter() - began

    def close(self):
        self.envs.close()


def measure(python, drones, frequency):
    """Return the median microseconds of a step of each environment."""
    contestants = {
        "lightweight": Ours(drones, frequency, "lightweight"),
        "motor level, firmware": Ours(drones, frequency, "motors"),
    }
    if python:
        contestants["crazyflow"] = Peer(python, drones, frequency)
    seconds = {name: [] for name in contestants}
    for _ in range(REPEATS):
        for name, one in contestants.items():
            seconds[name].append(one.turn())
    for one in contestants.values():
        one.close()
    return {
        name: statistics.median(took) / STEPS * 1e6 for name, took in seconds.items()
    }


def main():
    """Print a row for each length of a step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", help="Python with crazyflow")
    parser.add_argument("--drones", type=int, default=64)
    arguments = parser.parse_args()
    for frequency in FREQUENCIES:
        row = measure(arguments.python, arguments.drones, frequency)
        figures = ", ".join(f"{name} {us:.0f} us" for name, us in row.items())
        sys.stdout.write(f"{arguments.drones} drones, {frequency} Hz: {figures}\n")


if __name__ == "__main__":
    main()
