"""What the cameras of virtual drones see."""

import numpy as np
import pytest

from crazychoir.mocap.mounting import Mounting
from crazychoir.radio.virtual.cameras import observe_bodies
from crazychoir.radio.virtual.faults import Faults

TURNED = Mounting((0.0, 0.01, 0.02), (0.0, 0.0, np.pi / 2))
"""A body that is tracked beside the centre of its drone, and defined while the drone looked along -y."""


def test_a_body_is_seen_as_it_is_mounted_on_its_drone():
    states = np.zeros((2, 13))
    states[:, :3] = (1.0, 2.0, 0.5), (-1.0, 0.0, 0.0)
    states[:, 6:10] = (0.0, 0.0, 0.6, 0.8), (0.6, 0.0, 0.0, 0.8)
    mountings = {4: TURNED, 7: Mounting()}

    seen = observe_bodies(
        states,
        {4: 0, 7: 1},
        {4: Faults(), 7: Faults()},
        {4: "cf4", 7: "cf7"},
        mountings,
    )

    drones = [mountings[4].drone(seen["cf4"]), mountings[7].drone(seen["cf7"])]
    assert drones == pytest.approx(states[:, [0, 1, 2, 6, 7, 8, 9]])
    assert seen["cf4"][:3] != pytest.approx(states[0, :3])
