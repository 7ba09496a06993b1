"""The log of a page: what drones say, what becomes of them, what was commanded; the newest lines, with levels."""

from collections import deque
from dataclasses import dataclass
from typing import Literal

from crazychoir.bus.commands import COMMANDED
from crazychoir.runtime.clock import Clock

Level = Literal["info", "warning", "error"]
KEPT = 500
"""Lines."""
GRAVE = ("failed", "hangs", "late by")
"""Words of the lines with which agents say that a part of them has failed, and processes that their loop hangs."""


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
        self._lines.append(
            Line(self.count, round(self.clock.now(), 2), level, text, drone)
        )

    def told(self, i: int, text: str, grave: bool = False) -> None:
        """Trouble of drone i, or a command, which is none; grave, or with one of GRAVE, it is an error."""
        bare = text.removeprefix(f"drone {i}: ")
        trouble: Level = (
            "error" if grave or any(word in bare for word in GRAVE) else "warning"
        )
        self.add(bare, "info" if bare.startswith(COMMANDED) else trouble, i)

    def after(self, number: int) -> list[Line]:
        """The lines since that one, oldest first."""
        return [line for line in self._lines if line.number > number]
