"""The lines on the console that programs and operators of real drones read."""

import pytest
from virtual_drones import Hangar

from crazychoir.radio.virtual.fault_control import overturn


def _said(hangar):
    return b"".join(packet.data for packet in hangar.said if packet.port == 0).decode()


def test_an_emergency_stop_in_the_air_locks_and_the_drone_falls():
    """The firmware: `SUP: Locked, reboot required`, and `SUP: free falling!` once."""
    hangar = Hangar().hovering(1.5)
    hangar.said.clear()
    hangar.send("emergency_stop")
    hangar.run(0.4)
    assert _said(hangar).splitlines() == [
        "SUP: Locked, reboot required",
        "SUP: free falling!",
    ]


def test_a_tumbled_drone_says_that_it_has_crashed():
    """The firmware: `SUP: Crashed, recovery required`."""
    hangar = Hangar().hovering()
    for _ in range(150):
        overturn(hangar.world.states[0])
        hangar.run(0.01)
    assert _said(hangar).count("SUP: Crashed, recovery required\n") == 1


@pytest.mark.parametrize(("platform", "says"), [("cf21", 0), ("cf21bl", 1)])
def test_a_drone_that_is_armed_by_programs_says_that_it_is_ready(platform, says):
    hangar = Hangar(platform).run(0.5)
    if says:
        hangar.send("arm", True)
    hangar.run(0.2)
    assert hangar.supervisor == "ready to fly"
    assert _said(hangar).count("SUP: Ready to fly\n") == says


def test_an_estimate_out_of_bounds_is_told_every_two_seconds():
    """The firmware: `ESTKALMAN: State out of bounds, resetting`."""
    hangar = Hangar(told=False).run(0.5)
    for _ in range(30):
        hangar.onboard.record["x"] = 1e6
        hangar.run(0.1)
    assert _said(hangar).count("ESTKALMAN: State out of bounds") == 2
