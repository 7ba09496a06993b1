"""Collision avoidance by agreed paths, for drones with a planner on board or that get velocities.

Each such drone announces what it will fly, to the end. It flies where it is wanted as long as that
is clear of all that the others will fly. Otherwise it delays its flight, splits it by a waypoint,
or flies a part of it; `agreement` says when it may. It announces which place it cannot come to. A
drone that rests there without being at its own goal goes elsewhere.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from crazychoir.bus.port import Port
from crazychoir.config.tables import CollisionTable
from crazychoir.safety.collision.agreed.agreement import (
    NO_PATH,
    NO_REST_PLACE,
    Agreement,
)
from crazychoir.safety.collision.agreed.detours import Detours
from crazychoir.safety.collision.agreed.meeting import OtherPaths
from crazychoir.safety.collision.agreed.obstacles import OBSTACLE_LIMITS, Obstacles
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
from crazychoir.safety.collision.filter import COLLISION_DISTANCES
from crazychoir.safety.collision.neighbour_table import NEIGHBOUR_AGES, NeighbourTable
from crazychoir.safety.collision.relayed_states import RelayedStates
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import FullState, State, Vec


@dataclass(frozen=True, slots=True)
class PlanningTimes:
    """Times, s, by which a drone with agreed paths looks for a path, and keeps or leaves one."""

    check_interval: float = 0.1
    """Seconds between two looks for a better path."""
    offer_lead_time: float = 0.3
    """Seconds before an offer begins, within which the others agree, or do not."""
    least_horizon: float = 0.8
    """Least time in s that is planned ahead if the wanted reference has no known end."""
    least_gain: float = 0.3
    """Seconds that another path must save."""
    imminent_meeting: float = 1.0
    """Seconds before a meeting with a drone outside the agreement.

    Within this the drone brakes if there is no other path.
    """
    flight_break: float = 0.5
    """Seconds without a flight after which the next one begins anew."""
    landing_end: float = 60.0
    """Seconds after which each landing has ended."""


PLANNING_TIMES = PlanningTimes()


GOLDEN_SECTION = 0.5 * (math.sqrt(5.0) - 1.0)
"""Its multiples spread the looks over a PLANNING_TIMES.check_interval.

Drones of one process that take off together then do not look at the same time.
"""


@dataclass(frozen=True, slots=True)
class PathTolerances:
    """How near a drone, its path and its wanted reference are while they still count as together."""

    moving_goal_share: float = 0.25
    """Share of the distance left to a moving goal.

    A path that ends that near to the goal still leads there. Each new path begins slowly.
    """
    on_reference: float = 0.03
    """Distance in m from the wanted reference within which the drone is on it."""
    off_reference: float = 0.05
    """Distance in m from the wanted reference that needs a flight of its own to catch up."""
    same_end: float = 1e-3
    """Two ends of paths within this, in m and m/s, are the same."""
    lost_path: float = 0.35
    """Distance in m between a drone and its path, beyond which it begins a new path from here.
    """


PATH_TOLERANCES = PathTolerances()


@dataclass(frozen=True, slots=True)
class PathAccelerations:
    """The accelerations of agreed paths, and the room that a hard path needs."""

    gentle: float = 0.8
    """Acceleration in m/s2 of flights among others; harder paths are flown less exactly."""
    urgent: float = 1.6
    """Acceleration in m/s2 with which the drone brakes before a drone without an announced path.
    """
    hard: float = 1.2
    """Sideways acceleration in m/s2 from which on a wanted path counts as hard."""
    hard_path_room: float = 0.4
    """Distance in m that a hard path needs beside D."""


PATH_ACCELERATIONS = PathAccelerations()


LOWEST_WAYPOINT = 0.25
"""Height in m above the ground of waypoints."""
FutureReference = Callable[[float], FullState]
"""The wanted reference a number of seconds from now."""


class PlannedFlights:
    """Turns a wanted reference into a reference that the drone may fly.

        |S (w_i(t) - w_j(t))| >= D for all t,  S = diag(1, s_x / s_y, s_x / s_z),
        D = 2 s_x + margin + slack

    w_i and w_j are the paths of two drones that announce theirs. A drone that announces none is
    assumed to brake from its newest known state.

    port: the port of this drone
    settings: [collision]
    traffic: the states of the others
    planners: ids of the drones that announce their paths
    fence: where the drone flies
    a_max: m/s2, of the paths
    v_max: m/s, of the paths
    ground: m, height of the ground
    """

    def __init__(
        self,
        port: Port,
        settings: CollisionTable,
        traffic: NeighbourTable,
        planners: Iterable[int],
        fence: Fence,
        a_max: float,
        v_max: float,
        ground: float,
    ) -> None:
        sx, sy, sz = settings.semi_axes
        self._brake = min(a_max, PATH_ACCELERATIONS.urgent)
        a_max = min(a_max, PATH_ACCELERATIONS.gentle)
        self.traffic = traffic
        self.a_max = a_max
        self.v_max = v_max
        figures = np.array(
            [
                sx / sy,
                sx / sz,
                2.0 * sx + settings.margin + settings.slack,
                COLLISION_DISTANCES.standing_drone,
            ]
        )
        self.agreement = Agreement(port, planners)
        # It answers; a drone that it does not hear is asked for its path.
        self.hearsay = RelayedStates(traffic)
        self.obstacles = Obstacles(figures, self.agreement, traffic, a_max, ground)
        self.detours = Detours(v_max, a_max, fence, np.random.default_rng(port.address))
        self._flew = -math.inf
        self._next = 0.0
        self._phase = PLANNING_TIMES.check_interval * (
            GOLDEN_SECTION * port.address % 1.0
        )
        self._kept = self._stands = False
        self._brakes = NO_PATH
        self.gives_way_to: int | None = None
        """Id of the drone that this one would have met on its wanted path.

        None if there is no such drone.
        """

    def fly(
        self,
        state: State,
        wanted: FullState,
        future: FutureReference,
        whole: float,
        now: float,
        lands: bool = False,
        waits: bool = False,
    ) -> FullState:
        """Return what to fly now instead of `wanted`; `wanted` itself while no other is in the way.

        state: of the drone
        wanted: the wanted reference of now
        future: the wanted reference a number of seconds from now
        whole: s until the wanted reference ends at rest, if one go_to leads there; else 0
        now: s
        lands: whether the drone is landing; it then waits for agreement for at most OBSTACLE_LIMITS.answer_timeout s
        waits: whether the wanted reference stands still while the drone is delayed
        """
        mine = self.agreement
        self._stands = waits and self.delayed
        self._begin(state, wanted, now)
        mine.settle(now)
        self.obstacles.look(now)
        if now >= self._next and len(mine.offer) == 0:
            self.obstacles.measure(state)
            self._next = self._look_after(now)
            mine.awaits = NO_REST_PLACE
            if (
                lands
                and (
                    j := self.obstacles.who_stands_at(
                        future(PLANNING_TIMES.landing_end).p
                    )
                )
                is not None
            ):
                self.gives_way_to = j
            else:
                self._decide(future, whole, now, lands and self.unanswered)
        self._answer(now)
        mine.tell(now)
        self._flew = now
        flown = compute_motion(mine.way, now - mine.began)
        self._kept = math.dist(flown[0:3], wanted.p) < PATH_TOLERANCES.on_reference
        return wanted if self._kept else _build_reference(flown, wanted.yaw)

    def hears(self, state: State, now: float) -> bool:
        """Return whether the drone sees itself and can ask all drones that it must ask.

        Without this it cannot agree with them.
        """
        return state.age <= NEIGHBOUR_AGES.usable and self.agreement.mute(now) is None

    def rest(self, now: float) -> None:
        """Note that the drone is on the ground."""
        self.agreement.rest(now)
        self._kept = True

    @property
    def unanswered(self) -> bool:
        """Whether the drone has waited for agreement as long as a landing drone does."""
        return self.agreement.in_vain >= OBSTACLE_LIMITS.answer_timeout

    def lands(self, wanted: FullState, now: float) -> FullState:
        """Return the wanted reference itself, whatever is in the way.

        This is for a drone that must land and cannot agree with the others.
        """
        if now >= self._next:
            self.agreement.begin(plan_braking(wanted.flat[0:12], self.a_max), now)
            self._next = self._look_after(now)
            self.agreement.awaits = NO_REST_PLACE
        self.obstacles.look(now)
        self.agreement.tell(now)
        self._flew = now
        self._kept = True
        return wanted

    def departure(self, yaw: float, now: float) -> FullState | None:
        """Return where the drone should be now, if it is not on the wanted reference; else None."""
        if (
            self._kept
            or len(self.agreement.way) == 0
            or now - self._flew > PLANNING_TIMES.flight_break
        ):
            return None
        return _build_reference(
            compute_motion(self.agreement.way, now - self.agreement.began), yaw
        )

    def left(self, now: float) -> float:
        """Return s until its path ends."""
        return max(
            self.agreement.began + compute_path_duration(self.agreement.way) - now, 0.0
        )

    def comes_to(self, goal: Vec) -> bool:
        """Return whether its path ends at the goal, (3,) m."""
        return math.dist(compute_end_place(self.agreement.way), goal) < ARRIVAL_DISTANCE

    @property
    def delayed(self) -> bool:
        """Whether the drone was away from the wanted reference when it last flew."""
        return not self._kept

    def _look_after(self, now: float) -> float:
        """Return the time in s of the next look, at most PLANNING_TIMES.check_interval later."""
        return (
            now
            + PLANNING_TIMES.check_interval
            - (now - self._phase) % PLANNING_TIMES.check_interval
        )

    def _begin(self, state: State, wanted: FullState, now: float) -> None:
        """Begin a first path, to rest.

        If the drone was blown off its path, begin another one from here.
        """
        mine = self.agreement
        if len(mine.way) == 0 or now - self._flew > PLANNING_TIMES.flight_break:
            near = math.dist(state.p, wanted.p) < PATH_TOLERANCES.lost_path
            mine.begin(
                plan_braking(
                    wanted.flat[0:12] if near else _build_motion(state), self.a_max
                ),
                now,
            )
        elif (
            math.dist(state.p, compute_motion(mine.way, now - mine.began)[0:3])
            > PATH_TOLERANCES.lost_path
        ):
            mine.begin(plan_braking(_build_motion(state), self.a_max), now)

    def _answer(self, now: float) -> None:
        """Agree to offers of higher ids that do not meet what this drone flies, or may fly soon."""
        mine = self.agreement
        asking = [
            other
            for other in mine.others.values()
            if other.pending and other.id > mine.id
        ]
        if not asking:
            return
        own = OtherPaths(self.obstacles.figures, self.a_max)
        own.way(mine.id, mine.way, mine.began)
        if len(mine.offer):
            own.way(mine.id, mine.offer, mine.begins)
        for other in asking:
            if own.clear(other.offer, other.begins, now):
                mine.agree(other)

    def _decide(
        self, future: FutureReference, whole: float, now: float, alone: bool
    ) -> None:
        """Look for a better path than the present one, and ask for it.

        alone: whether a landing drone goes on without asking
        """
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
            mine.waited(mute, PLANNING_TIMES.check_interval)
            self._brake_before(threat, now, self.obstacles.all(now))

    def _arrives(self, future: FutureReference, whole: float, now: float) -> bool:
        """Return whether the present path is the wanted reference, to its end."""
        mine = self.agreement
        near = (
            math.dist(compute_motion(mine.way, now - mine.began)[0:3], future(0.0).p)
            <= PATH_TOLERANCES.off_reference
        )
        return near and self._ends(
            future(whole if whole > 0.0 else PLANNING_TIMES.least_horizon)
        )

    def _ends(self, wanted: FullState) -> bool:
        """Return whether the wanted reference rests where the present path ends."""
        then = wanted.flat
        return (
            math.dist(then[0:3], compute_end_place(self.agreement.way))
            < PATH_TOLERANCES.same_end
            and float(np.linalg.norm(then[3:6])) < PATH_TOLERANCES.same_end
        )

    def _brake_before(self, threat: float, now: float, others: OtherPaths) -> None:
        """Brake unasked before a meeting in `threat` s, unless braking would cause one sooner.

        The meeting is with a drone that announces no path. The drone brakes once: a path to rest
        that begins anew, slowly each time, comes to rest ever later and further on.
        """
        mine = self.agreement
        if threat >= PLANNING_TIMES.imminent_meeting or mine.way is self._brakes:
            return
        way = plan_braking(compute_motion(mine.way, now - mine.began), self._brake)
        if others.first(way, now, now)[0] >= now + threat:
            self._brakes = way
            mine.begin(way, now)

    def _choose(
        self, future: FutureReference, whole: float, now: float, threat: float
    ) -> None:
        """Ask for the best path that is clear."""
        mine = self.agreement
        begins = now + PLANNING_TIMES.offer_lead_time if mine.asks() else now
        start = compute_motion(mine.way, begins - mine.began)
        others = self.obstacles.all(now)
        if self._keeps_up(future, whole, begins, now, others):
            return
        goal, moves = self._goal(future, whole, begins - now)
        aim = RestGoal(
            goal, self.v_max, self.a_max, mine.awaited(now), self.obstacles.figures
        )
        leads = moves and math.dist(compute_end_place(mine.way), goal) <= max(
            ARRIVAL_DISTANCE,
            PATH_TOLERANCES.moving_goal_share * math.dist(start[0:3], goal),
        )
        present = self.left(now) + (
            0.0 if leads else aim.missing(compute_end_place(mine.way))
        )
        mine.awaits = NO_REST_PLACE if moves or self.comes_to(goal) else goal
        if threat < PLANNING_TIMES.imminent_meeting:
            present = math.inf
        wait = begins - now
        for option in self.detours.options(
            start, aim, present - PLANNING_TIMES.least_gain - wait
        ):
            if others.clear(option.way, begins, now):
                mine.propose(option.way, begins)
                mine.settle(now)
                return
        self._brake_before(threat, now, others)

    def _keeps_up(
        self,
        future: FutureReference,
        whole: float,
        begins: float,
        now: float,
        others: OtherPaths,
        alone: bool = False,
    ) -> bool:
        """Follow the wanted reference if the drone is near it and no other is in the way.

        future: the wanted reference a number of seconds from now
        whole: s until the wanted reference ends at rest, if one go_to leads there; else 0
        begins: s, when the path begins
        now: s
        others: the paths of the others
        alone: whether the drone flies without asking
        Returns whether it does.
        """
        mine = self.agreement
        wait = 0.0 if self._stands else begins - now
        start = compute_motion(mine.way, begins - mine.began)
        behind = start - future(wait).flat[0:12]
        if np.linalg.norm(behind[0:3]) > PATH_TOLERANCES.off_reference:
            return False
        ahead = max(
            whole - wait if whole > 0.0 else PLANNING_TIMES.least_horizon,
            self._catches_up(behind),
        )
        then = future(wait + ahead)
        if self._ends(then):
            return True
        way = plan_catching_up(start, then.flat[0:12], ahead, self.a_max)
        room = (
            PATH_ACCELERATIONS.hard_path_room
            if find_peak_sideways_acceleration(way) > PATH_ACCELERATIONS.hard
            else 0.0
        )
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
        """Return the time in s to catch up with the wanted reference.

        behind: (12,): motion relative to the wanted reference
        """
        return compute_path_duration(
            plan_flight(behind, np.zeros(3), self.v_max, self.a_max)
        )

    def _goal(
        self, future: FutureReference, whole: float, wait: float
    ) -> tuple[Vec, bool]:
        """Return where the wanted reference ends, (3,) m, and whether that place moves.

        A reference without a known end is assumed to brake, inside the fence.
        """
        if whole > 0.0:
            return future(whole).p, False
        if self._stands:
            return future(0.0).p, False
        then = future(wait).flat[0:12]
        if np.linalg.norm(then[3:6]) <= ARRIVAL_DISTANCE:
            return then[0:3], False
        return self._inside(
            then[0:3], compute_end_place(plan_braking(then, self.a_max))
        ), True

    def _inside(self, wanted: Vec, beyond: Vec) -> Vec:
        """Return a place, (3,) m, that is not further outside the fence than the wanted place."""
        fence = self.detours.fence
        return np.clip(
            beyond, np.minimum(fence.low, wanted), np.maximum(fence.high, wanted)
        )


def _build_motion(state: State) -> Vec:
    """Return the motion, (12,), of a drone with an unknown acceleration."""
    return np.concatenate([state.p, state.v, np.zeros(6)])


def _build_reference(motion: Vec, yaw: float) -> FullState:
    """Return the reference of a motion, (12,), with this yaw in rad."""
    return FullState(np.array([*motion.tolist(), yaw, 0.0]))
