"""Share of messages that were lost recently, from counters that only grow."""

from collections import deque


class RecentCounts:
    """Recent counts of one sender.

    window: s; older counts are forgotten, but the last two are always kept.
    """

    def __init__(self, window: float) -> None:
        self.window = window
        self._counts: deque[tuple[float, int, int]] = deque()

    def note(self, now: float, sent: int, lost: int) -> None:
        """Store the counts of sent and lost messages at a time in s."""
        counts = self._counts
        if counts and sent < counts[-1][1]:  # the agent was restarted
            counts.clear()
        counts.append((now, sent, lost))
        while len(counts) > 2 and now - counts[0][0] > self.window:
            counts.popleft()

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of recently sent messages and of those lost."""
        if not self._counts:
            return 0, 0
        (_, sent, lost), (_, sent_now, lost_now) = self._counts[0], self._counts[-1]
        return sent_now - sent, lost_now - lost


def lost_share(*of: RecentCounts) -> float:
    """Return the lost share of the messages of all these senders."""
    counts = [one.counts for one in of]
    return sum(lost for _, lost in counts) / max(sum(sent for sent, _ in counts), 1)
