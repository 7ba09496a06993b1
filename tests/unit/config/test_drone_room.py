"""The room of a drone is the same for the checks of a mission and for its guard."""

import pytest

from crazychoir.config.drone_room import fence_of, room_of, shared_room
from crazychoir.config.flight_room import EDGE_MARGIN
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.path_checks import require_inside
from crazychoir.planning.point_to_point import PointToPoint
from crazychoir.safety.rules.guard import Fence, Guard
from crazychoir.types import FullState

INSET = 0.5  # m: a quarter of half the fence below


def swarm(*uris: str, sender: str = "frpy") -> SwarmConfig:
    drones = [
        {"id": i, "home": [0.0, 0.4 * i, 0.0], "uri": uri} for i, uri in enumerate(uris)
    ]
    return SwarmConfig.of(
        {
            "name": "room",
            "drones": drones,
            "graph": "empty",
            "control": {"sender": sender},
            "fence": {"min": [-2, -2, 0], "max": [2, 2, 2]},
        }
    )


def test_room_of_a_drone_that_a_radio_streams_to_is_inset():
    config = swarm("udp://127.0.0.1:19850", "sim://")
    assert room_of(config, 0)[1][0] == pytest.approx(2.0 - INSET - EDGE_MARGIN)
    assert room_of(config, 1)[1][0] == pytest.approx(2.0 - EDGE_MARGIN)
    assert shared_room(config) == room_of(config, 0)
    onboard = swarm("udp://127.0.0.1:19850", sender="xyz")
    assert room_of(onboard, 0)[1][0] == pytest.approx(2.0 - EDGE_MARGIN)


@pytest.mark.parametrize("uri", ["udp://127.0.0.1:19850", "sim://"])
def test_room_of_the_checks_is_the_room_of_the_guard(uri):
    config = swarm(uri)
    guard = Guard(Fence.box(*fence_of(config, 0)), ground=config.flight.ground)
    assert Fence(*room_of(config, 0)) == guard.room


def test_path_between_the_room_of_the_guard_and_the_fence_is_refused_before_take_off():
    path = PointToPoint(FullState.at([0.0, 0.0, 1.0]), [1.8, 0.0, 1.0], 0.0, 6.0)
    require_inside(path, swarm("sim://"), 0, "figure")
    with pytest.raises(ConfigError, match="within the fence"):
        require_inside(path, swarm("udp://127.0.0.1:19850"), 0, "figure")
