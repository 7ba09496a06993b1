"""The choice of a path: a drone follows its wanted reference, goes round the others, or brakes."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from crazychoir.safety.collision.agreed.agreement import (
    NO_PATH,
    NO_REST_PLACE,
    Agreement,
)
from crazychoir.safety.collision.agreed.detours import Detours
from crazychoir.safety.collision.agreed.meeting import OtherPaths
from crazychoir.safety.collision.agreed.obstacles import Obstacles
from crazychoir.safety.collision.agreed.path_limits import (
    PATH_ACCELERATIONS,
    PATH_TOLERANCES,
    PLANNING_TIMES,
    PathLimits,
    compute_hard_path_room,
)
from crazychoir.safety.collision.agreed.paths import (
    compute_end_place,
    compute_motion,
    compute_path_duration,
    find_peak_sideways_acceleration,
    plan_braking,
    plan_catching_up,
    plan_flight,
)
from crazychoir.safety.collision.agreed.rest_goal import ARRIVAL_DISTANCE, RestGoal
from crazychoir.types import FullState, Vec

FutureReference = Callable[[float], FullState]
"""The wanted reference a number of seconds from now."""


@dataclass(frozen=True, slots=True)
class WantedFlight:
    """The wanted reference from now on."""

    future: FutureReference
    """The wanted reference a number of seconds from now."""
    whole: float
    """Seconds until it ends at rest, if one go_to leads there; else 0."""
    stands: bool
    """Whether it stands still now, because the drone is delayed."""


class PathChoice:
    """Chooses the path that a drone flies next, and asks the others for it.

    agreement: path and offer of this drone, and those of the others
    obstacles: what the drone must keep clear of
    detours: paths that go round them
    limits: where and how fast the drone flies
    """

    def __init__(
        self,
        agreement: Agreement,
        obstacles: Obstacles,
        detours: Detours,
        limits: PathLimits,
    ) -> None:
        self._agreement = agreement
        self._obstacles = obstacles
        self._detours = detours
        self._v_max = limits.v_max
        self._a_max = min(limits.a_max, PATH_ACCELERATIONS.gentle)
        self._hardest_braking = min(limits.a_max, PATH_ACCELERATIONS.urgent)
        self._braking_path = NO_PATH
        self.gives_way_to: int | None = None
        """Id of the drone that this one would have met on its wanted path.

        None if there is no such drone.
        """

    def decide(self, wanted: WantedFlight, now: float, alone: bool) -> None:
        """Look for a better path than the present one, and ask for it.

        wanted: the wanted reference from now on
        now: s
        alone: whether a landing drone goes on without asking
        """
        mine = self._agreement
        if self._arrives(wanted, now):
            mine.in_vain = 0.0
            return
        threat = self._obstacles.strangers().first(mine.way, mine.began, now)[0] - now
        mute = mine.mute(now)
        if alone:
            self._keeps_up(wanted, now, now, self._obstacles.all(now), alone)
        elif mute is None:
            self._choose(wanted, now, threat)
        else:
            mine.waited(mute, PLANNING_TIMES.check_interval)
            self._brake_before(threat, now, self._obstacles.all(now))

    def _arrives(self, wanted: WantedFlight, now: float) -> bool:
        """Return whether the present path is the wanted reference, to its end."""
        mine = self._agreement
        near = (
            math.dist(
                compute_motion(mine.way, now - mine.began)[0:3], wanted.future(0.0).p
            )
            <= PATH_TOLERANCES.off_reference
        )
        return near and self._ends(
            wanted.future(
                wanted.whole if wanted.whole > 0.0 else PLANNING_TIMES.horizons[0]
            )
        )

    def _ends(self, then: FullState) -> bool:
        """Return whether the wanted reference rests where the present path ends."""
        motion = then.flat
        return (
            math.dist(motion[0:3], compute_end_place(self._agreement.way))
            < PATH_TOLERANCES.same_end
            and float(np.linalg.norm(motion[3:6])) < PATH_TOLERANCES.same_end
        )

    def _brake_before(self, threat: float, now: float, others: OtherPaths) -> None:
        """Brake unasked before a meeting in `threat` s, unless braking would cause one sooner.

        The meeting is with a drone that announces no path. The drone brakes once: a path to rest
        that begins anew, slowly each time, comes to rest ever later and further on.
        """
        mine = self._agreement
        if threat >= PLANNING_TIMES.imminent_meeting or mine.way is self._braking_path:
            return
        way = plan_braking(
            compute_motion(mine.way, now - mine.began), self._hardest_braking
        )
        if others.first(way, now, now)[0] >= now + threat:
            self._braking_path = way
            mine.begin(way, now)

    def _choose(self, wanted: WantedFlight, now: float, threat: float) -> None:
        """Ask for the best path that is clear."""
        mine = self._agreement
        begins = now + mine.lead_time if mine.asks() else now
        start = compute_motion(mine.way, begins - mine.began)
        others = self._obstacles.all(now)
        if self._keeps_up(wanted, begins, now, others):
            return
        if threat >= PLANNING_TIMES.imminent_meeting and self._may_wait(
            wanted, begins - now + PLANNING_TIMES.check_interval, now
        ):
            return
        goal, moves = self._goal(wanted, begins - now)
        aim = RestGoal(
            goal, self._v_max, self._a_max, mine.awaited(now), self._obstacles.figures
        )
        leads = moves and math.dist(compute_end_place(mine.way), goal) <= max(
            ARRIVAL_DISTANCE,
            PATH_TOLERANCES.moving_goal_share * math.dist(start[0:3], goal),
        )
        present = mine.left(now) + (
            0.0 if leads else aim.missing(compute_end_place(mine.way))
        )
        mine.awaits = NO_REST_PLACE if moves or mine.comes_to(goal) else goal
        if threat < PLANNING_TIMES.imminent_meeting:
            present = math.inf
        wait = begins - now
        for option in self._detours.options(
            start,
            aim,
            (mine.way, begins - mine.began),
            present - PLANNING_TIMES.least_gain - wait,
        ):
            if others.clear(option.way, begins, now):
                mine.propose(option.way, begins)
                mine.settle(now)
                return
        self._brake_before(threat, now, others)

    def _keeps_up(
        self,
        wanted: WantedFlight,
        begins: float,
        now: float,
        others: OtherPaths,
        alone: bool = False,
    ) -> bool:
        """Follow the wanted reference if the drone is near it and no other is in the way.

        wanted: the wanted reference from now on
        begins: s, when the path begins
        now: s
        others: the paths of the others
        alone: whether the drone flies without asking
        Returns whether it does.
        """
        mine = self._agreement
        wait = 0.0 if wanted.stands else begins - now
        start = compute_motion(mine.way, begins - mine.began)
        behind = start - wanted.future(wait).flat[0:12]
        if np.linalg.norm(behind[0:3]) > PATH_TOLERANCES.off_reference:
            return False
        catching_up = self._catches_up(behind)
        horizons = (
            (wanted.whole - wait,) if wanted.whole > 0.0 else PLANNING_TIMES.horizons
        )
        for horizon in horizons:
            ahead = max(horizon, catching_up)
            then = wanted.future(wait + ahead)
            if horizon == horizons[0] and self._ends(then):
                return True
            way = plan_catching_up(start, then.flat[0:12], ahead, self._a_max)
            room = compute_hard_path_room(find_peak_sideways_acceleration(way))
            _, self.gives_way_to = others.first(way, begins, now, room)
            if self.gives_way_to is None:
                break
        else:
            return False
        if alone:
            mine.begin(way, now)
        else:
            mine.propose(way, begins)
            mine.settle(now)
        return True

    def _may_wait(self, wanted: WantedFlight, later: float, now: float) -> bool:
        """Return whether the present path is still the moving reference `later` s from now.

        Then the drone looks once more before it leaves the reference: the other drone may go on by then.
        """
        mine = self._agreement
        place = compute_motion(mine.way, now + later - mine.began)[0:3]
        gap = math.dist(place, wanted.future(later).p)
        moves = wanted.whole == 0.0 and not wanted.stands
        return moves and gap <= PATH_TOLERANCES.off_reference

    def _catches_up(self, behind: Vec) -> float:
        """Return the time in s to catch up with the wanted reference.

        behind: (12,): motion relative to the wanted reference
        """
        return compute_path_duration(
            plan_flight(behind, np.zeros(3), self._v_max, self._a_max)
        )

    def _goal(self, wanted: WantedFlight, wait: float) -> tuple[Vec, bool]:
        """Return where the wanted reference ends, (3,) m, and whether that place moves.

        A reference without a known end is assumed to brake, inside the fence.
        """
        if wanted.whole > 0.0:
            return wanted.future(wanted.whole).p, False
        if wanted.stands:
            return wanted.future(0.0).p, False
        then = wanted.future(wait).flat[0:12]
        if np.linalg.norm(then[3:6]) <= ARRIVAL_DISTANCE:
            return then[0:3], False
        return self._inside(
            then[0:3], compute_end_place(plan_braking(then, self._a_max))
        ), True

    def _inside(self, wanted: Vec, beyond: Vec) -> Vec:
        """Return a place, (3,) m, that is not further outside the fence than the wanted place."""
        fence = self._detours.fence
        return np.clip(
            beyond, np.minimum(fence.low, wanted), np.maximum(fence.high, wanted)
        )
