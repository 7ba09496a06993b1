"""The agreement on paths: a drone asks all drones with lower ids before it changes its path.

A drone that wants another path publishes it as its offer, and flies its old path until all flying
drones with lower ids have agreed to the offer. Without their answers it stays on its path. The drone
with the lowest id asks no other drone. Each drone keeps clear of every offer that it has agreed to,
until it hears that the offer is not flown. Therefore one of two drones always knows all paths that
the other may fly, however many messages are lost. A drone that was in the air in its last message
counts as flying until another message says that it is not.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from crazychoir.bus.port import PORT_ADDRESSES, Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.collision.agreed.paths import (
    PIECE_SIZE,
    compute_end_place,
    compute_path_duration,
)
from crazychoir.safety.collision.agreed.rest_goal import ARRIVAL_DISTANCE
from crazychoir.types import Mat, Plan, Vec


@dataclass(frozen=True, slots=True)
class PlanAnnouncements:
    """How often a drone announces its plan, and how it numbers its offers."""

    repeat_interval: float = 0.05
    """s between two messages of a flying drone without news."""
    ground_repeat_interval: float = 0.2
    """s between two messages of a drone on the ground."""
    offer_lead_time: float = 0.3
    """Seconds before an offer begins, within which the others agree, or do not."""
    longest_lead_time: float = 0.7
    """The same at most, where messages are late.

    With a look, it is as long as what a drone plans ahead, so that the drone need not stop meanwhile.
    """
    answer_time: float = 0.15
    """Seconds of the lead time that are left beside the ways of an offer and its answer."""
    delay_decay: float = 0.99
    """Share of the largest delay of a drone's messages that is still expected after one more of them."""
    no_offer: int = -1
    """The number that stands for no offer."""
    offers_per_incarnation: int = 2**20
    """Numbers of offers for one incarnation of an agent."""


PLAN_ANNOUNCEMENTS = PlanAnnouncements()


NO_PATH: Mat = np.zeros((0, PIECE_SIZE))
"""A path without pieces: the drone does not fly, or has no offer."""
NO_REST_PLACE: Vec = np.zeros(0)
"""No place."""


@dataclass
class OtherPlanner:
    """What this drone knows about another drone with agreed paths."""

    id: int
    """Id of the drone."""
    heard: float = -np.inf
    """Time in s of its newest message."""
    delay: float = 0.0
    """Seconds that its messages take at most, as far as is known."""
    way: Mat = field(default_factory=lambda: NO_PATH)
    """(k, 25): its path."""
    began: float = 0.0
    """Time in s when its path began."""
    offer: Mat = field(default_factory=lambda: NO_PATH)
    """(k, 25): the path that it offers."""
    begins: float = 0.0
    """Time in s when its offer would begin."""
    number: int = PLAN_ANNOUNCEMENTS.no_offer
    """Number of its offer."""
    agreed: dict[int, int] = field(default_factory=dict)
    """Its agreements: id of a drone -> number of the offer."""
    allowed: int = PLAN_ANNOUNCEMENTS.no_offer
    """Number of its offer to which this drone has agreed."""
    pending: bool = False
    """Whether its offer still needs an answer."""
    awaits: Vec = field(default_factory=lambda: NO_REST_PLACE)
    """(3,) m, world: where it wants to rest but cannot; (0,) for nowhere."""
    stands: bool = False
    """Whether it has stood on the floor since its newest message."""

    @property
    def flies(self) -> bool:
        """Whether it is in the air, or about to be, by its newest message."""
        return len(self.way) > 0 and not self.stands

    def silent(self, now: float) -> bool:
        """Return whether its newest message is too old to rely on."""
        return now - self.heard > NEIGHBOUR_AGES.usable


class Agreement:
    """The path and the offer of this drone, and of all others with agreed paths.

    After a restart, offers get higher numbers than before, so that agreements to old offers no
    longer count.

    port: the port of this drone
    ids: ids of the drones with agreed paths
    """

    def __init__(self, port: Port, ids: Iterable[int]) -> None:
        self.port = port
        self.clock = port.bus.clock
        self.id = port.address
        self.others = {j: OtherPlanner(j) for j in ids if j != port.address}
        self.way = NO_PATH
        """(k, 25): the path that is flown."""
        self.began = 0.0
        """Time in s when the path began."""
        self.offer = NO_PATH
        """(k, 25): the path that is asked for."""
        self.begins = 0.0
        """Time in s when the offer begins."""
        self.number = (
            port.incarnation % 2**32 * PLAN_ANNOUNCEMENTS.offers_per_incarnation
        )
        """Number of the offer."""
        self.awaits = NO_REST_PLACE
        """(3,) m, world: where this drone wants to rest but cannot; (0,) for nowhere."""
        self.in_vain = 0.0
        """Seconds that it has asked, or could not ask, since an offer last succeeded."""
        self._asked = 0.0
        self.lacking: int | None = None
        """Id of the drone that last failed to answer."""
        self._next = 0.0
        self._news = False
        if self.others:
            port.bus.subscribe(
                DRONE_TOPICS.plan,
                PORT_ADDRESSES.any_drone,
                port.address,
                Call(self.clock, self._hear, "plans"),
            )

    def _hear(self, message: tuple[int, Plan], age: float) -> None:
        """Store a message of another drone if it is valid and not older than the last."""
        j, plan = message
        other = self.others.get(j)
        heard = self.clock.now_ns() / NS_PER_SECOND - age
        if other is None:
            return
        other.delay = max(age, PLAN_ANNOUNCEMENTS.delay_decay * other.delay)
        if heard < other.heard or not PLAN_VALIDATOR.is_sound(plan):
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

    def flying(self) -> list[OtherPlanner]:
        """Return the drones in the air, as far as is known."""
        return [other for other in self.others.values() if other.flies]

    def awaited(self, now: float) -> tuple[Vec, ...]:
        """Return the places, (3,) m each, where others want to rest but cannot."""
        return tuple(
            other.awaits
            for other in self.flying()
            if len(other.awaits) and not other.silent(now)
        )

    def left(self, now: float) -> float:
        """Return the time in s until the path of this drone ends."""
        return max(self.began + compute_path_duration(self.way) - now, 0.0)

    def comes_to(self, goal: Vec) -> bool:
        """Return whether the path of this drone ends at the goal, (3,) m."""
        return math.dist(compute_end_place(self.way), goal) < ARRIVAL_DISTANCE

    def begin(self, way: Mat, now: float) -> None:
        """Fly a path from now on without asking: the first path, or the only safe one.

        way: (k, 25), the path
        now: s
        """
        self.way = way
        self.began = now
        self.offer = NO_PATH
        self._news = True

    def propose(self, way: Mat, begins: float) -> None:
        """Offer another path to the drones with lower ids.

        way: (k, 25), the path
        begins: time in s at which it begins; until then all must have agreed
        """
        self.offer = way
        self.begins = begins
        self.number = self.number + 1
        self._news = True
        self._asked = self.clock.now()

    def settle(self, now: float) -> None:
        """When the offer is due, fly it if all flying drones with lower ids have agreed; else drop it."""
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
        self.offer = NO_PATH
        self._news = True

    def waited(self, j: int, seconds: float) -> None:
        """Note that this drone has waited `seconds` s in vain for drone j."""
        self.lacking = j
        self.in_vain = self.in_vain + seconds

    def rest(self, now: float) -> None:
        """Publish that this drone does not fly."""
        if len(self.way):
            self.way = NO_PATH
            self.offer = NO_PATH
            self.in_vain = 0.0
            self._news = True
            self.awaits = NO_REST_PLACE
        self.tell(now)

    def agree(self, other: OtherPlanner) -> None:
        """Agree to the offer of another drone; the next message says so."""
        other.allowed = other.number
        other.pending = False
        self._news = True

    def may_be_flown(self, other: OtherPlanner) -> bool:
        """Return whether the other drone may fly its offer, as far as this drone decides."""
        return len(other.offer) > 0 and (
            other.id < self.id or other.allowed == other.number
        )

    def mute(self, now: float) -> int | None:
        """Return the id of a flying drone that keeps this drone from changing its path, or None.

        This is a drone with messages that do not yet list this one as flying, or a silent drone with a
        lower id, which cannot agree. A silent drone with a higher id is no obstacle: it stays on the
        paths that it has announced.
        """
        for other in self.flying():
            if self.id not in other.agreed or (
                other.id < self.id and other.silent(now)
            ):
                return other.id
        return None

    def asks(self) -> bool:
        """Return whether this drone must ask another one: a flying drone with a lower id."""
        return any(other.id < self.id for other in self.flying())

    @property
    def lead_time(self) -> float:
        """Seconds before an offer begins; longer where the messages of drones that must agree are late.

        It covers the delay of an offer, that of its answer, and PLAN_ANNOUNCEMENTS.answer_time.
        """
        times = PLAN_ANNOUNCEMENTS
        asked = (other for other in self.flying() if other.id < self.id)
        delay = max((other.delay for other in asked), default=0.0)
        needed = 2.0 * delay + times.answer_time
        return min(times.longest_lead_time, max(times.offer_lead_time, needed))

    def tell(self, now: float) -> None:
        """Publish path and offer if there is news, or when it is time to repeat them."""
        if not self.others or not (self._news or now >= self._next):
            return
        self._next = now + (
            PLAN_ANNOUNCEMENTS.repeat_interval
            if len(self.way)
            else PLAN_ANNOUNCEMENTS.ground_repeat_interval
        )
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
        self.port.publish(DRONE_TOPICS.plan, plan)


class _PlanValidator:
    """Checks whether a plan is sound.

    A plan that many drones of a process receive is checked once.
    """

    def __init__(self) -> None:
        self._last: tuple[Plan | None, bool] = None, False

    def is_sound(self, plan: Plan) -> bool:
        """Return whether all of the plan can be flown."""
        last, sound = self._last
        if plan is not last:
            sound = (
                _is_path(plan.way) and _is_path(plan.offer) and _is_place(plan.awaits)
            )
            self._last = plan, sound
        return sound


PLAN_VALIDATOR = _PlanValidator()


def _is_path(way: Mat) -> bool:
    """Return whether it is a table of pieces with finite numbers and no negative duration."""
    fits = way.ndim == 2 and way.shape[1] == PIECE_SIZE and len(way) <= 8
    return fits and bool(np.isfinite(way).all() and (way[:, 0] >= 0.0).all())


def _is_place(p: Vec) -> bool:
    """Return whether it is a finite place, (3,), or no place, (0,)."""
    return p.shape in ((0,), (3,)) and bool(np.isfinite(p).all())
