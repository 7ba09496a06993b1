"""The configuration files of Crazyswarm2: their values, and remarks on values without an equivalent here."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crazychoir.config.reader import show_value
from crazychoir.errors import ConfigError
from crazychoir.files.text_files import read_text

Table = Mapping[str, Any]
"""A table of a YAML file."""


@dataclass
class ImportRemarks:
    """Values of the files that were not taken over as they are, in the order in which they were found."""

    lines: list[str] = field(default_factory=list)
    """One line a value: file, key, value and why."""

    def add(self, file: str, key: str, value: object, why: str) -> None:
        """Note that a value was not taken over, or changed."""
        line = f"{file}: {key} = {show_value(value)}: {why}"
        if line not in self.lines:
            self.lines.append(line)

    def add_rest(self, file: str, key: str, table: Table, known: set[str]) -> None:
        """Note each value of a table that is not among the known keys."""
        for name, value in table.items():
            if name not in known:
                for path, leaf in list_leaves(value, f"{key}.{name}" if key else name):
                    self.add(file, path, leaf, "no equivalent")


def list_leaves(value: object, path: str) -> Iterator[tuple[str, object]]:
    """Yield the values below a key, with their paths; a list is one value."""
    if isinstance(value, Mapping) and value:
        for name, inner in value.items():
            yield from list_leaves(inner, f"{path}.{name}")
    else:
        yield path, value


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the tables of a YAML file.

    Raises ConfigError for a file that cannot be read, or is no table.
    """
    import yaml  # takes 30 ms, which --help does not need

    text = read_text(path, "a YAML file of Crazyswarm2")
    try:
        raw = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}, line {mark.line + 1}" if mark is not None else f"{path}"
        problem = getattr(error, "problem", None) or "no YAML"
        raise ConfigError(where, problem, "YAML", "Correct the line.") from error
    if not isinstance(raw, Mapping):
        raise ConfigError(f"{path}", show_value(raw), "tables, as crazyflies.yaml has")
    return {str(key): _convert_keys(value) for key, value in raw.items()}


def _convert_keys(value: Any) -> Any:
    """Return plain values with texts as keys; YAML may have numbers there."""
    if isinstance(value, Mapping):
        return {str(key): _convert_keys(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_convert_keys(inner) for inner in value]
    return value


def read_ros_parameters(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the path of the parameters in a file of ROS parameters, and the parameters of its first node.

    Raises ConfigError if it has none.
    """
    for node, table in read_yaml(path).items():
        found = table.get("ros__parameters") if isinstance(table, Mapping) else None
        if isinstance(found, Mapping):
            return f"{node}.ros__parameters", dict(found)
    raise ConfigError(
        f"{path}", "no ros__parameters", "a node with a table ros__parameters"
    )


def find_table(table: Table, key: str, where: str) -> dict[str, Any]:
    """Return the table below a key; empty if there is none.

    where: file and path of the table, for errors
    Raises ConfigError for another value.
    """
    found = table.get(key)
    if found is None:
        return {}
    if not isinstance(found, Mapping):
        raise ConfigError(f"{where}.{key}", show_value(found), "a table")
    return dict(found)


def find_number(value: object, where: str) -> float:
    """Return a number; YAML takes 1e-3, without a point, for a text.

    Raises ConfigError for anything else.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise ConfigError(where, show_value(value), "a number") from None
    return int(number) if number.is_integer() and isinstance(value, int) else number
