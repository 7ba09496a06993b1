"""The watch of a drone near the floor: what the hover thrust says."""

from types import SimpleNamespace

import pytest
from pilots import make_pilot
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import ControlTable, FlightTable
from crazychoir.control.choice import make_controls
from crazychoir.flight.ground_watch import LARGEST_THRUST_ERROR
from crazychoir.platforms import find_platform
from crazychoir.safety.rules.guard import Fence

FENCE = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))
JUST_WRONG = LARGEST_THRUST_ERROR + 0.001
JUST_RIGHT = LARGEST_THRUST_ERROR - 0.001


@pytest.mark.parametrize(
    ("reach", "sender", "error", "is_wrong"),
    [
        ("seen", "fpqr", JUST_RIGHT, False),
        ("seen", "fpqr", -JUST_RIGHT, False),
        ("seen", "fpqr", JUST_WRONG, True),
        ("seen", "frpy", -JUST_WRONG, True),
        ("own", "fpqr", JUST_WRONG, True),
        ("no", "fpqr", JUST_WRONG, False),
        ("seen", "xyz", JUST_WRONG, False),
    ],
)
def test_a_drone_behind_a_radio_hovers_with_the_thrust_that_its_platform_needs(
    reach, sender, error, is_wrong
):
    @virtual
    async def check(clock):
        link = SimpleNamespace(send=lambda command: None, cut=lambda: None)
        controls = make_controls(
            ControlTable(sender=sender), find_platform("cf21"), "motors"
        )
        pilot = make_pilot(
            Bus(clock).port(0),
            link,
            FlightTable(),
            FENCE,
            reach=reach,
            controls=controls,
        )
        controls.trim.flat[0] = error
        why = pilot.judge.ground_watch.explain_wrong_thrust()
        assert bool(why) is is_wrong
        if is_wrong:
            assert f"hovers with {1.0 + error:.2f} times the thrust" in why
            assert "0.85 to 1.15 are allowed" in why

    check()
