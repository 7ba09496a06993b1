"""What commands say of recordings that were cut off, are spoilt, lack messages, or have none."""

import json

import pytest
from typer.testing import CliRunner

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.cli.main import app
from crazychoir.config.swarm_config import default_swarm
from crazychoir.launch import flight
from crazychoir.launch.recording import describe_flight
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.mcap.reading import read_header

CHUNKS, EACH = 4, 5
MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of data that zstd has packed: the data of a chunk."""
CONFIG = default_swarm(2).replace(mission="goto")


def written(path, lost=0):
    """Lines of drone 0 in some chunks."""
    file = RecordingFile(
        path, describe_flight(CONFIG, virtual=True), CONFIG.dumps(), False
    )
    series = Series(0, DRONE_TOPICS.log.name, FORM_BY_VALUE_TYPE[str])
    pack = make_packer(series.message, 0)
    for k in range(CHUNKS):
        file.write(
            [
                RecordingEntry(series, n, n, pack(f"line {n}", n))
                for n in range(k * EACH, (k + 1) * EACH)
            ]
        )
    file.lost = lost
    file.close()
    return path.read_bytes()


def chunk(content, k):
    return [at for at in range(len(content)) if content.startswith(MAGIC, at)][k]


def cut(content):
    return content[: chunk(content, 2)]


def spoilt(content):
    at = chunk(content, 2) + 12
    return content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :]


def said(*words):
    done = CliRunner().invoke(app, [str(word) for word in (*words, "--json")])
    return done.exit_code, json.loads(done.stdout), " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("harm", "words"), [(cut, "was cut off at byte"), (spoilt, "was spoilt at byte")]
)
@pytest.mark.parametrize("options", [(), ("--partial",)])
def test_a_bag_of_a_part_is_no_success_unless_it_was_asked_for(
    tmp_path, harm, words, options
):
    path = tmp_path / "a.mcap"
    path.write_bytes(harm(written(tmp_path / "whole.mcap")))
    code, told, aside = said("convert", path, "--rosbag2", tmp_path / "bag", *options)
    assert (code, told["success"]) == ((0, True) if options else (1, False))
    assert (told["complete"], told["messages"]) == (False, 2 * EACH)
    assert f"a.mcap: the recording {words}" in aside
    assert "the bag has what lies before" in aside


def test_a_bag_of_all(tmp_path):
    written(tmp_path / "a.mcap", lost=3)
    code, told, aside = said(
        "convert", tmp_path / "a.mcap", "--rosbag2", tmp_path / "bag"
    )
    assert (code, told["success"], told["complete"], told["lost"]) == (0, True, True, 3)
    assert told["messages"] == CHUNKS * EACH
    assert "messages lost while it was recorded: 3" in aside


@pytest.mark.parametrize(
    "command", [("convert", "--rosbag2", "bag"), ("replay",), ("rerun",)]
)
def test_a_recording_without_a_message_is_refused(tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    content = written(tmp_path / "whole.mcap")
    (tmp_path / "a.mcap").write_bytes(content[: chunk(content, 0)])
    code, told, aside = said(command[0], "a.mcap", *command[1:])
    assert (code, told["success"], told["kind"]) == (2, False, "ConfigError")
    assert "a.mcap: found no message: it was cut off at byte" in aside
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(
    ("harm", "complete"), [(cut, False), (spoilt, False), (bytes, True)]
)
def test_a_replay_says_what_is_not_said(tmp_path, monkeypatch, harm, complete):
    async def replaying(*arguments):
        return {"messages": 1, "seconds": 0.0}

    monkeypatch.setattr("crazychoir.cli.recordings.replay._replay", replaying)
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(tmp_path / "crazychoir"))
    path = tmp_path / "a.mcap"
    path.write_bytes(harm(written(tmp_path / "whole.mcap", lost=2)))
    code, told, aside = said("replay", path)
    assert (code, told["complete"]) == (0, complete)
    assert ("what lies before is said" in aside) is not complete
    assert (told["lost"], "lost while it was recorded: 2" in aside) == (
        (2, True) if complete else (0, False)
    )


@pytest.mark.parametrize(
    ("harm", "complete"), [(cut, False), (spoilt, False), (bytes, True)]
)
def test_a_rerun_is_compared_as_far_as_the_recording_goes(
    tmp_path, monkeypatch, harm, complete
):
    def flies_the_same(config, mission, progress, file):
        """Write the lines of `written`, and one more."""
        series = Series(0, DRONE_TOPICS.log.name, FORM_BY_VALUE_TYPE[str])
        pack = make_packer(series.message, 0)
        file.write(
            [
                RecordingEntry(series, n, n, pack(f"line {n}", n))
                for n in range(CHUNKS * EACH + 1)
            ]
        )
        return {"digest": "ab", "simulated_s": 1.0, "wall_s": 1.0}

    monkeypatch.setattr(flight, "fly_fast", flies_the_same)
    path = tmp_path / "a.mcap"
    path.write_bytes(harm(written(tmp_path / "whole.mcap")))
    code, told, aside = said("rerun", path, "--record", tmp_path / "again.mcap")
    assert (told["complete"], told["same"]) == (complete, not complete)
    assert (code, told["success"]) == (1, False), (
        "half a recording proves nothing of the whole flight"
    )
    assert ("it is compared as far as it goes" in aside) is not complete
    assert (
        "no message first, the message then" in (told["first_difference"] or "")
    ) is complete
    assert read_header(tmp_path / "again.mcap").complete
