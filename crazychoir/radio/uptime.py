"""When a drone has found what it says: by its own clock, which runs since it was started."""

import math

RUNS = 1e-3
"""How wrong its clock may run."""
WRAPS, MILLI = 1 << 24, 1e-3
"""Where its time begins anew; s, a unit of it."""
SLACK, WAITS = 0.5, 10.0
"""s by which what is known of its age may be wrong; and which no log waits in a link."""


class Uptime:
    """Of one drone, from the times `at`, ms, that its logs bear, and from when they have come.

    What waits in a link, or in our loop, comes all at once: when it has come says nothing of when it was so.
    """

    def __init__(self) -> None:
        self._at: int | None = None  # none has come
        self._own = 0.0
        self._least = math.inf
        self._taken = math.inf

    def restarted(self, now: float, at: int) -> bool:
        """Whether it has been started again since its last log: its time is less, and no longer than that is ago; or
        it has gained on ours, which no clock does, or lost what no link holds back.
        """
        if self._at is None:
            return False
        since = self._since(at)
        ago = now - self._taken
        if since < 0.0:
            return since < -SLACK and MILLI * at < ago + SLACK
        return since > ago + SLACK + RUNS * ago or since < ago - WAITS - RUNS * ago

    def overtaken(self, at: int) -> bool:
        """Whether something newer has been heard."""
        return self._since(at) < 0.0

    def taken(self, now: float, at: int) -> float:
        """s, by our clock, when it was as this log says; too late by the least time that one has been on its way."""
        since = self._since(at)
        self._at = at
        self._own = self._own + since
        self._least = min(self._least + RUNS * since, now - self._own)
        self._taken = self._own + self._least
        return self._taken

    def _since(self, at: int) -> float:
        """s since the newest, by its clock; negative of one that was overtaken; of the first, since its start."""
        if self._at is None:
            return MILLI * at
        return MILLI * ((at - self._at + WRAPS // 2) % WRAPS - WRAPS // 2)
