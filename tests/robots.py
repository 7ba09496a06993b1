"""Worlds of robots that do not fly, for tests."""

import numpy as np

from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.simulation.common.world import WorldSetup
from crazychoir.simulation.engines import BUILT_IN_ENGINES


def world_of(uri, homes=((0.0, 0.0, 0.0),), yaws=(0.0,), dt=0.01):
    """The world of this uri with robots at these places."""
    n = len(homes)
    yaws = tuple(yaws) * n if len(yaws) < n else tuple(yaws)
    setup = WorldSetup(
        tuple(range(n)),
        (uri,) * n,
        tuple(homes),
        yaws,
        (PAPER_PLATFORM,) * n,
        {},
        (0.0, 0.0, 0.0),
        0,
        dt,
    )
    return BUILT_IN_ENGINES[uri].load()(setup)


def heading(world, i=0):
    """rad."""
    q = world.state(i).q
    return 2.0 * np.arctan2(q[2], q[3])
