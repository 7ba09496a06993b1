"""Observe a flying swarm: distances, lengths of paths, errors of a formation."""

import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from crazychoir.agent.drone import WAITING_TASK
from crazychoir.agent.operator_commands import GROUNDED_PHASES
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.feedback import LAW_TASK
from crazychoir.guidance.mission import Mission, has_hook
from crazychoir.launch.flight_tracks import FlightTracks
from crazychoir.numerics.near_pairs import find_nearest, list_near_pairs
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.mailbox import Call
from crazychoir.types import Mat, State, Status, Vec


@dataclass(frozen=True, slots=True)
class ScoreLimits:
    """When a score counts drones as settled or compares them, and how many log lines it keeps."""

    settled_distance: float = 0.01
    """Distance from the goal, m: a formation is settled while every drone is nearer."""
    comparable_age: float = 0.15
    """Age of a place, s, up to which distances are computed from it.

    Places are extrapolated by their velocity. Two drones that brake with 2 m/s2 each are then
    0.05 m off, which is precise enough to tell whether drones touch.
    """
    most_log_lines: int = 1000
    """Number of log lines that a score keeps: the newest."""


SCORE_LIMITS = ScoreLimits()


Watch = Callable[["FlightScore"], None]


class TrueStates(Protocol):
    """The true states of drones of this process, such as those of a simulated world."""

    ids: tuple[int, ...]
    """The drones, in the order of the rows."""
    states: Mat
    """(n, 13): rows laid out as State.flat."""


class _StandingDrones:
    """The drones that say that they have never taken off, and that no cameras see.

    unseen: for each row, whether no cameras see the drone
    """

    def __init__(self, unseen: Sequence[bool]) -> None:
        self._is_unseen = np.array(unseen, np.bool_)
        self._has_status = np.zeros(len(unseen), np.bool_)
        self._has_flown = np.zeros(len(unseen), np.bool_)

    def take(self, row: int, has_left_ground: bool) -> None:
        """Note the status of a drone."""
        self._has_status[row] = True
        self._has_flown[row] |= has_left_ground

    def find(self) -> npt.NDArray[np.bool_]:
        """Return for each row whether the drone stands."""
        return self._has_status & ~self._has_flown & self._is_unseen


@dataclass
class FlightScore(Actor):
    """What an observer measures of a swarm: states, distances, lengths flown, distance from a goal.

    Its memory does not grow with the duration of the flight.

    statuses: last status of each drone
    touching: m: least distance of each pair (i, j) that came nearer than the touching distance
    errors: rows (s since the law began, m: largest distance of a drone from its goal). At most two
        are kept: the last one beyond the settled distance, and the newest.
    """

    bus: Bus
    """Bus of this process."""
    ids: tuple[int, ...]
    """Drones of the swarm."""
    goal: dict[int, Vec] = field(default_factory=dict)
    """(3,) m, world: goal of each drone; empty for a mission without one."""
    watch: Watch = lambda score: None
    """Called with this score at every tick."""
    name: str = "score"
    """Name of this actor."""
    address: int = PORT_ADDRESSES.first_observer
    """Address on the bus at which it listens."""
    source: Callable[[Topic, int], int] = lambda topic, i: i
    """Returns the address that publishes a topic of a drone."""
    unseen: Collection[int] = ()
    """Drones that no cameras see: their place is only their own estimate."""
    worlds: Sequence[TrueStates] = ()
    """Worlds of this process. The states of all other drones come by their topic.

    Their states must be true at the time of each tick, as they are in virtual time.
    """

    def __post_init__(self) -> None:
        self.statuses: dict[int, Status] = {}
        self.log: deque[str] = deque(maxlen=SCORE_LIMITS.most_log_lines)
        self.min_separation = float("inf")
        self.touching: dict[tuple[int, int], float] = {}
        self.errors: list[tuple[float, float]] = []
        here = [i for world in self.worlds for i in world.ids]
        elsewhere = [i for i in self.ids if i not in here]
        order = (*here, *elsewhere)
        self._tracks = FlightTracks(order)
        self._standing = _StandingDrones([i in self.unseen for i in order])
        self._goals = (
            [self._tracks.row_of[i] for i in self.goal],
            np.array(list(self.goal.values())).reshape(-1, 3),
        )
        self._law_began: float | None = None
        self._law_ended = False
        self.go_at: float | None = None
        """s on the observer's clock at which a drone was first known to have begun."""
        if self.address not in self.bus.ports:
            self.bus.port(self.address)
        for i in elsewhere:
            self._listen(DRONE_TOPICS.truth, i, partial(self._hear_truth, i))
        for i in self.ids:
            self._listen(DRONE_TOPICS.status, i, partial(self._hear_status, i))
            self._listen(DRONE_TOPICS.log, i, self._hear_log)
            self._listen(DRONE_TOPICS.console, i, self._hear_log)

    def _listen(
        self, topic: Topic, i: int, function: Callable[[Any, float], None]
    ) -> None:
        self.bus.subscribe(
            topic, self.source(topic, i), self.address, Call(self.bus.clock, function)
        )

    async def run(self) -> None:
        """Compare the drones as often as the true states arrive."""
        async for _ in self.bus.clock.ticks(DRONE_TOPICS.truth.rate):
            now = self.bus.clock.now()
            self._see_worlds(now)
            self._look(now)
            self.watch(self)

    def _see_worlds(self, now: float) -> None:
        """Add the states of the drones in the worlds of this process."""
        first = 0
        for world in self.worlds:
            self._tracks.add(first, world.states, now)
            first += len(world.ids)

    def _hear_truth(self, i: int, state: State, age: float) -> None:
        self._tracks.add(
            self._tracks.row_of[i], state.flat[None], self.bus.clock.now() - age
        )

    @property
    def flown(self) -> dict[int, float]:
        """Length flown by each drone, in truth, m.

        It is 0 for a drone that has never taken off and that no cameras see: its estimate drifts.
        """
        stands = self._standing.find()
        lengths = np.where(stands, 0.0, self._tracks.rows["length"])
        return {i: float(lengths[self._tracks.row_of[i]]) for i in self.ids}

    @property
    def places(self) -> dict[int, Vec]:
        """True place at which each drone was last seen: (3,) m, world."""
        rows = self._tracks.rows
        row_of = self._tracks.row_of
        return {
            i: rows["place"][row_of[i]].copy()
            for i in self.ids
            if rows["time"][row_of[i]] > -math.inf
        }

    @property
    def tracks(self) -> dict[int, list[tuple[float, ...]]]:
        """True track of each drone: rows of t in s and p in m, world."""
        return {i: self._tracks.kept[self._tracks.row_of[i]] for i in self.ids}

    @property
    def law_s(self) -> float | None:
        """Seconds since the law began; None before and after the law."""
        began = self._law_began
        return (
            None if began is None or self._law_ended else self.bus.clock.now() - began
        )

    def _hear_status(self, i: int, status: Status, age: float) -> None:
        self.statuses[i] = status
        has_left_ground = status.phase not in GROUNDED_PHASES
        self._standing.take(self._tracks.row_of[i], has_left_ground)
        if self.go_at is None and status.task != WAITING_TASK:
            self.go_at = self.bus.clock.now()
        flying = status.phase in ("hovering", "mission") and status.task == LAW_TASK
        if self.goal and flying and self._law_began is None:
            self._law_began = self.bus.clock.now()
        if self._law_began is not None and status.task == "landing":
            self._law_ended = True

    def _hear_log(self, line: str, age: float) -> None:
        self.log.append(line)

    def _look(self, now: float) -> None:
        """Compare the drones, unless one was never seen."""
        rows = self._tracks.rows
        if not (rows["time"] > -math.inf).all():
            return
        self._compare(now)
        if self._law_began is not None and not self._law_ended:
            goal_rows, goals = self._goals
            offsets = rows["place"][goal_rows] - goals
            far = float(np.linalg.norm(offsets, axis=1).max())
            beyond = [
                error
                for error in self.errors
                if error[1] > SCORE_LIMITS.settled_distance
            ]
            self.errors = [*beyond[-1:], (now - self._law_began, far)]

    def _compare(self, now: float) -> None:
        """Update the least distances from the recent places of all pairs, extrapolated to now.

        A pair is left out while neither of its drones has flown.
        """
        rows = self._tracks.rows
        ages = now - rows["time"]
        places = rows["place"] + ages[:, None] * rows["velocity"]
        is_known = ages <= SCORE_LIMITS.comparable_age
        is_known &= np.isfinite(places).all(axis=1)
        known = np.flatnonzero(is_known)
        if len(known) < 2:
            return
        places = places[known]
        stands = self._standing.find()[known]
        self.min_separation = min(self.min_separation, _find_least_gap(places, stands))
        touching = SWARM_LIMITS.touching_distance
        for a, b in list_near_pairs(places, touching).tolist():
            gap = math.dist(places[a], places[b])
            if gap < touching and not (stands[a] and stands[b]):
                i = self._tracks.ids[known[a]]
                j = self._tracks.ids[known[b]]
                pair = (min(i, j), max(i, j))
                self.touching[pair] = min(gap, self.touching.get(pair, math.inf))

    def formation(self) -> dict[str, float | None]:
        """Return the final error of the formation and its settling time.

        formation_error_m: m: largest distance from the goal at the end of the law
        settling_s: s: time until all drones stay within 1 cm of the goal, None if they never do
        Empty for a mission without a goal.
        """
        if not self.errors:
            return {}
        late = [t for t, far in self.errors if far > SCORE_LIMITS.settled_distance]
        settled = None
        if self.errors[-1][1] <= SCORE_LIMITS.settled_distance:
            settled = late[-1] if late else 0.0
        return {"formation_error_m": self.errors[-1][1], "settling_s": settled}

    def messages(self) -> dict[str, int]:
        """Return the totals of the message counters over all drones, from their last statuses."""
        of = self.statuses.values()
        return {
            name: sum(getattr(status, name) for status in of)
            for name in ("sent", "lost", "resent")
        }


def _find_least_gap(places: Mat, stands: npt.NDArray[np.bool_]) -> float:
    """Return the least distance in m between two drones; at least one of the two has flown.

    places: (N, 3) m, with N at least 2.
    stands: (N,): whether each drone has never flown.
    """
    if not stands.any():
        return float(find_nearest(places).distances.min())
    flown = places[~stands]
    if not len(flown):
        return math.inf
    gaps, _ = cKDTree(places[stands]).query(flown)
    least = float(gaps.min())
    if len(flown) > 1:
        least = min(least, float(find_nearest(flown).distances.min()))
    return least


def list_goals(mission: Mission, config: SwarmConfig) -> dict[int, Vec]:
    """Return the goals of the drones; empty if the mission has none."""
    return (
        {i: np.asarray(p) for i, p in mission.goal(config).items()}
        if has_hook(mission, "goal")
        else {}
    )
