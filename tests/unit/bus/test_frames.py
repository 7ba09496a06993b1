import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crazychoir.bus.codec import MAX_PAYLOAD, decode, encode
from crazychoir.bus.frames import (
    FRAME_FORMAT,
    Envelope,
    Frame,
    FrameBuffer,
    FrameVersionError,
    decode_frame,
    encode_frame,
)
from crazychoir.errors import CodecError

ADDRESSES = st.integers(0, 2**32 - 1)
COUNTS = st.integers(0, 2**64 - 1)
ENVELOPES = st.builds(
    Envelope,
    topic=st.integers(0, 2**16 - 1),
    source=ADDRESSES,
    to=st.lists(ADDRESSES, max_size=5).map(tuple),
    number=COUNTS,
    payload=st.binary(max_size=100),
    age=st.floats(0, 1e9),
    channel=st.text(max_size=20),
    flags=ADDRESSES,
)
FRAMES = st.builds(
    Frame,
    st.text(max_size=20),
    COUNTS,
    st.integers(0, 255),
    st.lists(ENVELOPES, max_size=8),
)


def envelope(topic=1, source=3, to=(1,), number=0, payload=b"x", channel="", age=0.0):
    return Envelope(topic, source, to, number, 0, age, channel, payload)


def contents(frames):
    return [one for data in frames for one in decode_frame(data).envelopes]


@given(FRAMES)
def test_frames_arrive_as_they_were_sent(frame):
    data = encode_frame(frame)
    assert decode_frame(data) == frame
    assert decode_frame(memoryview(bytearray(data))) == frame


@given(st.binary(max_size=100))
def test_random_bytes_raise_nothing_but_codec_error(data):
    for received in (
        data,
        bytes([FRAME_FORMAT.version]) + data,
        bytes([FRAME_FORMAT.version]) + b"\x94\xa1a\x01\x01\x91\x98" + data,
    ):
        try:
            decode_frame(received)
        except CodecError:
            continue


def test_another_version_is_told_apart():
    data = encode_frame(Frame("cf3", 1, 2, []))
    with pytest.raises(
        FrameVersionError,
        match=f"version {FRAME_FORMAT.version + 1}; allowed: {FRAME_FORMAT.version}",
    ) as caught:
        decode_frame(bytes([FRAME_FORMAT.version + 1]) + data[1:])
    assert caught.value.found == FRAME_FORMAT.version + 1
    assert isinstance(caught.value, CodecError)
    with pytest.raises(CodecError) as caught:
        decode_frame(data[:-1])
    assert not isinstance(caught.value, FrameVersionError)


def raw(
    topic=1, source=3, to=(1,), number=0, flags=0, age=0.0, channel="", payload=b"x"
):
    fields = [topic, source, to, number, flags, age, channel, payload]
    return bytes([FRAME_FORMAT.version]) + msgspec.msgpack.encode(
        ["cf3", 1, 2, [fields]]
    )


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes([FRAME_FORMAT.version]),
        raw(topic=-1),
        raw(topic=2**16),
        raw(source=-3),
        raw(source=2**32),
        raw(to=[-1]),
        raw(to=[1.5]),
        raw(to=None),
        raw(to=[1] * (FRAME_FORMAT.max_destinations + 1)),
        raw(number=-1),
        raw(flags=-1),
        raw(age=float("nan")),
        raw(age=-0.001),
        raw(age=float("inf")),
        raw(channel="c" * 256),
        raw(payload="text"),
        bytes([FRAME_FORMAT.version]) + b"\x94\xa1a\x01\x01\xdd\xff\xff\xff\xff",
        bytes([FRAME_FORMAT.version])
        + b"\x94\xa1a\x01\x01\x91\x98\x01\x01\xdd\xff\xff\xff\xff",
        bytes([FRAME_FORMAT.version]) + b"\x94\xa2\xff\xfe\x01\x01\x90",
        bytes([FRAME_FORMAT.version]) + b"\x91" * 100_000,
    ],
)
def test_bad_frames_are_refused(data):
    assert decode_frame(raw()).envelopes == [envelope()]
    with pytest.raises(CodecError):
        decode_frame(data)


def test_the_number_of_envelopes_is_bounded_before_they_are_read():
    many = Frame("cf3", 1, 2, [envelope()] * (FRAME_FORMAT.max_envelopes + 1))
    with pytest.raises(CodecError, match="length <= 4096"):
        decode_frame(encode_frame(many))


def test_frames_are_bounded_both_ways():
    frame = Frame("cf3", 1, 2, [envelope(payload=bytes(1000))])
    data = encode_frame(frame)
    with pytest.raises(CodecError, match="allowed: 1000"):
        encode_frame(frame, limit=1000)
    with pytest.raises(CodecError, match="allowed: 1 to 1000"):
        decode_frame(data, limit=1000)


def test_what_cannot_be_encoded_is_a_codec_error():
    for bad in (
        envelope(number=2**64),
        envelope(channel="\ud800"),
        envelope(payload=object()),
    ):
        with pytest.raises(CodecError, match="frame: cannot be encoded"):
            encode_frame(Frame("cf3", 1, 2, [bad]))


def test_a_buffer_refuses_a_name_that_is_no_text_before_it_spoils_a_frame():
    buffer = FrameBuffer("cf3", 7, 2)
    buffer.add(envelope(channel="zürich"))
    with pytest.raises(CodecError, match="cannot be encoded"):
        buffer.add(envelope(channel="caf\ud800"))
    assert len(buffer.take()) == 1


def test_a_buffer_keeps_the_order_and_is_empty_when_taken():
    buffer = FrameBuffer("cf3", 7, 2)
    sent = [envelope(number=k) for k in range(5)]
    for one in sent:
        buffer.add(one)
    assert len(buffer) == 5
    frames = buffer.take()
    assert len(frames) == 1
    frame = decode_frame(frames[0])
    assert (frame.process, frame.incarnation, frame.kind, frame.envelopes) == (
        "cf3",
        7,
        2,
        sent,
    )
    assert len(buffer) == 0
    assert buffer.take() == []


def test_only_the_newest_of_a_stream_is_kept_when_conflating():
    buffer = FrameBuffer("cf3", 7, 1, conflate=True)
    for number in range(3):
        for source in (3, 4):
            buffer.add(
                envelope(source=source, number=number, payload=bytes([number, source]))
            )
    assert [
        (one.source, one.number, one.payload) for one in contents(buffer.take())
    ] == [
        (3, 2, b"\x02\x03"),
        (4, 2, b"\x02\x04"),
    ]
    assert buffer.conflated == 4
    for source in (4, 3, 4):
        buffer.add(envelope(source=source, number=9))
    assert [one.source for one in contents(buffer.take())] == [4, 3]


@pytest.mark.parametrize(
    "other",
    [{"topic": 2}, {"source": 4}, {"to": (2,)}, {"to": (1, 2)}, {"channel": "b"}],
)
def test_different_streams_are_not_conflated(other):
    buffer = FrameBuffer("cf3", 7, 1, conflate=True)
    buffer.add(envelope())
    buffer.add(envelope(**other))
    assert len(contents(buffer.take())) == 2


@given(
    st.lists(st.integers(0, 700), max_size=60), st.integers(0, 24), st.text(max_size=10)
)
def test_frames_are_split_below_the_limit_and_nothing_is_lost(
    sizes, addressees, channel
):
    buffer = FrameBuffer("cf3", 2**64 - 1, 255, limit=1200)
    sent = [
        envelope(
            number=2**64 - 1 - k,
            to=(2**32 - 1,) * addressees,
            payload=bytes(size),
            channel=channel,
        )
        for k, size in enumerate(sizes)
    ]
    for one in sent:
        buffer.add(one)
    frames = buffer.take()
    assert all(len(data) <= 1200 for data in frames)
    assert contents(frames) == sent
    assert len(frames) <= 1 + sum(sizes) // 100 + len(sizes) // 2


def test_the_largest_payload_fits_a_frame_and_one_byte_more_is_refused_by_the_sender():
    """msgpack adds one byte of kind and five of its own to bytes of this size."""
    largest = encode(bytes(MAX_PAYLOAD - 6))
    assert len(largest) == MAX_PAYLOAD
    with pytest.raises(
        CodecError,
        match=r"value: 600001 bytes when encoded; allowed: 600000. Send less, or in parts.",
    ):
        encode(bytes(MAX_PAYLOAD - 5))
    buffer = FrameBuffer("\N{SNOWMAN}" * FRAME_FORMAT.max_name_length, 2**64 - 1, 255)
    to, name = (
        (2**32 - 1,) * FRAME_FORMAT.max_destinations,
        "\N{SNOWMAN}" * FRAME_FORMAT.max_name_length,
    )
    buffer.add(
        Envelope(2**16 - 1, 2**32 - 1, to, 2**64 - 1, 2**32 - 1, 1e9, name, largest)
    )
    (frame,) = buffer.take()
    assert len(frame) <= FRAME_FORMAT.max_bytes
    (arrived,) = decode_frame(frame).envelopes
    assert decode(arrived.payload) == bytes(MAX_PAYLOAD - 6)
    with pytest.raises(CodecError, match="payload: 600001 bytes; allowed: 600000"):
        decode(largest + b"x")


def test_a_frame_has_no_more_envelopes_than_a_receiver_takes():
    buffer = FrameBuffer("cf3", 1, 2)
    for number in range(FRAME_FORMAT.max_envelopes + 1):
        buffer.add(envelope(number=number))
    frames = buffer.take()
    assert [len(decode_frame(data).envelopes) for data in frames] == [
        FRAME_FORMAT.max_envelopes,
        1,
    ]


@pytest.mark.parametrize(
    "bad",
    [
        envelope(payload=bytes(2000)),
        envelope(age=-1e-9),
        envelope(age=float("nan")),
        envelope(channel="c" * 256),
        envelope(to=(1,) * (FRAME_FORMAT.max_destinations + 1)),
    ],
)
def test_what_would_spoil_a_frame_is_refused_when_added(bad):
    buffer = FrameBuffer("cf3", 1, 2, limit=12_000 if len(bad.to) > 1 else 1200)
    with pytest.raises(CodecError, match="topic 1 of 3: found"):
        buffer.add(bad)
    assert buffer.take() == []
