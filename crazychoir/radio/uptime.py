"""The time at which a drone took its logs, from its own clock, which counts since its start."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DroneClock:
    """What is known of a drone's clock and of the delay of its logs."""

    rate_error: float = 1e-3
    """Largest relative error of the drone's clock."""
    wrap_period: int = 1 << 24
    """ms: time after which the drone's time starts again at 0."""
    tick: float = 1e-3
    """s: a millisecond, the unit of the drone's time."""
    age_error: float = 0.5
    """s: time by which the known age of the last log may be wrong."""
    longest_wait: float = 10.0
    """s: no log waits so long in a link; a longer wait means that the drone was restarted."""


DRONE_CLOCK = DroneClock()


class Uptime:
    """The clock of one drone, from the time stamps `at` (ms) of its logs and their arrivals.

    Logs that wait in a link or in the event loop arrive together, so the time of arrival alone does
    not tell when a log was taken.
    """

    def __init__(self) -> None:
        self._at: int | None = None  # ms, newest log; None: no log yet
        self._own = 0.0
        self._least = math.inf
        self._taken = math.inf

    def restarted(self, now: float, at: int) -> bool:
        """Return whether the drone was restarted since its last log.

        Its time has then gone back, and is not longer than the time since that log. Or its time has
        gained on our clock, which no clock does, or has lost more than any link delays a log.

        now: s, our clock: arrival of the log
        at: ms, drone's clock: time stamp of the log
        """
        if self._at is None:
            return False
        since = self._since(at)
        ago = now - self._taken
        if since < 0.0:
            return (
                since < -DRONE_CLOCK.age_error
                and DRONE_CLOCK.tick * at < ago + DRONE_CLOCK.age_error
            )
        return (
            since > ago + DRONE_CLOCK.age_error + DRONE_CLOCK.rate_error * ago
            or since < ago - DRONE_CLOCK.longest_wait - DRONE_CLOCK.rate_error * ago
        )

    def overtaken(self, at: int) -> bool:
        """Return whether a newer log has already arrived."""
        return self._since(at) < 0.0

    def taken(self, now: float, at: int) -> float:
        """Return when the log was taken, in s of our clock.

        The result is late by the shortest time that a log has travelled so far.

        now: s, our clock: arrival of the log
        at: ms, drone's clock: time stamp of the log
        """
        since = self._since(at)
        self._at = at
        self._own = self._own + since
        self._least = min(self._least + DRONE_CLOCK.rate_error * since, now - self._own)
        self._taken = self._own + self._least
        return self._taken

    def _since(self, at: int) -> float:
        """Return the seconds from the newest log to this one, on the drone's clock.

        The value is negative if a newer log has overtaken this one. For the first log it counts
        from the drone's start.
        """
        if self._at is None:
            return DRONE_CLOCK.tick * at
        return DRONE_CLOCK.tick * (
            (at - self._at + DRONE_CLOCK.wrap_period // 2) % DRONE_CLOCK.wrap_period
            - DRONE_CLOCK.wrap_period // 2
        )
