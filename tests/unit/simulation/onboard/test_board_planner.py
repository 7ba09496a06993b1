import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.firmware.memories import TRAJECTORY_MEMORY
from crazychoir.firmware.results import FIRMWARE_RESULTS
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard.board_planner import BoardPlanner, TrajectoryStore
from crazychoir.simulation.onboard.record import make_fleet

PIECE = np.ones((1, TRAJECTORY_MEMORY.piece_size))


@pytest.fixture
def rows():
    return make_fleet(2, CRAZYFLIE_21)


def test_a_trajectory_is_written_behind_those_of_other_slots(rows):
    store = TrajectoryStore(rows, 1)
    store.upload(4, PIECE)
    store.upload(2, 2.0 * PIECE)
    plan = rows[1]["planner"]
    assert plan["offset"][[4, 2]].tolist() == [0, TRAJECTORY_MEMORY.piece_size]
    assert plan["pieces"][[4, 2]].tolist() == [1, 1]
    assert store.memory.view(np.float32)[TRAJECTORY_MEMORY.piece_size] == 2.0
    assert not TrajectoryStore(rows, 0).memory.any(), "another drone has another memory"


def test_a_slot_that_is_not_there_is_refused(rows):
    with pytest.raises(ConfigError, match="slot"):
        TrajectoryStore(rows, 0).upload(TRAJECTORY_MEMORY.slot_count, PIECE)


def test_plans_wait_until_the_supervisor_allows_flight(rows):
    planner = BoardPlanner(rows, 0, TrajectoryStore(rows, 0))
    assert planner.take_off(1.0, 1.0) == FIRMWARE_RESULTS.busy
