"""The log of a page: what drones say, what becomes of them, what was commanded; the newest lines, with levels."""

from collections import deque
from dataclasses import dataclass
from typing import Literal

from crazychoir.bus.commands import COMMANDED
from crazychoir.runtime.clock import Clock

Level = Literal["info", "warning", "error"]
KEPT = 500
"""Lines."""
GRAVE = ("failed", "hangs", "late by", "motors", "stopped", "emergency")
"""Words of a line that somebody should act upon."""


@dataclass(frozen=True)
class Line:
    """number: counts from 1;  t: s, by the clock of the page's server;  drone: None for the page's own."""

    number: int
    t: float
    level: Level
    text: str
    drone: int | None = None


class Watch:
    """The lines."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self._lines: deque[Line] = deque(maxlen=KEPT)
        self.count = 0

    def add(self, text: str, level: Level = "info", drone: int | None = None) -> None:
        """One line more."""
        self.count += 1
        self._lines.append(Line(self.count, round(self.clock.now(), 2), level, text, drone))

    def told(self, i: int, text: str) -> None:
        """A line of drone i, which names no level: one of GRAVE makes it an error; commands are no trouble."""
        bare = text.removeprefix(f"drone {i}: ")
        trouble: Level = "error" if any(word in bare for word in GRAVE) else "warning"
        self.add(bare, "info" if bare.startswith(COMMANDED) else trouble, i)

    def after(self, number: int) -> list[Line]:
        """The lines since that one, oldest first."""
        return [line for line in self._lines if line.number > number]
