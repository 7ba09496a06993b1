"""Messages of a recording back as the values that drones have said."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.cdr import Layout
from crazychoir.recording.mcap.messages import MESSAGES
from crazychoir.recording.mcap.reading import STAMP
from crazychoir.recording.mcap.sequence import Source, Told

NEEDLESS = ("header.", "child_frame_id", "pose.covariance", "twist.covariance")
"""How the paths of fields begin that say nothing of a value."""
Reader = tuple[Layout | None, Callable[[Sequence[Any]], Any]]
"""Where the numbers of a message lie, if they always lie there; and what makes a value of them."""
BY_TYPE = {message.type: message for message in MESSAGES.values()}


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
        return make(
            [
                value
                for name, value in message.values().items()
                if not name.startswith(NEEDLESS)
            ]
        )

    def _find(self, source: Source) -> Reader:
        found = BY_TYPE.get(source.type)
        if found is None or found.value is None or found.schema != source.schema:
            do = "Use the version that recorded it."
            raise ConfigError(
                str(self._path),
                f"another {source.type} for {source.name}",
                "those of this version",
                do,
            )
        fixed = all(
            leaf.fixed for leaf in found.leaves if not leaf.path.startswith(NEEDLESS)
        )
        reader = self._known[source] = (
            found.layout(source.drone) if fixed else None,
            found.value,
        )
        return reader
