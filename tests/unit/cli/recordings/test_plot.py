"""What `plot` draws of recordings that have some topics only, and what it says of the rest."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import default_swarm
from crazychoir.launch.flight import FIGURES_KEY
from crazychoir.launch.recording import describe_flight
from crazychoir.recording.analysis import plots
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.types import State, Status

CONFIG = default_swarm(2).replace(mission="goto")
TIMES = np.arange(41) / 20.0
RESULT = {
    "served": [],
    "history": [[1, 4.5, None], [3, 4.75, 5.0]],
    "objective": ["total"],
}


def place(i, t):
    return State.at((0.5 * t, float(i), 1.0))


def said(i, topic):
    """(s, value) of a topic of drone i: it flies along x, 1 m from the other."""
    values = {
        "truth": [(t, place(i, t)) for t in TIMES],
        "state": [(t, State.at((0.5 * t, i + 0.003, 1.0))) for t in TIMES],
        "status": [
            (t, Status("mission", "flying", sent=int(100 * t)))
            for t in (0.0, 0.5, 1.0, 1.5, 2.0)
        ],
        "result": [(2.0, RESULT)],
    }
    return values[topic]


@pytest.fixture
def plot(tmp_path, monkeypatch):
    """`crazychoir plot` of a recording of these topics: exit code, JSON, what is said aside, and the table."""
    monkeypatch.setattr(plots, "PICTURE_FORMATS", ("png",))
    monkeypatch.setenv("COLUMNS", "200")

    def run(*topics, unseen="", figures=None):
        path = tmp_path / "a.mcap"
        path.unlink(missing_ok=True)
        file = RecordingFile(
            path,
            describe_flight(CONFIG, virtual=False) | {"unseen": unseen},
            CONFIG.dumps(),
            False,
        )
        entries = []
        for i in (0, 1):
            for topic in topics:
                message = FORM_BY_VALUE_TYPE[type(said(i, topic)[0][1])]
                series, pack = Series(i, topic, message), make_packer(message, i)
                for t, value in said(i, topic):
                    ns = round((100.0 + t) * 1e9)
                    entries.append(RecordingEntry(series, ns, ns, pack(value, ns)))
        file.write(entries)
        file.close({FIGURES_KEY: json.dumps(figures or {})})
        words = ["plot", str(path), "--out", str(tmp_path / "out")]
        done, shown = (
            CliRunner().invoke(app, [*words, *more]) for more in (["--json"], [])
        )
        assert done.exit_code == shown.exit_code
        told = json.loads(done.stdout)
        drawn = sorted(
            Path(file).stem for file in told.get("files", ()) if file.endswith(".png")
        )
        return (
            done.exit_code,
            told,
            drawn,
            " ".join((shown.stdout + shown.stderr).split()),
        )

    return run


def test_states_and_statuses_are_enough(plot):
    code, told, drawn, shown = plot("state", "status")
    assert (code, told["success"], told["seconds"]) == (0, True, pytest.approx(2.0))
    assert drawn == ["heights", "messages", "separation", "space", "tasks", "top"]
    assert sorted(told["not_drawn"]) == ["convergence", "tracking"]
    own = told["drones"]["1"]
    assert (own["source"], own["estimation_rmse_m"], own["flown_m"]) == (
        "state",
        None,
        pytest.approx(1.0),
    )
    assert "By state: the drone's own estimate of its position" in shown
    assert (
        "Not drawn: tracking: no reference while it was known where a drone was; convergence: no result"
        in shown
    )


def test_the_recorded_error_of_a_formation_is_told(plot):
    figures = {"formation_error_m": 0.00123, "settling_s": None}
    _, told, _, shown = plot("truth", figures=figures)
    assert (told["formation_error_m"], told["settling_s"]) == (0.00123, None)
    assert "Error of the formation at its end: 0.0012 m, not settled" in shown


def test_truth_is_used_only_for_drones_that_the_camera_saw(plot):
    _, told, _, shown = plot("truth", "state")
    assert told["drones"]["0"]["source"] == "truth"
    assert told["drones"]["0"]["estimation_rmse_m"] == pytest.approx(0.003)
    assert "By state" not in shown
    _, told, _, shown = plot("truth", "state", unseen="0")
    assert {i: own["source"] for i, own in told["drones"].items()} == {
        "0": "state",
        "1": "truth",
    }
    assert told["drones"]["0"]["estimation_rmse_m"] is None
    assert "By state" in shown


@pytest.mark.parametrize(
    ("topic", "pictures"),
    [("status", ["messages", "tasks"]), ("result", ["convergence"])],
)
def test_topics_of_drones_are_drawn_even_without_truth_or_state(plot, topic, pictures):
    code, told, drawn, shown = plot(topic)
    assert (code, drawn, told["drones"], told["min_separation_m"]) == (
        0,
        pictures,
        {},
        None,
    )
    assert told["not_drawn"]["top"] == "no truth or state of any drone"
    assert "goto, seed 0" in shown
    assert "top: no truth or state of any drone" in shown


def test_a_recording_without_anything_to_draw_is_an_error(plot, tmp_path, monkeypatch):
    monkeypatch.setitem(RESULT, "history", [])
    code, told, _, shown = plot("result")
    assert (code, told["success"], told["kind"]) == (2, False, "ConfigError")
    assert (
        "a.mcap: found no truth or state of any drone; no status of any drone;" in shown
    )
    assert not (tmp_path / "out").exists()
