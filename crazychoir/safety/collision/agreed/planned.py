"""Collision avoidance by agreed paths, for drones with a planner on board or that get velocities.

Each such drone announces what it will fly, to the end. It flies where it is wanted as long as that
is clear of all that the others will fly. Otherwise it delays its flight, splits it by a waypoint,
or flies a part of it; `agreement` says when it may. It announces which place it cannot come to. A
drone that rests there without being at its own goal goes elsewhere.
"""

import math
from collections.abc import Iterable

import numpy as np

from crazychoir.bus.port import Port
from crazychoir.config.tables import CollisionTable
from crazychoir.safety.airspace.distances import COLLISION_DISTANCES
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.relayed_states import RelayedStates
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES
from crazychoir.safety.collision.agreed.agreement import NO_REST_PLACE, Agreement
from crazychoir.safety.collision.agreed.detours import Detours
from crazychoir.safety.collision.agreed.meeting import OtherPaths
from crazychoir.safety.collision.agreed.obstacles import OBSTACLE_LIMITS, Obstacles
from crazychoir.safety.collision.agreed.path_choice import (
    FutureReference,
    PathChoice,
    WantedFlight,
)
from crazychoir.safety.collision.agreed.path_limits import (
    PATH_ACCELERATIONS,
    PATH_TOLERANCES,
    PLANNING_TIMES,
    PathLimits,
)
from crazychoir.safety.collision.agreed.paths import compute_motion, plan_braking
from crazychoir.types import FullState, State, Vec

GOLDEN_SECTION = 0.5 * (math.sqrt(5.0) - 1.0)
"""Its multiples spread the looks over a PLANNING_TIMES.check_interval.

Drones of one process that take off together then do not look at the same time.
"""


class PlannedFlights:
    """Turns a wanted reference into a reference that the drone may fly.

        |S (w_i(t) - w_j(t))| >= D for all t,  S = diag(1, s_x / s_y, s_x / s_z),
        D = 2 s_x + margin + slack

    w_i and w_j are the paths of two drones that announce theirs. A drone that announces none is
    assumed to brake from its newest known state.

    port: the port of this drone
    settings: [collision]
    traffic: what this drone knows of the others; it keeps all of them
    planners: ids of the drones that announce their paths
    limits: where and how fast the drone flies its paths
    """

    def __init__(
        self,
        port: Port,
        settings: CollisionTable,
        traffic: Neighbours,
        planners: Iterable[int],
        limits: PathLimits,
    ) -> None:
        sx, sy, sz = settings.semi_axes
        self.traffic = traffic
        self._a_max = min(limits.a_max, PATH_ACCELERATIONS.gentle)
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
        self.obstacles = Obstacles(
            figures, self.agreement, traffic, self._a_max, limits.ground
        )
        draws = np.random.default_rng(port.address)
        detours = Detours(limits.v_max, self._a_max, limits.fence, draws)
        self.choice = PathChoice(self.agreement, self.obstacles, detours, limits)
        self._flew = -math.inf
        self._next = 0.0
        self._phase = PLANNING_TIMES.check_interval * (
            GOLDEN_SECTION * port.address % 1.0
        )
        self._kept = False
        self._is_in_step = False

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
        self._begin(state, wanted, now)
        mine.settle(now)
        self.obstacles.look(now)
        if now >= self._next and len(mine.offer) == 0:
            self._next = self._look_after(now)
            mine.awaits = NO_REST_PLACE
            below = (
                self.obstacles.find_drone_at(future(PLANNING_TIMES.landing_end).p)
                if lands
                else None
            )
            if below is not None:
                self.choice.gives_way_to = below
            else:
                flight = WantedFlight(future, whole, waits and self.delayed)
                self.choice.decide(flight, now, lands and self.unanswered)
        self._answer(now)
        mine.tell(now)
        self._flew = now
        flown = compute_motion(mine.way, now - mine.began)
        self._kept = math.dist(flown[0:3], wanted.p) < PATH_TOLERANCES.on_reference
        # The path of a drone that brakes may still be on a trajectory that goes on at full speed.
        self._is_in_step = self._kept and (
            whole > 0.0 or math.dist(flown[3:6], wanted.v) < PATH_TOLERANCES.same_speed
        )
        return wanted if self._is_in_step else _build_reference(flown, wanted.yaw)

    def hears(self, state: State, now: float) -> bool:
        """Return whether the drone sees itself and can ask all drones that it must ask.

        Without this it cannot agree with them.
        """
        return state.age <= NEIGHBOUR_AGES.usable and self.agreement.mute(now) is None

    def rest(self, now: float) -> None:
        """Note that the drone is on the ground."""
        self.agreement.rest(now)
        self._kept = True
        self._is_in_step = True

    @property
    def unanswered(self) -> bool:
        """Whether the drone has waited for agreement as long as a landing drone does."""
        return self.agreement.in_vain >= OBSTACLE_LIMITS.answer_timeout

    def lands(self, wanted: FullState, now: float) -> FullState:
        """Return the wanted reference itself, whatever is in the way.

        This is for a drone that must land and cannot agree with the others.
        """
        if now >= self._next:
            self.agreement.begin(plan_braking(wanted.flat[0:12], self._a_max), now)
            self._next = self._look_after(now)
            self.agreement.awaits = NO_REST_PLACE
        self.obstacles.look(now)
        self.agreement.tell(now)
        self._flew = now
        self._kept = True
        self._is_in_step = True
        return wanted

    def departure(self, yaw: float, now: float) -> FullState | None:
        """Return where the drone should be now, if it does not fly the wanted reference; else None."""
        if (
            self._is_in_step
            or len(self.agreement.way) == 0
            or now - self._flew > PLANNING_TIMES.flight_break
        ):
            return None
        return _build_reference(
            compute_motion(self.agreement.way, now - self.agreement.began), yaw
        )

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
                    wanted.flat[0:12] if near else _build_motion(state), self._a_max
                ),
                now,
            )
        elif (
            math.dist(state.p, compute_motion(mine.way, now - mine.began)[0:3])
            > PATH_TOLERANCES.lost_path
        ):
            mine.begin(plan_braking(_build_motion(state), self._a_max), now)

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
        own = OtherPaths(self.obstacles.figures, self._a_max)
        own.way(mine.id, mine.way, mine.began)
        if len(mine.offer):
            own.way(mine.id, mine.offer, mine.begins)
        for other in asking:
            if own.clear(other.offer, other.begins, now):
                mine.agree(other)


def _build_motion(state: State) -> Vec:
    """Return the motion, (12,), of a drone with an unknown acceleration."""
    return np.concatenate([state.p, state.v, np.zeros(6)])


def _build_reference(motion: Vec, yaw: float) -> FullState:
    """Return the reference of a motion, (12,), with this yaw in rad."""
    return FullState(np.array([*motion.tolist(), yaw, 0.0]))
