"""Texts of users: file names go into messages, digests and outputs, and names in files become paths.

A file name is bytes. Python decodes it by the locale, and keeps bytes that have no character there as lone surrogates
(U+DC80 to U+DCFF, PEP 383). No message, JSON text or picture can hold these, and not every output has every character.
"""

import codecs
import os
import sys
from collections.abc import Callable, Mapping
from io import TextIOWrapper
from typing import Any, Literal

import msgspec

OUTPUT_ERRORS = "crazychoir.output"
"""The error handler of standard output and standard error."""
CHILD_ENCODING = "utf-8:backslashreplace"
"""How Python programs that this process starts, and listens to, write: whatever the locale is."""


def readable(text: str) -> str:
    r"""Return the text without lone surrogates: their bytes as UTF-8 if they are, else written as \xfc.

    A name is the same text on all hosts, also where one host has a locale without its characters.
    """
    if text.isascii():
        return text
    try:
        return text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # a surrogate that stands for no byte
        return text.encode("utf-8", "backslashreplace").decode()


def readable_texts(value: Any) -> Any:
    """Return the value with `readable` texts in its lists, dictionaries and wire types, at any depth, in keys too."""
    if isinstance(value, str):
        return readable(value)
    if isinstance(value, Mapping):
        return {readable_texts(key): readable_texts(item) for key, item in value.items()}
    if isinstance(value, list):
        return [readable_texts(item) for item in value]
    if isinstance(value, tuple):
        return tuple(readable_texts(item) for item in value)
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.replace(value, **readable_texts(msgspec.structs.asdict(value)))
    return value


def json_bytes(
    value: Any, order: Literal["sorted"] | None = None, enc_hook: Callable[[Any], Any] | None = None
) -> bytes:
    """Return the value as JSON, with `readable` texts."""
    try:
        return msgspec.json.encode(value, order=order, enc_hook=enc_hook)
    except UnicodeEncodeError:
        return msgspec.json.encode(readable_texts(value), order=order, enc_hook=enc_hook)


def as_path(name: str) -> str:
    """Return a name that stands in a UTF-8 file as a path of this process: in a locale without its characters too."""
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return os.fsdecode(name.encode("utf-8", "surrogateescape"))
    return name


def let_outputs_take_any_text() -> None:
    r"""Print what has no character in the encoding of standard output or standard error as \xfc or \u2192.

    Bytes of file names that have no character are printed as they are.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors=OUTPUT_ERRORS)


def child_environment() -> dict[str, str]:
    """Return the environment of Python programs whose output this process reads as UTF-8."""
    return {**os.environ, "PYTHONIOENCODING": CHILD_ENCODING}


def _replacement(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    characters = error.object[error.start : error.end]
    return b"".join(_output_bytes(character) for character in characters), error.end


def _output_bytes(character: str) -> bytes:
    """Return the byte that a lone surrogate stands for; else an escape."""
    try:
        return character.encode("ascii", "surrogateescape")
    except UnicodeEncodeError:
        return character.encode("ascii", "backslashreplace")


codecs.register_error(OUTPUT_ERRORS, _replacement)
