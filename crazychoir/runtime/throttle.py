"""How often the same thing is said."""

import math


class Throttle:
    """Lets each topic through at most once in `period` s; one that comes back or goes on, ever more rarely.

    The silence after a topic doubles each time that it is said, up to `longest` s; one of which nothing was to be said
    for `longest` s begins anew.
    """

    def __init__(self, period: float = 1.0, longest: float = 30.0) -> None:
        self.period = period
        self.longest = longest
        self._asked: dict[str, float] = {}
        self._next: dict[
            str, tuple[float, float]
        ] = {}  # when it may be said again, and the silence after that

    def due(self, now: float, topic: str) -> bool:
        """May this topic be said again at `now`? Saying so counts as having said it."""
        if now - self._asked.get(topic, -math.inf) >= self.longest:
            self._next.pop(topic, None)
        self._asked[topic] = now
        again, silence = self._next.get(topic, (-math.inf, self.period))
        if now < again:
            return False
        self._next[topic] = now + silence, min(2.0 * silence, self.longest)
        return True
