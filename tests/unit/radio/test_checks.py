"""What keeps a drone on the ground."""

import math

from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio import checks


def test_the_supervisor() -> None:
    ready = SUPERVISOR_BITS.can_fly | SUPERVISOR_BITS.auto_arm
    assert checks.supervisor_problems(ready) == []
    assert checks.supervisor_problems(ready | SUPERVISOR_BITS.tumbled) == ["tumbled"]
    assert "self-test failed" in checks.supervisor_problems(0)[0]
    assert "locked" in checks.supervisor_problems(SUPERVISOR_BITS.locked)[0]
    assert checks.supervisor_problems(0)
    assert checks.supervisor_problems(SUPERVISOR_BITS.auto_arm), (
        "its checks before flight have failed"
    )
    assert checks.supervisor_problems(SUPERVISOR_BITS.can_arm) == [], (
        "its motors wait for a request"
    )
    assert checks.supervisor_problems(ready | SUPERVISOR_BITS.deck_fault) == [
        "a deck is faulty"
    ]


def test_the_battery() -> None:
    assert checks.battery_problems(3.9, 3.7) == []
    assert checks.battery_problems(3.65, 3.7) == [
        "battery at 3.65 V, 3.7 V are needed to start"
    ]
    assert checks.battery_problems(3.65, 3.6) == []
    assert checks.battery_problems(math.nan, 3.7)


def test_an_unseen_drone_must_know_where_it_is() -> None:
    assert checks.spread_problems([1e-4, 1e-4, 1e-4]) == []
    assert "0.20 m" in checks.spread_problems([1e-4, 0.04, 1e-4])[0]
    assert checks.spread_problems([1e-4, math.nan, 1e-4])
