"""Texts of users: file names go into messages, digests and outputs, and names in files become paths.

A file name is bytes. Python decodes it by the locale, and keeps bytes that have no character there as lone surrogates
(U+DC80 to U+DCFF, PEP 383). No message, JSON text or picture can hold these; outputs.py prints them.
"""

import os
from collections.abc import Callable, Mapping
from typing import Any, Literal

import msgspec

CHILD_ENCODING = "utf-8:backslashreplace"
"""How Python programs that this process starts, and listens to, write: whatever the locale is."""


def readable(text: str, other: str = "backslashreplace") -> str:
    r"""Return the text without lone surrogates: their bytes as UTF-8 if they are, else written as \xfc.

    A name is the same text on all hosts, also where one host has a locale without its characters.
    other: what is done with a surrogate that stands for no byte, which no file name has: an error handler of codecs.
    """
    if text.isascii():
        return text
    try:
        return text.encode("utf-8", "surrogateescape").decode(
            "utf-8", "backslashreplace"
        )
    except UnicodeEncodeError:  # a surrogate that stands for no byte
        return text.encode("utf-8", other).decode()


def readable_texts(value: Any, other: str = "backslashreplace") -> Any:
    """Return the value with `readable` texts in its lists, dictionaries and wire types, at any depth, in keys too."""
    if isinstance(value, str):
        return readable(value, other)
    if isinstance(value, Mapping):
        return {
            readable_texts(key, other): readable_texts(item, other)
            for key, item in value.items()
        }
    if isinstance(value, list):
        return [readable_texts(item, other) for item in value]
    if isinstance(value, tuple):
        return tuple(readable_texts(item, other) for item in value)
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.replace(
            value, **readable_texts(msgspec.structs.asdict(value), other)
        )
    return value


def json_bytes(
    value: Any,
    order: Literal["sorted"] | None = None,
    enc_hook: Callable[[Any], Any] | None = None,
) -> bytes:
    """Return the value as JSON, with `readable` texts."""
    try:
        return msgspec.json.encode(value, order=order, enc_hook=enc_hook)
    except UnicodeEncodeError:
        return msgspec.json.encode(
            readable_texts(value), order=order, enc_hook=enc_hook
        )


def as_path(name: str) -> str:
    """Return a name that stands in a UTF-8 file as a path of this process: in a locale without its characters too."""
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return os.fsdecode(name.encode("utf-8", "surrogateescape"))
    return name


def child_environment() -> dict[str, str]:
    """Return the environment of Python programs whose output this process reads as UTF-8."""
    return {**os.environ, "PYTHONIOENCODING": CHILD_ENCODING}
