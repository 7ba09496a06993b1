"""What share of messages was lost lately, by counts that only grow."""

from collections import deque


class Lately:
    """Of one sender; window: s, what is older is forgotten, but for the last two counts."""

    def __init__(self, window: float) -> None:
        self.window = window
        self._counts: deque[tuple[float, int, int]] = deque()

    def note(self, now: float, sent: int, lost: int) -> None:
        """Its counts at a time, in s."""
        counts = self._counts
        if counts and sent < counts[-1][1]:  # its agent was started again
            counts.clear()
        counts.append((now, sent, lost))
        while len(counts) > 2 and now - counts[0][0] > self.window:
            counts.popleft()

    @property
    def counts(self) -> tuple[int, int]:
        """Sent, and lost of these."""
        if not self._counts:
            return 0, 0
        (_, sent, lost), (_, sent_now, lost_now) = self._counts[0], self._counts[-1]
        return sent_now - sent, lost_now - lost


def share(*of: Lately) -> float:
    """Of the messages of all of these."""
    counts = [one.counts for one in of]
    return sum(lost for _, lost in counts) / max(sum(sent for sent, _ in counts), 1)
