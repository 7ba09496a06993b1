"""Flights from Python: what a flight tells, that a recording tells the same, and errors."""

import gc
import json

import numpy as np
import pytest

from crazychoir.api import fly, read
from crazychoir.api.recorded_data import NO_RECORDED_RESULT
from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError
from crazychoir.launch.flight import UNRECORDED_FIGURES
from crazychoir.launch.recording import make_recording
from crazychoir.recording.mcap.file import RecordingEntry, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.types import State


def test_a_flight_tells_its_figures(flight):
    assert flight.success
    assert flight.reasons == {}
    assert flight.ids == (0, 1)
    assert flight.figures["mission"] == "rising"
    assert flight.figures["drones"] == 2
    assert sorted(flight.figures["flown_m"]) == [0, 1]
    assert len(flight.digest) == 32


def test_equal_flights_have_one_digest_and_another_seed_has_another(flight, rising):
    assert fly(rising, drones=2, seed=3).digest == flight.digest
    assert fly(rising, drones=2, seed=3, loss=0.4).digest != flight.digest


def test_a_failed_flight_is_a_flight_with_reasons(rising):
    failed = fly(rising, drones=3)
    assert not failed.success
    assert list(failed.reasons) == [1]
    assert "one" in failed.reasons[1]
    assert "failed" in repr(failed)
    assert "<th>drone 1</th>" in failed._repr_html_()


def test_a_track_has_named_fields_in_world_and_time(flight):
    track = flight.track(1)
    assert (np.diff(track["time"]) > 0.0).all()
    assert track["position"].shape == (len(track), 3)
    assert track["position"][:, 2].max() == pytest.approx(0.3, abs=0.02)
    assert track["position"][-1] == pytest.approx([0.6, 0.0, 0.0], abs=0.05)
    assert np.linalg.norm(track["attitude"], axis=1) == pytest.approx(1.0)
    rise = np.trapezoid(track["velocity"][:, 2], track["time"])
    assert rise == pytest.approx(0.0, abs=0.02)
    with pytest.raises(ConfigError, match=r"track: found drone 7; .*\[0, 1\]"):
        flight.track(7)


def test_the_frame_has_a_row_a_drone_and_time(flight):
    frame = flight.frame()
    assert list(frame.columns[:5]) == ["drone", "t_s", "x_m", "y_m", "z_m"]
    own = frame[frame["drone"] == 1]
    assert np.array_equal(own["z_m"], flight.track(1)["position"][:, 2])


def test_a_recording_tells_what_the_flight_told(flight):
    again = read(flight.path)
    told = {k: x for k, x in flight.figures.items() if k not in UNRECORDED_FIGURES}
    del told["recording"]
    assert again.figures == told
    assert np.array_equal(again.track(0)["position"], flight.track(0)["position"])


def test_saved_flights_are_read_again(flight, tmp_path):
    flight.save(tmp_path / "saved.mcap")
    assert (tmp_path / "saved.mcap").read_bytes() == flight.path.read_bytes()
    with pytest.raises(ConfigError, match=r"save: found .*a.bag.*\.mcap"):
        flight.save(tmp_path / "a.bag")


def test_a_temporary_recording_lives_as_long_as_its_flight(rising):
    flown = fly(rising, drones=1)
    folder = flown.path.parent
    assert flown.path.is_file()
    del flown
    gc.collect()
    assert not folder.exists()


def test_a_named_recording_stays(flight):
    assert flight.path.name == "flight.mcap"
    assert flight.figures["recording"]["file"] == str(flight.path)


def test_a_recording_without_figures_tells_what_it_knows(tmp_path):
    config = default_swarm(2).replace(mission="figure", seed=4)
    path = tmp_path / "a.mcap"
    file = make_recording(path, config, None, virtual=False)
    state = FORM_BY_VALUE_TYPE[State]
    result = FORM_BY_VALUE_TYPE[dict]
    truth = Series(0, "truth", state)
    ended = Series(0, "result", result)
    entries = [
        RecordingEntry(
            truth, k, k, make_packer(state, 0)(State.at((0.0, 0.0, 1e-8 * k)), k)
        )
        for k in (0, 100_000_000)
    ]
    told = make_packer(result, 0)({"success": True}, 0)
    entries.append(RecordingEntry(ended, 100_000_000, 100_000_000, told))
    file.write(entries)
    file.close()
    flown = read(path)
    assert not flown.success
    assert flown.reasons == {1: NO_RECORDED_RESULT}
    assert flown.figures["seed"] == 4
    assert flown.figures["flown_m"] == {0: pytest.approx(1.0)}
    assert flown.digest is None
    json.dumps(flown.figures)


def test_a_plot_is_a_figure_that_a_notebook_shows(flight):
    figure = flight.plot()
    assert len(figure.subfigs) == 2
    assert figure._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match=r"plot: found side; allowed: top, space"):
        flight.plot("side")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"mission": "nothing"}, "mission: found nothing"),
        ({"mission": "figure", "processes": 2}, "processes: found 2 with fast=True"),
        ({"mission": "figure", "options": {"lapz": 2}}, "lapz"),
        ({"mission": "figure", "loss": 2.0}, "loss"),
    ],
)
def test_wrong_values_are_refused_before_the_flight(values, said):
    with pytest.raises(ConfigError, match=said):
        fly(**values)


def test_a_class_does_not_fly_in_several_processes(rising):
    with pytest.raises(ConfigError, match=r"in real time, a name or a file"):
        fly(rising, fast=False)


def test_a_swarm_with_an_operator_does_not_fly_in_virtual_time(rising):
    swarm = default_swarm(1).replace(flight={"operator": True})
    with pytest.raises(ConfigError, match=r"fast: found \[flight\] operator = true"):
        fly(rising, swarm=swarm)


@pytest.mark.parametrize("content", [None, b"no recording"])
def test_a_file_that_is_no_recording_is_refused(tmp_path, content):
    path = tmp_path / "a.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"a\.mcap"):
        read(path)
