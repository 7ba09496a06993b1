"""What a recording says in numbers, and in pictures of a column's width."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.recording.analysis import plots
from crazychoir.recording.analysis.figures import TRACK_COLUMNS, recorded_flight
from crazychoir.recording.analysis.plots import (
    COLUMN_WIDTH,
    PICTURE_FORMATS,
    draw,
    flight_pictures,
)
from crazychoir.recording.mcap.reading import RecordedValues, Recording

BEGAN = 1.7e9
"""s: real time is since 1970."""


def odometry(t, p):
    """Values of truth or state: level, at rest in the body's frame but for 1 m/s along y."""
    rest = [
        [*place, 0, 0, np.sqrt(0.5), np.sqrt(0.5), 0, 1.0, 0, 0, 0, 0] for place in p
    ]
    return RecordedValues(t + BEGAN, t + BEGAN, np.array(rest))


def references(t, p):
    return RecordedValues(t + BEGAN, t + BEGAN, np.hstack([p, np.zeros((len(t), 11))]))


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
    figures = recorded_flight(recording(tmp_path)).figures()
    assert figures["min_separation_m"] == pytest.approx(1.0)
    own, other = figures["drones"][0], figures["drones"][1]
    assert (own.pop("source"), other["source"]) == ("truth", "truth")
    assert own == pytest.approx(
        {
            "flown_m": 1.0,
            "highest_m": 1.0,
            "fastest_m_s": 1.0,
            "compared_s": 5.0,
            "tracking_rmse_m": 0.03,
            "tracking_max_m": 0.03,
            "estimation_rmse_m": 0.004,
        },
        abs=1e-6,
    )
    assert (other["compared_s"], other["tracking_rmse_m"], other["tracking_max_m"]) == (
        0.0,
        None,
        None,
    )


def test_velocities_are_those_of_the_world(tmp_path):
    track = recorded_flight(recording(tmp_path)).tracks[0]
    assert track.v[0] == pytest.approx([-1.0, 0.0, 0.0]), (
        "the body's y, a quarter turn to the left"
    )


def test_what_is_late_or_doubled_is_put_in_order(tmp_path):
    found = recording(tmp_path)
    truth = found.topics[0, "truth"]
    order = np.r_[1, 0, 0, 2:201]
    found.topics[0, "truth"] = RecordedValues(
        truth.came, truth.born[order], truth.numbers[order]
    )
    track = recorded_flight(found).tracks[0]
    assert len(track.t) == 201
    assert track.p[:, 0] == pytest.approx(track.t / 10.0, abs=1e-6)


def test_a_gap_is_no_line(tmp_path):
    found = recording(tmp_path)
    truth = found.topics[1, "truth"]
    seen = (truth.born - BEGAN < 3.0) | (truth.born - BEGAN > 4.0)
    found.topics[1, "truth"] = RecordedValues(
        truth.came[seen], truth.born[seen], truth.numbers[seen]
    )
    flight = recorded_flight(found)
    unknown = np.isnan(flight.separation)
    assert 0.9 < unknown.sum() / 20.0 < 1.1
    assert flight.figures()["min_separation_m"] == pytest.approx(1.0)


def test_one_drone_alone_has_no_separation(tmp_path):
    assert (
        recorded_flight(recording(tmp_path, n=1)).figures()["min_separation_m"] is None
    )


def test_where_there_is_no_truth_a_drone_is_where_it_took_itself_to_be(tmp_path):
    """Its estimate is compared with nothing. The recorded truth of an unseen drone is its own estimate, too."""
    found = recording(tmp_path, n=4)
    del found.topics[0, "truth"], found.topics[3, "truth"], found.topics[3, "state"]
    found.about["unseen"] = "2,12"
    figures = recorded_flight(found).figures()
    assert {i: own["source"] for i, own in figures["drones"].items()} == {
        0: "state",
        1: "truth",
        2: "state",
    }
    errors = {i: own["estimation_rmse_m"] for i, own in figures["drones"].items()}
    assert errors == {0: None, 1: pytest.approx(0.004), 2: None}
    assert figures["drones"][0]["tracking_rmse_m"] == pytest.approx(
        np.hypot(0.03, 0.004)
    ), "of its state"
    assert figures["min_separation_m"] == pytest.approx(0.996)


def test_without_truth_and_state_there_is_no_flight(tmp_path):
    found = recording(tmp_path, n=1)
    del found.topics[0, "truth"], found.topics[0, "state"]
    flight = recorded_flight(found)
    assert flight.figures() == {"min_separation_m": None, "drones": {}}
    pictures, missing = flight_pictures(flight)
    assert (pictures, set(missing.values())) == ({}, {"no truth or state of any drone"})


def test_a_table_a_drone(tmp_path):
    recorded_flight(recording(tmp_path)).tracks[0].write(tmp_path / "drone0.csv")
    rows = np.genfromtxt(tmp_path / "drone0.csv", delimiter=",", names=True)
    assert rows.dtype.names == TRACK_COLUMNS
    assert rows["t_s"][[0, -1]].tolist() == pytest.approx([0.0, 10.0])
    assert rows["tracking_error_m"][0] == pytest.approx(0.03)
    assert np.isnan(rows["reference_z_m"][-1])


@pytest.mark.parametrize(
    ("n", "formats"), [(1, ("png",)), (7, PICTURE_FORMATS), (8, ("png",))]
)
def test_pictures_have_the_width_of_a_column(tmp_path, monkeypatch, n, formats):
    monkeypatch.setattr(plots, "PICTURE_FORMATS", formats)
    pictures, missing = flight_pictures(recorded_flight(recording(tmp_path, n)))
    assert missing == ({"separation": "no two drones at one time"} if n == 1 else {})
    files = draw(pictures, tmp_path)
    assert len(files) == (4 if n == 1 else 5) * len(formats)
    for path in files:
        if path.suffix == ".png":
            assert imread(path).shape[1] == round(300 * COLUMN_WIDTH)


def drawn(found, name):
    """The axes of a picture of a recording, and the texts of its legend."""
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    flight_pictures(recorded_flight(found))[0][name][1](figure)
    return figure.axes[0], [
        text.get_text() for legend in figure.legends for text in legend.get_texts()
    ]


def data(line):
    return [np.asarray(column, float) for column in line.get_data()]


T = np.arange(201) / 20.0
COMPARED = T <= 5.0
"""While drone 0 has a reference."""


def test_paths_from_above(tmp_path):
    axes, legend = drawn(recording(tmp_path), "top")
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == (
        "$x$ [m]",
        "$y$ [m]",
        1.0,
    )
    flown, wanted, start, other, _, _ = axes.lines
    for line, y in ((flown, 0.0), (other, 1.0)):
        np.testing.assert_allclose(data(line), [T / 10.0, np.full(201, y)], atol=1e-6)
    x, y = data(wanted)
    np.testing.assert_allclose(x[COMPARED], T[COMPARED] / 10.0, atol=1e-6)
    assert np.isnan(x[~COMPARED]).all()
    assert np.isnan(y[~COMPARED]).all()
    np.testing.assert_allclose(data(start), [[0.0], [0.0]], atol=1e-6)
    assert legend == ["drone 0", "drone 1", "reference", "start"]


def test_paths_in_space(tmp_path):
    axes, legend = drawn(recording(tmp_path), "space")
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()) == (
        "$x$ [m]",
        "$y$ [m]",
        "$z$ [m]",
    )
    flown, wanted, _, other, _, _ = (
        np.asarray(line.get_data_3d(), float) for line in axes.lines
    )
    np.testing.assert_allclose(
        flown, [T / 10.0, np.zeros(201), np.ones(201)], atol=1e-6
    )
    np.testing.assert_allclose(other, [T / 10.0, np.ones(201), np.ones(201)], atol=1e-6)
    np.testing.assert_allclose(wanted[2][COMPARED], 1.03)
    assert legend == ["drone 0", "drone 1", "reference", "start"]


def test_errors_are_drawn_in_cm(tmp_path):
    axes, legend = drawn(recording(tmp_path), "tracking")
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "$t$ [s]",
        "distance from reference [cm]",
    )
    (own, other) = (data(line) for line in axes.lines)
    np.testing.assert_allclose(own[0], T, atol=1e-6)
    np.testing.assert_allclose(own[1][COMPARED], 3.0, atol=1e-4)
    assert np.isnan(own[1][~COMPARED]).all()
    assert np.isnan(other[1]).all()
    assert legend == ["drone 0", "drone 1"]


def test_heights(tmp_path):
    axes, legend = drawn(recording(tmp_path), "heights")
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_xlim()[0]) == (
        "$t$ [s]",
        "$z$ [m]",
        0.0,
    )
    flown, wanted, other, _ = (data(line) for line in axes.lines)
    for t, z in (flown, other):
        np.testing.assert_allclose(t, T, atol=1e-6)
        np.testing.assert_array_equal(z, 1.0)
    np.testing.assert_allclose(wanted[1][COMPARED], 1.03)
    assert legend == ["drone 0", "drone 1", "reference"]


def test_distances_are_drawn_with_the_one_at_which_drones_may_touch(tmp_path):
    found = recording(tmp_path)
    found.topics[1, "truth"] = odometry(
        T, np.column_stack([T / 10.0, 1.0 - 0.08 * T, np.ones(201)])
    )
    axes, legend = drawn(found, "separation")
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "$t$ [s]",
        "least distance of two [m]",
    )
    least, touching = (data(line) for line in axes.lines)
    np.testing.assert_allclose(least[1], 1.0 - 0.08 * least[0], atol=1e-6)
    assert touching[1].tolist() == [
        SWARM_LIMITS.touching_distance,
        SWARM_LIMITS.touching_distance,
    ]
    assert legend == []


def test_the_distance_that_the_filter_keeps_is_drawn(tmp_path):
    found = recording(tmp_path)
    drones = [{"id": i, "home": [0, i, 0]} for i in (0, 1)]
    collision = {"semi_axes": [0.15, 0.15, 0.3], "margin": 0.1}
    swarm = {"name": "lab", "drones": drones, "collision": collision}
    found.swarm = SwarmConfig.of(swarm).dumps()
    axes, _ = drawn(found, "separation")
    assert [data(line)[1][0] for line in axes.lines[1:]] == pytest.approx(
        [SWARM_LIMITS.touching_distance, 0.4]
    )
    assert "kept side by side: 0.4 m" in [text.get_text() for text in axes.texts]
    agreed = {"collision": collision | {"slack": 0.05}, "control": {"sender": "xyz"}}
    found.swarm = SwarmConfig.of(swarm | agreed).dumps()
    assert recorded_flight(found).kept_distance == pytest.approx(0.45)
    off = collision | {"method": "off"}
    found.swarm = SwarmConfig.of(swarm | {"collision": off}).dumps()
    assert recorded_flight(found).kept_distance is None


def test_the_distances_are_a_table(tmp_path):
    recorded_flight(recording(tmp_path)).write_separation(tmp_path / "a.csv")
    rows = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)
    assert rows.dtype.names == ("t_s", "least_distance_m")
    assert rows["least_distance_m"][0] == pytest.approx(1.0)


def test_a_drone_that_is_drawn_by_its_own_state_is_marked(tmp_path):
    found = recording(tmp_path)
    del found.topics[1, "truth"]
    _, legend = drawn(found, "heights")
    assert legend == ["drone 0", "drone 1 (state)", "reference"]
    many = recording(tmp_path, n=8)
    assert drawn(many, "tracking")[0].figure.axes[1].get_ylabel() == "drone"
    del many.topics[1, "truth"]
    assert (
        drawn(many, "tracking")[0].figure.axes[1].get_ylabel() == "drone (some: state)"
    )
    many.about["unseen"] = "0,1,2,3,4,5,6,7"
    assert drawn(many, "tracking")[0].figure.axes[1].get_ylabel() == "drone (state)"


def test_without_a_reference_no_errors_are_drawn(tmp_path):
    found = recording(tmp_path)
    del found.topics[0, "reference"]
    pictures, missing = flight_pictures(recorded_flight(found))
    assert list(pictures) == ["top", "space", "heights", "separation"]
    assert missing == {"tracking": "no reference while it was known where a drone was"}
