"""Tables of a flight, read for a calibration: units and columns."""

import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.simulation.identification.calibration.columns import read_columns
from crazychoir.simulation.identification.flights import read_flight

NAMES = tuple(
    name
    for names in (
        ("t", "x", "y", "z", "qx", "qy", "qz", "qw"),
        ("gyro_x", "gyro_y", "gyro_z"),
        ("duty_1", "duty_2", "duty_3", "duty_4", "vbat"),
    )
    for name in names
)


def write(path, names=NAMES, **factors):
    """Write a table of 6 s in the air; factors change the unit of a column."""
    t = np.arange(0.0, 6.0, 0.01)
    columns = {name: np.full(t.size, 0.6) for name in names}
    columns |= {"t": t, "vbat": np.full(t.size, 3.9)}
    for name, factor in factors.items():
        columns[name] = factor * columns[name]
    rows = np.column_stack([columns[name] for name in names])
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="")
    return path


def test_a_table_in_si_units_is_read(tmp_path):
    assert read_columns(write(tmp_path / "flight.csv"))["duty"].shape[1] == 4


@pytest.mark.parametrize(
    ("name", "factor", "said"),
    [
        ("x", 1000.0, "p: found 600; allowed: m, at most 100"),
        ("gyro_x", 180.0 / np.pi * 2.0, "gyro: found 68.7549; allowed: rad/s"),
        ("duty_2", 65535.0, "name the columns motor.m1, motor.m2"),
        ("vbat", 1000.0, "vbat: found 3900; allowed: V, at most 30"),
        ("t", 1000.0, "t: found 10 from row to row; allowed: s"),
    ],
)
def test_a_column_in_another_unit_is_refused_with_the_right_one(
    tmp_path, name, factor, said
):
    path = write(tmp_path / "flight.csv", **{name: factor})
    with pytest.raises(ConfigError) as caught:
        read_columns(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_part_of_an_array_is_refused_with_what_is_missing(tmp_path):
    path = write(tmp_path / "flight.csv", [name for name in NAMES if name != "gyro_y"])
    with pytest.raises(ConfigError, match="gyro_x, gyro_z without gyro_y"):
        read_columns(path)


@pytest.mark.parametrize("reader", [read_columns, read_flight])
@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_a_file_that_cannot_be_read_is_refused_in_words_of_the_user(
    tmp_path, reader, suffix
):
    path = tmp_path / f"flight{suffix}"
    with pytest.raises(ConfigError, match=r"flight\.\w+: found no file .No such file"):
        reader(path)
    path.write_text("")
    with pytest.raises(ConfigError, match=r"found (no arrays|an empty file)") as caught:
        reader(path)
    assert "pickle" not in str(caught.value)
