"""Trajectory handlers: which references each of them reads, and as what."""

import numpy as np
import pytest

from crazychoir.control.handlers import AccelerationTraj, FullStateTraj, PositionTraj
from crazychoir.types import Acceleration, FullState, State

MOVING = FullState(np.arange(1.0, 15.0))


def test_position_handler_keeps_place_and_heading_alone():
    flat = PositionTraj().read(MOVING)

    np.testing.assert_array_equal(flat[0:3], MOVING.flat[0:3])
    assert flat[12] == MOVING.flat[12]
    assert not flat[3:12].any()
    assert flat[13] == 0.0


def test_full_state_handler_reads_every_number():
    assert FullStateTraj().read(MOVING) is MOVING.flat


@pytest.mark.parametrize("handler", [PositionTraj(), FullStateTraj()])
@pytest.mark.parametrize("reference", [Acceleration(np.ones(3)), FullState(np.ones(3))])
def test_references_of_another_kind_or_shape_are_not_read(handler, reference):
    assert handler.read(reference) is None


@pytest.mark.parametrize("handler", [PositionTraj(), FullStateTraj()])
def test_without_a_reference_a_handler_holds_the_place_of_the_drone(handler):
    flat = handler.hold(State.at((1.0, 2.0, 3.0)), None)

    assert flat.shape == (14,)
    np.testing.assert_array_equal(flat[0:3], [1.0, 2.0, 3.0])
    assert not flat[3:12].any()


def test_acceleration_handler_holds_without_acceleration():
    flat = AccelerationTraj().hold(State.at((1.0, 2.0, 3.0)), np.arange(14.0))

    assert not flat[0:12].any()
    assert flat[12] == 12.0
