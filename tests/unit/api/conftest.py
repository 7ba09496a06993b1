"""A short mission, and one flight of it for all tests of a process."""

import pytest

from crazychoir import CFGuidance
from crazychoir.api import fly


class Rising(CFGuidance):
    """Take off to 0.3 m and land; drone 1 fails in a swarm of three."""

    async def mission(self):
        await self.take_off(0.3)
        await self.land()
        return {"success": self.id != 1 or len(self.graph.ids) != 3, "reason": "one"}


@pytest.fixture(scope="session")
def rising():
    """The class of the guidance."""
    return Rising


@pytest.fixture(scope="session")
def flight(tmp_path_factory):
    """Two drones that have risen and landed, with their recording."""
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    return fly(Rising, drones=2, seed=3, record=path)
