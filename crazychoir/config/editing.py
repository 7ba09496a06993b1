"""Change keys of [[drones]] tables in the text of a swarm file; every other byte stays as it is."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from crazychoir.config.reader import write_value
from crazychoir.errors import ConfigError
from crazychoir.files.output_files import output_file
from crazychoir.files.text_files import TEXT_MARKS, read_text

TABLE_HEADER = re.compile(r"\s*\[")
"""First line of a table."""
DRONES_HEADER = re.compile(r"\s*\[\[\s*drones\s*\]\]\s*(#.*)?")
"""First line of a [[drones]]."""


def lines_of(i: int, keys: Mapping[str, object]) -> str:
    """Return the text of a [[drones]] table with this id and these keys."""
    return "\n".join(
        [
            "[[drones]]",
            f"id = {i}",
            *(f"{key} = {write_value(value)}" for key, value in keys.items()),
        ]
    )


def with_keys(
    text: str, changes: Mapping[int, Mapping[str, object]], where: str = "swarm"
) -> str:
    """Return the TOML text with new values for some keys of [[drones]].

    changes: {drone id: {key: value}}; a new key is added at the end of its table
    where: name of the file, for errors
    Raises ConfigError, with the lines to write by hand, unless the file has one table for each of
    these drones and one line for each key.
    """
    before = _parsed(text)
    lines = text.splitlines(keepends=True)
    for i, keys in changes.items():
        for key, value in keys.items():
            lines = _with_key(lines, i, key, write_value(value))
    after = "".join(lines)
    expected = _expected_values(before, changes)
    if expected is None or _parsed(after) != expected:
        do = "\n".join(
            [
                "Write them yourself:",
                *(lines_of(i, keys) for i, keys in changes.items()),
            ]
        )
        raise ConfigError(
            where,
            "tables in another layout",
            "[[drones]], and one line a key",
            do,
        )
    return after


def write_keys(path: Path, changes: Mapping[int, Mapping[str, object]]) -> None:
    """Write other values of some keys of [[drones]] into a file; see `with_keys`."""
    text = read_text(path, "a swarm file that can be written", exact=True)
    mark = (
        TEXT_MARKS.byte_order_mark
        if text.startswith(TEXT_MARKS.byte_order_mark)
        else ""
    )
    changed = with_keys(text.removeprefix(mark), changes, str(path))
    with output_file(path, "swarm file") as place:
        place.write_bytes((mark + changed).encode())


def _with_key(lines: list[str], i: int, key: str, value: str) -> list[str]:
    """Return the lines with this key of drone i."""
    for begin, end in _tables(lines):
        if _parsed_id(lines[begin:end]) != i:
            continue
        line = next(
            (n for n in range(begin + 1, end) if re.match(rf"\s*{key}\s*=", lines[n])),
            None,
        )
        if line is not None:
            return [
                *lines[:line],
                _replace_value(lines[line], key, value),
                *lines[line + 1 :],
            ]
        last = max(n for n in range(begin, end) if lines[n].split("#")[0].strip())
        ending = "\r\n" if lines[begin].endswith("\r\n") else "\n"
        previous = lines[last] if lines[last].endswith("\n") else lines[last] + ending
        return [*lines[:last], previous, f"{key} = {value}{ending}", *lines[last + 1 :]]
    return lines


def _tables(lines: list[str]) -> Iterator[tuple[int, int]]:
    """Yield the first line of each [[drones]] and the first line of the next table."""
    headers = [n for n, line in enumerate(lines) if TABLE_HEADER.match(line)]
    for n, end in pairwise([*headers, len(lines)]):
        if DRONES_HEADER.fullmatch(lines[n].rstrip("\r\n")):
            yield n, end


def _replace_value(line: str, key: str, value: str) -> str:
    """Return the line with another value; a comment after it stays."""
    found = re.match(
        rf"(\s*{key}\s*=\s*)(\"[^\"]*\"|'[^']*'|\[[^\]]*\]|\{{[^}}]*\}}|[^#\s]*)(.*)",
        line,
        re.DOTALL,
    )
    return line if found is None else f"{found[1]}{value}{found[3]}"


def _parsed_id(lines: list[str]) -> object:
    try:
        found: Any = tomllib.loads("".join(lines))["drones"][0]
        return found.get("id")
    except (tomllib.TOMLDecodeError, LookupError):
        return None


def _parsed(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None


def _expected_values(
    raw: dict[str, Any] | None, changes: Mapping[int, Mapping[str, object]]
) -> dict[str, Any] | None:
    """Return the plain values that the changed text must have; None if that is impossible."""
    if raw is None or not all(
        any(drone.get("id") == i for drone in raw.get("drones", ())) for i in changes
    ):
        return None
    drones = [{**drone, **changes.get(drone.get("id"), {})} for drone in raw["drones"]]
    return {**raw, "drones": drones}
