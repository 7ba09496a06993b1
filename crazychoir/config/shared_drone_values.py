"""[defaults] of a swarm file given to its [[drones]], and drones that are left out of the run.

Both change the plain values before they become tables. Values of another form are left to the reader of
tables, which refuses them.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeGuard

Raw = dict[str, Any]
"""Plain values of a swarm file."""
MERGED_KEYS = ("options", "parameters")
"""Tables of a drone that are merged with those of [defaults], key by key."""


def fill_in_defaults(raw: Raw) -> Raw:
    """Return the values with [defaults] in each of the [[drones]] that lacks them."""
    defaults = raw.get("defaults")
    rows = raw.get("drones")
    if not isinstance(defaults, Mapping) or not _is_list_of_tables(rows):
        return raw
    return raw | {"drones": [_fill_row(row, defaults) for row in rows]}


def _fill_row(row: Mapping[str, Any], defaults: Mapping[str, Any]) -> Raw:
    merged = {
        key: {**defaults[key], **row[key]}
        for key in MERGED_KEYS
        if isinstance(defaults.get(key), Mapping) and isinstance(row.get(key), Mapping)
    }
    return {**defaults, **row, **merged}


def leave_out_drones(raw: Raw) -> Raw:
    """Return the values without drones that are left out, and without edges and neighbours to them.

    A drone is left out if it has enabled = false, or if `left_out` lists it. `left_out` then lists all.
    """
    rows = raw.get("drones")
    listed = raw.get("left_out", ())
    if not _is_list_of_tables(rows) or not isinstance(listed, list | tuple):
        return raw
    disabled = [
        row.get("id")
        for row in rows
        if row.get("enabled") is False or row.get("id") in listed
    ]
    gone = list(dict.fromkeys([*listed, *disabled]))
    if not gone:
        return raw
    kept = [_keep_neighbors(row, gone) for row in rows if row.get("id") not in disabled]
    changed = raw | {"drones": kept, "left_out": gone}
    for key, keep in KEEP_BY_KEY.items():
        if isinstance(raw.get(key), list | tuple):
            changed[key] = keep(raw[key], gone)
    return changed


def _keep_neighbors(row: Mapping[str, Any], gone: list[Any]) -> Raw:
    """Return a drone without the neighbours that are left out."""
    if not isinstance(row.get("neighbors"), list | tuple):
        return dict(row)
    return {**row, "neighbors": _without(row["neighbors"], gone)}


def _keep_edges(edges: Any, gone: list[Any]) -> list[Any]:
    """Return the edges between drones that fly."""
    return [
        edge
        for edge in edges
        if not isinstance(edge, list | tuple) or not any(i in gone for i in edge)
    ]


def _keep_groups(groups: Any, gone: list[Any]) -> list[Any]:
    """Return the groups without the drones that are left out, and no group without a drone."""
    kept = [
        _without(group, gone) if isinstance(group, list | tuple) else group
        for group in groups
    ]
    return [group for group in kept if group != []]


def _keep_logs(logs: Any, gone: list[Any]) -> list[Any]:
    """Return the [[logs]] of drones that fly."""
    kept = []
    for row in logs:
        drones = row.get("drones") if isinstance(row, Mapping) else None
        if not isinstance(drones, list | tuple):
            kept.append(row)
        elif left := _without(drones, gone):
            kept.append({**row, "drones": left})
    return kept


KEEP_BY_KEY: dict[str, Callable[[Any, list[Any]], list[Any]]] = {
    "edges": _keep_edges,
    "processes": _keep_groups,
    "logs": _keep_logs,
}
"""Keys of the file that list drones, and what remains of them."""


def _without(ids: Any, gone: list[Any]) -> list[Any]:
    return [i for i in ids if i not in gone]


def _is_list_of_tables(rows: object) -> TypeGuard[list[Mapping[str, Any]]]:
    return isinstance(rows, list | tuple) and all(
        isinstance(row, Mapping) for row in rows
    )
