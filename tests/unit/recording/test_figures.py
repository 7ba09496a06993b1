"""What a recording says in numbers, and in pictures of a column's width."""

import numpy as np
import pytest
from matplotlib.image import imread

from crazychoir.errors import ConfigError
from crazychoir.recording import plots
from crazychoir.recording.figures import COLUMNS, flight_of
from crazychoir.recording.plots import FORMATS, WIDTH, draw, of_flight
from crazychoir.recording.reading import Recording, Values

BEGAN = 1.7e9
"""s: real time is since 1970."""


def odometry(t, p):
    """Values of truth or state: level, at rest in the body's frame but for 1 m/s along y."""
    rest = [[*place, 0, 0, np.sqrt(0.5), np.sqrt(0.5), 0, 1.0, 0, 0, 0, 0] for place in p]
    return Values(t + BEGAN, t + BEGAN, np.array(rest))


def references(t, p):
    return Values(t + BEGAN, t + BEGAN, np.hstack([p, np.zeros((len(t), 11))]))


def recording(tmp_path, n=2):
    """Drones in a row along y, 1 m apart, that move 1 m along x in 10 s; of drone 0 a reference, 3 cm above, to 5 s."""
    found = Recording(tmp_path / "a.mcap")
    t, fine = np.arange(201) / 20.0, np.arange(501) / 100.0
    for i in range(n):
        path = np.column_stack([t / 10.0, np.full(201, float(i)), np.ones(201)])
        found.topics[i, "truth"] = odometry(t, path)
        found.topics[i, "state"] = odometry(t, path + np.array([0.0, 0.004, 0.0]))
    path = np.column_stack([fine / 10.0, np.zeros(501), np.full(501, 1.03)])
    found.topics[0, "reference"] = references(fine, path)
    return found


def test_figures(tmp_path):
    figures = flight_of(recording(tmp_path)).figures()
    assert figures["seconds"] == pytest.approx(10.0, abs=1e-6)
    assert figures["min_separation_m"] == pytest.approx(1.0)
    own, other = figures["drones"][0], figures["drones"][1]
    assert own == pytest.approx({
        "flown_m": 1.0, "highest_m": 1.0, "fastest_m_s": 1.0, "compared_s": 5.0, "tracking_rmse_m": 0.03,
        "tracking_max_m": 0.03, "estimation_rmse_m": 0.004,
    }, abs=1e-6)  # fmt: skip
    assert (other["compared_s"], other["tracking_rmse_m"], other["tracking_max_m"]) == (0.0, None, None)


def test_velocities_are_those_of_the_world(tmp_path):
    track = flight_of(recording(tmp_path)).tracks[0]
    assert track.v[0] == pytest.approx([-1.0, 0.0, 0.0]), "the body's y, a quarter turn to the left"


def test_what_is_late_or_doubled_is_put_in_order(tmp_path):
    found = recording(tmp_path)
    truth = found.topics[0, "truth"]
    order = np.r_[1, 0, 0, 2:201]
    found.topics[0, "truth"] = Values(truth.came, truth.born[order], truth.numbers[order])
    track = flight_of(found).tracks[0]
    assert len(track.t) == 201
    assert track.p[:, 0] == pytest.approx(track.t / 10.0, abs=1e-6)


def test_a_gap_is_no_line(tmp_path):
    found = recording(tmp_path)
    truth = found.topics[1, "truth"]
    seen = (truth.born - BEGAN < 3.0) | (truth.born - BEGAN > 4.0)
    found.topics[1, "truth"] = Values(truth.came[seen], truth.born[seen], truth.numbers[seen])
    flight = flight_of(found)
    unknown = np.isnan(flight.separation)
    assert 0.9 < unknown.sum() / 20.0 < 1.1
    assert flight.figures()["min_separation_m"] == pytest.approx(1.0)


def test_one_drone_alone_has_no_separation(tmp_path):
    assert flight_of(recording(tmp_path, n=1)).figures()["min_separation_m"] is None


def test_without_truth_there_is_nothing_to_draw(tmp_path):
    found = recording(tmp_path)
    del found.topics[0, "truth"], found.topics[1, "truth"]
    with pytest.raises(ConfigError, match=r"a\.mcap.*no truth"):
        flight_of(found)


def test_a_table_a_drone(tmp_path):
    flight_of(recording(tmp_path)).tracks[0].write(tmp_path / "drone0.csv")
    rows = np.genfromtxt(tmp_path / "drone0.csv", delimiter=",", names=True)
    assert rows.dtype.names == COLUMNS
    assert rows["t_s"][[0, -1]].tolist() == pytest.approx([0.0, 10.0])
    assert rows["tracking_error_m"][0] == pytest.approx(0.03)
    assert np.isnan(rows["reference_z_m"][-1])


@pytest.mark.parametrize(("n", "formats"), [(1, ("png",)), (7, FORMATS), (8, ("png",))])
def test_pictures_have_the_width_of_a_column(tmp_path, monkeypatch, n, formats):
    monkeypatch.setattr(plots, "FORMATS", formats)
    files = draw(of_flight(flight_of(recording(tmp_path, n))), tmp_path)
    assert len(files) == 5 * len(formats)
    assert all(path.stat().st_size > 1000 for path in files)
    for path in files:
        if path.suffix == ".png":
            assert imread(path).shape[1] == round(300 * WIDTH)
