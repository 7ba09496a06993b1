"""ROS 2 message definitions as text, and values as bytes: CDR, little-endian, as in ROS 2 tools.

    message = 00 01 00 00, then the fields in order
    number: at a multiple of its size, counted after these four bytes
    string = uint32 length with its NUL, UTF-8, NUL
    sequence = uint32 count, elements

Source: OMG DDS-XTypes 1.3, section 7.4.1 (plain CDR, version 1).
"""

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Final

CDR_HEADER: Final = b"\x00\x01\x00\x00"
"""First bytes of every message: CDR, little-endian, no options."""
NUMBER_FORMATS: Final = {
    "bool": "?",
    "uint8": "B",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Types of numbers, with their letters in `struct`."""
SCHEMA_SEPARATOR: Final = "=" * 80  # line between the definitions in a schema
_FIELD_PATTERN = re.compile(r"([\w/]+)(\[(\d*)\])? +(\w+)")

Definitions = Mapping[str, str]
"""Text of each message by `package/Name`, a field a line."""


@dataclass(frozen=True)
class Leaf:
    """A field that is not a message itself."""

    path: str
    """Names of the fields that lead to it, joined by dots."""
    type: str
    """Its type."""
    count: int | None = 1
    """1 for a single value, n for an array, None for a sequence."""

    @property
    def fixed(self) -> bool:
        """True if it has the same length in every message."""
        return self.type != "string" and self.count is not None


def schema(name: str, definitions: Definitions) -> str:
    """Return the text that makes a file self-describing.

    It is the definition of a message, followed by those of all messages that it contains.
    """
    parts = [definitions[name]]
    parts += [
        f"{SCHEMA_SEPARATOR}\nMSG: {other}\n{definitions[other]}"
        for other in _nested_messages(name, definitions)
    ]
    return "\n".join(parts)


def definitions_of(name: str, text: str) -> Definitions:
    """Return the definitions in such a text: of the named message and of the messages it contains."""
    first, *others = text.split(f"{SCHEMA_SEPARATOR}\nMSG: ")
    pairs = (part.split("\n", 1) for part in others)
    return {name: first, **{other: own for other, own in pairs}}


def leaves(name: str, definitions: Definitions, path: str = "") -> Iterator[Leaf]:
    """Yield the fields of a message and of the messages in it, in the order of their bytes.

    A sequence of messages is a field that can be empty only.
    """
    for kind, brackets, count, field in _fields(definitions[name]):
        if kind in definitions and brackets:
            yield Leaf(path + field, "uint8", None)
        elif kind in definitions:
            yield from leaves(kind, definitions, f"{path}{field}.")
        else:
            values: int | None = 1
            if brackets:
                values = int(count) if count else None
            yield Leaf(path + field, kind, values)


class Layout:
    """Places of the values of one message type.

    fields: fields in order
    constants: by path, texts that are equal in every message, and None for numbers that are zero.
        Their values are not passed. They must stand before the first field of variable length.
    """

    def __init__(
        self, fields: Sequence[Leaf], constants: Mapping[str, str | None]
    ) -> None:
        front = list(
            takewhile(lambda leaf: leaf.fixed or leaf.path in constants, fields)
        )
        form = "<4s"
        end = 0
        count = 0
        # (number of the value that follows, bytes of the constant), the last one first
        self._constants: list[tuple[int, bytes]] = []
        for leaf in front:
            pad = -end % _width(leaf.type)
            width = _width(leaf.type)
            text = constants.get(leaf.path)
            numbers = leaf.count or 0
            if text is not None:
                content = _content(text)
                content = struct.pack("<I", len(content)) + content
                self._constants.insert(0, (count, content))
                letters = f"{len(content)}s"
                size = len(content)
            elif leaf.path in constants:
                letters = f"{numbers * width}x"
                size = numbers * width
            else:
                letters = numbers * NUMBER_FORMATS[leaf.type]
                size = numbers * width
                count += numbers
            form = f"{form}{pad}x{letters}"
            end = end + pad + size
        self._constants.append((0, CDR_HEADER))
        self._front = struct.Struct(form)
        self._rest = list(fields[len(front) :])
        self._values = count
        self._read = struct.Struct(re.sub(r"(\d+)s", r"\1x", form))

    def pack(self, values: Sequence[Any]) -> bytes:
        """Return the bytes of a message.

        values: one value a field; all numbers of an array that lies before the first field of
            variable length
        Raises struct.error or TypeError for a value that its field cannot hold.
        """
        n = self._values
        front = list(values[:n] if self._rest else values)
        for place, content in self._constants:
            front.insert(place, content)
        packed = self._front.pack(*front)
        if not self._rest:
            return packed
        message = bytearray(packed)
        for leaf, value in zip(self._rest, values[n:], strict=True):
            _append(message, leaf, value)
        return bytes(message)

    def numbers(self, message: bytes) -> tuple[Any, ...]:
        """Return the values before the first field of variable length, without constants."""
        return self._read.unpack_from(message)


def unpack_values(fields: Sequence[Leaf], message: bytes) -> dict[str, Any]:
    """Return the values of a message by the paths of its fields; arrays and sequences are lists.

    Raises struct.error, IndexError or UnicodeDecodeError if the message is cut off or has other
    fields.
    """
    found: dict[str, Any] = {}
    at = len(CDR_HEADER)
    for leaf in fields:
        count = leaf.count
        if count is None:
            count, at = _read(message, at, "uint32")
        values = []
        for _ in range(count):
            value, at = _read(message, at, leaf.type)
            values.append(value)
        found[leaf.path] = values[0] if leaf.count == 1 else values
    return found


def _read(message: bytes, at: int, kind: str) -> tuple[Any, int]:
    """Return the value at a place, after its padding, and the place where it ends."""
    width = _width(kind)
    at += -(at - len(CDR_HEADER)) % width
    if kind != "string":
        return struct.unpack_from(f"<{NUMBER_FORMATS[kind]}", message, at)[
            0
        ], at + width
    end = at + width + int(struct.unpack_from("<I", message, at)[0])
    if end > len(message):
        raise IndexError(f"a text up to byte {end} in a message of {len(message)}")
    return message[at + width : end - 1].decode(), end


def _append(message: bytearray, leaf: Leaf, value: Any) -> None:
    """Append a field after the first field of variable length.

    An empty sequence has no padding after its count.
    """
    if leaf.count is None:
        _number(message, "uint32", len(value))
    elif leaf.count != 1 and len(value) != leaf.count:
        raise TypeError(f"{leaf.path}: {len(value)} values; allowed: {leaf.count}")
    for item in (value,) if leaf.count == 1 else value:
        if leaf.type == "string":
            content = _content(item)
            _number(message, "uint32", len(content))
            message += content
        else:
            _number(message, leaf.type, item)


def _number(message: bytearray, kind: str, value: Any) -> None:
    message += bytes(-(len(message) - 4) % _width(kind)) + struct.pack(
        f"<{NUMBER_FORMATS[kind]}", value
    )


def _content(text: str) -> bytes:
    """Return the text with NUL; a character that UTF-8 cannot encode becomes a question mark."""
    return text.encode(errors="replace") + b"\0"


def _width(kind: str) -> int:
    """Return the bytes of a number, or of the length before a text; they are also its alignment."""
    return 4 if kind == "string" else struct.calcsize(f"<{NUMBER_FORMATS[kind]}")


def _nested_messages(name: str, definitions: Definitions) -> list[str]:
    """Return the messages within a message, each once."""
    found: dict[str, None] = {}
    for kind, *_ in _fields(definitions[name]):
        if kind in definitions:
            found |= dict.fromkeys([kind, *_nested_messages(kind, definitions)])
    return list(found)


def _fields(text: str) -> list[tuple[str, str, str, str]]:
    """Return (type, brackets, count, name) of each line."""
    lines = (line.split("#")[0].strip() for line in text.splitlines())
    found = [_FIELD_PATTERN.fullmatch(line) for line in lines if line]
    return [(m[1], m[2] or "", m[3] or "", m[4]) for m in found if m]
