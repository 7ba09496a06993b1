"""Whole flights, recorded: the same flight, all of it, and readable whatever ends it."""

import asyncio
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ros2_decoders import by_mcap_ros2, by_rosbags
from rosbags.rosbag2 import Reader
from system.agents import BRISK

from crazychoir.bus.topics import OBSERVABLE_TOPICS
from crazychoir.cli.recordings.record import _wait_until_gone
from crazychoir.cli.recordings.replay import _replay
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.network import isolate_swarm, make_observer_link, run_attached
from crazychoir.launch.observer import Window
from crazychoir.launch.recording import make_recording
from crazychoir.recording.analysis import plots
from crazychoir.recording.analysis.figures import recorded_flight
from crazychoir.recording.mcap.reading import read, read_header
from crazychoir.recording.recorder import Recorder
from crazychoir.runtime.clock import run_wall
from crazychoir.runtime.supervisor import Supervisor

pytestmark = pytest.mark.system
MISSION = "bearing_formation"
RISING = """
import numpy as np
from crazychoir import Acceleration, CFDistributedFeedback

class Rising(CFDistributedFeedback):
    duration = 1.0

    def step(self, me, heard):
        return Acceleration(np.array([0.0, 0.0, {gain} - me.v[2]]))

def guidance(i, config):
    return Rising()
"""


@pytest.fixture(scope="module")
def fly_short(here, tmp_path_factory):
    """Flies a short formation in virtual time with lost messages; what the run says."""
    swarm = (
        load_mission(MISSION)
        .swarm(None)
        .replace(flight=BRISK, mission_options={"duration": 3.0})
    )
    path = tmp_path_factory.mktemp("short") / "swarm.json"
    path.write_text(swarm.dumps())

    def fly(*words):
        said = here(
            "crazychoir",
            "run",
            path,
            "--fast",
            "--loss",
            0.2,
            "--seed",
            3,
            "--json",
            *words,
        )
        assert said.code == 0, said.err
        return said.json

    return fly


@pytest.fixture(scope="module")
def recorded(fly_short, tmp_path_factory):
    """Return the file of a recorded flight, and what its run says."""
    path = tmp_path_factory.mktemp("recorded") / "flight.mcap"
    return path, fly_short("--record", path)


def test_a_recorded_flight_is_the_same_flight(recorded, fly_short):
    _, result = recorded
    plain = fly_short()
    assert result["digest"] == plain["digest"]
    assert (result["messages"], result["flown_m"]) == (
        plain["messages"],
        plain["flown_m"],
    )
    assert plain["recording"] is None


def test_others_read_every_message(recorded):
    path, result = recorded
    everything = by_mcap_ros2(path)
    found = [row for row in everything if row[0] not in ("/tf", "/scene")]
    assert result["recording"] == {
        "file": str(path),
        "messages": len(found),
        "lost": 0,
        "missed": 0,
        "error": "",
    }
    assert str(everything) == str(by_rosbags(path))
    times = {
        name: [t for topic, _, t, _ in found if topic == name]
        for name in {topic for topic, *_ in found}
    }
    said = {
        name
        for name in OBSERVABLE_TOPICS
        if name not in ("log", "telemetry", "plan", "link", "console")
    } | {"round"}
    assert set(times) >= {f"/drone{i}/{name}" for i in range(4) for name in said}
    for i in range(4):
        assert len(times[f"/drone{i}/pose"]) == pytest.approx(
            100 * result["simulated_s"], rel=0.01
        )
        assert len(times[f"/drone{i}/truth"]) == pytest.approx(
            20 * result["simulated_s"], rel=0.01
        )
    moved = [fields["transforms"] for name, *_, fields in everything if name == "/tf"]
    assert len(moved) == pytest.approx(4 * 20 * result["simulated_s"], rel=0.01)
    assert len(everything) == len(found) + len(moved) + 1
    (told,) = [fields for name, *_, fields in found if name == "/drone2/result"]
    assert json.loads(told["json"]) == result["results"]["2"]


def test_the_figures_are_those_of_the_run(recorded):
    path, result = recorded
    recording = read(path, ("truth", "state", "reference"))
    assert (
        recording.about["mission"],
        recording.about["seed"],
        recording.about["time"],
    ) == (MISSION, "3", "virtual")
    config = SwarmConfig.loads(recording.swarm)
    assert (config.seed, config.network.loss) == (3, 0.2)
    figures = recorded_flight(recording).figures()
    assert figures["min_separation_m"] == pytest.approx(
        result["min_separation_m"], abs=0.005
    )
    for i, length in result["flown_m"].items():
        assert figures["drones"][int(i)]["flown_m"] == pytest.approx(length, abs=1e-3)


def test_a_rerun_is_the_same_flight(here, recorded, tmp_path):
    path, result = recorded
    again = tmp_path / "again.mcap"
    said = here("crazychoir", "rerun", path, "--record", again, "--json")
    assert said.code == 0, said.err
    assert said.json["success"]
    assert said.json["digest"] == said.json["recorded_digest"] == result["digest"]
    assert (said.json["seed"], said.json["others"], said.json["first_difference"]) == (
        3,
        {},
        None,
    )
    assert again.read_bytes() == path.read_bytes()


def test_a_rerun_names_the_module_beside_the_mission_that_is_another(here, tmp_path):
    (tmp_path / "gain_of_rising.py").write_text("GAIN = 0.5\n")
    law, path = tmp_path / "law.py", tmp_path / "a.mcap"
    law.write_text(f"from gain_of_rising import GAIN\n{RISING.format(gain='GAIN')}")
    assert (
        here("crazychoir", "run", law, "--drones", 2, "--fast", "--record", path).code
        == 0
    )
    assert here("crazychoir", "rerun", path, "--json").json["others"] == {}
    (tmp_path / "gain_of_rising.py").write_text("GAIN = 0.625\n")
    said = here("crazychoir", "rerun", path, "--json")
    assert said.json["others"] == {"gain_of_rising.py": "its content is another now"}


def test_a_rerun_of_a_changed_mission_says_where_it_first_differs(here, tmp_path):
    law = tmp_path / "law.py"
    law.write_text(RISING.format(gain=0.5))
    path = tmp_path / "a.mcap"
    assert (
        here("crazychoir", "run", law, "--drones", 2, "--fast", "--record", path).code
        == 0
    )
    assert here("crazychoir", "rerun", path, "--json").json["success"]
    law.write_text(RISING.format(gain=0.625))
    said = here("crazychoir", "rerun", path, "--json")
    assert said.code == 1, said.err
    assert said.json["digest"] != said.json["recorded_digest"]
    assert list(said.json["others"]) == ["mission"]
    assert "in /drone0/" in said.json["first_difference"]
    table = here("crazychoir", "rerun", path)
    assert table.code == 1
    for words in ("not the same", "they differ first", said.json["recorded_digest"]):
        assert words in table.out
    assert "law.py has changed" in table.err


def test_a_rerun_of_a_cut_off_recording(here, recorded, tmp_path):
    path = tmp_path / "cut.mcap"
    content = recorded[0].read_bytes()
    path.write_bytes(content[: len(content) // 2])
    said = here("crazychoir", "rerun", path, "--json")
    assert said.code == 1, said.err
    assert (said.json["complete"], said.json["same"], said.json["recorded_digest"]) == (
        False,
        True,
        None,
    )
    assert "as far as it goes" in said.err


def test_plot_says_and_draws(here, recorded, tmp_path, monkeypatch):
    path, _ = recorded
    said = here("crazychoir", "plot", path, "--out", tmp_path / "made", "--json")
    assert said.code == 0, said.err
    assert said.json["complete"]
    assert said.json["about"]["mission"] == MISSION
    assert all(Path(file).stat().st_size for file in said.json["files"])
    assert len(list((tmp_path / "made").iterdir())) == len(said.json["files"]) == 25
    monkeypatch.setattr(
        plots, "draw", lambda pictures, folder: list(folder.glob("*.png"))
    )  # they are there already
    table = here("crazychoir", "plot", path, "--out", tmp_path / "made")
    assert table.code == 0
    assert table.err == ""
    for word in (
        "RMSE",
        "its place against the reference",
        f"{said.json['min_separation_m']:.3f} m",
        "made",
    ):
        assert word in table.out


def test_an_impossible_recording_is_refused_before_any_drone_flies(here, tmp_path):
    taken = tmp_path / "taken.mcap"
    taken.write_text("old")
    wrong = (
        (taken, "one already"),
        (tmp_path / "a.bag", "ends in .mcap"),
        ("/proc/a.mcap", "that can be made"),
    )
    for world, (path, words) in zip(((), ("--fast",), ()), wrong, strict=True):
        here("crazychoir", "run", MISSION, "--record", path, *world).refuses(
            "--record", words
        )
    assert taken.read_text() == "old"


def test_what_cannot_be_plotted_is_said(here, tmp_path, recorded):
    other = tmp_path / "other.mcap"
    other.write_text("not MCAP")
    here("crazychoir", "plot", other).refuses("other.mcap", "an MCAP file")
    here("crazychoir", "plot", tmp_path / "none.mcap").refuses(
        "none.mcap", "No such file"
    )
    here("crazychoir", "plot", recorded[0], "--out", other).refuses(
        "--out", "File exists"
    )


@pytest.mark.real_time
def test_killed_all_but_the_last_second_can_be_read(tmp_path):
    path = tmp_path / "a.mcap"
    command = [
        sys.executable,
        str(Path(__file__).with_name("recording_process.py")),
        str(path),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        while int(process.stdout.readline()) < 250:
            pass
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split()
    published = int(rest[-1]) if rest else 250
    recording = read(path, ("state",))
    numbers = recording.of(0, "state").numbers[:, 0]
    assert not recording.complete
    assert numbers.tolist() == list(range(len(numbers)))
    assert len(numbers) > published - 100, "100 states a second"


def test_a_cut_off_recording_is_plotted_with_a_warning(here, recorded, tmp_path):
    content = recorded[0].read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[: len(content) // 2])
    said = here("crazychoir", "plot", path, "--json")
    assert said.code == 0, said.err
    assert not said.json["complete"]
    assert "was cut off" in said.err
    assert 0.2 < said.json["seconds"] / recorded[1]["simulated_s"] < 0.8
    assert (tmp_path / "cut" / "top.png").exists()


@pytest.mark.slow
@pytest.mark.real_time
def test_a_replay_is_seen_as_a_swarm_and_recorded_anew(recorded, tmp_path):
    """Over Zenoh: what the one says again, the other records until it is gone, with the same values."""
    path, new = recorded[0], tmp_path / "new.mcap"
    config = isolate_swarm(SwarmConfig.loads(read_header(path).swarm), 1)

    async def main(clock):
        replaying = asyncio.create_task(_replay(clock, config, path, 4.0, None, 60.0))
        link = make_observer_link(clock, config)
        async with run_attached(link):
            window = Window(clock, config, link, None, 60.0)
            assert await window.find() == [0, 1, 2, 3]
            file, topics = (
                make_recording(new, config, None, virtual=False),
                ("state", "truth", "result"),
            )
            recorder = Recorder(
                link.bus,
                config.ids,
                file,
                window.address,
                config.topology.source,
                topics=topics,
            )
            recording = asyncio.create_task(Supervisor(clock, "record").run([recorder]))
            assert (await _wait_until_gone(window, recorder, 100.0)).startswith(
                "no drone was there"
            )
            recording.cancel()
            await asyncio.wait([recording])
        return await replaying, recorder.result()

    told, result = run_wall(main)
    assert told["seconds"] == pytest.approx(recorded[1]["simulated_s"], abs=0.3)
    assert (result["lost"], result["error"]) == (0, "")
    first, again = (read(one, ("state", "truth", "result")) for one in (path, new))
    assert (again.complete, again.drones) == (True, [0, 1, 2, 3])
    for i in again.drones:
        one, other = first.of(i, "state").numbers, again.of(i, "state").numbers
        nearest = np.abs(other[:, None, :3] - one[None, :, :3]).max(axis=2).min(axis=1)
        assert len(other) > 0.2 * len(one), "where it is too fast, the newest counts"
        assert nearest.max() < 1e-9
        assert len(again.of(i, "truth"))


@pytest.mark.real_time
def test_a_replay_without_a_viewer_ends(here, recorded):
    said = here(
        "crazychoir", "replay", recorded[0], "--speed", "100", "--wait", "0", "--json"
    )
    assert said.code == 0, said.err
    assert "crazychoir status --swarm" in said.err
    assert said.json["seconds"] == pytest.approx(recorded[1]["simulated_s"], abs=0.3)


def test_what_cannot_be_recorded_or_replayed_is_said(here, tmp_path):
    said = here(
        "crazychoir", "record", tmp_path / "a.mcap", "--topics", "state,nothing"
    )
    said.refuses("--topics", "nothing", "pose")
    here("crazychoir", "replay", tmp_path / "none.mcap").refuses(
        "none.mcap", "No such file"
    )


def test_a_flight_as_a_bag_of_ros(here, recorded, tmp_path):
    said = here(
        "crazychoir", "convert", recorded[0], "--rosbag2", tmp_path / "bag", "--json"
    )
    assert said.code == 0, said.err
    assert said.json["topics"]["/tf"]["type"] == "tf2_msgs/msg/TFMessage"
    with Reader(tmp_path / "bag") as reader:
        assert (
            reader.message_count
            == said.json["messages"]
            > recorded[1]["recording"]["messages"]
        )
    here("crazychoir", "convert", recorded[0], "--rosbag2", tmp_path / "bag").refuses(
        "--rosbag2", "File exists"
    )
    here(
        "crazychoir", "convert", tmp_path / "none.mcap", "--rosbag2", tmp_path / "new"
    ).refuses("none.mcap")
    assert not (tmp_path / "new").exists()


@pytest.mark.real_time
def test_real_time_is_not_flown_again(here, formation):
    here("crazychoir", "rerun", formation[1]).refuses(
        "a flight in real time", "--fast --record"
    )


@pytest.mark.real_time
def test_a_flight_in_real_time(formation):
    """Three processes over Zenoh: every topic at its full rate, by the wall clock."""
    result, path, before = formation
    assert result["success"], result
    assert result["recording"]["messages"] > 0, result
    recording = read(path, ("pose", "state", "command", "truth", "result"))
    assert recording.complete
    first, last = recording.seconds
    assert before - 5.0 < first < last < time.time() + 5.0
    for i in range(4):
        for topic, rate in (
            ("pose", 100.0),
            ("state", 100.0),
            ("command", 100.0),
            ("truth", 20.0),
        ):
            came = recording.of(i, topic).came
            assert len(came) / (came[-1] - came[0]) > 0.8 * rate, (i, topic)
            assert np.all(np.diff(came) >= 0.0)
        assert len(recording.of(i, "result")) == 1
