import numpy as np
import pytest

from crazychoir.routing.pricing.label_setting_priced import (
    _extend_state,
    _guide_label,
    _list_due_tasks,
    _may_stop,
)

M = 2
PICKUP_1 = 1
DELIVERY_0 = 2
START = 4
END = 5
DISTANCE = np.abs(np.subtract.outer(*2 * [np.array([1.0, 3.0, 2.0, 6.0, 0.0, 0.0])]))
"""m: pickups at 1 m and 3 m, deliveries at 2 m and 6 m, start and end at 0 m."""
EARLIEST = np.array([0.0, 50.0, 0.0, 0.0, 0.0, 20.0])
PRICES = np.array([0.0, 7.0])


def test_tasks_that_are_gone_or_too_heavy_are_not_picked_up():
    gone = np.array([[1, 0]], np.uint64)
    load = np.array([1.0, 2.0])
    assert not _may_stop(gone, load, 0, 0, 9.0)
    assert _may_stop(gone, load, 0, PICKUP_1, 2.0)
    assert not _may_stop(gone, load, 0, PICKUP_1, 1.9)
    assert _may_stop(gone, load, 0, DELIVERY_0, 0.0)


def test_a_stop_adds_its_way_and_subtracts_its_price():
    before = (1.0, 10.0, 9.0, 1.0)
    found = _extend_state(
        before, DELIVERY_0, PICKUP_1, False, DISTANCE, DISTANCE, EARLIEST, PRICES, 8.0
    )
    assert found == pytest.approx((1.0 + 1.0 - 7.0, 50.0, 8.0, 1.0))


def test_a_new_trip_begins_at_the_end_with_a_new_limit():
    before = (1.0, 10.0, 9.0, 1.0)
    found = _extend_state(
        before, DELIVERY_0, 0, True, DISTANCE, DISTANCE, EARLIEST, PRICES, 8.0
    )
    assert found == pytest.approx((1.0 + 2.0 + 1.0, 21.0, 7.0, 2.0))


def test_a_pickup_becomes_due_and_a_delivery_is_due_no_more():
    on = np.array([0, 9])
    due = np.zeros(M, np.int64)
    assert _list_due_tasks(on, 1, PICKUP_1, M, due) == 2
    assert due.tolist() == [0, 1]
    assert _list_due_tasks(on, 1, DELIVERY_0, M, due) == 0


def test_the_guide_is_the_longest_way_over_a_due_delivery():
    due = np.array([0, 1])
    assert _guide_label(DISTANCE, 1.0, PICKUP_1, due, 0, M) == pytest.approx(4.0)
    assert _guide_label(DISTANCE, 1.0, PICKUP_1, due, 2, M) == pytest.approx(10.0)
