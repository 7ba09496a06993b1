"""What others read in a recording: the decoders of mcap-ros2-support and of rosbags."""

from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Read = list[tuple[str, str, int, dict[str, Any]]]
"""(channel, type, log time in ns, fields) of each message, in the order of the file."""


def decoded(kind: str, schema: str, message: bytes) -> dict[str, Any]:
    """The fields of one message, as both decoders find them."""
    decode = DecoderFactory().decoder_for(
        "cdr", Schema(1, schema.encode(), "ros2msg", kind)
    )
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema, kind))
    one, other = fields(decode(message)), fields(store.deserialize_cdr(message, kind))
    assert str(one) == str(other)  # compare texts, because NaN != NaN
    return one


def by_mcap_ros2(path: Path) -> Read:
    """A whole file, by mcap-ros2-support."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, schema.name, message.log_time, fields(found))
            for schema, channel, message, found in reader.iter_decoded_messages()
        ]


def by_rosbags(path: Path) -> Read:
    """A whole file, by rosbags, with the types that the file itself defines."""
    with AnyReader([path]) as reader:
        return [
            (
                connection.topic,
                connection.msgtype,
                time,
                fields(reader.deserialize(data, connection.msgtype)),
            )
            for connection, time, data in reader.messages()
        ]


def fields(value: Any) -> Any:
    """A message as dictionaries, its arrays as lists."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, bytes | list):
        return [fields(item) for item in value]
    names = getattr(type(value), "__slots__", None) or getattr(value, "__dict__", None)
    if not names:
        return value
    return {
        name: fields(getattr(value, name)) for name in names if not name.startswith("_")
    }
