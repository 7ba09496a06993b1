"""Texts of users: names of files in messages, digests and outputs; names in files as paths.

A file name is a sequence of bytes. Python decodes it by the locale, and keeps bytes that are no
character there as lone surrogates (U+DC80 to U+DCFF, PEP 383). No message, JSON text or picture can
hold these; launch/process/ending.py lets a process print them.
"""

import os
from collections.abc import Callable, Mapping
from typing import Any, Literal

import msgspec

CHILD_ENCODING = "utf-8:backslashreplace"
"""Output encoding of Python programs that this process starts and reads, in any locale."""


def make_readable(text: str, other: str = "backslashreplace") -> str:
    r"""Return the text without lone surrogates: UTF-8 where their bytes are UTF-8, else \xfc.

    A name becomes the same text on all hosts, also on a host with a locale that lacks its
    characters.

    other: error handler of codecs for a surrogate that stands for no byte; no file name has one
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
    """Return the value with `make_readable` applied to all its texts.

    Texts in lists, dictionaries (keys too) and wire types are made readable at any depth.
    """
    if isinstance(value, str):
        return make_readable(value, other)
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
    """Return the value as JSON; its texts are changed by `make_readable` if UTF-8 cannot hold them.

    order: "sorted" to sort keys, as for msgspec
    enc_hook: converts objects that msgspec does not know
    """
    try:
        return msgspec.json.encode(value, order=order, enc_hook=enc_hook)
    except UnicodeEncodeError:
        return msgspec.json.encode(
            readable_texts(value), order=order, enc_hook=enc_hook
        )


def as_path(name: str) -> str:
    """Return a name from a UTF-8 file as a path, also in a locale that lacks its characters."""
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return os.fsdecode(name.encode("utf-8", "surrogateescape"))
    return name


def child_environment() -> dict[str, str]:
    """Return an environment for Python programs that lets them print UTF-8."""
    return {**os.environ, "PYTHONIOENCODING": CHILD_ENCODING}
