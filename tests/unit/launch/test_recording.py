"""What a recording says of the files that its flight depends on."""

import hashlib
import json
import sys

import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.recording import (
    FILES_KEY,
    compute_file_digests,
    list_changed_files,
    make_recording,
)
from crazychoir.recording.mcap.file import RecordingEntry, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.mcap.reading import read_header

MISSION = """
import numpy
from gains_of_a_test import GAIN
import laws_of_a_test.linear

def guidance(i, config):
    return None
"""


def sha(text):
    return hashlib.sha256(text.encode()).hexdigest()


@pytest.fixture
def flown(tmp_path, monkeypatch):
    """A swarm and its mission in a folder, with a module beside it, one below, and files that the swarm file names."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "laws_of_a_test").mkdir()
    (tmp_path / "laws_of_a_test" / "__init__.py").write_text("")
    (tmp_path / "laws_of_a_test" / "linear.py").write_text("K = 1\n")
    (tmp_path / "gains_of_a_test.py").write_text("GAIN = 2\n")
    (tmp_path / "not_imported.py").write_text("")
    (tmp_path / "law.py").write_text(MISSION)
    (tmp_path / "tasks.json").write_text("[]")
    (tmp_path / "old.csv").write_text("t,x\n")
    rows = [
        {"id": 0, "home": [0, 0, 0]},
        {"id": 3, "home": [1, 0, 0], "uri": f"replay://{tmp_path}/old.csv?drone=3"},
    ]
    options = {
        "instance": str(tmp_path / "tasks.json"),
        "drawing": str(tmp_path / "none.csv"),
        "gain": 2,
    }
    config = SwarmConfig.of({"name": "a", "drones": rows, "mission_options": options})
    yield config, load_mission(str(tmp_path / "law.py"))
    for name in [
        name
        for name in sys.modules
        if name.endswith("_of_a_test") or name.startswith("laws_of_a_test")
    ]:
        del sys.modules[name]


EXPECTED = {
    "mission_options.instance": sha("[]"),
    "drone 3: uri": sha("t,x\n"),
    "gains_of_a_test.py": sha("GAIN = 2\n"),
    "laws_of_a_test/__init__.py": sha(""),
    "laws_of_a_test/linear.py": sha("K = 1\n"),
}


def test_named_files_and_modules_beside_the_mission_are_told(flown, tmp_path):
    assert compute_file_digests(*flown) == EXPECTED, (
        "no library, no file that is not there, nothing of where they lie"
    )
    assert compute_file_digests(flown[0], None) == {
        name: EXPECTED[name] for name in list(EXPECTED)[:2]
    }


def test_those_of_a_recording_are_compared_with_those_of_now(flown, tmp_path):
    config, mission = flown
    file, message = (
        make_recording(tmp_path / "a.mcap", config, mission, virtual=True),
        FORM_BY_VALUE_TYPE[str],
    )
    file.write(
        [
            RecordingEntry(
                Series(0, "log", message), 0, 0, make_packer(message, 0)("a line", 0)
            )
        ]
    )
    file.close()
    told = json.loads(read_header(tmp_path / "a.mcap").about[FILES_KEY])
    assert told == EXPECTED
    assert list_changed_files(told, config, mission) == {}
    (tmp_path / "tasks.json").write_text("[1]")
    (tmp_path / "gains_of_a_test.py").write_text("GAIN = 3\n")
    (tmp_path / "laws_of_a_test" / "linear.py").unlink()
    assert list_changed_files(told, config, mission) == {
        "mission_options.instance": "its content is another now",
        "gains_of_a_test.py": "its content is another now",
        "laws_of_a_test/linear.py": "it is not there any more",
    }
