"""The bytes of a file: what others find in its index, its checksums, and messages out of order."""

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import SummaryOffset
from mcap.stream_reader import StreamReader

from crazychoir.recording.mcap.writer import McapWriter

SCHEMA = "string data"


@pytest.fixture
def path(tmp_path):
    """Write two chunks of two channels; the second opens a third channel. Messages came at 9, 3, 5, 7 and 20 ns."""
    writer = McapWriter()
    writer.begin("ros2", "a library")
    writer.metadata("about", {"seed": "3"})
    writer.attachment("swarm.json", "application/json", b"{}")
    schema = writer.schema("a/msg/A", "ros2msg", SCHEMA)
    one, two = (
        writer.channel(f"/{name}", "cdr", schema, {"drone": name})
        for name in ("one", "two")
    )
    writer.chunk([(one, 9, 8, b"nine"), (two, 3, 3, b"three"), (one, 5, 5, b"five")])
    first = writer.take()
    three = writer.channel("/three", "cdr", schema, {})
    writer.chunk([(two, 7, 6, b"seven"), (three, 20, 0, b"")])
    writer.metadata("outcome", {"digest": "ab"})
    writer.finish()
    path = tmp_path / "a.mcap"
    path.write_bytes(first + writer.take())
    return path


def test_others_find_everything_by_its_index(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().library == "a library"
        assert {channel.topic for channel in summary.channels.values()} == {
            "/one",
            "/two",
            "/three",
        }
        counts = summary.statistics
        assert (counts.message_count, counts.channel_message_counts) == (
            5,
            {1: 2, 2: 2, 3: 1},
        )
        assert (
            counts.message_start_time,
            counts.message_end_time,
            counts.chunk_count,
        ) == (3, 20, 2)
        assert (counts.schema_count, counts.channel_count) == (1, 3)
        assert (counts.attachment_count, counts.metadata_count) == (1, 2)
        assert [
            (one.name, one.encoding, one.data) for one in summary.schemas.values()
        ] == [("a/msg/A", "ros2msg", SCHEMA.encode())]
        assert [one.metadata for one in summary.channels.values()] == [
            {"drone": "one"},
            {"drone": "two"},
            {},
        ]
        assert [one.metadata for one in reader.iter_metadata()] == [
            {"seed": "3"},
            {"digest": "ab"},
        ]
        assert [one.data for one in reader.iter_attachments()] == [b"{}"]
        found = [
            (channel.topic, m.log_time, m.publish_time, m.data)
            for _, channel, m in reader.iter_messages()
        ]
    assert found == [
        ("/two", 3, 3, b"three"),
        ("/one", 5, 5, b"five"),
        ("/two", 7, 6, b"seven"),
        ("/one", 9, 8, b"nine"),
        ("/three", 20, 0, b""),
    ]


def test_they_find_a_part_of_it(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        late = [
            m.data
            for *_, m in reader.iter_messages(topics=["/two", "/three"], starting_at=4)
        ]
    assert late == [b"seven", b""]


def test_a_chunk_index_says_where_each_chunk_lies_and_what_times_it_has(path):
    content = path.read_bytes()
    with path.open("rb") as file:
        one, other = make_reader(file).get_summary().chunk_indexes
    assert [(x.message_start_time, x.message_end_time) for x in (one, other)] == [
        (3, 9),
        (7, 20),
    ]
    for index in (one, other):
        begin, packed = index.chunk_start_offset, index.compressed_size
        assert content[begin] == Opcode.CHUNK
        assert (
            int.from_bytes(content[begin + 1 : begin + 9], "little") + 9
            == index.chunk_length
        )
        data = content[begin + index.chunk_length - packed : begin + index.chunk_length]
        assert data[:4] == b"\x28\xb5\x2f\xfd", "as long as it is said"
        assert content[begin + index.chunk_length] == Opcode.MESSAGE_INDEX


def test_groups_of_the_summary_lie_one_after_the_other(path):
    content = path.read_bytes()
    with path.open("rb") as file:
        groups = [
            one
            for one in StreamReader(file, emit_chunks=True).records
            if isinstance(one, SummaryOffset)
        ]
    start, offsets = (
        int.from_bytes(content[k : k + 8], "little") for k in (-28, -20)
    )  # of the footer
    assert [content[one.group_start] for one in groups] == [
        one.group_opcode for one in groups
    ]
    assert len(groups) == 6
    ends = [one.group_start + one.group_length for one in groups]
    assert [start, *ends] == [*(one.group_start for one in groups), offsets]
    assert content[offsets] == Opcode.SUMMARY_OFFSET


def test_a_message_index_says_where_each_message_lies(path):
    """Players that seek read these, and no other message of a chunk."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        content = path.read_bytes()
    first = summary.chunk_indexes[0]
    assert sorted(first.message_index_offsets) == [1, 2]
    at = first.message_index_offsets[1]
    assert content[at] == 0x07
    assert int.from_bytes(content[at + 9 : at + 11], "little") == 1
    times = [int.from_bytes(content[k : k + 8], "little") for k in (at + 15, at + 31)]
    assert times == [9, 5]
    assert first.message_index_length == sum(9 + 6 + 16 * n for n in (2, 1))
