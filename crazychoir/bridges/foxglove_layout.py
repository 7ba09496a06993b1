"""The layout of Foxglove's panels for a swarm.

The file data/foxglove_layout.json is a layout for drone 0, which Foxglove imports as it is. For a
swarm, each series of drone 0 is repeated for every drone.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

LAYOUT_FILE = Path(__file__).with_name("data") / "foxglove_layout.json"
"""The layout for drone 0."""
_FIRST_TOPIC = "/drone0/"


def make_layout(drones: Sequence[int], key: str = "") -> dict[str, Any]:
    """Return the layout for these drones, as JSON values.

    key: key of the commands, which is filled into the requests
    """
    layout: dict[str, Any] = json.loads(LAYOUT_FILE.read_text(encoding="utf-8"))
    for config in layout["configById"].values():
        if "paths" in config:
            config["paths"] = [
                _series_of(path, i) for path in config["paths"] for i in drones
            ]
        if "requestPayload" in config:
            request = json.loads(config["requestPayload"])
            config["requestPayload"] = json.dumps(_fill(request, drones, key))
    return layout


def _series_of(path: dict[str, Any], i: int) -> dict[str, Any]:
    """Return the series of drone 0 for drone i."""
    value = path["value"].replace(_FIRST_TOPIC, f"/drone{i}/")
    return path | {"value": value, "label": f"drone {i}"}


def _fill(request: dict[str, Any], drones: Sequence[int], key: str) -> dict[str, Any]:
    """Return a request with the key, and with the first drone in place of drone 0."""
    chosen = {"drones": list(drones[:1])} if "drones" in request else {}
    return request | {"key": key} | chosen
