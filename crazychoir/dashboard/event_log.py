"""The logs of the page: messages of drones, changes of their state, and commands; the newest lines."""

from collections import deque
from dataclasses import dataclass
from typing import Literal

from crazychoir.bus.commands import COMMANDED_PREFIX
from crazychoir.runtime.clock import Clock

Level = Literal["info", "warning", "error"]
MOST_LOG_LINES = 500
"""Number of lines that are kept."""
ERROR_WORDS = ("failed", "hangs", "late by")
"""Words that mark an error: a part of an agent has failed, or a process's loop hangs."""


@dataclass(frozen=True)
class LogLine:
    """One line of a log."""

    number: int
    """Number of the line, from 1."""
    t: float
    """s, by the clock of the page's server."""
    level: Level
    """Level of the line."""
    text: str
    """The message."""
    drone: int | None = None
    """Id of the drone, None for the page itself."""


class EventLog:
    """The log with its newest lines."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._lines: deque[LogLine] = deque(maxlen=MOST_LOG_LINES)
        self.count = 0

    def add(self, text: str, level: Level = "info", drone: int | None = None) -> None:
        """Add one line."""
        self.count += 1
        self._lines.append(
            LogLine(self.count, round(self.clock.now(), 2), level, text, drone)
        )

    def told(self, i: int, text: str, grave: bool = False) -> None:
        """Add a message of drone i.

        A message about a command has level info. Another message is a warning, or an error if it
        is grave or contains one of ERROR_WORDS.
        """
        bare = text.removeprefix(f"drone {i}: ")
        trouble: Level = (
            "error" if grave or any(word in bare for word in ERROR_WORDS) else "warning"
        )
        is_news = bare.startswith(COMMANDED_PREFIX)
        self.add(bare, "info" if is_news else trouble, i)

    def after(self, number: int) -> list[LogLine]:
        """Return the lines after line `number`, oldest first."""
        return [line for line in self._lines if line.number > number]
