"""Control messages that a newer one has overtaken on another way.

When two processes change from Zenoh to a socket, the first messages through the socket may overtake
the last ones through Zenoh. Of most topics of this class only the newest message counts, and Zenoh
does not tell how long it took. So the numbers of the messages decide.
"""

from collections.abc import Iterable
from typing import Final

from crazychoir.bus.frames import Envelope
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS

ControlStream = tuple[int, int, tuple[int, ...], str]
"""Topic, source, receivers and channel: of messages that agree in them only the newest counts."""

MOST_STREAMS: Final = 4096
"""Streams of a peer that are kept; with more, all are forgotten."""
PARTIAL_TOPICS: Final = (
    DRONE_TOPICS.airspace.number,
    MESSAGE_TOPICS.wanted_states.number,
    MESSAGE_TOPICS.relayed_states.number,
)
"""Topics with messages that do not replace each other, as each tells of other drones."""


class ControlNumbers:
    """The numbers of the newest control messages of a peer that came through a socket."""

    def __init__(self) -> None:
        self._newest: dict[ControlStream, int] = {}

    def note(self, messages: Iterable[Envelope]) -> None:
        """Note the messages of a frame that came through a socket."""
        if len(self._newest) > MOST_STREAMS:
            self._newest.clear()
        for message in messages:
            if message.topic not in PARTIAL_TOPICS:
                self._newest[_find_stream(message)] = message.number

    def drop_overtaken(self, messages: list[Envelope]) -> list[Envelope]:
        """Return the messages of a frame that came through Zenoh, without the overtaken ones.

        Messages without a number stay.
        """
        newest = self._newest
        return [
            message
            for message in messages
            if not 0 < message.number < newest.get(_find_stream(message), 0)
        ]


def _find_stream(message: Envelope) -> ControlStream:
    return message.topic, message.source, message.to, message.channel
