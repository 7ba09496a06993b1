import numpy as np
import pytest

from crazychoir.planning.figure import eight
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.number_table import TableError
from crazychoir.planning.trajectory_file import (
    PIECE_COLUMNS,
    read_pieces,
    read_samples,
    write_pieces,
    write_samples,
)
from crazychoir.planning.upload import compute_difference

FIGURE = eight((0, 0, 1), (1.0, 0.5), 8.0, laps=2, yaw="along")
HEAD = "t,x,y,z,yaw"
PIECES = ",".join(PIECE_COLUMNS)


def test_samples_come_back_with_all_their_derivatives(tmp_path):
    file = tmp_path / "eight.csv"
    write_samples(file, FIGURE, rate=20.0)
    flight = read_samples(file)
    assert compute_difference(FIGURE, flight) == pytest.approx((0.0, 0.0), abs=1e-5)
    for t in (0.0, 1.0, 5.55, FIGURE.duration):
        np.testing.assert_allclose(
            flight.sample(t).flat[0:9], FIGURE.sample(t).flat[0:9], atol=1e-6
        )


def test_places_alone_make_a_smooth_flight_from_rest_to_rest(tmp_path):
    file = tmp_path / "places.csv"
    file.write_text(f"{HEAD}\n1,0,0,1,0\n2,1,0,1,3\n4,1,1,1,-3\n")
    flight = read_samples(file)
    assert flight.duration == 3.0
    np.testing.assert_allclose(flight.sample(1.0).p, (1, 0, 1), atol=1e-12)
    np.testing.assert_allclose(flight.sample(0.0).v, 0.0, atol=1e-12)
    assert flight.sample(3.0).yaw == pytest.approx(2 * np.pi - 3)
    assert flight.jumps[:, 0:3].max() < 1e-9


def test_velocities_are_honoured(tmp_path):
    file = tmp_path / "places.csv"
    file.write_text(
        f"{HEAD},vx,vy,vz,yaw_rate\n0,0,0,1,0,0.5,0,0,0.1\n1,1,0,1,0,0,0.3,0,0\n2,1,1,1,0,0,0,0,0\n"
    )
    flight = read_samples(file)
    np.testing.assert_allclose(flight.sample(0.0).v, (0.5, 0, 0), atol=1e-12)
    np.testing.assert_allclose(flight.sample(1.0).v, (0, 0.3, 0), atol=1e-12)
    assert flight.sample(0.0).flat[13] == pytest.approx(0.1)


def test_yaws_go_the_short_way_with_and_without_their_rates(tmp_path):
    for rates in ("", ",yaw_rate"):
        file = tmp_path / "yaws.csv"
        file.write_text(
            f"{HEAD}{rates}\n0,0,0,1,3{',0.1' if rates else ''}\n1,1,0,1,-3{',0.1' if rates else ''}\n"
        )
        yaws = [read_samples(file).sample(t).yaw for t in np.linspace(0.0, 1.0, 20)]
        assert yaws == sorted(yaws)
        assert yaws[-1] == pytest.approx(2 * np.pi - 3)


def test_pieces_come_back_to_the_last_digit(tmp_path):
    flight = minimum_snap(
        [[0, 0, 1], [1, 0, 1], [1, 1, 1]], [0, 1.1, 2.7], yaws=[0, 1, 2]
    )
    write_pieces(tmp_path / "pieces.csv", flight)
    again = read_pieces(tmp_path / "pieces.csv")
    np.testing.assert_array_equal(again.coefficients, flight.coefficients)
    np.testing.assert_array_equal(again.durations, flight.durations)


def test_the_files_of_others_have_capitals_spaces_and_a_comma_at_the_end(tmp_path):
    file = tmp_path / "figure.csv"
    straight = ["1.5", *["0"] * 32]
    file.write_text(
        f"{PIECES.replace('duration', 'Duration').replace(',', ', ')},\n{','.join(straight)},\n\n"
    )
    assert read_pieces(file).duration == 1.5


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "empty file"),
        (f"{HEAD}\n", "no row"),
        (f"{HEAD}\n0,0,0,1,0\n", "at least two"),
        ("t,x,y,yaw\n0,0,0,1\n", "line 1: found no column z"),
        ("t,x,y,z,yaw_rate\n0,0,0,1,0\n1,0,0,1,0\n", "a column yaw_rate without yaw"),
        ("t,x,y,z\n0,0,0,1\n", "at least two"),
        (f"{HEAD},q\n", "line 1, column 6: found 'q'"),
        (f"{HEAD},x\n", "line 1, column 6: found 'x'.*once"),
        (f"{HEAD}\n0,0,0,1,0\n\n1,0,abc,1,0\n", r"line 4, column 3 \(y\): found 'abc'"),
        (f"{HEAD}\n0,0,0,1,0\n1,0,nan,1,0\n", r"line 3, column 3 \(y\): found 'nan'"),
        (f"{HEAD}\n0,0,0,1,0\n1,0,1,0\n", "line 3: found 4 columns; allowed: 5"),
        (
            f"{HEAD}\n0,0,0,1,0\n1,0,0,1,0\n1,1,0,1,0\n",
            r"line 4, column 1 \(t\): found 1",
        ),
        (f"{HEAD},vx\n0,0,0,1,0,0\n1,0,0,1,0,0\n", "no column vy, vz"),
        (f"{HEAD},ax,ay,az\n0,0,0,1,0,0,0,0\n1,0,0,1,0,0,0,0\n", "higher derivative"),
    ],
)
def test_bad_samples_are_refused_with_file_line_and_column(tmp_path, text, complaint):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(TableError, match=f"bad.csv.*{complaint}"):
        read_samples(file)


def test_without_a_yaw_column_the_yaw_is_zero(tmp_path):
    file = tmp_path / "places.csv"
    file.write_text("t,x,y,z,vx,vy,vz\n0,0,0,1,0,0,0\n1,1,0,1,0,0.3,0\n2,1,1,1,0,0,0\n")
    flight = read_samples(file)
    yaws = [flight.sample(t).flat[12:14] for t in np.linspace(0.0, 2.0, 20)]
    np.testing.assert_array_equal(yaws, np.zeros((20, 2)))
    np.testing.assert_allclose(flight.sample(1.0).p, (1, 0, 1), atol=1e-12)


def test_a_trajectory_as_numpy_saves_it_is_read(tmp_path):
    file = tmp_path / "numpy.csv"
    rows = [[0.0, 0.0, 0.0, 1.0, 0.0], [1.0, 1.0, 0.0, 1.0, 0.5]]
    for header, separator in (
        ("t,x,y,z,yaw", ","),
        ("t x y z yaw", " "),
        ("t x y z yaw", ","),
    ):
        np.savetxt(file, rows, header=header, delimiter=separator)
        assert read_samples(file).sample(1.0).yaw == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        ([[0, *[0] * 32]], r"line 2, column 1 \(duration\): found 0"),
        ([[1, *[0] * 32], [1, 0.5, *[0] * 31]], "line 3: found a place 0.5 off"),
        ([[1, *[0] * 32], [1, 0, 0.5, *[0] * 30]], "line 3: found a velocity 0.5 off"),
        ([[1, *[0] * 31]], "line 2: found 32 columns"),
    ],
)
def test_bad_pieces_are_refused_with_file_and_line(tmp_path, rows, complaint):
    file = tmp_path / "bad.csv"
    file.write_text("\n".join([PIECES, *(",".join(map(str, row)) for row in rows)]))
    with pytest.raises(TableError, match=f"bad.csv.*{complaint}"):
        read_pieces(file)


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path):
    with pytest.raises(TableError, match=r"none\.csv"):
        read_samples(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TableError, match=r"bytes\.csv"):
        read_pieces(tmp_path / "bytes.csv")


def test_shipped_figure_of_eight_begins_and_ends_at_rest_at_its_centre(repository):
    path = read_pieces(repository / "agents" / "data" / "figure8.csv")
    assert np.allclose(path.sample(0.0).flat, 0.0)
    assert np.allclose(path.end, 0.0, atol=1e-9)
    places = path.samples(np.linspace(0.0, path.duration, 500))[:, 0:3]
    assert np.allclose(np.abs(places).max(axis=0), [0.8, 0.4, 0.0], atol=0.01)
    assert path.peaks[0] < 1.0
