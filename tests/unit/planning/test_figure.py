import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.planning.figure import circle, eight


def test_a_circle_starts_at_its_right_and_ends_after_its_laps():
    figure = circle((1, 2, 1), 0.5, 4.0, laps=1.25)
    np.testing.assert_allclose(figure.sample(-1.0).p, (1.5, 2, 1))
    np.testing.assert_allclose(figure.sample(figure.duration + 9).p, (1, 2.5, 1))
    assert figure.duration == pytest.approx(1.25 * 4.0 + 2.0)
    assert figure.done(figure.duration)
    assert not figure.done(figure.duration - 0.01)


def test_yaws_of_a_figure():
    assert circle((0, 0, 1), 1, 4, yaw=0.7).sample(3.0).yaw == pytest.approx(0.7)
    turning = circle((0, 0, 1), 1, 4, laps=2, yaw=0.7, yaw_rate=0.2)
    assert turning.sample(4.0).flat[13] == pytest.approx(0.2)
    assert turning.sample(turning.duration).yaw == pytest.approx(0.7 + 0.2 * 8.0)
    along = circle((0, 0, 1), 1, 4, laps=2, yaw="along")
    assert along.sample(0.0).yaw == pytest.approx(np.pi / 2)
    assert along.sample(along.duration).yaw == pytest.approx(np.pi / 2 + 4 * np.pi)


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"radius": 0.0}, "circle: radius"),
        ({"radius": np.nan}, "circle: radius"),
        ({"period": -1.0}, "circle: period"),
        ({"laps": 0.0}, "circle: laps"),
        ({"laps": np.inf}, "circle: laps"),
        ({"ramp": 0.0}, "circle: ramp"),
        ({"ramp": 4.1}, "circle: ramp.*0 and 4 s"),
        ({"center": (0, 0)}, "center"),
        ({"center": (0, 0, np.inf)}, "center"),
        ({"yaw": "across"}, "along"),
        ({"yaw": "along", "yaw_rate": 1.0}, "without a rate"),
    ],
)
def test_bad_figures_are_refused(wrong, complaint):
    with pytest.raises(ConfigError, match=complaint):
        circle(**({"center": (0, 0, 1), "radius": 1.0, "period": 4.0} | wrong))


def test_an_eight_needs_both_sizes():
    with pytest.raises(ConfigError, match="eight: b"):
        eight((0, 0, 1), (1.0, 0.0), 4.0)
