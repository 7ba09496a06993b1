import math
import struct
import tracemalloc
from datetime import UTC, datetime
from enum import IntEnum

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from crazychoir.bus import codec
from crazychoir.bus.array_codec import PAYLOAD_FORMAT, ArrayPayload
from crazychoir.bus.codec import MAX_DEPTH, decode, encode, register
from crazychoir.errors import CodecError
from crazychoir.types import (
    FPQR,
    Acceleration,
    FullState,
    Goto,
    PerNeighbor,
    Pose,
    State,
    Status,
    Vec,
    Wire,
)


class Color(IntEnum):
    RED = 1


def same(sent, got):
    """Whether `got` is what the codec promises for `sent`."""
    if isinstance(sent, np.ndarray):
        return (
            type(got) is np.ndarray
            and got.dtype == sent.dtype.newbyteorder("=")
            and got.shape == sent.shape
            and np.array_equal(got, sent, equal_nan=sent.dtype.kind == "f")
        )
    if isinstance(sent, Wire):
        return type(sent) is type(got) and all(
            same(a, b)
            for a, b in zip(
                msgspec.structs.astuple(sent), msgspec.structs.astuple(got), strict=True
            )
        )
    if isinstance(sent, list | tuple):
        return type(got) is list and len(sent) == len(got) and all(map(same, sent, got))
    if isinstance(sent, dict):
        return (
            type(got) is dict
            and list(sent) == list(got)
            and all(same(sent[k], got[k]) for k in sent)
        )
    if isinstance(sent, np.generic):
        return same(sent.item(), got)
    return type(sent) is type(got) and (sent == got or (sent != sent and got != got))


INTS = st.integers(-(2**63), 2**64 - 1)
ARRAYS = st.sampled_from(
    [np.dtype(name) for name in PAYLOAD_FORMAT.dtype_names]
).flatmap(
    lambda dtype: hnp.arrays(
        dtype, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)
    )
)
FLOATS = st.floats(width=64)


def wire(cls, size, floats):
    return st.builds(cls, hnp.arrays(np.float64, size), *[FLOATS] * floats)


WIRES = st.one_of(
    wire(Pose, 7, 1),
    wire(State, 13, 1),
    st.builds(State, hnp.arrays(np.float64, 13), FLOATS, hnp.arrays(np.float64, 3)),
    wire(Acceleration, 3, 1),
    wire(FullState, 14, 0),
    wire(Goto, 3, 2),
    wire(FPQR, 4, 0),
    st.builds(
        Status,
        phase=st.text(),
        cost=FLOATS,
        suspect=st.lists(st.integers(0, 9)),
        note=st.text(),
    ),
)
SCALARS = st.one_of(st.none(), st.booleans(), INTS, FLOATS, st.text(), st.binary())
LEAVES = st.one_of(
    SCALARS,
    ARRAYS,
    WIRES,
    st.integers(-100, 100).map(np.int32),
    st.floats(width=32).map(np.float32),
)
KEYS = st.one_of(st.text(), INTS, st.tuples(st.integers(0, 9), st.integers(0, 9)))
VALUES = st.recursive(
    LEAVES,
    lambda parts: st.one_of(
        st.lists(parts), st.tuples(parts, parts), st.dictionaries(KEYS, parts)
    ),
    max_leaves=12,
)


@given(VALUES)
def test_every_value_arrives_as_it_was_sent(value):
    payload = encode(value)
    assert same(value, decode(payload))
    assert same(value, decode(memoryview(bytearray(payload))))


@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_but_codec_error(data):
    for payload in (data, *(bytes([tag]) + data for tag in (64, 65, 66, 67, 81, 86))):
        try:
            value = decode(payload)
        except CodecError:
            continue
        encode(value)


@pytest.mark.parametrize("name", PAYLOAD_FORMAT.dtype_names)
def test_arrays_of_every_dtype_order_and_layout(name):
    array = np.arange(24).astype(name).reshape(2, 3, 4)
    for variant in (
        array,
        array.T,
        array[:, ::2, 1:],
        np.asfortranarray(array),
        array.astype(array.dtype.newbyteorder(">")),
    ):
        assert same(variant, decode(encode(variant)))


def test_arrays_arrive_as_aligned_read_only_views():
    payload = encode(np.arange(6.0))
    arrays = [
        decode(payload),
        decode(encode(np.arange(6).reshape(2, 3))),
        decode(encode(State.at([1, 2, 3]))).flat,
    ]
    arrays += decode(encode(["x", np.arange(3.0), {"s": State.at([1, 2, 3]).flat}]))[
        1:2
    ]
    for array in arrays:
        assert array.flags.aligned
        assert not array.flags.writeable
    assert np.shares_memory(arrays[0], np.frombuffer(payload, np.uint8))
    with pytest.raises(ValueError, match="read-only"):
        decode(memoryview(bytearray(payload)))[0] = 1.0


def test_limits_of_integers_and_dimensions():
    for number in (2**64 - 1, -(2**63)):
        assert decode(encode(number)) == number
    assert decode(encode(np.zeros((1,) * 8))).shape == (1,) * 8
    for value in (2**64, -(2**63) - 1, np.zeros((1,) * 9)):
        with pytest.raises(CodecError, match=r"^value: found"):
            encode(value)


@pytest.mark.parametrize(
    ("value", "where", "what"),
    [
        ({1, 2}, "value", "a set"),
        ([1, {"a": [object()]}], "value[1]['a'][0]", "a object"),
        (bytearray(b"x"), "value", "a bytearray"),
        ([datetime.now(UTC)], "value[0]", "datetime"),
        ({"c": Color.RED}, "value['c']", "Color"),
        ({frozenset(): 1}, "a key of value", "a frozenset"),
        ({(1, (2, 3)): 1}, "a key of value", "a tuple"),
        ([1 + 2j], "value[0]", "a complex"),
        (np.zeros(2, complex), "value", "complex128"),
        (np.array(["x"]), "value", "<U1"),
        ([np.ma.zeros(2)], "value[0]", "MaskedArray"),
        ({"k": 2**64}, "value['k']", "a int"),
        (["\ud800"], "value[0]", "surrogates"),
        ([State(np.zeros(2))], "value[0]", "shape (2,), not (13,)"),
        (State(np.zeros(13), "old"), "value", "not a float"),
        (State(np.zeros(13), 0.0, np.zeros(2)), "value", "shape (2,), not (3,)"),
        (Status(phase=3), "value", "Expected `str`"),
        (PerNeighbor({1: 2.0}), "value", "PerNeighbor"),
        ([{"s": PerNeighbor({})}], "value[0]['s']", "PerNeighbor"),
    ],
)
def test_what_cannot_travel_is_named_with_its_place(value, where, what):
    with pytest.raises(CodecError) as caught:
        encode(value)
    text = str(caught.value)
    assert text.startswith(f"{where}: found ")
    assert what in text
    assert "allowed: None, bool, int" in text
    assert "State" in text


def test_vectors_of_references_may_be_lists_or_integers():
    assert same(
        Acceleration(np.array([0.0, 0.0, 1.0]), 2.0),
        decode(encode(Acceleration([0, 0, 1], 2))),
    )
    assert same(FPQR(np.ones(4)), decode(encode(FPQR(np.ones(4, int)))))


def nested(depth):
    value = []
    for k in range(depth - 1):
        value = [value] if k % 2 else {"x": value}
    return value


def test_containers_nest_to_the_limit_and_no_further():
    assert decode(encode(nested(MAX_DEPTH))) == nested(MAX_DEPTH)
    with pytest.raises(CodecError, match="one container more than is allowed"):
        encode(nested(MAX_DEPTH + 1))
    with pytest.raises(CodecError, match="more than 32 containers"):
        decode(b"\x40" + msgspec.msgpack.encode(nested(MAX_DEPTH + 1)))
    cyclic = []
    cyclic.append(cyclic)
    with pytest.raises(CodecError, match="one container more"):
        encode(cyclic)


@pytest.mark.parametrize(
    "hostile",
    [
        b"",
        b"\x40",
        b"\x40\xdd\xff\xff\xff\xff",
        b"\x40\xdf\xff\xff\xff\xff",
        b"\x40\xc6\xff\xff\xff\xff",
        b"\x40\xc9\xff\xff\xff\xff\x01",
        b"\x40" + b"\xdc\xff\xff" * 30_000,
        b"\x40" + b"\x91" * 1_000_000,
        b"\x40" + b"\x81\xa1a" * 300_000,
        b"\x40\xa2\xff\xfe",
        b"\x40\xc1",
        b"\x40\x01\x02",
        b"\x40\xd6\xff\x00\x00\x00\x00",
        b"\x40\x81\xd6\xff\x00\x00\x00\x00\x01",
        b"\x40\x81\x91\x91\x01\x01",
        b"\x40\xd4\x02\x00",
        b"\x40\xd4\x01\x40",
        b"\x40\xc7\x00\x01",
        b"\x41\x00",
        b"\x42" + bytes(6),
        b"\x42" + bytes(8),
        struct.pack("<BBB5xQ", ArrayPayload.ARRAY, 0, 1, 2**61 + 1) + bytes(8),
        struct.pack("<BBB5x4Q", ArrayPayload.ARRAY, 0, 4, 2**16, 2**16, 2**16, 2**16),
        struct.pack("<BBB5x3Q", ArrayPayload.ARRAY, 0, 3, 0, 2**62, 2**62),
        struct.pack("<BBB5xQ", ArrayPayload.ARRAY, 0, 9, 1) + bytes(80),
        struct.pack("<BBB5xQ", ArrayPayload.ARRAY, 10, 1, 1) + bytes(8),
        struct.pack("<BBB5xQ", ArrayPayload.ARRAY, 9, 1, 1) + b"\x02",
        struct.pack("<BBB5xQ", ArrayPayload.ARRAY, 0, 1, 1) + bytes(16),
        encode(State.at([1, 2, 3]))[:-8],
        encode(State.at([1, 2, 3])) + bytes(8),
        b"\x56\x91\x01",
        b"\x56\xdd\xff\xff\xff\xff",
        b"\x56\x92\xa1x" + b"\x91" * 100_000,
        b"\x7f",
        b"\x81\x00",
        b"\x00",
    ],
)
def test_hostile_payloads_are_refused_and_take_no_memory(hostile):
    tracemalloc.start()
    try:
        with pytest.raises(CodecError):
            decode(hostile)
        assert tracemalloc.get_traced_memory()[1] < 200_000 + 2 * len(hostile)
    finally:
        tracemalloc.stop()


def test_payloads_are_bounded_both_ways():
    assert decode(encode(bytes(100), limit=110), limit=110) == bytes(100)
    with pytest.raises(CodecError, match="allowed: 100"):
        encode(bytes(100), limit=100)
    with pytest.raises(CodecError, match="allowed: 100"):
        decode(encode(bytes(100)), limit=100)
    with pytest.raises(CodecError, match="allowed: 600000"):
        encode(np.zeros(1 << 17))


def test_another_format_version_is_named():
    with pytest.raises(CodecError, match="format version 2; allowed: 1"):
        decode(b"\x80\x01")


def test_what_is_no_buffer_is_a_codec_error():
    for payload in (None, "text", [1]):
        with pytest.raises(CodecError):
            decode(payload)


class Track(Wire, frozen=True, array_like=True, gc=False):
    points: Vec
    names: list[str]


class Vague(Wire, frozen=True, array_like=True, gc=False):
    anything: object


class Nest(Wire, frozen=True, array_like=True, gc=False):
    states: list[State]


@pytest.fixture
def layouts(monkeypatch):
    monkeypatch.setitem(codec.WIRE_LAYOUTS, "Track", (63, 0))
    monkeypatch.setitem(codec.WIRE_LAYOUTS, "Vague", (62, 0))
    monkeypatch.setitem(codec.WIRE_LAYOUTS, "Nest", (61, 0))
    monkeypatch.setattr(codec, "_encoder_by_type", dict(codec._encoder_by_type))
    monkeypatch.setattr(codec, "_decoder_by_kind", list(codec._decoder_by_kind))


def test_a_wire_type_registers_under_its_own_number(layouts):
    assert register(Track) is Track
    track = Track(np.arange(6.0).reshape(2, 3), ["a", "b"])
    payload = encode(track)
    assert payload[0] == 64 | 63
    assert same(track, decode(payload))
    assert same([{"t": track}], decode(encode([{"t": track}])))
    with pytest.raises(CodecError, match="Expected"):
        encode(Track(np.zeros(1), [1]))


def test_a_field_of_a_wire_type_takes_float_arrays_only(layouts):
    register(Track)
    with pytest.raises(CodecError):
        encode(Track(np.zeros(2, np.float32), []))
    forged = msgspec.msgpack.encode(
        [msgspec.msgpack.Ext(1, encode(np.zeros((1, 1), np.float32))), []]
    )
    with pytest.raises(CodecError, match="allowed: float64"):
        decode(bytes([64 | 63]) + forged)
    forged = msgspec.msgpack.encode(
        [msgspec.msgpack.Ext(1, encode(State.at([1, 2, 3]))), []]
    )
    with pytest.raises(CodecError, match="in a field"):
        decode(bytes([64 | 63]) + forged)


def test_classes_that_cannot_be_checked_are_not_registered(layouts):
    for cls in (Vague, Nest):
        with pytest.raises(CodecError, match="a field is Any, a struct or a class"):
            register(cls)
    with pytest.raises(
        CodecError, match=r"is not in codec\.WIRE_LAYOUTS, which has Pose"
    ):
        register(type("Unlisted", (Wire,), {}))


def test_numbers_on_the_wire_do_not_change():
    assert encode(1.5) == b"\x41" + struct.pack("<d", 1.5)
    assert encode(np.array([1.0])) == b"\x42" + bytes(7) + struct.pack("<d", 1.0)
    assert encode(Goto(np.array([1.0, 2.0, 3.0]), 4.0, 5.0)) == b"\x54" + bytes(
        7
    ) + struct.pack("<5d", 4, 5, 1, 2, 3)
    assert encode(
        State(np.arange(13.0), 4.0, np.array([5.0, 6.0, 7.0]))
    ) == b"\x51" + bytes(7) + struct.pack("<17d", 4, *range(13), 5, 6, 7)
    assert {name: tag for name, (tag, *_) in codec.WIRE_LAYOUTS.items()} == {
        "Pose": 16,
        "State": 17,
        "Acceleration": 18,
        "FullState": 19,
        "Goto": 20,
        "FPQR": 21,
        "Status": 22,
        "FRPY": 23,
        "Vel": 24,
        "XYZ": 25,
        "Body": 26,
        "Failure": 27,
        "Acc": 40,
        "Drive": 41,
        "Velocity": 42,
        "Plan": 43,
        "LinkStatus": 44,
        "HoldRequest": 45,
        "HoldAnswer": 46,
    }
    assert math.isnan(decode(encode(math.nan)))
