"""What a drone hears of all others of its swarm: the newest state of each, and how often each hears its own."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from crazychoir.bus.port import ANY, Port
from crazychoir.bus.topics import STATE
from crazychoir.runtime.clock import SECOND
from crazychoir.runtime.mailbox import Call
from crazychoir.types import LinkStatus, State, Vec

BORN, SHARE, SOON, BORNE, HEARD, COLUMNS = 16, 17, 18, 19, 20, 21
"""Columns after the state (13,) and the acceleration (3,): s, when it was so; 1 if it gives way to nobody, else 0.5;
s, after which both could be near each other; s, the age of its state beyond which one brakes for want of a newer one;
s, when it was so that it itself has said it: of others it may be heard later.
"""
USABLE = 0.6
"""s: a state that is older is no use."""
UNHEARD = 0.2
"""s without a state after which a place that the cameras say counts."""
SILENT = 1.5
"""s, after which a drone that flew counts as not heard by who asks whether it is cut off."""
GONE = 10.0
"""s: a drone of which nobody hears for so long has come down, see Hearsay: it is cut off itself, or has failed."""
FAR, FASTEST = 1e6, 100.0
"""m, m/s2: a state with larger numbers is none."""
SLOW = 0.3
"""m/s, by which two drones may be faster at once than they are."""
SELDOM, OFTEN, TOTAL = 2.0, 20.0, 100.0
"""Hz, at which a drone is heard that is far away: as often as makes TOTAL for all of them, within these two."""
RATES = ((0.7, 50.0), (3.0, 20.0))
"""s, within which both could be near each other, and Hz, at which they then hear each other."""
PATIENCE = ((1.0, 10.0), (2.0, 5.0))
"""s, of ages that are borne, and Hz, so that several states in a row may be lost before somebody brakes."""
LOOK = 0.1
"""s, between two looks at who is near."""
DEAF = 0.3
"""s for which a radio is silent, after which its drone does not do what its agent says that it does."""


class Traffic:
    """The table of the others, by their place in `ids`: state, acceleration, when, share, how soon.

    Each drone hears all others, now and then; it says its own state more often to those that could be near soon, or
    that would brake soon if they did not hear it, as both know.
    alone: the drones that do not give way, as they fly by a planner on board.
    """

    def __init__(
        self, port: Port, ids: Iterable[int], alone: Sequence[int] = ()
    ) -> None:
        self.port = port
        self.clock = port.bus.clock
        self.ids = [j for j in ids if j != port.address]
        self.rows = np.zeros((len(self.ids), COLUMNS))
        self._parts = {
            j: (row, row[0:13], row[13:16])
            for j, row in zip(self.ids, self.rows, strict=True)
        }
        self.rows[:, 9] = 1.0
        self.rows[:, BORN] = -np.inf
        self.rows[:, SOON] = np.inf
        self.rows[:, HEARD] = -np.inf
        self.rows[:, BORNE] = np.inf
        self._shares = {j: 1.0 if j in alone else 0.5 for j in self.ids}
        self._deaf = dict.fromkeys(self.ids, False)
        self.rows[:, SHARE] = list(self._shares.values())
        self._pace = np.zeros(len(self.ids))
        self._looks = 0.0
        if self.ids:
            rate = min(max(TOTAL / len(self.ids), SELDOM), OFTEN)
            port.bus.subscribe(
                STATE, ANY, port.address, Call(self.clock, self.hear, "traffic"), rate
            )

    def now(self) -> float:
        """s, by the clock of the ages."""
        return self.clock.now_ns() / SECOND

    def row(self, j: int) -> Vec | None:
        """What is known of drone j, all columns; None for one that is not among the others."""
        found = self._parts.get(j)
        return None if found is None else found[0]

    def hear(self, message: tuple[int, State], age: float) -> None:
        """Keep a state that a drone has said, `age` s ago, unless a newer one is there or it is none."""
        row = self._keep(message, age)
        if row is not None:
            j = message[0]
            row[HEARD] = max(row[HEARD], self.now() - age)
            row[SHARE] = 1.0 if self._deaf[j] else self._shares[j]

    def told(self, message: tuple[int, State], age: float) -> None:
        """Keep a state of a drone that another one has told."""
        self._keep(message, age)

    def seen(self, j: int, state: State, age: float) -> None:
        """Where the cameras see drone j: that counts while nothing is heard of it, and then it gives way to nobody."""
        row = self.row(j)
        if row is not None and self.now() - row[BORN] > UNHEARD:
            self._keep((j, state), age)
            row[SHARE] = 1.0

    def linked(self, j: int, link: LinkStatus | None, age: float) -> None:
        """How the radio of drone j is: one that does not hear its agent gives way to nobody, whatever that says."""
        if j in self._deaf and link is not None:
            self._deaf[j] = link.silence + age > DEAF

    def deaf(self, j: int) -> bool:
        """Whether the radio of drone j is silent: it goes on with what it heard last."""
        return self._deaf[j]

    def _keep(self, message: tuple[int, State], age: float) -> Vec | None:
        """The row of a drone whose state this is; None if it is none, or of nobody."""
        j, state = message
        found = self._parts.get(j)
        if found is None or not (
            math.hypot(*state.flat.tolist()) < FAR
            and math.hypot(*state.a.tolist()) < FASTEST
        ):
            return None
        row, flat, a = found
        born = self.now() - age
        if born >= row[BORN]:
            flat[:] = state.flat
            a[:] = state.a
            row[BORN] = born
        return row

    def look(self, now: float) -> bool:
        """Say the own state more often to who is near, now and then: whether it has looked."""
        if now < self._looks:
            return False
        self._looks = now + LOOK
        soon = self.rows[:, SOON]
        borne = self.rows[:, BORNE]
        pace = np.zeros(len(self.ids))
        for reached, tiers in ((soon, RATES), (borne, PATIENCE)):
            for within, rate in tiers:
                pace[reached < within] = np.maximum(pace[reached < within], rate)
        for k in np.flatnonzero(pace != self._pace).tolist():
            self.port.pace(STATE, self.ids[k], float(pace[k]))
        self._pace = pace
        return True
