"""Decode messages of a recording into the values that the drones published."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.cdr import Layout
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE
from crazychoir.recording.mcap.reading import STAMP_NUMBERS
from crazychoir.recording.mcap.sequence import RecordedChannel, RecordedMessage

SKIPPED_PREFIXES = ("header.", "child_frame_id", "pose.covariance", "twist.covariance")
"""Prefixes of the paths of fields that are no part of a value."""
Reader = tuple[Layout | None, Callable[[Sequence[Any]], Any]]
"""Layout of a message's numbers if they have fixed places, and the function that makes the value.
"""
MESSAGE_BY_ROS_TYPE = {message.type: message for message in FORM_BY_VALUE_TYPE.values()}
"""Messages by their type in the notation of ROS 2."""


class MessageDecoder:
    """Decodes the messages of one recording.

    path: the recording, for error texts
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[RecordedChannel, Reader] = {}

    def of(self, message: RecordedMessage) -> Any:
        """Return the value of a message; raises ConfigError for a message of another version."""
        source = message.source
        layout, make = self._known.get(source) or self._find(source)
        if layout is not None:
            return make(layout.numbers(message.data)[STAMP_NUMBERS:])
        return make(
            [
                value
                for name, value in message.values().items()
                if not name.startswith(SKIPPED_PREFIXES)
            ]
        )

    def _find(self, source: RecordedChannel) -> Reader:
        found = MESSAGE_BY_ROS_TYPE.get(source.type)
        if found is None or found.value is None or found.schema != source.schema:
            do = "Use the version that recorded it."
            raise ConfigError(
                str(self._path),
                f"another {source.type} for {source.name}",
                "those of this version",
                do,
            )
        fixed = all(
            leaf.fixed
            for leaf in found.leaves
            if not leaf.path.startswith(SKIPPED_PREFIXES)
        )
        reader = self._known[source] = (
            found.layout(source.drone) if fixed else None,
            found.value,
        )
        return reader
