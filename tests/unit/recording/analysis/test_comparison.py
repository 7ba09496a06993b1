"""Recordings of what should be one flight: the same, or where they first differ."""

import pytest

from crazychoir.errors import ConfigError
from crazychoir.recording.analysis.comparison import first_difference
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.types import State, Status

TENTH = 100_000_000
STATES = [(k * TENTH, 0, "state", State.at((k, 0, 0))) for k in range(10)]
STATUSES = [
    (k * TENTH, 2, "status", Status("mission", "at task 3", round=k)) for k in range(10)
]
FLIGHT = [message for pair in zip(STATES, STATUSES, strict=True) for message in pair]


def recorded(path, flight):
    file, series = RecordingFile(path, {"version": "1"}, "{}", False), {}
    for came_ns, drone, topic, value in flight:
        one = series.setdefault(
            (drone, topic), Series(drone, topic, FORM_BY_VALUE_TYPE[type(value)])
        )
        file.write(
            [
                RecordingEntry(
                    one,
                    came_ns,
                    came_ns,
                    make_packer(one.message, drone)(value, came_ns),
                )
            ]
        )
    file.close()
    return path


@pytest.fixture
def original(tmp_path):
    return recorded(tmp_path / "a.mcap", FLIGHT)


def instead(k, *message):
    return [*FLIGHT[:k], *message, *FLIGHT[k + 1 :]]


def test_messages_come_in_order_with_their_fields(original):
    found = list(read_messages(original))
    assert [(one.came_ns, one.source.drone, one.source.topic) for one in found] == [
        row[:3] for row in FLIGHT
    ]
    last = found[-1].values()
    assert (last["header.stamp.sec"], last["header.stamp.nanosec"]) == (0, 900_000_000)
    assert (last["phase"], last["task"], last["round"], last["suspect"]) == (
        "mission",
        "at task 3",
        9,
        [],
    )
    assert found[-2].values()["pose.pose.position.x"] == 9.0


def test_equal_recordings_do_not_differ(original, tmp_path):
    assert first_difference(original, recorded(tmp_path / "b.mcap", FLIGHT)) is None


@pytest.mark.parametrize(
    ("flight", "says"),
    [
        (
            instead(6, (3 * TENTH, 0, "state", State.at((3, 1e-9, 0)))),
            "at 0.300 s in /drone0/state: pose.pose.position.y: 0.0 first, 1e-09 then",
        ),
        (
            instead(
                7, (3 * TENTH, 2, "status", Status("mission", "at task 4", round=3))
            ),
            "at 0.300 s in /drone2/status: task: at task 3 first, at task 4 then",
        ),
        (
            instead(6, (3 * TENTH + 5, 0, "state", State.at((3, 0, 0)))),
            "at 0.300 s in /drone0/state: header.stamp.nanosec: 300000000 first, 300000005 then",
        ),
        (
            [*FLIGHT[:6], FLIGHT[7], FLIGHT[6], *FLIGHT[8:]],
            "at 0.300 s in /drone0/state: order of messages: /drone0/state first, /drone2/status then",
        ),
        (
            FLIGHT[:-1],
            "at 0.900 s in /drone2/status: end: the message first, no message then",
        ),
        (
            [*FLIGHT, (TENTH * 12, 2, "status", Status("x"))],
            "at 1.200 s in /drone2/status: end: no message first, the message then",
        ),
    ],
)
def test_where_they_first_differ(original, tmp_path, flight, says):
    assert (
        str(first_difference(original, recorded(tmp_path / "b.mcap", flight))) == says
    )


def test_a_truncated_recording_is_compared_as_far_as_it_goes(original, tmp_path):
    cut = tmp_path / "cut.mcap"
    content = original.read_bytes()
    cut.write_bytes(content[: len(content) // 3])
    assert 0 < len(list(read_messages(cut))) < len(FLIGHT)
    assert first_difference(cut, original) is None
    assert str(first_difference(original, cut)).endswith(
        "end: the message first, no message then"
    )


def test_the_messages_say_why_there_are_no_more(original, tmp_path):
    whole, content = read_messages(original), original.read_bytes()
    assert whole.fault == "not read"
    assert (len(list(whole)), whole.fault) == (len(FLIGHT), "")
    found, chunks = (
        [],
        [
            at
            for at in range(len(content))
            if content[at : at + 4] == b"\x28\xb5\x2f\xfd"
        ],
    )
    for spoilt, text in (
        (b"", "cut off"),
        (b"\xff" + content[chunks[5] + 1 :], "spoilt"),
    ):
        path = tmp_path / f"{text}.mcap"
        path.write_bytes(content[: chunks[5]] + spoilt)
        messages = read_messages(path, ("status",))
        found.append([message.values()["round"] for message in messages])
        assert messages.fault == f"{text} at byte {chunks[5] - 49 - len('zstd')}"
        assert first_difference(path, original) is None
    assert found == [[0, 1], [0, 1]]


def test_no_recording(tmp_path):
    (tmp_path / "a.mcap").write_text("text")
    with pytest.raises(ConfigError, match=r"a\.mcap.*an MCAP file"):
        list(read_messages(tmp_path / "a.mcap"))
