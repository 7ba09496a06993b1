"""The ways among which a drone chooses stay inside the fence."""

import numpy as np
import pytest

from crazychoir.safety.collision.detours import Detours
from crazychoir.safety.collision.ways import braking, end, moving, seconds
from crazychoir.safety.guard import Fence

FENCE = Fence.box((-3.0, -3.0, 0.25), (3.0, 3.0, 2.5))
DOWN = np.array([0.0, 0.0, 0.6, 0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def options(start, goal):
    return Detours(1.0, 0.8, FENCE, np.random.default_rng(1)).options(start, np.array(goal), np.inf)


def lowest(option):
    return min(moving(option.way, t)[2] for t in np.linspace(0.0, seconds(option.way), 300))


@pytest.mark.parametrize(("z", "kinds"), [(0.6, {"delayed"}), (1.0, {"delayed", "split"})])
def test_no_way_leaves_the_fence_though_the_drone_flies_towards_it(z, kinds):
    start = DOWN.copy()
    start[2] = z
    unavoidable = min(FENCE.low[2], end(braking(start, 0.8))[2])
    found = options(start, (2.5, 0.0, 1.0))
    assert kinds <= {option.kind for option in found}
    assert min(map(lowest, found)) >= unavoidable - 0.005


def test_a_goal_below_the_fence_is_flown_to():
    found = options(np.array([0.0, 0.0, 1.0, *np.zeros(9)]), (0.0, 0.0, 0.05))
    assert found[0].kind == "straight"
    assert min(map(lowest, found)) >= 0.045
