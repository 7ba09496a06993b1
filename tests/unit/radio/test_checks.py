"""What keeps a drone on the ground."""

import math

import numpy as np
import pytest

from crazychoir.radio import checks
from crazychoir.types import Pose

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def turned(axis: int, degrees: float) -> np.ndarray:
    q = np.zeros(4)
    q[axis], q[3] = math.sin(math.radians(degrees) / 2), math.cos(math.radians(degrees) / 2)
    return q


def seen(p: tuple[float, float, float], q: np.ndarray) -> Pose:
    return Pose(np.array([*p, *q]))


@pytest.mark.parametrize(
    ("p", "q", "words"),
    [
        ((0.04, 0.0, 0.0), turned(2, 4.0), []),
        ((0.06, 0.0, 0.0), LEVEL, ["0.06 m from where the cameras see it"]),
        ((0.0, 0.0, 0.0), turned(2, 180.0), ["its heading is 180 degrees"]),
        ((0.0, 0.0, 0.0), turned(0, 8.0), ["tilted 8 degrees"]),
        ((1.0, 0.0, 0.0), turned(2, -90.0), ["1.00 m from", "its heading is 90 degrees"]),
        ((math.nan, 0.0, 0.0), LEVEL, ["nan m from"]),
    ],
)  # fmt: skip
def test_the_drones_estimate_agrees_with_the_cameras(p, q, words) -> None:
    found = checks.agreement((np.zeros(3), LEVEL), seen(p, q))
    assert len(found) == len(words)
    assert all(word in text for word, text in zip(words, found, strict=True)), found


def test_the_supervisor() -> None:
    ready = checks.CAN_FLY | checks.AUTO_ARM
    assert checks.supervisor_problems(ready) == []
    assert checks.supervisor_problems(ready | checks.TUMBLED) == ["tumbled"]
    assert "locked" in checks.supervisor_problems(checks.LOCKED)[0]
    assert checks.supervisor_problems(0)
    assert checks.supervisor_problems(ready | checks.DECK_FAULT) == ["a deck is faulty"]


def test_the_battery() -> None:
    assert checks.battery_problems(3.9) == []
    assert "3.65 V" in checks.battery_problems(3.65)[0]
    assert checks.battery_problems(math.nan)


def test_who_nobody_sees_must_know_where_it_is() -> None:
    assert checks.spread_problems([1e-4, 1e-4, 1e-4]) == []
    assert "0.20 m" in checks.spread_problems([1e-4, 0.04, 1e-4])[0]
    assert checks.spread_problems([1e-4, math.nan, 1e-4])
