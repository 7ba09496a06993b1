"""Files that are no recording, are cut off or spoilt."""

import io
import struct
import tracemalloc

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.file import (
    RECORDING_FORMAT,
    RecordingEntry,
    RecordingFile,
    Series,
)
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE, make_packer
from crazychoir.recording.mcap.reading import read, read_header
from crazychoir.recording.mcap.records import MESSAGE_HEADER
from crazychoir.recording.mcap.sequence import read_messages
from crazychoir.types import State

CHUNKS, EACH = 5, 20


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """The bytes of a recording of CHUNKS chunks, with EACH states of drone 4, numbered in x."""
    path = tmp_path_factory.mktemp("recording") / "a.mcap"
    file, series = (
        RecordingFile(path, {"version": "1"}, "{}", False),
        Series(4, "state", FORM_BY_VALUE_TYPE[State]),
    )
    pack = make_packer(series.message, 4)
    for chunk in range(CHUNKS):
        numbers = range(chunk * EACH, (chunk + 1) * EACH)
        file.write(
            [
                RecordingEntry(series, k, k, pack(State.at((k, 0, 0)), k))
                for k in numbers
            ]
        )
    file.close()
    return path.read_bytes()


def found(path, content):
    path.write_bytes(content)
    recording = read(path, ("state",))
    return recording.of(4, "state").numbers[:, 0].tolist(), recording.complete


def test_whole(tmp_path, content):
    assert found(tmp_path / "a.mcap", content) == (list(range(CHUNKS * EACH)), True)


def test_cut_off_anywhere_every_whole_chunk_is_there(tmp_path, content):
    seen = []
    for end in range(len(content) - 1, 0, -97):
        try:
            numbers, complete = found(tmp_path / "a.mcap", content[:end])
        except ConfigError:
            numbers, complete = [], False
        assert numbers == list(range(len(numbers)))
        assert len(numbers) % EACH == 0
        assert not complete or end > len(content) - 9
        seen.append(len(numbers))
    assert seen == sorted(seen, reverse=True)
    assert set(seen) == {EACH * k for k in range(CHUNKS + 1)}


def chunk(content, k):
    """Where the data of a chunk begins: at the magic number of zstd."""
    return [
        at for at in range(len(content)) if content[at : at + 4] == b"\x28\xb5\x2f\xfd"
    ][k]


def test_what_a_power_cut_leaves(tmp_path, content):
    """Blocks that were never written are zeros; what lies before them counts."""
    half = found(tmp_path / "a.mcap", content[: len(content) // 2] + bytes(1000))
    assert half in [(list(range(EACH * k)), False) for k in range(1, CHUNKS)]
    hole = chunk(content, 2) - 49 - len("zstd")  # the record's opcode
    assert content[hole] == 6
    beyond = content[:hole] + bytes(9 * 11) + content[hole:]
    assert found(tmp_path / "a.mcap", beyond) == (list(range(2 * EACH)), False)


def test_a_spoilt_chunk_ends_it(tmp_path, content):
    third = chunk(content, 2)
    for at in range(third, third + 200, 3):
        spoilt = bytearray(content)
        spoilt[at] ^= 0x10
        assert found(tmp_path / "a.mcap", bytes(spoilt)) == (
            list(range(2 * EACH)),
            False,
        )


def test_a_header_says_whether_all_is_whole(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    whole = read_header(path)
    assert (whole.complete, whole.fault, whole.chunks, whole.topics) == (
        True,
        "",
        CHUNKS,
        {},
    )
    third = chunk(content, 2)
    spoilt = bytearray(content)
    spoilt[third + 20] ^= 0x10
    path.write_bytes(spoilt)
    begin = third - 49 - len("zstd")  # of the record
    assert (
        read_header(path).complete,
        read_header(path).fault,
        read_header(path).chunks,
    ) == (
        False,
        f"spoilt at byte {begin}",
        2,
    )
    path.write_bytes(content[:third])
    assert (read_header(path).fault, read_header(path).chunks) == (
        f"cut off at byte {begin}",
        2,
    )
    ended = content.replace(b"lost\x01\0\0\x000", b"lost\x01\0\0\0x")
    assert ended != content
    path.write_bytes(ended)
    assert read_header(path).fault.startswith("spoilt at byte"), (
        "how many it lacks cannot be read"
    )


def test_what_ended_before_its_first_chunk_has_no_header(tmp_path, content):
    path = tmp_path / "a.mcap"
    begin = chunk(content, 0) - 49 - len("zstd")
    path.write_bytes(content[:begin])
    with pytest.raises(
        ConfigError,
        match=rf"no message: it was cut off at byte {begin}; allowed: a recording",
    ):
        read_header(path)


def test_spoilt_anywhere_it_is_read_or_refused(tmp_path, content):
    for at in range(8, len(content), 37):
        spoilt = bytearray(content)
        spoilt[at] ^= 0xFF
        try:
            numbers, _ = found(tmp_path / "a.mcap", bytes(spoilt))
        except ConfigError:
            continue
        assert numbers == list(range(len(numbers)))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "an empty file"),
        (b"\x89PNG\r\n\x1a\n picture", "begins with"),
        (b"\x89MCAP0\r\n", "another program"),
        (b"\x89MCAP0\r\n" + bytes(99), "another program"),
    ],
)
def test_no_recording(tmp_path, content, words):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=rf"a\.mcap.*{words}.*--record"):
        read(path, ("state",))


def test_the_recording_of_another_program(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(
            "/chatter", "json", writer.register_schema("any", "jsonschema", b"{}")
        )
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(
        ConfigError, match="of another program; allowed: one of crazychoir"
    ):
        read(path, ("state",))


def test_a_long_recording_takes_little_more_than_its_numbers(tmp_path):
    """A state has 13 numbers and two times, 120 bytes; twice as much while it is read."""
    path, series = tmp_path / "a.mcap", Series(4, "state", FORM_BY_VALUE_TYPE[State])
    file, pack = (
        RecordingFile(path, {"version": "1"}, "{}", False),
        make_packer(series.message, 4),
    )
    count, at_once = 20_000, 500
    for first in range(0, count, at_once):
        states = [(k, State.at((0.1 * k, 0, 0))) for k in range(first, first + at_once)]
        file.write(
            [RecordingEntry(series, k, k, pack(state, k)) for k, state in states]
        )
    file.close()
    tracemalloc.start()
    try:
        values = read(path, ("state",)).of(4, "state")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (values.numbers.shape, values.numbers[-1, 0]) == (
        (count, 13),
        pytest.approx(0.1 * (count - 1)),
    )
    assert peak / count < 240.0


def test_nothing_of_these_topics(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="no truth and no pose"):
        read(path, ("truth", "pose"))


def test_a_recording_of_another_version_is_not_misread(tmp_path, monkeypatch, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    monkeypatch.setitem(FORM_BY_VALUE_TYPE, State, FORM_BY_VALUE_TYPE[dict])
    with pytest.raises(
        ConfigError, match=r"another nav_msgs/msg/Odometry for state.*version"
    ):
        read(path, ("state",))


def test_no_file_and_a_folder(tmp_path):
    for path, words in (
        (tmp_path / "none.mcap", "No such file"),
        (tmp_path, "Is a directory"),
    ):
        with pytest.raises(ConfigError, match=words):
            read(path, ("state",))


def rewritten(path, content, metadata_last=False, **options):
    """The same recording, as another program writes it with these options of the library."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, **options)
        writer.start(profile="ros2", library="another")
        reader = make_reader(io.BytesIO(content))
        if not metadata_last:
            copy_about(writer, reader)
        schemas, channels = {}, {}
        for schema, channel, message in reader.iter_messages():
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[schema.id],
                    channel.metadata,
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
            )
        if metadata_last:
            copy_about(writer, reader)
        writer.finish()
    return path


def copy_about(writer, reader):
    for one in reader.iter_metadata():
        writer.add_metadata(one.name, one.metadata)
    for one in reader.iter_attachments():
        writer.add_attachment(
            one.create_time, one.log_time, one.name, one.media_type, one.data
        )


NO_SUMMARY = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_chunking": False, **NO_SUMMARY},
        {"use_chunking": False, "metadata_last": True},
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"enable_crcs": False},
        NO_SUMMARY,
        {"metadata_last": True},
    ],
    ids=str,
)
def test_a_recording_that_another_program_has_rewritten_is_read_as_it_was(
    tmp_path, content, options
):
    path = rewritten(tmp_path / "a.mcap", content, **options)
    recording = read(path, ("state",))
    assert recording.of(4, "state").numbers[:, 0].tolist() == list(range(CHUNKS * EACH))
    assert recording.complete
    assert (read_header(path).complete, read_header(path).swarm) == (True, "{}")
    before = tmp_path / "before.mcap"
    before.write_bytes(content)
    assert [(m.came_ns, m.born_ns, m.data) for m in read_messages(path)] == [
        (m.came_ns, m.born_ns, m.data) for m in read_messages(before)
    ]


def test_every_whole_message_of_a_cut_off_recording_without_chunks_is_there(
    tmp_path, content
):
    whole = rewritten(tmp_path / "whole.mcap", content, use_chunking=False).read_bytes()
    seen = []
    for end in range(len(whole) // 2, 0, -97):
        try:
            numbers, complete = found(tmp_path / "a.mcap", whole[:end])
        except ConfigError:
            numbers, complete = [], False
        assert not complete
        assert numbers == list(range(len(numbers)))
        seen.append(len(numbers))
    assert seen == sorted(seen, reverse=True)
    assert len(set(seen)) > 20, "message by message, not chunk by chunk"


def test_a_recording_without_a_message_is_refused_whether_it_has_chunks_or_not(
    tmp_path,
):
    for chunking in (True, False):
        path = tmp_path / f"{chunking}.mcap"
        with path.open("wb") as file:
            writer = Writer(file, use_chunking=chunking)
            writer.start()
            writer.add_metadata(RECORDING_FORMAT.about_record, {"version": "1"})
            schema = writer.register_schema("nav_msgs/msg/Odometry", "ros2msg", b"")
            writer.register_channel(
                "/drone4/state", "cdr", schema, {"drone": "4", "topic": "state"}
            )
            writer.finish()
        with pytest.raises(ConfigError, match="no message"):
            read_header(path)


def test_a_compression_that_is_not_known_is_named(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content.replace(b"\x04\x00\x00\x00zstd", b"\x04\x00\x00\x00brot"))
    with pytest.raises(
        ConfigError, match="compressed by 'brot', where zstd, lz4 and nothing are read"
    ):
        read_header(path)


def test_a_message_of_a_channel_that_is_not_there_is_refused(tmp_path):
    path = tmp_path / "a.mcap"
    message = MESSAGE_HEADER.pack(7, 0, 1, 1)
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        writer.add_metadata(RECORDING_FORMAT.about_record, {"version": "1"})
        writer.finish()
    whole = path.read_bytes()
    record = struct.pack("<BQ", Opcode.MESSAGE, len(message)) + message
    data_end = whole.rindex(struct.pack("<BQ", Opcode.DATA_END, 4))
    path.write_bytes(whole[:data_end] + record + whole[data_end:])
    with pytest.raises(ConfigError, match="channel 7, which is not there"):
        list(read_messages(path))
