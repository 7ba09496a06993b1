"""Who may fly what: a drone asks those with lower ids before it flies another way, and keeps clear of what it allowed.

A drone flies its way until all drones with lower ids that fly have agreed to the offer of another. The lowest asks
nobody, and begins at once; but it keeps clear of all ways that it has agreed to, until it hears that they are not
flown. So of any two one always knows all that the other may fly, however many messages are lost.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from crazychoir.bus.local import ANY, Port
from crazychoir.bus.topics import PLAN
from crazychoir.math3d import Mat
from crazychoir.runtime.clock import SECOND
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.collision.filter import GONE, USABLE
from crazychoir.safety.collision.ways import PIECE
from crazychoir.types import Plan

REPEAT = 0.05
"""s between two messages without news."""
NO_WAY: Mat = np.zeros((0, PIECE))
NOTHING = -1


@dataclass
class Other:
    """What is heard of another drone that plans.

    heard: s, when it said so;  began, begins: s, when its way began, when its offer would begin;  agreed: what it has
    agreed to;  allowed: the number of its offer to which this drone has agreed;  pending: an offer to be looked at.
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
    stands: bool = False

    def flies(self, now: float) -> bool:
        """Whether it is in the air, or about to be, as far as is heard."""
        return now - self.heard < GONE and not (self.stands and self.silent(now))

    def silent(self, now: float) -> bool:
        """Whether what it has said is too old to go by."""
        return now - self.heard > USABLE


class Agreement:
    """The own way and offer, and those of the others.

    way, began: what is flown, and since when, s;  offer, begins, number: what is asked for.
    """

    def __init__(self, port: Port, ids: Iterable[int]) -> None:
        self.port, self.clock, self.id = port, port.bus.clock, port.address
        self.others = {j: Other(j) for j in ids if j != port.address}
        self.way, self.began = NO_WAY, 0.0
        self.offer, self.begins, self.number = NO_WAY, 0.0, 0
        self._next, self._news = 0.0, False
        if self.others:
            port.bus.subscribe(PLAN, ANY, port.address, Call(self.clock, self._hear, "plans"))

    def _hear(self, message: tuple[int, Plan], age: float) -> None:
        j, plan = message
        other = self.others.get(j)
        heard = self.clock.now_ns() / SECOND - age
        if other is None or heard < other.heard or not (_is_way(plan.way, 1) and _is_way(plan.offer, 0)):
            return
        if heard - other.heard > GONE:
            other.allowed = NOTHING
        other.heard, other.agreed = heard, plan.agreed
        other.way, other.began = plan.way, heard - plan.since
        other.pending = len(plan.offer) > 0 and plan.number != other.allowed
        other.offer, other.begins, other.number = plan.offer, heard + plan.due, plan.number

    def flying(self, now: float) -> list[Other]:
        """Those in the air, as far as is heard."""
        return [other for other in self.others.values() if other.flies(now)]

    def begin(self, way: Mat, now: float) -> None:
        """Fly this from now on, without asking: at first, and when there is no other way."""
        self.way, self.began, self.offer, self._news = way, now, NO_WAY, True

    def propose(self, way: Mat, begins: float) -> None:
        """Ask for another way, which begins at the time `begins`, s."""
        self.offer, self.begins, self.number, self._news = way, begins, self.number + 1, True

    def settle(self, now: float) -> None:
        """When the offer is due: fly it if all have agreed; else forget it."""
        if len(self.offer) == 0 or now < self.begins:
            return
        if all(other.agreed.get(self.id) == self.number for other in self.flying(now) if other.id < self.id):
            self.way, self.began = self.offer, self.begins
        self.offer, self._news = NO_WAY, True

    def agree(self, other: Other) -> None:
        """The other may fly what it offers."""
        other.allowed, other.pending, self._news = other.number, False, True

    def may_be_flown(self, other: Other) -> bool:
        """Whether the other may fly its offer, as far as this drone is concerned."""
        return len(other.offer) > 0 and (other.id < self.id or other.allowed == other.number)

    def ready(self, now: float) -> bool:
        """Whether all that fly are heard, and know that this one does."""
        return all(not other.silent(now) and self.id in other.agreed for other in self.flying(now))

    def asks(self, now: float) -> bool:
        """Whether there is anybody to ask."""
        return any(other.id < self.id for other in self.flying(now))

    def tell(self, now: float) -> None:
        """Say it, when there is something new or it is time again."""
        if not self.others or not (self._news or now >= self._next):
            return
        self._next, self._news = now + REPEAT, False
        agreed = {other.id: other.allowed for other in self.flying(now)}
        plan = Plan(self.way, now - self.began, self.offer, self.begins - now, self.number, agreed)
        self.port.publish(PLAN, plan)


def _is_way(way: Mat, least: int) -> bool:
    """Whether it is a table of pieces, all numbers finite, no duration negative."""
    fits = way.ndim == 2 and way.shape[1] == PIECE and least <= len(way) <= 8
    return fits and bool(np.isfinite(way).all() and (way[:, 0] >= 0.0).all())
