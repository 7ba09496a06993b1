"""A law of accelerations, which knows no places, with drones that are not as strong as their controllers believe."""

import pytest

from crazychoir.config.swarm_config import default_swarm
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast

pytestmark = pytest.mark.system
LAW = '''
import numpy as np
from crazychoir import Acceleration, CFDistributedFeedback

class Still(CFDistributedFeedback):
    """Brakes: nothing holds the place."""
    duration = 8.0
    def step(self, me, heard):
        return Acceleration(-2.0 * me.v)

def guidance(i, config):
    return Still()
'''


@pytest.mark.parametrize("uri", ["sim://", "sim://motors"])
@pytest.mark.parametrize("thrust_error", [-0.05, 0.05])
def test_it_neither_sinks_nor_rises_as_it_has_learnt_its_thrust_before(
    tmp_path, uri, thrust_error
):
    path = tmp_path / "still.py"
    path.write_text(LAW)
    config = default_swarm(1).replace(
        mission=str(path),
        graph="empty",
        plant={"thrust_error": thrust_error, "command_delay": 0.02},
        motors={"imperfections": 0.0},
        drones=[{"id": 0, "home": [0.0, 0.0, 0.0], "uri": uri, "platform": "cf21"}],
    )
    result = fly_fast(config, load_mission(str(path)))
    assert result["success"], result["reasons"]
    assert result["results"][0]["place"][2] == pytest.approx(1.0, abs=0.12), (
        "0.5 m and more without"
    )
