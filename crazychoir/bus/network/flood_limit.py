"""A limit for the frames of a host: what exceeds it is dropped before it reaches the event loop."""

from dataclasses import dataclass

from crazychoir.runtime.clock import SECOND

RATE = 20_000.0
"""Frames/s of a host; a team that exchanges as fast as two processes can sends about 8000."""
BURST = 5_000.0
"""Frames that a host may send at once."""
PART = 16_384
"""Bytes that count as one frame; a larger frame counts as several.

So a burst that waits for the event loop has at most 80 MB, and 320 MB/s pass.
"""
MAX_HOSTS = 512
"""Hosts with their own budget; all others share one."""


@dataclass(slots=True)
class Budget:
    """The frames that a host may still send."""

    at_ns: int
    """ns: time of the last frame."""
    left: float = BURST
    """Frames left at that time."""
    said: bool = False
    """True if the flood was logged."""

    def take(self, now_ns: int, size: int = 0) -> bool:
        """Return True if one more frame of `size` bytes is within the budget, and take it."""
        self.left = min(BURST, self.left + (now_ns - self.at_ns) * RATE / SECOND)
        self.at_ns = now_ns
        cost = 1 + size // PART
        if self.left < cost:
            return False
        self.left -= cost
        return True


class Budgets:
    """The budgets of all hosts."""

    def __init__(self) -> None:
        self._of: dict[str, Budget] = {}

    def of(self, host: str, now_ns: int) -> Budget:
        """Return the budget of a host; a new one is full."""
        found = self._of.get(host)
        if found is None:
            name = host if len(self._of) < MAX_HOSTS else ""
            found = self._of.setdefault(name, Budget(now_ns))
        return found
