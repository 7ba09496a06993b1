"""Messages of a recording back as the values that drones have said."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.recording.cdr import Layout
from crazychoir.recording.figures import into_world
from crazychoir.recording.messages import MESSAGES
from crazychoir.recording.reading import STAMP
from crazychoir.recording.sequence import Source, Told
from crazychoir.types import (
    FPQR,
    FRPY,
    XYZ,
    Acc,
    Acceleration,
    Body,
    Drive,
    FullState,
    Goto,
    LinkStatus,
    Plan,
    Pose,
    State,
    Status,
    Vec,
    Vel,
    Velocity,
)

NEEDLESS = ("header.", "child_frame_id", "pose.covariance", "twist.covariance")
"""How the paths of fields begin that say nothing of a value."""
WAY = 25
"""Numbers of a row of a plan's way."""

Numbers = Sequence[Any]
Reader = tuple[Layout | None, Callable[[Numbers], Any]]
"""Where the numbers of a message lie, if they always lie there; and what makes a value of them."""


def _flat(x: Numbers) -> Vec:
    return np.array(x, dtype=float)


def _state(x: Numbers) -> State:
    """The opposite of messages.odometry; what the drone commanded is not recorded."""
    flat = _flat(x)
    v = into_world(flat[None, 3:7], flat[None, 7:10])[0]
    return State(np.concatenate([flat[0:3], v, flat[3:7], flat[10:13]]))


def _plan(raw: Mapping[str, Any]) -> Plan:
    way, offer = (_flat(raw[name]).reshape(-1, WAY) for name in ("way", "offer"))
    agreed = {int(i): number for i, number in raw["agreed"].items()}
    return Plan(way, raw["since"], offer, raw["due"], raw["number"], agreed, _flat(raw["awaits"]))


def _said(x: Numbers) -> Any:
    raw = json.loads(x[0])
    return _plan(raw) if isinstance(raw, dict) and "awaits" in raw else raw


VALUES: dict[Any, Callable[[Numbers], Any]] = {
    Pose: lambda x: Pose(_flat(x)),
    State: _state,
    Acceleration: lambda x: Acceleration(_flat(x[:3]), x[3]),
    FullState: lambda x: FullState(_flat(x)),
    Goto: lambda x: Goto(_flat(x[:3]), x[3], x[4]),
    FPQR: lambda x: FPQR(_flat(x)),
    FRPY: lambda x: FRPY(_flat(x)),
    Vel: lambda x: Vel(_flat(x)),
    Velocity: lambda x: Velocity(_flat(x[:3]), x[3]),
    Acc: lambda x: Acc(_flat(x)),
    Drive: lambda x: Drive(_flat(x)),
    XYZ: lambda x: XYZ(x[0], _flat(x[1:])),
    LinkStatus: lambda x: LinkStatus(*x),
    Body: lambda x: Body(*x),
    Status: lambda x: Status(*x),
    str: lambda x: x[0],
    dict: _said,
}
"""By the type of a value: from the fields of its message, without stamp and constants."""
BY_TYPE = {MESSAGES[kind].type: (MESSAGES[kind], make) for kind, make in VALUES.items()}


class Values:
    """What the messages of one recording say; path: named in errors."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[Source, Reader] = {}

    def of(self, message: Told) -> Any:
        """The value of a message; raises ConfigError for one of another version."""
        source = message.source
        layout, make = self._known.get(source) or self._find(source)
        if layout is not None:
            return make(layout.numbers(message.data)[STAMP:])
        return make([value for name, value in message.values().items() if not name.startswith(NEEDLESS)])

    def _find(self, source: Source) -> Reader:
        found = BY_TYPE.get(source.type)
        if found is None or found[0].schema != source.schema:
            do = "Use the version that recorded it."
            raise ConfigError(str(self._path), f"another {source.type} for {source.name}", "those of this version", do)
        row, make = found
        fixed = all(leaf.fixed for leaf in row.leaves if not leaf.path.startswith(NEEDLESS))
        reader = self._known[source] = (row.layout(source.drone) if fixed else None, make)
        return reader
