"""The file: what is refused before a flight, and what is left when the disk fails."""

import errno
import os

import pytest
from ros2_decoders import by_mcap_ros2, by_rosbags

from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.file import (
    RECORDING_FORMAT,
    RecordingEntry,
    RecordingFile,
    Series,
)
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.mcap.reading import read, read_header
from crazychoir.types import Pose, State

ABOUT = {"version": "1.2", "mission": "probe", "seed": "3", "time": "virtual"}
SECOND = 1_000_000_000


def opened(path, durable=False):
    return RecordingFile(path, ABOUT, '{"name": "probe"}', durable)


def entries(series, first, last):
    pack = make_packer(series.message, series.drone)
    times = [(k, k * SECOND) for k in range(first, last)]
    return [
        RecordingEntry(series, ns + 5, ns, pack(State.at((k, 0, 0)), ns))
        for k, ns in times
    ]


def truth(drone=0):
    return Series(drone, "truth", FORM_BY_VALUE_TYPE[State])


def test_a_file_says_what_was_flown(tmp_path):
    path = tmp_path / "new" / "a.mcap"
    file, series = opened(path), truth()
    file.write(entries(series, 0, 3))
    file.write(entries(truth(1), 3, 5))
    file.write([])
    file.close()
    file.close()
    assert file.written == 5
    recording = read(path, ("truth",))
    assert (recording.about, recording.swarm, recording.complete) == (
        ABOUT,
        '{"name": "probe"}',
        True,
    )
    assert (recording.drones, recording.seconds) == ([0, 1], (5e-9, 4.000000005))
    assert recording.of(0, "truth").numbers[:, 0].tolist() == [0, 1, 2]
    assert recording.of(0, "truth").came.tolist() == [5e-9, 1.000000005, 2.000000005]
    assert recording.of(1, "truth").born.tolist() == [3.0, 4.0]
    assert len(recording.of(2, "truth")) == 0
    assert by_mcap_ros2(path) == by_rosbags(path)
    assert [name for name, *_ in by_rosbags(path)] == 3 * ["/drone0/truth"] + 2 * [
        "/drone1/truth"
    ]


@pytest.mark.parametrize(
    ("lost", "said", "outcome"),
    [
        (
            0,
            None,
            {"lost": "0", "missed": "0", "ended": RECORDING_FORMAT.unknown_ending},
        ),
        (
            7,
            {"ended": "Ctrl-C", "digest": "ab"},
            {"lost": "7", "missed": "0", "ended": "Ctrl-C", "digest": "ab"},
        ),
    ],
)
def test_it_always_says_what_it_lacks_and_how_it_ended(tmp_path, lost, said, outcome):
    path = tmp_path / "a.mcap"
    file = opened(path)
    file.write(entries(truth(), 0, 3))
    file.lost += lost
    file.close(said)
    recording = read_header(path)
    assert (recording.outcome, recording.lost, recording.complete) == (
        outcome,
        lost,
        True,
    )


def test_what_comes_after_the_end_is_lost(tmp_path):
    file = opened(tmp_path / "a.mcap")
    file.write(entries(truth(), 0, 3))
    file.close()
    file.write(entries(truth(), 3, 5))
    assert (file.written, file.lost, file.error) == (3, 2, "")


def test_a_file_is_never_written_over(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_text("old")
    with pytest.raises(
        ConfigError, match=r"a\.mcap: there is one already; name a new file.*never"
    ):
        opened(path)
    assert path.read_text() == "old"


@pytest.mark.parametrize("name", ["a.bag", "a", "a.mcap/b", ".mcap"])
def test_a_name_that_no_reader_takes_is_refused(tmp_path, name):
    with pytest.raises(ConfigError, match=r"--record.*ends in \.mcap"):
        opened(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"--record.*its folder is a file"):
        opened(tmp_path / "file" / "a.mcap")


def test_a_full_disk_is_said_before_the_flight(tmp_path, monkeypatch):
    monkeypatch.setattr(
        os,
        "write",
        lambda *_: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left")),
    )
    with pytest.raises(ConfigError, match="No space left"):
        opened(tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


def test_without_a_message_there_is_no_file(tmp_path):
    opened(tmp_path / "a.mcap").close()
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_ends_the_recording_and_keeps_what_is_there(
    tmp_path, monkeypatch
):
    path = tmp_path / "a.mcap"
    file, series = opened(path), truth()
    file.write(entries(series, 0, 10))
    whole, write = path.stat().st_size, os.write
    room = [100]

    def full(fd, data):
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        n = write(fd, data[: room[0]])
        room[0] -= n
        return n

    monkeypatch.setattr(os, "write", full)
    file.write(entries(series, 10, 20))
    assert (file.error, file.written, file.lost) == ("No space left on device", 10, 10)
    assert path.stat().st_size == whole, "no part of a chunk"
    monkeypatch.undo()
    file.write(entries(series, 20, 30))
    file.close()
    assert file.lost == 20
    recording = read(path, ("truth",))
    assert (len(recording.of(0, "truth")), recording.complete) == (10, False)


def test_on_the_disk_once_a_second_in_real_time_alone(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fdatasync", synced.append)
    for durable, times in ((True, 4), (False, 0)):
        file, series = (
            opened(tmp_path / f"{durable}.mcap", durable),
            Series(0, "pose", FORM_BY_VALUE_TYPE[Pose]),
        )
        pack = make_packer(series.message, 0)
        for tenth in range(10, 35):  # s / 10
            ns = tenth * SECOND // 10
            file.write(
                [
                    RecordingEntry(
                        series, ns, ns, pack(Pose(State.at((0, 0, 0)).flat[:7]), ns)
                    )
                ]
            )
        assert len(synced) == times, "at the beginning, and at 1, 2 and 3 s"
        file.close()
        synced.clear()


def test_nothing_raises_in_flight(tmp_path):
    file, series = opened(tmp_path / "a.mcap"), truth()
    file.write([*entries(series, 0, 3), RecordingEntry(series, 1, -1, b"")])
    assert file.error.startswith("error: ")
    assert (file.written, file.lost) == (0, 4)
    file.close()
