"""A limit for the frames of a host: what exceeds it is dropped before it reaches the event loop."""

from dataclasses import dataclass

from crazychoir.runtime.clock import NS_PER_SECOND


@dataclass(frozen=True, slots=True)
class FloodLimits:
    """Limits of the frames that this process takes from a host."""

    frame_rate: float = 20_000.0
    """Frames/s of a host; a team that exchanges as fast as two processes can sends about 8000.
    """
    burst_size: float = 5_000.0
    """Frames that a host may send at once."""
    frame_part: int = 16_384
    """Bytes that count as one frame; a larger frame counts as several.

    So a burst that waits for the event loop has at most 80 MB, and 320 MB/s pass.
    """
    max_hosts: int = 512
    """Hosts with their own budget; all others share one."""


FLOOD_LIMITS = FloodLimits()


@dataclass(slots=True)
class FrameBudget:
    """The frames that a host may still send."""

    at_ns: int = 0
    """ns: time of the last frame."""
    left: float = FLOOD_LIMITS.burst_size
    """Frames left at that time."""
    said: bool = False
    """True if the flood was logged."""

    def take(self, now_ns: int, size: int = 0) -> bool:
        """Return True if one more frame of `size` bytes is within the budget, and take it."""
        limits = FLOOD_LIMITS
        left = self.left + (now_ns - self.at_ns) * limits.frame_rate / NS_PER_SECOND
        if left > limits.burst_size:
            left = limits.burst_size
        cost = 1 + size // limits.frame_part
        is_within = left >= cost
        self.left = left - cost if is_within else left
        self.at_ns = now_ns
        return is_within


class FrameBudgets:
    """The budgets of all hosts."""

    def __init__(self) -> None:
        self._of: dict[str, FrameBudget] = {}

    def of(self, host: str, now_ns: int) -> FrameBudget:
        """Return the budget of a host; a new one is full."""
        found = self._of.get(host)
        if found is None:
            name = host if len(self._of) < FLOOD_LIMITS.max_hosts else ""
            found = self._of.setdefault(name, FrameBudget(now_ns))
        return found
