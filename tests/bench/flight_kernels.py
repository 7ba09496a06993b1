"""What a tick of one drone costs: filter, planner, controller, guard; and the world and its cameras for 100 drones.

python tests/bench/flight_kernels.py prints microseconds a call, the median over seven repetitions.
"""

import statistics
import time
from collections.abc import Callable

import numpy as np

from crazychoir.control.attitude import GeometryAttitudeCtrl
from crazychoir.control.controller import HierarchicalController
from crazychoir.control.handlers import AccelerationTraj, FullStateTraj
from crazychoir.control.position import FlatnessAccelerationCtrl, FlatnessPositionCtrl
from crazychoir.control.senders import FPQRSender
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.mocap.simulated import SimulatedMocap
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.safety.rules.guard import Guard
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.types import Acceleration, FullState, Pose, State


def microseconds(call: Callable[[], object], n: int = 5000) -> float:
    """Median over seven repetitions of n calls, us a call."""
    call()
    took = []
    for _ in range(7):
        start = time.perf_counter()
        for _ in range(n):
            call()
        took.append((time.perf_counter() - start) / n * 1e6)
    return statistics.median(took)


class Clock:
    """A time that advances by 10 ms at each reading, so that a filter sees new poses."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 0.01
        return self.now


def bench() -> dict[str, float]:
    """us a call, by name."""
    clock, pose, here = (
        Clock(),
        Pose(np.array([0.0, 0, 1, 0, 0, 0, 1])),
        State.at((0, 0, 1)),
    )
    velocity, plan = (
        VelocityFilter(),
        PointToPoint(FullState.at((0, 0, 0)), np.ones(3), 0.0, 3.0),
    )
    tracking = HierarchicalController(
        FlatnessPositionCtrl(), GeometryAttitudeCtrl(), FPQRSender(), FullStateTraj()
    )
    led = HierarchicalController(
        FlatnessAccelerationCtrl(),
        GeometryAttitudeCtrl(),
        FPQRSender(),
        AccelerationTraj(),
    )
    pieces = minimum_snap(
        np.random.default_rng(0).uniform(-1.0, 1.0, (101, 3)), np.arange(101.0)
    )
    reference, acceleration, guard = (
        FullState.at((0, 0, 1)),
        Acceleration(np.zeros(3)),
        Guard(),
    )
    place = np.random.default_rng(0).uniform(0.5, 9.0, (100, 3))
    world, mocap = CFIntegrator(range(100), place), SimulatedMocap(range(100), 0)
    tick = iter(range(10**9))
    found = {
        "filter": microseconds(lambda: velocity.update(pose, clock())),
        "planner": microseconds(lambda: plan.sample(1.0)),
        "controller, full state": microseconds(
            lambda: tracking.command(here, reference, 0.0)
        ),
        "controller, acceleration": microseconds(
            lambda: led.command(here, acceleration, clock())
        ),
        "guard": microseconds(lambda: guard.check(0.0, here, 0.01, 0.02)),
        "world step, 100 drones": microseconds(world.step, 500),
        "mocap sample, 100 drones": microseconds(
            lambda: mocap.sample(world.states, next(tick)), 500
        ),
        "planner, 100 pieces": microseconds(lambda: pieces.sample(50.3)),
        "separation, 100 drones": microseconds(world.min_separation, 500),
    }
    found["sum: filter, planner, controller, guard"] = (
        sum(list(found.values())[:3]) + found["guard"]
    )
    return found


if __name__ == "__main__":
    for name, us in bench().items():
        print(f"{us:8.2f} us  {name}")
