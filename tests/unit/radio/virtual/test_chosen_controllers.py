"""The controllers that a client chooses by number are read back, and fly."""

import numpy as np
import pytest
from virtual_drones import Hangar


@pytest.mark.parametrize("number", [3, 4])
def test_a_chosen_controller_is_read_back_and_flies_a_plan(number):
    hangar = Hangar()
    hangar.drone.parameters.set("stabilizer.controller", float(number))
    assert hangar.drone.parameters.read("stabilizer.controller") == number
    hangar.hovering(0.5)
    hangar.send("go_to", 0, 0, 0, 0.5, 0.3, 0.8, 0.0, 2.0)
    hangar.run(4.0)
    assert hangar.supervisor == "flying"
    assert hangar.state[:3] == pytest.approx([0.5, 0.3, 0.8], abs=0.1)
    assert np.linalg.norm(hangar.state[3:6]) < 0.1


def test_the_commands_of_indi_are_logged():
    hangar = Hangar()
    hangar.drone.parameters.set("stabilizer.controller", 3.0)
    hangar.hovering(0.5)
    assert hangar.log("ctrlINDI.cmd_roll") == pytest.approx(
        hangar.log("controller.cmd_roll"), abs=1.0
    )
    thrust = hangar.log("posCtrlIndi.T_incremented")
    assert thrust == pytest.approx(hangar.log("stabilizer.thrust"))
    assert thrust > 20000.0
    assert abs(hangar.log("ctrlINDI.n_p")) < 0.1
