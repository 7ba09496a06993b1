"""`crazychoir mocap names` and `calibrate`, of a recording."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.mounting import Mounting
from crazychoir.mocap.recording import FrameRecorder
from crazychoir.numerics.math3d import quaternion_of_yaw

MOUNTING = Mounting((0.0, 0.01, 0.03), (0.05, -0.02, 0.0))
FILE = """name = "lab"  # ours
[[drones]]
id = 0
home = [0, 0, 0]
uri = "udp://127.0.0.1:19850"
[[drones]]
id = 1
home = [1, 0, 0]
uri = "udp://127.0.0.1:19851"
{}
[mocap]
source = "replay"
file = "rest.csv"
rate = 200
"""


@pytest.fixture
def lab(tmp_path):
    """Both drones at home; the body of drone 1 is mounted askew above it. It turns about in the second file."""
    draw = np.random.default_rng(0)
    for name, turn in (("rest.csv", 0.0), ("turn.csv", 4.0 * np.pi)):
        with FrameRecorder(tmp_path / name) as recorder:
            for k in range(100):
                drone = np.array([1.0, 0.0, 0.0, *quaternion_of_yaw(0.005 * k * turn)])
                bodies = {
                    "a": np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
                    "b": MOUNTING.body(drone),
                }
                for flat in bodies.values():
                    flat[0:3] += draw.normal(0.0, 0.0002, 3)
                wand = np.array([3.0, 3.0, 1.0, 0.0, 0.0, 0.0, 1.0])
                recorder.write(
                    PoseFrame(k, 0.005 * k, {**bodies, "wand": wand}), 0.005 * k
                )

    def written(line=""):
        path = tmp_path / "lab.toml"
        path.write_text(FILE.format(line))
        return path

    return written


def said(*words, seconds=0.25):
    done = CliRunner().invoke(
        app, ["mocap", *map(str, words), "--seconds", str(seconds)]
    )
    return done, json.loads(done.stdout) if done.stdout.startswith("{") else None


def test_names_are_proposed_by_where_drones_stand_and_written(lab):
    path = lab()
    done, told = said("names", "--swarm", path, "--write", "--json")
    assert done.exit_code == 0, done.output
    assert {i: one["body"] for i, one in told["proposed"].items()} == {
        "0": "a",
        "1": "b",
    }
    assert [one["name"] for one in told["bodies"]] == ["a", "b", "wand"]
    new = [
        line
        for line in path.read_text().splitlines()
        if line not in ("", *FILE.splitlines())
    ]
    assert new == ['body = "a"', 'body = "b"']
    assert path.read_text().startswith('name = "lab"  # ours\n[[drones]]\nid = 0\n')


def test_without_write_the_lines_are_shown_and_the_file_stays(lab):
    path = lab('body = "b"')
    before = path.read_text()
    done, _ = said("names", "--swarm", path)
    assert done.stdout.endswith('[[drones]]\nid = 0\nbody = "a"\n'), (
        "drone 1 has its body already"
    )
    assert path.read_text() == before


def test_a_drone_that_is_not_at_home_has_no_sure_body(lab):
    path = lab()
    path.write_text(path.read_text().replace("home = [1, 0, 0]", "home = [1, 1, 0]"))
    done, told = said("names", "--swarm", path, "--write", "--json")
    assert done.exit_code == 1
    assert not told["proposed"]["1"]["sure"]
    assert path.read_text().count("body") == 1


def test_rest_shows_tilt_and_height_and_a_turn_the_offset(lab, tmp_path):
    path = lab('body = "b"')
    done, _ = said("calibrate", 1, "--swarm", path, "--write", "--json")
    assert done.exit_code == 0, done.output
    turns = ("calibrate", 1, "--turn", "--source", tmp_path / "turn.csv")
    done, _ = said(
        *turns, "--swarm", path, "--write", "--json", seconds=1.0
    )  # a busy machine misses some of it
    assert done.exit_code == 0, done.output
    drone = SwarmConfig.load(path).drone(1)
    np.testing.assert_allclose(drone.body_rotation, MOUNTING.rotation, atol=1e-4)
    np.testing.assert_allclose(drone.body_offset, MOUNTING.offset, atol=2e-4)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ("calibrate", 5),
            "DRONE: found drone 5; allowed: 0 to 1",
        ),
        (
            ("calibrate", 1),
            "body cf1 of drone 1: it is not visible; visible are: a, b, wand",
        ),
        (("calibrate", 1, "--turn"), "it is not visible"),
        (("names", "--source", "virtual@a:b"), "--source: found virtual@a:b"),
        (("names", "--source", "kinect"), '"vicon"'),
        (("names", "--source", "none.csv"), "No such file"),
    ],
)
def test_what_cannot_be_is_refused(lab, words, text):
    done, _ = said(*words, "--swarm", lab())
    assert done.exit_code != 0
    assert text in done.stderr
