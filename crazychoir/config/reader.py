"""Reads the text of a swarm file into tables.

Errors name the file, the key, the value and the allowed values.
"""

import contextlib
import json
import math
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Any, TypeVar, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo

from crazychoir.config.misplaced_keys import (
    advise_on_unknown_key,
    key_names,
    keys_of_the_file,
    not_a_table,
    place_of_missing,
)
from crazychoir.errors import ConfigError

StructType = TypeVar("StructType", bound=msgspec.Struct)

NESTING_LIMIT = 16
"""Most levels of lists and tables."""
MOST_OPEN_LINES = 200
"""Last lines of a text in which an open bracket is looked for."""
END_OF_TEXT = "at end of document"
"""Words of an error of tomllib about something that is still open at the end."""
SHOWN_LETTERS = 80
"""Most letters of a value in an error text."""


def parse(text: str, where: str) -> dict[str, Any]:
    """Return the plain values of a TOML text, or of a JSON text, which begins with a brace.

    Raises ConfigError for a wrong text, and for values that not every host can read back: dates,
    infinities, NaN, huge numbers, deep nests.
    """
    language, decode = (
        ("JSON", _decode_json)
        if text.lstrip().startswith("{")
        else ("TOML", tomllib.loads)
    )
    try:
        raw: dict[str, Any] = decode(text)
    except (ValueError, RecursionError) as error:
        found = str(error)
        if language == "TOML" and END_OF_TEXT in found:
            found = found.replace(END_OF_TEXT, _name_open_line(text))
        do = "Correct the line."
        raise ConfigError(where, found, f"{language} text", do) from error
    require_plain(raw, where)
    return raw


def _name_open_line(text: str) -> str:
    """Return where the line is that begins what is still open at the end of a TOML text: "at line 7".

    It is the line after the longest part that is a text of its own. In a long text it is looked for
    among the last lines only.
    """
    lines = text.split("\n")
    for count in range(len(lines) - 1, max(0, len(lines) - MOST_OPEN_LINES), -1):
        with contextlib.suppress(ValueError):
            tomllib.loads("\n".join(lines[:count]))
            return f"at line {count + 1}"
    return "at line 1" if len(lines) <= MOST_OPEN_LINES else END_OF_TEXT


def _decode_json(text: str) -> Any:
    """Return the values of a JSON text.

    Only the standard library reads a path with bytes that are not UTF-8.
    """
    try:
        return msgspec.json.decode(text)
    except msgspec.DecodeError:
        if "\\ud" not in text:
            raise
        return json.loads(text)


def require_plain(raw: dict[str, Any], where: str) -> None:
    """Raise ConfigError for values other than numbers, texts,
    true, false, and lists or tables of them.
    """
    pending = [(key, value, 1) for key, value in raw.items()]
    while pending:
        key, value, depth = pending.pop()
        if depth > NESTING_LIMIT:
            raise ConfigError(
                f"{where}: {key}",
                "a deeper nest",
                f"{NESTING_LIMIT} levels of lists and tables",
            )
        if isinstance(value, Mapping):
            pending += [
                (f"{key}.{name}", item, depth + 1) for name, item in value.items()
            ]
        elif isinstance(value, list | tuple):
            pending += [
                (f"{key}[{n}]", item, depth + 1) for n, item in enumerate(value)
            ]
        elif not _is_plain(value):
            raise ConfigError(
                f"{where}: {key}",
                show_value(value),
                "finite numbers below 2^63, texts, true, false",
            )


def _is_plain(value: object) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < 2**63
    return (
        math.isfinite(value)
        if isinstance(value, float)
        else isinstance(value, str | bool | None)
    )


def read_table(
    raw: object,
    kind: type[StructType],
    where: str,
    key: str = "",
    file: type[msgspec.Struct] | None = None,
) -> StructType:
    """Return the table `kind` with the values of `raw`.

    where: name of the file, for errors
    key: path to this table in the file
    file: struct of the whole file, to find the table of a misplaced key; None: `kind`, if it is
        read without a path
    Raises ConfigError for unknown, missing or wrong keys.
    """
    file = kind if file is None and not key else file
    if not isinstance(raw, Mapping):
        raise ConfigError(
            _at(where, key),
            show_value(raw),
            f"a table with {_names(kind)}",
            not_a_table(raw, key),
        )
    fields = _find_keys(kind)
    for name, value in raw.items():
        if name not in fields:
            raise _unknown(name, value, kind, where, key, file)
    for name, entry in fields.items():
        if entry.required and name not in raw:
            description, example = describe_allowed(entry)
            elsewhere = "" if key else place_of_missing(name, raw, kind)
            do = elsewhere or f"Add for example {name} = {example}."
            raise ConfigError(_at(where, key, name), "nothing", description, do)
    return kind(
        **{
            fields[name].name: _value(
                value, fields[name], where, _path(key, name), file
            )
            for name, value in raw.items()
        }
    )


@lru_cache(maxsize=64)
def _find_keys(kind: type[msgspec.Struct]) -> dict[str, FieldInfo]:
    """Return {key: field} of a table; to evaluate its annotations takes long."""
    return {entry.encode_name: entry for entry in msgspec.structs.fields(kind)}


def show_value(value: object) -> str:
    """Return a value as a swarm file writes it, shortened."""
    text = write_value(value)
    return text if len(text) <= SHOWN_LETTERS else f"{text[:SHOWN_LETTERS]}..."


def write_value(value: object) -> str:
    """Return a value as a swarm file writes it, on one line."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key} = {write_value(item)}" for key, item in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(write_value(item) for item in value)}]"
    return json.dumps(value, ensure_ascii=False, default=str)


def _value(
    raw: object,
    entry: FieldInfo,
    where: str,
    key: str,
    file: type[msgspec.Struct] | None,
) -> object:
    """Return the converted value of a key; raise ConfigError if it is not allowed."""
    kind = _bare(entry.type)
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return read_table(raw, kind, where, key, file)
    if isinstance(raw, list | tuple) and (table := _row(kind)):
        return tuple(
            read_table(item, table, where, f"{key}[{n}]", file)
            for n, item in enumerate(raw)
        )
    try:
        return msgspec.convert(raw, entry.type, str_keys=True)
    except msgspec.ValidationError:
        description, example = describe_allowed(entry)
        do = f"For example {entry.encode_name} = {example}.{keys_of_the_file(raw, key, file)}"
        raise ConfigError(f"{where}: {key}", show_value(raw), description, do) from None


def _bare(kind: Any) -> Any:
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def _row(kind: Any) -> type[msgspec.Struct] | None:
    """Return the struct of the rows if `kind` is a list of tables, else None."""
    inner = get_args(kind)[0] if get_origin(kind) is tuple else None
    return (
        inner if isinstance(inner, type) and issubclass(inner, msgspec.Struct) else None
    )


def describe_allowed(entry: FieldInfo) -> tuple[str, str]:
    """Return the allowed values of a key as text, and an example."""
    kinds = (entry.type, *get_args(entry.type))
    meta = next(kind.__metadata__[0] for kind in kinds if get_origin(kind) is Annotated)
    return meta.description, show_value(meta.examples[0])


def _unknown(
    name: str,
    value: object,
    kind: type[msgspec.Struct],
    where: str,
    key: str,
    file: type[msgspec.Struct] | None,
) -> ConfigError:
    """Return the error for a key that the table does not have."""
    do = advise_on_unknown_key(name, value, kind, key, file)
    allowed = (
        f"the keys here are {_names(kind)}"
        if key_names(kind)
        else "there is no key here"
    )
    return ConfigError(
        _at(where, key, name),
        show_value(value),
        allowed,
        do,
        problem="there is no such key",
    )


def _names(kind: type[msgspec.Struct]) -> str:
    return ", ".join(key_names(kind))


def _path(*keys: str) -> str:
    return ".".join(filter(None, keys))


def _at(where: str, *keys: str) -> str:
    return ": ".join(filter(None, (where, _path(*keys))))
