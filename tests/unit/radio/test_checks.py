"""What keeps a drone on the ground."""

import math

from crazychoir.radio import checks
from crazychoir.safety.rules.radio_watch import SupervisorBit


def test_the_supervisor() -> None:
    ready = checks.ReadinessBit.CAN_FLY | checks.ReadinessBit.AUTO_ARM
    assert checks.supervisor_problems(ready) == []
    assert checks.supervisor_problems(ready | SupervisorBit.TUMBLED) == ["tumbled"]
    assert "locked" in checks.supervisor_problems(SupervisorBit.LOCKED)[0]
    assert checks.supervisor_problems(0)
    assert checks.supervisor_problems(checks.ReadinessBit.AUTO_ARM), (
        "its checks before flight have failed"
    )
    assert checks.supervisor_problems(checks.ReadinessBit.CAN_ARM) == [], (
        "its motors wait for a request"
    )
    assert checks.supervisor_problems(ready | checks.ReadinessBit.DECK_FAULT) == [
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
