"""The keys of a swarm file in deploy/REFERENCE.md, from config/tables.py."""

import re
from collections.abc import Iterator
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec.structs import FieldInfo

from crazychoir.config.misplaced_keys import list_fields
from crazychoir.config.tables import Swarm
from reference.markdown import attribute_docs, one_line, table

Kind = type[msgspec.Struct]
LABEL = re.compile(r"^(One )?\[+[a-z_.]+\]+[.:]\s*")
"""Name of a table at the start of its docstring."""


def tables() -> str:
    """Return a section for each table of a swarm file, the keys above all tables first."""
    return "\n\n".join(_section(path, kind) for path, kind in _walk("", Swarm))


def _walk(path: str, kind: Kind) -> Iterator[tuple[str, Kind]]:
    """Yield a table and the tables inside it; path: how it is written, "" for the file itself."""
    yield path, kind
    inside = path.strip("[]")
    for entry in list_fields(kind):
        name = f"{inside}.{entry.encode_name}" if inside else entry.encode_name
        own = next(_structs(entry.type), None)
        if own is not None:
            yield from _walk(
                f"[[{name}]]" if _is_list(entry.type) else f"[{name}]", own
            )


def _section(path: str, kind: Kind) -> str:
    """Return the heading, the explanation and the keys of a table."""
    title = f"`{path}`" if path else "Keys above the first table"
    words = LABEL.sub("", one_line(kind.__doc__ or ""))
    about = f"{words[:1].upper()}{words[1:]}\n\n" if words and path else ""
    docs: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, msgspec.Struct) and base.__module__ == kind.__module__:
            docs |= attribute_docs(base)
    hints = get_type_hints(kind, include_extras=True)
    rows = [
        [
            _key(path, entry),
            _allowed(hints[entry.name]),
            _default(entry),
            docs[entry.name],
        ]
        for entry in list_fields(kind)
    ]
    return f"## {title}\n\n{about}{table(('key', 'value', 'default', 'meaning'), rows)}"


def _key(path: str, entry: FieldInfo) -> str:
    """Return a key as it is written in the file."""
    own = next(_structs(entry.type), None)
    if own is None:
        return f"`{entry.encode_name}`"
    inside = path.strip("[]")
    name = f"{inside}.{entry.encode_name}" if inside else entry.encode_name
    return f"`[[{name}]]`" if _is_list(entry.type) else f"`[{name}]`"


def _allowed(annotation: Any) -> str:
    """Return the allowed values of a key in words."""
    if get_origin(annotation) in (Union, UnionType):
        annotation = next(t for t in get_args(annotation) if t is not type(None))
    if get_origin(annotation) is Annotated:
        return next(
            str(meta.description)
            for meta in get_args(annotation)[1:]
            if meta.description
        )
    return "a table"


def _default(entry: FieldInfo) -> str:
    """Return the value of a key that is left out."""
    if entry.required:
        return "required"
    value = (
        entry.default
        if entry.default_factory is msgspec.NODEFAULT
        else entry.default_factory()
    )
    if value is None:
        return "none"
    if isinstance(value, msgspec.Struct):
        return "see below"
    if isinstance(value, (dict, tuple)) and not value:
        return "empty"
    return f"`{msgspec.json.encode(value).decode()}`"


def _structs(annotation: Any) -> Iterator[Kind]:
    """Yield the tables in the type of a key."""
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        yield annotation
    for inner in get_args(annotation):
        yield from _structs(inner)


def _is_list(annotation: Any) -> bool:
    """Return whether the type of a key is a list of tables."""
    return not isinstance(annotation, type)
