"""What the filters are worth and what they cost.

python tests/bench/filters.py prints the errors of `crazychoir bench filters`, then microseconds a call of `update`.
"""

import numpy as np
from flight_kernels import Clock, microseconds
from rich import print as show

from crazychoir.bench import filters as bench_filters
from crazychoir.filters.kalman import KalmanFilter
from crazychoir.filters.motion import CommandedMotion
from crazychoir.filters.state_filter import StateFilter
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import Pose


def cost(filtering: StateFilter) -> float:
    """us a call, with poses that are 10 ms old and another command each tick."""
    clock, pose = Clock(), Pose(np.array([0.0, 0, 1, 0, 0, 0, 1]), 0.01)
    commands = [
        np.array([thrust * PAPER_PLATFORM.weight, 0.0, 0.0, 0.0])
        for thrust in (0.99, 1.01)
    ]

    def tick() -> None:
        commands.reverse()
        filtering.commanded = commands[0]
        filtering.update(pose, clock())

    return microseconds(tick)


if __name__ == "__main__":
    show(bench_filters.table(bench_filters.run()))
    motion = CommandedMotion(PAPER_PLATFORM.flat, 0.0)
    for name, filtering in {
        "derivative": VelocityFilter(period=0.01, motion=motion),
        "kalman": KalmanFilter(period=0.01, motion=motion),
        "kalman, no commands": KalmanFilter(period=0.01),
    }.items():
        print(f"{cost(filtering):8.2f} us  {name}")
