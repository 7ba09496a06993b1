"""Limit how often the same text is logged."""

import math


class Throttle:
    """Allows each topic at most once in `period` s, and a repeated topic more and more rarely.

    Each time a topic is allowed, the silence after it doubles, up to `longest` s. A topic that did
    not come up for `longest` s starts again with `period`.

    period: s: silence after the first time
    longest: s: longest silence
    """

    def __init__(self, period: float = 1.0, longest: float = 30.0) -> None:
        self.period = period
        self.longest = longest
        self._asked: dict[str, float] = {}
        # By topic: the time from which it is let through again, and the silence after that.
        self._next: dict[str, tuple[float, float]] = {}

    def due(self, now: float, topic: str) -> bool:
        """Return whether the topic may be logged at `now` (s); True counts as logged."""
        if now - self._asked.get(topic, -math.inf) >= self.longest:
            self._next.pop(topic, None)
        self._asked[topic] = now
        again, silence = self._next.get(topic, (-math.inf, self.period))
        if now < again:
            return False
        self._next[topic] = now + silence, min(2.0 * silence, self.longest)
        return True
