"""Bytes of ROS 2 messages: alignment, texts, sequences; read by decoders of others."""

import struct

import pytest
from ros2_decoders import decoded

from crazychoir.recording.mcap.cdr import (
    CDR_HEADER,
    SCHEMA_SEPARATOR,
    Layout,
    Leaf,
    definitions_of,
    leaves,
    schema,
    unpack_values,
)

INNER = {"a/Inner": "uint8 n\nfloat64 x", "a/Stamp": "int32 sec\nuint32 nanosec"}


def packed(text, values, constants=None, **more):
    """As others read it, and we."""
    definitions = {**INNER, **more, "a/Outer": text}
    message = Layout(list(leaves("a/Outer", definitions)), constants or {}).pack(values)
    written = schema("a/Outer", definitions)
    found = decoded("a/msg/Outer", written, message)
    own = unpack_values(
        list(leaves("a/Outer", definitions_of("a/Outer", written))), message
    )
    assert own == flat(found)
    return found


def flat(fields, path=""):
    """The fields of messages within a message by their paths."""
    found = {}
    for name, value in fields.items():
        found |= (
            flat(value, f"{path}{name}.")
            if isinstance(value, dict)
            else {path + name: value}
        )
    return found


def test_a_number_lies_at_a_multiple_of_its_size_counted_after_the_head():
    layout = Layout(
        [
            Leaf("n", "uint8"),
            Leaf("x", "float64"),
            Leaf("m", "uint8"),
            Leaf("k", "int32"),
        ],
        {},
    )
    message = layout.pack((7, 1.5, 9, -2))
    assert (
        message
        == CDR_HEADER
        + b"\7"
        + bytes(7)
        + struct.pack("<d", 1.5)
        + b"\t\0\0\0\xfe\xff\xff\xff"
    )
    assert layout.numbers(message) == (7, 1.5, 9, -2)


TRAPS = [
    ("uint8 n\nfloat64 x", (3, 1.25), {"n": 3, "x": 1.25}),
    (
        "bool b\nint64 k\nuint8 n\nuint64 m\nfloat32 f",
        (True, -(1 << 62), 255, 1 << 63, 0.5),
        {"b": True, "k": -(1 << 62), "n": 255, "m": 1 << 63, "f": 0.5},
    ),
    ("string s\nfloat64 x", ("ab", 2.5), {"s": "ab", "x": 2.5}),
    (
        "string s\nstring t\nuint8 n\nfloat64 x",
        ("", "größe", 1, 2.5),
        {"s": "", "t": "größe", "n": 1, "x": 2.5},
    ),
    ("float64[] xs\nuint8 n", ([], 4), {"xs": [], "n": 4}),
    (
        "uint8 n\nfloat64[] xs\nuint8 m",
        (1, [1.5, 2.5], 4),
        {"n": 1, "xs": [1.5, 2.5], "m": 4},
    ),
    ("int64[] a\nint64[] b\nstring s", ([], [], "end"), {"a": [], "b": [], "s": "end"}),
    (
        "int64[] a\nint64[] b\nstring s",
        ([1], [], "end"),
        {"a": [1], "b": [], "s": "end"},
    ),
    (
        "string s\nint64[] a\nfloat64 x",
        ("abc", [-1, 2], 0.5),
        {"s": "abc", "a": [-1, 2], "x": 0.5},
    ),
    ("uint8[3] raw\nfloat64 x", (1, 2, 3, 0.5), {"raw": [1, 2, 3], "x": 0.5}),
    (
        "string s\nfloat64[2] xs\nuint8[3] raw",
        ("a", (1.0, 2.0), (1, 2, 3)),
        {"s": "a", "xs": [1, 2], "raw": [1, 2, 3]},
    ),
    (
        "string[] names\nfloat64 x",
        (["a", "", "bcd"], 0.5),
        {"names": ["a", "", "bcd"], "x": 0.5},
    ),
    (
        "a/Inner one\na/Inner two",
        (1, 2.0, 3, 4.0),
        {"one": {"n": 1, "x": 2.0}, "two": {"n": 3, "x": 4.0}},
    ),
    (
        "string s\na/Inner one",
        ("abcd", 1, 2.0),
        {"s": "abcd", "one": {"n": 1, "x": 2.0}},
    ),
]


@pytest.mark.parametrize(
    ("text", "values", "found"),
    TRAPS,
    ids=[text.replace("\n", "; ") for text, *_ in TRAPS],
)
def test_others_read_what_was_written(text, values, found):
    assert packed(text, values) == found


def test_a_header_within_a_message_and_texts_that_are_always_the_same():
    more = {"a/Header": "a/Stamp stamp\nstring frame_id"}
    text = "a/Header header\nstring child\nfloat64[3] zero\nuint8 n\nfloat64 x\nstring last"
    constants = {"header.frame_id": "world", "child": "drone12", "zero": None}
    assert packed(text, (1, 2, 3, 4.5, "end"), constants, **more) == {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "world"},
        "child": "drone12",
        "zero": [0.0, 0.0, 0.0],
        "n": 3,
        "x": 4.5,
        "last": "end",
    }


@pytest.mark.parametrize("length", range(9))
def test_what_follows_a_text_of_any_length_is_aligned(length):
    text = "x" * length
    constants = {"s": text}
    for given, values in ((None, (text, 1, 2.5)), (constants, (1, 2.5))):
        assert packed("string s\nuint8 n\nfloat64 x", values, given) == {
            "s": text,
            "n": 1,
            "x": 2.5,
        }


def test_what_is_no_text_does_not_fail():
    assert packed("string s", ("a\udcffb",)) == {"s": "a?b"}


@pytest.mark.parametrize("values", [(1,), (1, 2.0, 3), ("a", 2.0), (1, 2.0, [1])])
def test_what_a_field_cannot_hold_is_an_error(values):
    with pytest.raises((struct.error, TypeError, ValueError)):
        Layout([Leaf("n", "uint8"), Leaf("x", "float64")], {}).pack(values)


def test_a_schema_names_every_message_once_and_drops_no_comment():
    text = schema(
        "a/Outer",
        {
            **INNER,
            "a/Outer": "a/Inner p  # m\na/Inner q\na/Stamp t",
            "a/Other": "bool b",
        },
    )
    assert (
        text.split(f"{SCHEMA_SEPARATOR}\n")[0]
        == "a/Inner p  # m\na/Inner q\na/Stamp t\n"
    )
    assert [
        part.splitlines()[0] for part in text.split(f"{SCHEMA_SEPARATOR}\n")[1:]
    ] == [
        "MSG: a/Inner",
        "MSG: a/Stamp",
    ]


def test_a_message_that_is_cut_off_is_an_error():
    fields = [Leaf("n", "uint8"), Leaf("s", "string"), Leaf("x", "float64")]
    message = Layout(fields, {}).pack((1, "text", 2.5))
    assert unpack_values(fields, message) == {"n": 1, "s": "text", "x": 2.5}
    for end in range(4, len(message)):
        with pytest.raises((struct.error, IndexError)):
            unpack_values(fields, message[:end])
