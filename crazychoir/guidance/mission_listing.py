"""What `crazychoir missions` lists: the missions in agents/, and the options of a mission."""

import ast
import importlib
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import msgspec

from crazychoir.config.reader import describe_allowed
from crazychoir.guidance.mission import (
    MISSION_PACKAGE,
    Mission,
    list_mission_names,
    load_mission,
)

OPTION_TABLES = {"mission_options": "Options", "drone_options": "DroneOptions"}
"""By table: the name in a mission file. Either may be left out."""


@dataclass(frozen=True, slots=True)
class OptionDescription:
    """An option of a mission."""

    option: str
    """Its key in the swarm file."""
    value: str
    """Type and allowed values, in words."""
    default: Any
    """Plain value; None: none."""
    meaning: str
    """What it does, with its unit."""


@dataclass(frozen=True, slots=True)
class MissionDescription:
    """A mission, and its options."""

    mission: str
    """Name, or path of the file."""
    summary: str
    """The first line of the file."""
    mission_options: tuple[OptionDescription, ...]
    """Keys of [mission_options]."""
    drone_options: tuple[OptionDescription, ...]
    """Keys of the `options` of a drone."""


def list_summaries() -> dict[str, str]:
    """Return the first line of each mission in agents/, by name."""
    package = importlib.import_module(MISSION_PACKAGE)
    folder = Path(package.__path__[0])
    return {name: read_summary(folder / f"{name}.py") for name in list_mission_names()}


def read_summary(file: Path) -> str:
    """Return the first line of the docstring of a Python file; "" without a docstring."""
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
    return (text or "").partition("\n")[0]


def describe_mission(name: str) -> MissionDescription:
    """Return a mission with its options.

    name: name of a mission in agents/, or path of a .py file.
    Raises ConfigError if there is no such mission.
    """
    mission = load_mission(name)
    file = Path(str(getattr(mission, "__file__", name)))
    tables = {
        key: describe_options(_find_table(mission, attribute), file)
        for key, attribute in OPTION_TABLES.items()
    }
    return MissionDescription(name, read_summary(file), **tables)


def _find_table(mission: Mission, attribute: str) -> type[msgspec.Struct] | None:
    """Return a table of options of the mission file; None if it has none of this name."""
    table = getattr(mission, attribute, None)
    if isinstance(table, type) and issubclass(table, msgspec.Struct):
        return table
    return None


def describe_options(
    table: type[msgspec.Struct] | None, file: Path
) -> tuple[OptionDescription, ...]:
    """Return the options of a table in order.

    table: None: no options.
    file: the mission file, which may define the table.
    """
    if table is None:
        return ()
    meanings: dict[str, str] = {}
    for kind in reversed(table.__mro__):
        if issubclass(kind, msgspec.Struct) and kind is not msgspec.Struct:
            meanings |= read_meanings(kind, file)
    return tuple(
        OptionDescription(
            entry.encode_name,
            _describe_value(entry),
            _get_default(entry),
            meanings.get(entry.name, ""),
        )
        for entry in msgspec.structs.fields(table)
    )


def _describe_value(entry: msgspec.structs.FieldInfo) -> str:
    """Return the allowed values of an option in words; without words, the name of its type."""
    kinds = (entry.type, *get_args(entry.type))
    if any(get_origin(kind) is Annotated for kind in kinds):
        return describe_allowed(entry)[0]
    return str(getattr(entry.type, "__name__", entry.type))


def _get_default(entry: msgspec.structs.FieldInfo) -> Any:
    """Return the default of an option as a plain value; None: none."""
    if entry.default_factory is not msgspec.NODEFAULT:
        return msgspec.to_builtins(entry.default_factory())
    if entry.default is msgspec.NODEFAULT:
        return None
    return msgspec.to_builtins(entry.default)


def read_meanings(kind: type, file: Path) -> dict[str, str]:
    """Return the text below each attribute of a class, by name.

    file: where the class is if its module is not imported by name, as that of a mission file.
    """
    module = sys.modules.get(kind.__module__)
    source = Path(getattr(module, "__file__", None) or file).read_text(encoding="utf-8")
    found = {}
    for node in ast.parse(source).body:
        if not (isinstance(node, ast.ClassDef) and node.name == kind.__name__):
            continue
        for attribute, below in pairwise(node.body):
            match attribute, below:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    found[name] = " ".join(text.split())
    return found
