"""Who may fly what: a drone asks those with lower ids before it flies another way, and keeps clear of what it allowed.

A drone flies its way until all drones with lower ids that fly have agreed to the offer of another. The lowest asks
nobody, and begins at once; but it keeps clear of all ways that it has agreed to, until it hears that they are not
flown. So of any two one always knows all that the other may fly, however many messages are lost. Who was in the air
when it was heard last flies until it says otherwise: a drone that gets no answer stays on the way it has.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from crazychoir.bus.port import ANY, Port
from crazychoir.bus.topics import PLAN
from crazychoir.runtime.clock import SECOND
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.collision.agreed.paths import PIECE
from crazychoir.safety.collision.neighbour_table import USABLE
from crazychoir.types import Mat, Plan, Vec

REPEAT = 0.05
"""s between two messages without news."""
RESTING = 0.2
"""s between two messages of one that is on the ground."""
NO_WAY: Mat = np.zeros((0, PIECE))
NOWHERE: Vec = np.zeros(0)
NOTHING = -1
NUMBERS = 2**20
"""Of offers, for one incarnation of an agent."""


@dataclass
class Other:
    """What is heard of another drone that plans.

    heard: s, when it said so;  began, begins: s, when its way began, when its offer would begin;  agreed: what it has
    agreed to;  allowed: the number of its offer to which this drone has agreed;  pending: an offer to be looked at;
    awaits: (3,) m, where it wants to rest, and cannot come to, or (0,).
    """

    id: int
    heard: float = -np.inf
    way: Mat = field(default_factory=lambda: NO_WAY)
    began: float = 0.0
    offer: Mat = field(default_factory=lambda: NO_WAY)
    begins: float = 0.0
    number: int = NOTHING
    agreed: dict[int, int] = field(default_factory=dict)
    allowed: int = NOTHING
    pending: bool = False
    awaits: Vec = field(default_factory=lambda: NOWHERE)
    stands: bool = False

    @property
    def flies(self) -> bool:
        """Whether it is in the air, or about to be, by the last that was heard of it."""
        return len(self.way) > 0 and not self.stands

    def silent(self, now: float) -> bool:
        """Whether what it has said is too old to go by."""
        return now - self.heard > USABLE


class Agreement:
    """The own way and offer, and those of the others.

    way, began: what is flown, and since when, s;  offer, begins, number: what is asked for;  awaits: (3,) m,
    where it wants to rest, and cannot come to, or (0,);  in_vain: s that it has asked, or could not ask, without having
    its way since;  lacking: whose word it lacked last.
    Numbers begin where no earlier agent of this drone has come to: what was agreed to for that one counts no more.
    """

    def __init__(self, port: Port, ids: Iterable[int]) -> None:
        self.port = port
        self.clock = port.bus.clock
        self.id = port.address
        self.others = {j: Other(j) for j in ids if j != port.address}
        self.way = NO_WAY
        self.began = 0.0
        self.offer = NO_WAY
        self.begins = 0.0
        self.number = port.incarnation % 2**32 * NUMBERS
        self.awaits = NOWHERE
        self.in_vain = 0.0
        self._asked = 0.0
        self.lacking: int | None = None
        self._next = 0.0
        self._news = False
        if self.others:
            port.bus.subscribe(
                PLAN, ANY, port.address, Call(self.clock, self._hear, "plans")
            )

    def _hear(self, message: tuple[int, Plan], age: float) -> None:
        j, plan = message
        other = self.others.get(j)
        heard = self.clock.now_ns() / SECOND - age
        if other is None or heard < other.heard or not JUDGE.is_sound(plan):
            return
        other.heard = heard
        other.agreed = plan.agreed
        other.awaits = plan.awaits
        other.way = plan.way
        other.began = heard - plan.since
        other.pending = len(plan.offer) > 0 and plan.number != other.allowed
        other.offer = plan.offer
        other.begins = heard + plan.due
        other.number = plan.number

    def flying(self) -> list[Other]:
        """Those in the air, as far as is heard."""
        return [other for other in self.others.values() if other.flies]

    def awaited(self, now: float) -> tuple[Vec, ...]:
        """The places (3,) m that others want to come to, and cannot."""
        return tuple(
            other.awaits
            for other in self.flying()
            if len(other.awaits) and not other.silent(now)
        )

    def begin(self, way: Mat, now: float) -> None:
        """Fly this from now on, without asking: at first, and when there is no other way."""
        self.way = way
        self.began = now
        self.offer = NO_WAY
        self._news = True

    def propose(self, way: Mat, begins: float) -> None:
        """Ask for another way, which begins at the time `begins`, s."""
        self.offer = way
        self.begins = begins
        self.number = self.number + 1
        self._news = True
        self._asked = self.clock.now()

    def settle(self, now: float) -> None:
        """When the offer is due: fly it if all have agreed; else forget it."""
        if len(self.offer) == 0 or now < self.begins:
            return
        lower = [other for other in self.flying() if other.id < self.id]
        lacking = next(
            (other.id for other in lower if other.agreed.get(self.id) != self.number),
            None,
        )
        if lacking is None:
            self.way = self.offer
            self.began = self.begins
            self.in_vain = 0.0
        else:
            self.waited(lacking, now - self._asked)
        self.offer = NO_WAY
        self._news = True

    def waited(self, j: int, seconds: float) -> None:
        """So long, for the word of drone j, in vain."""
        self.lacking = j
        self.in_vain = self.in_vain + seconds

    def rest(self, now: float) -> None:
        """Say that it does not fly."""
        if len(self.way):
            self.way = NO_WAY
            self.offer = NO_WAY
            self.in_vain = 0.0
            self._news = True
            self.awaits = NOWHERE
        self.tell(now)

    def agree(self, other: Other) -> None:
        """The other may fly what it offers."""
        other.allowed = other.number
        other.pending = False
        self._news = True

    def may_be_flown(self, other: Other) -> bool:
        """Whether the other may fly its offer, as far as this drone is concerned."""
        return len(other.offer) > 0 and (
            other.id < self.id or other.allowed == other.number
        )

    def mute(self, now: float) -> int | None:
        """One that keeps it from asking, or from flying another way unasked; None: nobody does.

        It is to be asked, and silent; or does not know that this drone flies. A silent one with a higher id stays on
        the ways that it has told.
        """
        for other in self.flying():
            if self.id not in other.agreed or (
                other.id < self.id and other.silent(now)
            ):
                return other.id
        return None

    def asks(self) -> bool:
        """Whether there is anybody to ask."""
        return any(other.id < self.id for other in self.flying())

    def tell(self, now: float) -> None:
        """Say it, when there is something new or it is time again."""
        if not self.others or not (self._news or now >= self._next):
            return
        self._next = now + (REPEAT if len(self.way) else RESTING)
        self._news = False
        agreed = {other.id: other.allowed for other in self.flying()}
        plan = Plan(
            self.way,
            now - self.began,
            self.offer,
            self.begins - now,
            self.number,
            agreed,
            self.awaits,
        )
        self.port.publish(PLAN, plan)


class _Judge:
    """Says whether a plan is sound; what many drones of a process are given is looked at once."""

    def __init__(self) -> None:
        self._last: tuple[Plan | None, bool] = None, False

    def is_sound(self, plan: Plan) -> bool:
        """Whether all of it can be flown."""
        last, sound = self._last
        if plan is not last:
            sound = _is_way(plan.way) and _is_way(plan.offer) and _is_place(plan.awaits)
            self._last = plan, sound
        return sound


JUDGE = _Judge()


def _is_way(way: Mat) -> bool:
    """Whether it is a table of pieces, all numbers finite, no duration negative."""
    fits = way.ndim == 2 and way.shape[1] == PIECE and len(way) <= 8
    return fits and bool(np.isfinite(way).all() and (way[:, 0] >= 0.0).all())


def _is_place(p: Vec) -> bool:
    """Whether it is one, all numbers finite, or none."""
    return p.shape in ((0,), (3,)) and bool(np.isfinite(p).all())
