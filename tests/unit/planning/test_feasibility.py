import math

import pytest

from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.planning.feasibility import (
    DEMAND_NAMES,
    Limits,
    check_limits,
    compute_demands,
    compute_peaks,
)
from crazychoir.planning.figure import circle
from crazychoir.types import FullState

CIRCLE = circle((0, 0, 1), 0.5, 2.0, laps=3)  # at 1.57 m/s, 4.93 m/s2


def test_a_hovering_drone_carries_its_weight_and_nothing_else():
    asked = dict(
        zip(
            DEMAND_NAMES,
            compute_demands(FullState.at((0, 0, 1)).flat[None], 0.03)[0].tolist(),
            strict=True,
        )
    )
    assert asked.pop("thrust") == pytest.approx(0.03 * STANDARD_GRAVITY)
    assert not any(asked.values())


def test_free_fall_has_no_attitude():
    asked = compute_demands(
        FullState.at((0, 0, 1), a=(0, 0, -STANDARD_GRAVITY), j=(1, 0, 0)).flat[None],
        1.0,
    )[0]
    assert math.isinf(asked[DEMAND_NAMES.index("pitch_rate")])


def test_a_steady_circle_asks_for_its_centripetal_force():
    w = math.pi
    most, a = (
        compute_peaks(circle((0, 0, 1), 0.5, 2.0, laps=6), mass=0.03),
        0.5 * math.pi**2,
    )
    assert most["acceleration"] == pytest.approx(a, rel=1e-3)
    assert most["jerk"] > a * w
    assert most["thrust"] == pytest.approx(
        0.03 * math.hypot(a, STANDARD_GRAVITY), rel=1e-3
    )
    assert most["tilt"] == pytest.approx(math.atan2(a, STANDARD_GRAVITY), rel=1e-3)


@pytest.mark.parametrize(
    ("limits", "name", "unit"),
    [
        (Limits(v_max=1.5), "speed", "m/s"),
        (Limits(a_max=4.0), "acceleration", "m/s2"),
        (Limits(j_max=10.0), "jerk", "m/s3"),
        (Limits(tilt_max=0.4), "tilt", "rad"),
        (Limits(thrust_max=0.32, mass=0.03), "thrust", "N"),
        (Limits(rate_max=(9, 0.5, 9)), "pitch_rate", "rad/s"),
    ],
)
def test_the_check_names_what_is_asked_too_much_and_when(limits, name, unit):
    with pytest.raises(
        ConfigError,
        match=rf"trajectory at \d\.\d\d s: {name}: found .* {unit}, and .*at most",
    ):
        check_limits(CIRCLE, limits)


def test_what_keeps_all_limits_passes():
    check_limits(
        CIRCLE,
        Limits(
            v_max=1.6,
            a_max=6.5,
            tilt_max=0.7,
            thrust_max=0.4,
            mass=0.03,
            low=(-1, -1, 0),
        ),
    )


def test_the_fence_holds_for_the_way_too():
    with pytest.raises(ConfigError, match=r"set-point\[\d+\].*\[-1, -0.4, 0\]"):
        check_limits(CIRCLE, Limits(low=(-1, -0.4, 0)))


def test_what_is_not_finite_is_refused():
    class Broken:
        duration = 2.0

        def sample(self, t):
            return FullState.at((0, 0, math.nan if t > 1.0 else 1.0))

        def done(self, t):
            return t >= self.duration

    with pytest.raises(ConfigError, match=r"at 1\.\d\d s.*finite"):
        check_limits(Broken(), Limits())


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"v_max": 0.0}, "v_max"),
        ({"a_max": math.nan}, "a_max"),
        ({"rate_max": (1, 2)}, "rate_max"),
        ({"rate_max": (1, 2, -3)}, "rate_max"),
        ({"mass": -1.0}, "mass"),
        ({"mass": 0.03, "thrust_max": 0.29}, r"thrust_max.*weight, 0\.294 N"),
        ({"low": (0, 0, 2), "high": (1, 1, 1)}, "low"),
    ],
)
def test_limits_that_no_flight_keeps_are_refused(wrong, complaint):
    with pytest.raises(ConfigError, match=complaint):
        Limits(**wrong)
