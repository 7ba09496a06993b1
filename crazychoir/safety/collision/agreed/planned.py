"""Keeping clear for drones that fly by a planner on board, and for those that are sent velocities: by agreed ways.

Each such drone says what it will fly, to the end. It flies where it is wanted as long as that is clear of all that
the others will fly; else it delays its flight, splits it by a waypoint, or goes part of it; see `agreement` for when it
may. It says which place it cannot come to, and whoever rests there without being at its own goal goes elsewhere.
"""

import math
from collections.abc import Callable, Iterable

import numpy as np

from crazychoir.bus.port import Port
from crazychoir.config.tables import Collision
from crazychoir.safety.collision.agreed.agreement import NO_WAY, NOWHERE, Agreement
from crazychoir.safety.collision.agreed.detours import Detours
from crazychoir.safety.collision.agreed.meeting import Meeting
from crazychoir.safety.collision.agreed.obstacles import UNANSWERED, Obstacles
from crazychoir.safety.collision.agreed.paths import (
    braking,
    end,
    flight,
    hardest,
    keeping_up,
    moving,
    seconds,
)
from crazychoir.safety.collision.agreed.rest_goal import NEAR, Aim
from crazychoir.safety.collision.filter import BODY
from crazychoir.safety.collision.neighbour_table import USABLE, Traffic
from crazychoir.safety.collision.relayed_states import Hearsay
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import FullState, State, Vec

PERIOD = 0.1
"""s between two looks at what could be flown."""
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Its multiples are spread over each PERIOD: drones of one process that take off together do not look together."""
ASKING = 0.3
"""s before an offer begins, within which the others agree, or do not."""
AHEAD = 0.8
"""s, at least, of what is wanted by somebody who does not say where it ends."""
BETTER = 0.3
"""s that another way must save."""
LEADS = 0.25
"""Of what is left to a goal that moves: ending so near to it, a way still leads there. Each new one begins slowly."""
ON, OFF = 0.03, 0.05
"""m from what is wanted: as good as there; and too far to catch up without a flight of its own."""
GENTLE = 0.8
"""m/s2, with which it flies where others are: harder ways are flown less exactly."""
URGENT = 1.6
"""m/s2, with which it brakes before a stranger."""
ROUGH, ROOM = 1.2, 0.4
"""m/s2 sideways, from which on a way as it is wanted is such a one; m of room that it needs beside D."""
SAME = 1e-3
"""m and m/s, in which what is wanted and what is flown end the same way."""
LOST = 0.35
"""m between a drone and its way, beyond which it begins another one from where it is."""
IMMINENT = 1.0
"""s before a meeting with somebody who does not agree, within which it brakes if there is no other way."""
AWAY = 0.5
"""s without a flight, after which the next one begins anew."""
LOWEST = 0.25
"""m above the ground, of waypoints."""
LONG = 60.0
"""s, after which every landing has ended."""
Future = Callable[[float], FullState]
"""What is wanted so many s from now."""


class PlannedFlights:
    """The one interface: what is wanted -> what may be flown.

    |S (w_i(t) - w_j(t))| >= D for all t,  S = diag(1, s_x / s_y, s_x / s_z),  D = 2 s_x + margin + slack

    w: the ways of two drones that say theirs;  one who says none is taken to brake, from the state that is heard of it.
    settings: [collision];  planners: ids of those that plan;  v_max, a_max: of the ways.
    """

    def __init__(
        self,
        port: Port,
        settings: Collision,
        traffic: Traffic,
        planners: Iterable[int],
        fence: Fence,
        a_max: float,
        v_max: float,
        ground: float,
    ) -> None:
        sx, sy, sz = settings.semi_axes
        self._brake = min(a_max, URGENT)
        a_max = min(a_max, GENTLE)
        self.traffic = traffic
        self.a_max = a_max
        self.v_max = v_max
        figures = np.array(
            [sx / sy, sx / sz, 2.0 * sx + settings.margin + settings.slack, BODY]
        )
        self.agreement = Agreement(port, planners)
        self.hearsay = Hearsay(
            traffic
        )  # it answers; who is not heard by it is asked for its way
        self.obstacles = Obstacles(figures, self.agreement, traffic, a_max, ground)
        self.detours = Detours(v_max, a_max, fence, np.random.default_rng(port.address))
        self._flew = -math.inf
        self._next = 0.0
        self._phase = PERIOD * (GOLDEN * port.address % 1.0)
        self._kept = self._stands = False
        self._brakes = NO_WAY
        self.gives_way_to: int | None = None
        """Whom it would have met, had it flown as it was wanted to; None: nobody."""

    def fly(
        self,
        state: State,
        wanted: FullState,
        future: Future,
        whole: float,
        now: float,
        lands: bool = False,
        waits: bool = False,
    ) -> FullState:
        """What to fly now instead of `wanted`; that itself as long as nobody is in the way.

        future: what is wanted later;  whole: s until that ends at rest, if it does so after one go_to; else 0;
        lands: whether it is on its way down, for which it waits UNANSWERED s for agreement at most;  waits: whether
        what is wanted stands still while the drone is delayed.
        """
        mine = self.agreement
        self._stands = waits and self.delayed
        self._begin(state, wanted, now)
        mine.settle(now)
        self.obstacles.look(now)
        if now >= self._next and len(mine.offer) == 0:
            self.obstacles.measure(state)
            self._next = self._look_after(now)
            mine.awaits = NOWHERE
            if (
                lands
                and (j := self.obstacles.who_stands_at(future(LONG).p)) is not None
            ):
                self.gives_way_to = j
            else:
                self._decide(future, whole, now, lands and self.unanswered)
        self._answer(now)
        mine.tell(now)
        self._flew = now
        flown = moving(mine.way, now - mine.began)
        self._kept = math.dist(flown[0:3], wanted.p) < ON
        return wanted if self._kept else _reference(flown, wanted.yaw)

    def hears(self, state: State, now: float) -> bool:
        """Whether it sees itself, and can ask all that it has to: else it cannot agree with them."""
        return state.age <= USABLE and self.agreement.mute(now) is None

    def rest(self, now: float) -> None:
        """It is on the ground."""
        self.agreement.rest(now)
        self._kept = True

    @property
    def unanswered(self) -> bool:
        """Whether it has waited for agreement as long as one that lands does."""
        return self.agreement.in_vain >= UNANSWERED

    def lands(self, wanted: FullState, now: float) -> FullState:
        """What is wanted, whoever is in the way: for a drone that must come down, and cannot agree."""
        if now >= self._next:
            self.agreement.begin(braking(wanted.flat[0:12], self.a_max), now)
            self._next = self._look_after(now)
            self.agreement.awaits = NOWHERE
        self.obstacles.look(now)
        self.agreement.tell(now)
        self._flew = now
        self._kept = True
        return wanted

    def departure(self, yaw: float, now: float) -> FullState | None:
        """Where it is to be now, if it is not where it is wanted."""
        if self._kept or len(self.agreement.way) == 0 or now - self._flew > AWAY:
            return None
        return _reference(moving(self.agreement.way, now - self.agreement.began), yaw)

    def left(self, now: float) -> float:
        """s until its way ends."""
        return max(self.agreement.began + seconds(self.agreement.way) - now, 0.0)

    def comes_to(self, goal: Vec) -> bool:
        """Whether its way ends at goal (3,) m."""
        return math.dist(end(self.agreement.way), goal) < NEAR

    @property
    def delayed(self) -> bool:
        """Whether it is elsewhere than it was wanted to be when it flew last."""
        return not self._kept

    def _look_after(self, now: float) -> float:
        """The next look after this one, PERIOD later at most."""
        return now + PERIOD - (now - self._phase) % PERIOD

    def _begin(self, state: State, wanted: FullState, now: float) -> None:
        """A first way, to rest; again, from where it is, when it has been blown away from the one it had."""
        mine = self.agreement
        if len(mine.way) == 0 or now - self._flew > AWAY:
            near = math.dist(state.p, wanted.p) < LOST
            mine.begin(
                braking(wanted.flat[0:12] if near else _motion(state), self.a_max), now
            )
        elif math.dist(state.p, moving(mine.way, now - mine.began)[0:3]) > LOST:
            mine.begin(braking(_motion(state), self.a_max), now)

    def _answer(self, now: float) -> None:
        """Agree to the offers of drones with higher ids that do not meet what it flies, or may fly soon."""
        mine = self.agreement
        asking = [
            other
            for other in mine.others.values()
            if other.pending and other.id > mine.id
        ]
        if not asking:
            return
        own = Meeting(self.obstacles.figures, self.a_max)
        own.way(mine.id, mine.way, mine.began)
        if len(mine.offer):
            own.way(mine.id, mine.offer, mine.begins)
        for other in asking:
            if own.clear(other.offer, other.begins, now):
                mine.agree(other)

    def _decide(self, future: Future, whole: float, now: float, alone: bool) -> None:
        """Look for a better way than the one that is flown, and ask for it; alone: who wants to land, asks nobody."""
        mine = self.agreement
        if self._arrives(future, whole, now):
            mine.in_vain = 0.0
            return
        threat = self.obstacles.strangers().first(mine.way, mine.began, now)[0] - now
        mute = mine.mute(now)
        if alone:
            self._keeps_up(future, whole, now, now, self.obstacles.all(now), alone)
        elif mute is None:
            self._choose(future, whole, now, threat)
        else:
            mine.waited(mute, PERIOD)
            self._brake_before(threat, now, self.obstacles.all(now))

    def _arrives(self, future: Future, whole: float, now: float) -> bool:
        """Whether its way is what is wanted, to its end."""
        mine = self.agreement
        near = math.dist(moving(mine.way, now - mine.began)[0:3], future(0.0).p) <= OFF
        return near and self._ends(future(whole if whole > 0.0 else AHEAD))

    def _ends(self, wanted: FullState) -> bool:
        """Whether what is wanted is to be at rest where its way ends."""
        then = wanted.flat
        return (
            math.dist(then[0:3], end(self.agreement.way)) < SAME
            and float(np.linalg.norm(then[3:6])) < SAME
        )

    def _brake_before(self, threat: float, now: float, others: Meeting) -> None:
        """Brake, unasked, if it meets a stranger in `threat` s, and would meet nobody sooner if it did.

        Once: a way to rest that is begun anew, and slowly each time, comes to rest ever later and further on.
        """
        mine = self.agreement
        if threat >= IMMINENT or mine.way is self._brakes:
            return
        way = braking(moving(mine.way, now - mine.began), self._brake)
        if others.first(way, now, now)[0] >= now + threat:
            self._brakes = way
            mine.begin(way, now)

    def _choose(self, future: Future, whole: float, now: float, threat: float) -> None:
        """The best way that is clear."""
        mine = self.agreement
        begins = now + ASKING if mine.asks() else now
        start = moving(mine.way, begins - mine.began)
        others = self.obstacles.all(now)
        if self._keeps_up(future, whole, begins, now, others):
            return
        goal, moves = self._goal(future, whole, begins - now)
        aim = Aim(
            goal, self.v_max, self.a_max, mine.awaited(now), self.obstacles.figures
        )
        leads = moves and math.dist(end(mine.way), goal) <= max(
            NEAR, LEADS * math.dist(start[0:3], goal)
        )
        present = self.left(now) + (0.0 if leads else aim.missing(end(mine.way)))
        mine.awaits = NOWHERE if moves or self.comes_to(goal) else goal
        if threat < IMMINENT:
            present = math.inf
        wait = begins - now
        for option in self.detours.options(start, aim, present - BETTER - wait):
            if others.clear(option.way, begins, now):
                mine.propose(option.way, begins)
                mine.settle(now)
                return
        self._brake_before(threat, now, others)

    def _keeps_up(
        self,
        future: Future,
        whole: float,
        begins: float,
        now: float,
        others: Meeting,
        alone: bool = False,
    ) -> bool:
        """Go on as wanted, if it is there and nobody is in the way."""
        mine = self.agreement
        wait = 0.0 if self._stands else begins - now
        start = moving(mine.way, begins - mine.began)
        behind = start - future(wait).flat[0:12]
        if np.linalg.norm(behind[0:3]) > OFF:
            return False
        ahead = max(whole - wait if whole > 0.0 else AHEAD, self._catches_up(behind))
        then = future(wait + ahead)
        if self._ends(then):
            return True
        way = keeping_up(start, then.flat[0:12], ahead, self.a_max)
        room = ROOM if hardest(way) > ROUGH else 0.0
        _, self.gives_way_to = others.first(way, begins, now, room)
        if self.gives_way_to is not None:
            return False
        if alone:
            mine.begin(way, now)
        else:
            mine.propose(way, begins)
            mine.settle(now)
        return True

    def _catches_up(self, behind: Vec) -> float:
        """s that it takes to come from a motion (12,), relative to what is wanted, to that."""
        return seconds(flight(behind, np.zeros(3), self.v_max, self.a_max))

    def _goal(self, future: Future, whole: float, wait: float) -> tuple[Vec, bool]:
        """(3,) m, where what is wanted ends; or would, if it braked, inside the fence; and whether that moves."""
        if whole > 0.0:
            return future(whole).p, False
        if self._stands:
            return future(0.0).p, False
        then = future(wait).flat[0:12]
        if np.linalg.norm(then[3:6]) <= NEAR:
            return then[0:3], False
        return self._inside(then[0:3], end(braking(then, self.a_max))), True

    def _inside(self, wanted: Vec, beyond: Vec) -> Vec:
        """A place (3,) m not further outside the fence than what is wanted."""
        fence = self.detours.fence
        return np.clip(
            beyond, np.minimum(fence.low, wanted), np.maximum(fence.high, wanted)
        )


def _motion(state: State) -> Vec:
    """The motion (12,) of a drone, whose acceleration nobody knows."""
    return np.concatenate([state.p, state.v, np.zeros(6)])


def _reference(motion: Vec, yaw: float) -> FullState:
    return FullState(np.array([*motion.tolist(), yaw, 0.0]))
