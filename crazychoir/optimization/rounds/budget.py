"""How long a team computes: a budget of seconds or of search steps, with one end for all robots."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from crazychoir.errors import ConfigError


class EndReason(StrEnum):
    """Why a team ended its computation early."""

    SECONDS = "seconds"
    """The seconds were over."""
    WORK = "work"
    """The next search steps would have exceeded the work."""
    INTERRUPTED = "interrupted"
    """The user interrupted it."""


@dataclass(frozen=True)
class BudgetSettings:
    """What a team may spend. Without a number the method ends by itself."""

    seconds: float | None = None
    """s, from the start of the clock."""
    work: int | None = None
    """Search steps, of the leaders of one cluster after the other: robots compute side by side."""

    def __post_init__(self) -> None:
        for name, value in (("seconds", self.seconds), ("work", self.work)):
            if value is not None and not 0 <= value < math.inf:
                raise ConfigError(name, value, "0 or more, and finite")

    @property
    def is_given(self) -> bool:
        """Whether the search goes on until the budget is spent."""
        return self.seconds is not None or self.work is not None


NO_BUDGET = BudgetSettings()
"""The method ends by itself."""


class Budget:
    """The budget of a team as one robot counts it.

    Clocks differ, so the robots agree on a round in which the computation ends. A robot that finds
    its time over in round k proposes round k + diameter. Each message has the earliest proposal
    that its sender knows:

        end <- min(end, ends of the neighbours, k + diameter if the own time is over)

    Every robot knows a proposal before its round comes. `is_over` is therefore the same at all
    robots in every round. Search steps need no message: all robots count the same.

    settings: seconds or search steps, the same at all robots.
    diameter: of the graph, hops.
    """

    def __init__(self, settings: BudgetSettings, diameter: int) -> None:
        self._settings = settings
        self._diameter = diameter
        self._round = 0
        self._end: tuple[int, EndReason] | None = None
        self._now: Callable[[], float] | None = None
        self._deadline = math.inf
        self._interrupted = False
        self.work = 0

    @property
    def is_given(self) -> bool:
        """Whether the search goes on until the budget is spent."""
        return self._settings.is_given

    @property
    def end_reason(self) -> EndReason | None:
        """Why the computation has ended early; None if it has not."""
        return self._end[1] if self._end and self._round >= self._end[0] else None

    @property
    def is_over(self) -> bool:
        """Whether the computation ends now, the same at all robots."""
        self._propose()
        return self.end_reason is not None

    @property
    def is_spent(self) -> bool:
        """Whether the time of this robot is over: it starts no long computation any more."""
        return self._spent_by() is not None

    def start_clock(self, now: Callable[[], float]) -> None:
        """Let the seconds begin; now: returns the time in s."""
        self._now = now
        if self._settings.seconds is not None:
            self._deadline = now() + self._settings.seconds

    def interrupt(self) -> None:
        """Let the team end its computation as soon as it can."""
        self._interrupted = True

    def word(self) -> list[Any] | None:
        """Return the earliest known end, for the next message: [round, reason], or None."""
        self._propose()
        return None if self._end is None else [self._end[0], self._end[1].value]

    def begin_round(self, number: int, words: Iterable[list[Any] | None]) -> None:
        """Take the ends that the neighbours know.

        number: of the round that begins.
        words: what their messages of the last round said.
        Raises ConfigError if the seconds have no clock.
        """
        if self._settings.seconds is not None and self._now is None:
            raise ConfigError("seconds", "no clock", "a clock, see `start_clock`")
        self._round = number
        for word in words:
            if word is not None:
                self._take((int(word[0]), EndReason(word[1])))

    def charge(self, steps: int) -> None:
        """Count search steps that are made in any case."""
        self.work += steps

    def allows(self, steps: int) -> bool:
        """Return whether so many search steps fit, and count them; the same at all robots."""
        if self.is_over:
            return False
        most = self._settings.work
        if most is not None and self.work + steps > most:
            self._take((self._round, EndReason.WORK))
            return False
        self.work += steps
        return True

    def _spent_by(self) -> EndReason | None:
        if self._interrupted:
            return EndReason.INTERRUPTED
        if self._now is not None and self._now() >= self._deadline:
            return EndReason.SECONDS
        return None

    def _propose(self) -> None:
        if self._end is None and (reason := self._spent_by()) is not None:
            self._take((self._round + self._diameter, reason))

    def _take(self, end: tuple[int, EndReason]) -> None:
        if self._end is None or end < self._end:
            self._end = end
