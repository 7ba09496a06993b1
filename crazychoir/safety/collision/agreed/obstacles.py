"""Where all others may be: on the ways that they tell, or, if they tell none, by the state that is heard of them."""

import math

import numpy as np

from crazychoir.safety.collision.agreed.agreement import Agreement, Other
from crazychoir.safety.collision.agreed.landing_place import nearest_free
from crazychoir.safety.collision.agreed.meeting import Meeting
from crazychoir.safety.collision.agreed.paths import end
from crazychoir.safety.collision.filter import BODY, STANDING
from crazychoir.safety.collision.neighbour_table import (
    BORN,
    SLOW,
    SOON,
    USABLE,
    Traffic,
)
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import State, Vec

RESTS = 0.3
"""m/s, below which a low drone stands."""
FREE = 0.25
"""m between one that comes down beside others and what it keeps clear of anyway."""
UNANSWERED = 5.0
"""s, for which one that lands waits for agreement: then it comes down as far as that is clear of what it knows."""


class Obstacles:
    """The others, as a drone that tells its ways sees them.

    figures: as f of `meets`;  agreement: with those that tell theirs;  traffic: the states of all;  a_max: m/s2, with
    which one who tells no way is taken to brake;  ground: m.
    """

    def __init__(
        self,
        figures: Vec,
        agreement: Agreement,
        traffic: Traffic,
        a_max: float,
        ground: float,
    ) -> None:
        self.figures = figures
        self.agreement = agreement
        self.traffic = traffic
        self.a_max = a_max
        self._ground = ground
        self._rows = {j: traffic.rows[k] for k, j in enumerate(traffic.ids)}
        self._guessed = [j for j in traffic.ids if j not in agreement.others]

    def look(self, now: float) -> None:
        """Say its state as often as is due; who has stood on the floor since it told its way flies no more."""
        self.traffic.look(now)
        for j, other in self.agreement.others.items():
            other.stands = self.stands(j) and self._rows[j][BORN] > other.heard + USABLE

    def measure(self, state: State) -> None:
        """How soon it could be near each of the others."""
        rows = self.traffic.rows
        apart = np.linalg.norm(rows[:, 0:3] - state.p, axis=1)
        rows[:, SOON] = apart / (
            np.linalg.norm(rows[:, 3:6], axis=1) + np.linalg.norm(state.v) + SLOW
        )

    def who_stands_at(self, p: Vec) -> int | None:
        """One that stands where another would come down, p (3,) m: that does not begin to, as it may sink further."""
        for j, x in self._rows.items():
            if math.hypot(x[0] - p[0], x[1] - p[1]) < BODY and self.stands(j):
                return j
        return None

    def stands(self, j: int) -> bool:
        """Whether it stood on the floor when it was heard last."""
        x = self._rows[j]
        return bool(
            x[BORN] > -math.inf
            and x[2] < self._ground + STANDING
            and np.linalg.norm(x[3:6]) < RESTS
        )

    def beside(self, p: Vec, fence: Fence) -> Vec | None:
        """The place nearest to p (3,) m, as high, to come down beside all others; None: there is none near."""
        spots = []
        for j, x in self._rows.items():
            if x[BORN] > -math.inf:
                other = self.agreement.others.get(j)
                at = end(other.way) if other is not None and other.flies else x[0:3]
                spots.append(
                    (at[0], at[1], self.figures[3 if self.stands(j) else 2] + FREE)
                )
        return nearest_free(p, np.array(spots), fence)

    def all(self, now: float) -> Meeting:
        """All that its own way must keep clear of."""
        meeting = self.strangers()
        for other in self.agreement.others.values():
            self._add(meeting, other, now)
        return meeting

    def strangers(self) -> Meeting:
        """Those that say no way, and keep clear by themselves."""
        meeting = Meeting(self.figures, self.a_max)
        for j in self._guessed:
            self._guess(meeting, j)
        return meeting

    def _add(self, meeting: Meeting, other: Other, now: float) -> None:
        if not other.flies:
            self._guess(meeting, other.id)
            return
        ways = [(other.way, other.began)]
        if self.agreement.may_be_flown(other):
            ways.append((other.offer, other.begins))
        for way, began in ways:
            if other.silent(now):
                meeting.somewhere(other.id, way, began, other.heard)
            else:
                meeting.way(other.id, way, began)
        if now - other.heard > UNANSWERED:
            meeting.below(other.id, end(other.way))
        if self.traffic.deaf(other.id):  # what it says, and where it is
            self._guess(meeting, other.id)

    def _guess(self, meeting: Meeting, j: int) -> None:
        x = self._rows[j]
        if self.stands(j):
            meeting.stands(j, x[0:3])
        elif x[BORN] > -math.inf:
            meeting.guessed(j, x[0:3], x[3:6], x[BORN])
