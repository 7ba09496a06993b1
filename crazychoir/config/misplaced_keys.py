"""Keys of a swarm file in the wrong table: the table to which they belong, and what to do.

In TOML every key below a [table] belongs to that table. Therefore a key of the file itself must
stand above the first table.
"""

import difflib
import inspect
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_args, get_origin

import msgspec
from msgspec.structs import FieldInfo

Kind = type[msgspec.Struct]
FILE_LABEL = ""
"""Label of the file itself."""
ROW_NUMBER = re.compile(r"\[\d+\]")
"""Number of a table in a list of tables."""
SURE_MATCH = 0.8
"""Likeness from which another key may be meant, although the key exists elsewhere."""
MOST_TABLES = 5
"""Most tables that are named for one key."""
OWN_KEYS = "mission_options"
"""Table for the user's own keys."""


def advise_on_unknown_key(
    name: str, value: object, kind: Kind, key: str, file: Kind | None
) -> str:
    """Return what to do with a key that its table does not have.

    name: the key
    value: its value
    kind: the table in which it stands
    key: the path of that table; empty for the file itself
    file: the whole file; None if a table is read alone
    """
    tables = {} if file is None else _tables_of_keys(file)
    near = difflib.get_close_matches(name, key_names(kind), n=1)
    if name in tables:
        near = difflib.get_close_matches(name, near, n=1, cutoff=SURE_MATCH)
        alternative = (
            f" Or did you mean {near[0]}, a key of this table?" if near else ""
        )
        own = "" if key else f" Write your own keys into [{OWN_KEYS}]."
        return _where_it_belongs(name, value, tables[name], key) + alternative + own
    if near:
        return f"Did you mean {near[0]}?"
    elsewhere = difflib.get_close_matches(name, list(tables), n=1, cutoff=0.75)
    if elsewhere:
        return f"Did you mean {elsewhere[0]}? {_where_it_belongs(elsewhere[0], value, tables[elsewhere[0]], key)}"
    return (
        "Remove it."
        if key == OWN_KEYS
        else f"Remove it; write your own keys into [{OWN_KEYS}]."
    )


def place_of_missing(name: str, raw: Mapping[str, Any], kind: Kind) -> str:
    """Return where a missing key of the file stands instead, and what to do.

    The text is empty if it stands nowhere.
    """
    fields = {entry.encode_name: entry for entry in msgspec.structs.fields(kind)}
    for other, value in raw.items():
        table = _table_of(fields[other])[0] if other in fields else None
        found = [(path, row) for path, row in _rows(other, value) if name in row]
        is_key_there = table is not None and name in key_names(table)
        if is_key_there and len(found) > 1:
            continue  # each row has a value of its own
        for path, row in found:
            return f"It stands in {table_label(path)}. {_write_it_in_the_file(name, row[name], path)}"
    return ""


def keys_of_the_file(raw: object, key: str, file: Kind | None) -> str:
    """Return what to do with keys of the file that stand in a table of the user's own keys.

    The text is empty if there are none.
    """
    if not isinstance(raw, Mapping) or file is None:
        return ""
    return "".join(
        f" {name}: {_write_it_in_the_file(name, raw[name], key)}"
        for name in key_names(file)
        if name in raw
    )


def not_a_table(raw: object, key: str) -> str:
    """Return what to do with a list of tables where one table is allowed.

    The text is empty for anything else.
    """
    if (
        isinstance(raw, list | tuple)
        and raw
        and all(isinstance(row, Mapping) for row in raw)
    ):
        return f"Write it once, as [{key}], with one pair of brackets."
    return ""


def key_names(kind: Kind) -> list[str]:
    """Return the keys of a table: its own keys, then the keys that it shares with another table."""
    return [entry.encode_name for entry in list_fields(kind)]


def list_fields(kind: Kind) -> list[FieldInfo]:
    """Return the fields of a table: its own, then the fields that it shares with another table."""
    own = inspect.get_annotations(kind)
    fields = msgspec.structs.fields(kind)
    return sorted(fields, key=lambda entry: entry.name not in own)


def table_label(path: str) -> str:
    """Return the path of a table as a TOML file writes it: [flight], [[drones]]."""
    plain = ROW_NUMBER.sub("", path)
    return f"[[{plain}]]" if path.endswith("]") else f"[{plain}]"


def _where_it_belongs(name: str, value: object, labels: list[str], key: str) -> str:
    """Return the advice for a key that is in the tables `labels`."""
    if FILE_LABEL in labels:
        others = ", ".join(table for table in labels if table != FILE_LABEL)
        also = f" {others} has a key of this name, too." if others else ""
        return _write_it_in_the_file(name, value, key) + also
    if len(labels) == 1:
        return f"It is a key of {labels[0]}: write it there."
    shown = labels[:MOST_TABLES]
    more = f" and {len(labels) - MOST_TABLES} more" if len(labels) > MOST_TABLES else ""
    return (
        f"It is a key of {', '.join(shown)}{more}: write it in the table that you mean."
    )


def _write_it_in_the_file(name: str, value: object, key: str) -> str:
    """Return the advice for a key of the file itself."""
    if isinstance(value, Mapping):
        return f"It is a table of its own: write [{name}], not [{_plain(key, name)}]."
    if isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
        return f"It is a list of tables: write [[{name}]], not [[{_plain(key, name)}]]."
    beside = (
        "in JSON beside name" if name != "name" else "in JSON in the outermost braces"
    )
    told = (
        f" Every line below {table_label(key)} is a key of that table." if key else ""
    )
    return f"It is a key of the file itself: write it above the first table ({beside}).{told}"


def _plain(key: str, name: str) -> str:
    return ".".join(filter(None, (ROW_NUMBER.sub("", key), name)))


def _tables_of_keys(file: Kind) -> dict[str, list[str]]:
    """Return the labels of the tables that have each key."""
    found: dict[str, list[str]] = {}
    for table, kind in [(FILE_LABEL, file), *_tables(file, "")]:
        for name in key_names(kind):
            found.setdefault(name, []).append(table)
    return found


def _tables(kind: Kind, path: str) -> Iterator[tuple[str, Kind]]:
    """Yield the tables within a table, with their labels."""
    for entry in msgspec.structs.fields(kind):
        table, is_list = _table_of(entry)
        if table is None:
            continue
        inner = f"{path}.{entry.encode_name}" if path else entry.encode_name
        yield (f"[[{inner}]]" if is_list else f"[{inner}]"), table
        yield from _tables(table, inner)


def _table_of(entry: FieldInfo) -> tuple[Kind | None, bool]:
    """Return the table that a key holds, and True if it holds a list of them."""
    kind: Any = entry.type
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    is_list = get_origin(kind) is tuple
    inner = get_args(kind)[0] if is_list else kind
    is_table = isinstance(inner, type) and issubclass(inner, msgspec.Struct)
    return (inner if is_table else None), is_list


def _rows(name: str, value: object) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the tables of a key, with their paths."""
    if isinstance(value, Mapping):
        yield name, value
    elif isinstance(value, list | tuple):
        for n, row in enumerate(value):
            if isinstance(row, Mapping):
                yield f"{name}[{n}]", row
