"""How long a wait for a round takes if no message is lost, and when to send a round again.

The mean and the deviation of the waits are those of TCP (Jacobson 1988, RFC 6298). TCP measures a
message and its acknowledgement; here a wait ends with the messages of all neighbours, which compute
before they send. Two things make such a wait longer than it will be next time, and both are left
out:

- The message that ended the wait was sent again: then the wait says how often it was lost.
- A neighbour has waited for a lost message itself: each message tells how late it is for this
  reason, and that time is subtracted. A drone that is delayed by a late message tells so in its own
  next one. As all drones are equally late soon, a lateness is passed on a few times only.

A message that was sent again may overtake the first one (Eifel, RFC 3522): if that arrives after all,
it was not lost.
"""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class ResendTimes:
    """When a round is sent again."""

    shortest: float = 0.010
    """Seconds: shortest time before a round is sent again."""
    longest: float = 0.100
    """Seconds: longest time between two resends of a round."""
    longest_first: float = 1.0
    """Seconds: longest time before a round is sent again for the first time."""
    attempts_a_time: int = 4
    """Resends after which the time between them doubles."""


RESEND_TIMES = ResendTimes()


NEGLIGIBLE_WAIT: Final = 0.1 * RESEND_TIMES.shortest
"""Seconds: a mean wait that changes the first resend by a tenth of the shortest time at most."""
MEAN_WEIGHT: Final = 1 / 8
"""Weight of a new wait in the mean (RFC 6298)."""
DEVIATION_WEIGHT: Final = 1 / 4
"""Weight of a new wait in the mean deviation (RFC 6298)."""
MOST_DEVIATIONS: Final = 4.0
"""Mean deviations above the mean after which a message counts as lost (RFC 6298)."""
LONGEST_SURPRISE: Final = 4.0
"""A wait counts for at most so many times the time before a resend.

So one long wait, for an agent that starts late, is not learned; long rounds are learned in a few.
"""
SHORTEST_SURPRISE: Final = LONGEST_SURPRISE * RESEND_TIMES.shortest
"""Seconds: a shorter wait is never such a surprise."""
LOSS_WEIGHT: Final = 1 / 32
"""Weight of a new wait in the share of the waits with losses."""
LOSSY_SHARE: Final = 0.1
"""Share of the waits with losses from which on a round is sent again after the shortest time."""
NO_LOSS_SHARE: Final = 1e-6
"""Share of the waits with losses that counts as none, some 300 rounds after a loss."""
UNPROVEN_SHARE: Final = 1e-4
"""Share of the waits with losses of a channel that knows nothing: it counts as none after 150 rounds."""


@dataclass(eq=False, slots=True)
class ExpectedWait:
    """What the past rounds of a channel tell about the next wait."""

    mean: float = 0.0
    """Seconds: smoothed wait without losses."""
    deviation: float = 0.0
    """Seconds: smoothed distance of the waits from their mean."""
    lost_share: float = UNPROVEN_SHARE
    """Smoothed share of the waits with a message that arrived only when it was sent again."""

    def learn(self, seconds: float) -> None:
        """Take into account a wait of this many seconds that no lost message has prolonged."""
        if seconds > SHORTEST_SURPRISE:
            seconds = min(seconds, LONGEST_SURPRISE * self._find_patience())
        error = seconds - self.mean
        self.mean += MEAN_WEIGHT * error
        self.deviation += DEVIATION_WEIGHT * (abs(error) - self.deviation)

    def note_repeat(self, was_needed: bool) -> None:
        """Take into account if a wait needed a message that was sent again."""
        self.lost_share += LOSS_WEIGHT * (was_needed - self.lost_share)
        if self.lost_share < NO_LOSS_SHARE:
            self.lost_share = 0.0

    def undo_repeat(self) -> None:
        """Undo the last `note_repeat`: the message was not lost, only overtaken."""
        self.lost_share = max(0.0, self.lost_share - LOSS_WEIGHT)

    def find_first_resend(self) -> float:
        """Return the seconds from the start of a wait to the first resend.

        The more messages are lost, the less it pays to wait for a late one.
        """
        lossy = min(1.0, self.lost_share / LOSSY_SHARE)
        return lossy * RESEND_TIMES.shortest + (1.0 - lossy) * self._find_patience()

    def find_next_resend(self, attempt: int) -> float:
        """Return the seconds to the next resend after this many."""
        doublings = min(attempt // RESEND_TIMES.attempts_a_time, 8)
        return min(RESEND_TIMES.longest, self.find_first_resend() * 2.0**doublings)

    def _find_patience(self) -> float:
        """Return the seconds in which nearly every message arrives that is not lost."""
        margin = max(RESEND_TIMES.shortest, MOST_DEVIATIONS * self.deviation)
        return min(self.mean + margin, RESEND_TIMES.longest_first)
