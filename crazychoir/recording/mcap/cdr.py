"""ROS 2 message definitions as text, and values to bytes by them: CDR, little-endian, as every ROS 2 tool reads it.

    message = 00 01 00 00, then the fields in order; a number lies at a multiple of its size, counted after these four
    string = uint32 length with its NUL, UTF-8, NUL;   sequence = uint32 count, elements

Source: OMG DDS-XTypes 1.3, section 7.4.1 (plain CDR, version 1).
"""

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Final

HEAD: Final = b"\x00\x01\x00\x00"
"""Of every message: CDR, little-endian, no options."""
NUMBERS: Final = {
    "bool": "?",
    "uint8": "B",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Types of numbers, with their letters of `struct`."""
RULE: Final = "=" * 80
_FIELD = re.compile(r"([\w/]+)(\[(\d*)\])? +(\w+)")

Definitions = Mapping[str, str]
"""By `package/Name`: the text of a message, a field a line."""


@dataclass(frozen=True)
class Leaf:
    """A field that is not a message itself: path with dots, type; count: 1, n of an array, None of a sequence."""

    path: str
    type: str
    count: int | None = 1

    @property
    def fixed(self) -> bool:
        """Whether it is as long in every message."""
        return self.type != "string" and self.count is not None


def schema(name: str, definitions: Definitions) -> str:
    """The text that makes a file self-describing: a message's definition, then of each message that it is made of."""
    parts = [definitions[name]]
    parts += [
        f"{RULE}\nMSG: {other}\n{definitions[other]}"
        for other in _needed(name, definitions)
    ]
    return "\n".join(parts)


def definitions_of(name: str, text: str) -> Definitions:
    """What such a text defines: the message of this name, and those that it is made of."""
    first, *others = text.split(f"{RULE}\nMSG: ")
    pairs = (part.split("\n", 1) for part in others)
    return {name: first, **{other: own for other, own in pairs}}


def leaves(name: str, definitions: Definitions, path: str = "") -> Iterator[Leaf]:
    """The fields of a message and of the messages in it, in the order of their bytes."""
    for kind, brackets, count, field in _fields(definitions[name]):
        if kind in definitions:
            yield from leaves(kind, definitions, f"{path}{field}.")
        else:
            yield Leaf(
                path + field, kind, (int(count) if count else None) if brackets else 1
            )


class Layout:
    """Where the values of one message type lie.

    constants: by path, texts that are the same in every message, and None for numbers that are zero; their values are
    not given. They stand before the first field whose length differs from message to message.
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
        self._constants: list[
            tuple[int, bytes]
        ] = []  # what stands before the value of that number, the last one first
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
                letters = numbers * NUMBERS[leaf.type]
                size = numbers * width
                count += numbers
            form = f"{form}{pad}x{letters}"
            end = end + pad + size
        self._constants.append((0, HEAD))
        self._front = struct.Struct(form)
        self._rest = list(fields[len(front) :])
        self._values = count
        self._read = struct.Struct(re.sub(r"(\d+)s", r"\1x", form))

    def pack(self, values: Sequence[Any]) -> bytes:
        """A message; one value a field, of an array in the front all its numbers.

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
        """The values before the first field whose length differs, without constants."""
        return self._read.unpack_from(message)


def unpacked(fields: Sequence[Leaf], message: bytes) -> dict[str, Any]:
    """The values of a message by the paths of its fields, arrays and sequences as lists.

    Raises struct.error, IndexError or UnicodeDecodeError for one that is cut off or of other fields.
    """
    found: dict[str, Any] = {}
    at = len(HEAD)
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
    """The value at a place or after its padding, and where it ends."""
    width = _width(kind)
    at += -(at - len(HEAD)) % width
    if kind != "string":
        return struct.unpack_from(f"<{NUMBERS[kind]}", message, at)[0], at + width
    end = at + width + int(struct.unpack_from("<I", message, at)[0])
    if end > len(message):
        raise IndexError(f"a text up to byte {end} in a message of {len(message)}")
    return message[at + width : end - 1].decode(), end


def _append(message: bytearray, leaf: Leaf, value: Any) -> None:
    """A field whose place depends on what was before it. An empty sequence has no padding after its count."""
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
        f"<{NUMBERS[kind]}", value
    )


def _content(text: str) -> bytes:
    """Text, NUL; what is no character of UTF-8 as a question mark."""
    return text.encode(errors="replace") + b"\0"


def _width(kind: str) -> int:
    """Bytes of a number, or of the length before a text; it lies at a multiple of them."""
    return 4 if kind == "string" else struct.calcsize(f"<{NUMBERS[kind]}")


def _needed(name: str, definitions: Definitions) -> list[str]:
    """The messages within a message, each once."""
    found: dict[str, None] = {}
    for kind, *_ in _fields(definitions[name]):
        if kind in definitions:
            found |= dict.fromkeys([kind, *_needed(kind, definitions)])
    return list(found)


def _fields(text: str) -> list[tuple[str, str, str, str]]:
    """(type, brackets, count, name) of each line."""
    lines = (line.split("#")[0].strip() for line in text.splitlines())
    found = [_FIELD.fullmatch(line) for line in lines if line]
    return [(m[1], m[2] or "", m[3] or "", m[4]) for m in found if m]
