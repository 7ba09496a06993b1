"""The table of platforms is consistent with itself and says where its figures come from."""

import pytest

from crazychoir.errors import ConfigError
from crazychoir.platforms import PLATFORM_BY_NAME, find_platform, rotor_speed


@pytest.mark.parametrize("row", PLATFORM_BY_NAME.values(), ids=lambda row: row.name)
def test_a_row_can_hover_with_thrust_to_spare_and_says_its_source(row):
    assert row.max_thrust == pytest.approx(4 * row.firmware.thrust_max)
    assert 1.3 < row.max_thrust / row.weight < 2.6
    assert len(row.source) > 40
    assert 0.9 < row.mass / row.firmware.mass < 1.2


@pytest.mark.parametrize("row", PLATFORM_BY_NAME.values(), ids=lambda row: row.name)
def test_rotor_speed_inverts_the_thrust_curve(row):
    b, c = row.rotor.thrust
    for f in (0.01, 0.05, row.firmware.thrust_max):
        r = rotor_speed(row.rotor, f)
        assert b * r + c * r * r == pytest.approx(f, rel=1e-12)
    assert rotor_speed(row.rotor, 0.0) == 0.0


@pytest.mark.parametrize("row", PLATFORM_BY_NAME.values(), ids=lambda row: row.name)
def test_the_battery_can_give_full_thrust_by_the_firmwares_curve(row):
    c0, c1, c2, c3 = row.rotor.voltage
    v = row.battery.full
    assert c0 + c1 * v + c2 * v**2 + c3 * v**3 > 0.9 * row.firmware.thrust_max


@pytest.mark.parametrize("row", PLATFORM_BY_NAME.values(), ids=lambda row: row.name)
def test_a_battery_is_enough_to_begin_before_it_is_low_and_low_before_it_is_empty(row):
    assert (
        row.battery.empty
        <= row.firmware.critical
        < row.firmware.low
        < row.battery.begin
        < row.battery.full
    )


def test_an_unknown_platform_is_refused_by_name():
    with pytest.raises(ConfigError, match="cf21bl"):
        find_platform("cf22")
