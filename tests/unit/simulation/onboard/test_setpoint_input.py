import math

import numpy as np
import pytest

from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES
from crazychoir.simulation.onboard.onboard import Onboard


@pytest.fixture
def setpoints():
    return Onboard(CRAZYFLIE_21).setpoints


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_a_set_point_that_is_not_finite_is_refused(setpoints, wrong):
    assert not setpoints.rpyt_raw(0.0, 0.0, wrong, 0.0)
    assert not setpoints.altitude_hold(0.0, 0.0, 0.0, wrong)
    assert not setpoints.full_state(np.full(16, wrong))
    assert setpoints.altitude_hold(0.0, 0.0, 0.0, 0.1)


def test_a_set_point_of_lower_priority_is_refused(setpoints):
    assert setpoints.hover(0.1, 0.0, 0.0, 1.0, SETPOINT_PRIORITIES.external)
    assert not setpoints.hover(0.1, 0.0, 0.0, 1.0, SETPOINT_PRIORITIES.crtp)
