"""How much a host may send: who sends more is cut off before the event loop hears of it."""

from dataclasses import dataclass

from crazychoir.runtime.clock import SECOND

RATE = 20_000.0
"""Frames/s of a host; a team that exchanges as fast as two processes can sends some 8000."""
BURST = 5_000.0
"""Frames that a host may send at once."""
PART = 16_384
"""Bytes; a larger frame counts as several. So a burst that waits for a loop takes 80 MB, and 320 MB/s pass."""
MAX_HOSTS = 512
"""With a budget of their own; all beyond share one."""


@dataclass(slots=True)
class Budget:
    """What a host may still send: `left` frames, at `at_ns`."""

    at_ns: int
    left: float = BURST
    said: bool = False

    def take(self, now_ns: int, size: int = 0) -> bool:
        """Whether one more frame, of so many bytes, is within it."""
        self.left = min(BURST, self.left + (now_ns - self.at_ns) * RATE / SECOND)
        self.at_ns = now_ns
        cost = 1 + size // PART
        if self.left < cost:
            return False
        self.left -= cost
        return True


class Budgets:
    """Of all hosts."""

    def __init__(self) -> None:
        self._of: dict[str, Budget] = {}

    def of(self, host: str, now_ns: int) -> Budget:
        """That of a host; a new one is full."""
        found = self._of.get(host)
        if found is None:
            name = host if len(self._of) < MAX_HOSTS else ""
            found = self._of.setdefault(name, Budget(now_ns))
        return found
