"""How late the control tick is beside the solver, and from pose to command: a campaign for a quiet machine."""

from statistics import median

import pytest

from crazychoir.bench.latency import (
    added_p99_ms,
    pose_to_command,
    ten_robot_instance,
    tick_alone,
    tick_while_solving,
)
from crazychoir.errors import CrazyChoirError
from crazychoir.runtime.clock import WallClock
from crazychoir.solve.solving import solve_here

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.timeout(300),
]
QUIET_MS = 1.0
"""p99 of a tick with nothing beside it, above which other programs are what would be measured."""
ATTEMPTS = 8


def quiet_median(measure, wanted=3):
    """The median of `wanted` measurements, each between two looks at an idle process that was prompt."""
    found = []
    for _ in range(ATTEMPTS):
        before = tick_alone(1.0)
        if before.p99_ms > QUIET_MS:
            continue
        try:
            value = measure(before)
        except CrazyChoirError:
            value = float("inf")  # did not even fly
        if tick_alone(1.0).p99_ms < QUIET_MS:
            found.append(value)
        if len(found) == wanted:
            return median(found)
    pytest.skip(
        f"the machine is busy: an idle tick is prompt around {len(found)} of {ATTEMPTS} measurements only"
    )


@pytest.fixture(scope="module")
def instance():
    problem = ten_robot_instance()
    solve_here(problem)  # its kernels are loaded
    return problem


def test_solving_adds_less_than_two_ms_to_the_tick(instance):
    assert (
        quiet_median(
            lambda before: added_p99_ms(before, tick_while_solving(instance, 3.0))
        )
        < 2.0
    )


def test_the_measure_sees_a_solver_on_the_event_loop(instance, monkeypatch):
    async def compute(self, function, *args):
        return function(*args)

    monkeypatch.setattr(WallClock, "compute", compute)
    assert added_p99_ms(tick_alone(1.0), tick_while_solving(instance, 1.0)) > 2.0


def test_pose_to_command_of_thirty_drones_in_one_process():
    assert quiet_median(lambda before: pose_to_command(30, 2.0).p99_ms) < 3.0
