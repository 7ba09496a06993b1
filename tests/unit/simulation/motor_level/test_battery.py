import pytest

from crazychoir.simulation.motor_level.battery import interpolate_open_circuit


def test_the_voltage_at_rest_goes_through_the_firmwares_table():
    table = [3.00, 3.78, 3.83, 3.87, 3.89, 3.92, 3.96, 4.00, 4.04, 4.10, 4.20]
    for tenth, volts in enumerate(table):
        assert 3.0 + 1.2 * interpolate_open_circuit(tenth / 10.0) == pytest.approx(
            volts, abs=1e-3
        )
    assert 3.0 + 1.2 * interpolate_open_circuit(0.05) == pytest.approx(3.39, abs=1e-3)
    assert interpolate_open_circuit(-1.0) == 0.0
    assert interpolate_open_circuit(2.0) == 1.0
