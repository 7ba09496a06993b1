"""The files that a swarm file names."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from squares import SQUARE, square

from crazychoir.config.digest import compute_digest
from crazychoir.config.file_paths import list_files
from crazychoir.config.swarm_config import (
    SwarmConfig,
    default_swarm,
)
from crazychoir.errors import ConfigError


def test_a_mission_path_is_relative_to_the_swarm_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lab").mkdir()
    file = tmp_path / "lab" / "own.toml"
    file.write_text(SQUARE.format(keys='mission = "../own.py"', first="", last=""))
    config = SwarmConfig.load(file)
    assert config.mission == str(tmp_path / "own.py")
    (tmp_path / "child.json").write_text(config.dumps())
    assert SwarmConfig.load(tmp_path / "child.json") == config
    monkeypatch.chdir(tmp_path)
    assert default_swarm(1).replace(mission="here.py").mission == str(
        tmp_path / "here.py"
    )


def test_files_of_options_are_relative_to_the_swarm_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lab").mkdir()
    text = (
        square()
        .replace(
            mission_options={
                "instance": "../own.json",
                "drawing": "a.csv",
                "method": "x",
            }
        )
        .dumps()
    )
    (tmp_path / "lab" / "own.json").write_text(text)
    monkeypatch.chdir("/")
    config = SwarmConfig.load(tmp_path / "lab" / "own.json")
    found = {
        "instance": str(tmp_path / "own.json"),
        "drawing": str(tmp_path / "lab" / "a.csv"),
        "method": "x",
    }
    assert config.mission_options == found
    assert SwarmConfig.loads(config.dumps()) == config


@pytest.mark.parametrize("key", ["drawing", "instance", "uri"])
def test_a_file_name_that_is_not_text_reaches_another_process(
    tmp_path: Path, key: str
) -> None:
    folder = tmp_path / "l\udce4b"
    folder.mkdir()
    uri = "replay://a.csv" if key == "uri" else "sim://"
    drones = [{"id": 0, "home": [0, 0, 0], "uri": uri}, {"id": 1, "home": [1, 0, 0]}]
    options = {} if key == "uri" else {key: "a.csv"}
    (folder / "own.json").write_text(
        square().replace(drones=drones, graph="path", mission_options=options).dumps()
    )
    config = SwarmConfig.load(folder / "own.json")
    assert list_files(config)
    handed_over = config.dumps()
    assert handed_over.isascii()
    assert SwarmConfig.loads(handed_over) == config


def test_a_name_that_no_file_can_have_is_refused_with_its_key(tmp_path: Path) -> None:
    for key, changes in (
        ("mission_options.drawing", {}),
        ("drone 0: uri", {"uri": "replay://a\0b.csv"}),
    ):
        drones = [{"id": 0, "home": [0, 0, 0], **changes}]
        options = {} if changes else {"drawing": "a\0b.csv"}
        raw = {
            "name": "one",
            "drones": drones,
            "graph": "empty",
            "mission_options": options,
        }
        (tmp_path / "own.json").write_text(json.dumps(raw))
        with pytest.raises(ConfigError, match=rf"^{key}: found 'a\\x00b.csv'"):
            SwarmConfig.load(tmp_path / "own.json")


def test_a_file_is_found_by_a_name_that_the_locale_cannot_say(tmp_path: Path) -> None:
    raw = {"name": "one", "drones": [{"id": 0, "home": [0, 0, 0]}], "graph": "empty"}
    (tmp_path / "own.json").write_text(
        json.dumps(raw | {"mission_options": {"drawing": "h\xf6rz.csv"}})
    )
    (tmp_path / "h\xf6rz.csv").write_text("0,0,1")
    load = "import sys; from crazychoir import SwarmConfig; config = SwarmConfig.load(sys.argv[1])"
    code = (
        f"{load}; from crazychoir.config.file_paths import list_files; "
        "print(*(path.exists() for path in list_files(config).values()))"
    )
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", code, str(tmp_path / "own.json")]
    done = subprocess.run(
        command,
        env=os.environ | ascii_only,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "True\n", done.stderr


def test_recordings_that_drones_replay_are_relative_to_the_swarm_file_and_count_by_content(
    tmp_path: Path,
) -> None:
    drones = [
        {"id": 0, "home": [0, 0, 0], "uri": "replay://../a.csv?drone=2"},
        {"id": 1, "home": [1, 0, 0]},
    ]
    for lab in ("here", "there"):
        (tmp_path / lab / "lab").mkdir(parents=True)
        (tmp_path / lab / "a.csv").write_text("t,x,y,z,yaw")
        text = square().replace(drones=drones, graph="path").dumps()
        (tmp_path / lab / "lab" / "own.json").write_text(text)
    here, there = (
        SwarmConfig.load(tmp_path / lab / "lab" / "own.json")
        for lab in ("here", "there")
    )
    assert here.drone(0).uri == f"replay://{tmp_path / 'here' / 'a.csv'}?drone=2"
    assert here.drone(1).uri == "sim://"
    assert compute_digest(here) == compute_digest(there)
    (tmp_path / "there" / "a.csv").write_text("x,y")
    assert compute_digest(here) != compute_digest(there)
    assert SwarmConfig.loads(here.dumps()) == here
