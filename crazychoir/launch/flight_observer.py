"""Observe a flying swarm: distances, lengths of paths, errors of a formation."""

import math
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import partial
from typing import Any

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
from crazychoir.numerics.near_pairs import find_nearest, list_near_pairs
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.mailbox import Call
from crazychoir.types import Mat, State, Status, Vec


@dataclass(frozen=True, slots=True)
class ScoreLimits:
    """When a score counts drones as settled or compares them, and how much of a flight it keeps."""

    settled_distance: float = 0.01
    """Distance from the goal, m: a formation is settled while every drone is nearer."""
    comparable_age: float = 0.15
    """Age of a place, s, up to which distances are computed from it.

    Places are extrapolated by their velocity. Two drones that brake with 2 m/s2 each are then
    0.05 m off, which is precise enough to tell whether drones touch.
    """
    track_interval: float = 0.1
    """Seconds between two places of a track, at first."""
    most_track_places: int = 2000
    """Largest number of places in a track.

    Beyond that every second place is removed, and the time between two places doubles.
    """
    most_log_lines: int = 1000
    """Number of log lines that a score keeps: the newest."""


SCORE_LIMITS = ScoreLimits()


Watch = Callable[["FlightScore"], None]


@dataclass
class FlightTrack:
    """The places of one drone during a flight, and the length of its path."""

    rows: list[tuple[float, ...]] = field(default_factory=list)
    """t in s and p in m, world: a bounded number of places of the flight."""
    length: float = 0.0
    """m: length of the path through all places, also through places that are not kept."""
    interval: float = SCORE_LIMITS.track_interval
    """s between two places that are kept."""
    newest: list[float] | None = None
    """(3,) m, world: newest place."""

    def add(self, t: float, p: list[float]) -> None:
        """Add a place to the path; keep it if the time for one has come."""
        if self.newest is not None:
            self.length += math.dist(p, self.newest)
        self.newest = p
        if self.rows and t - self.rows[-1][0] < self.interval - 1e-6:
            return
        self.rows.append((t, *p))
        if len(self.rows) > SCORE_LIMITS.most_track_places:
            del self.rows[1::2]
            self.interval *= 2.0


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

    def __post_init__(self) -> None:
        self.statuses: dict[int, Status] = {}
        self.log: deque[str] = deque(maxlen=SCORE_LIMITS.most_log_lines)
        self.min_separation = float("inf")
        self.touching: dict[tuple[int, int], float] = {}
        self._flew: set[int] = set()
        self.errors: list[tuple[float, float]] = []
        self._tracks = {i: FlightTrack() for i in self.ids}
        # For each drone: p in m, v in m/s, and the time in s at which they were true.
        self._truth: dict[int, tuple[Vec, Vec, float]] = {}
        self._law_began: float | None = None
        self._law_ended = False
        self.go_at: float | None = None
        """s on the observer's clock at which a drone was first known to have begun."""
        if self.address not in self.bus.ports:
            self.bus.port(self.address)
        for i in self.ids:
            self._listen(DRONE_TOPICS.truth, i, partial(self._hear_truth, i))
            self._listen(DRONE_TOPICS.status, i, partial(self._hear_status, i))
            self._listen(DRONE_TOPICS.log, i, self._hear_log)

    def _listen(
        self, topic: Topic, i: int, function: Callable[[Any, float], None]
    ) -> None:
        self.bus.subscribe(
            topic, self.source(topic, i), self.address, Call(self.bus.clock, function)
        )

    async def run(self) -> None:
        """Compare the drones as often as the true states arrive."""
        async for _ in self.bus.clock.ticks(DRONE_TOPICS.truth.rate):
            self._look()
            self.watch(self)

    def _hear_truth(self, i: int, state: State, age: float) -> None:
        now = self.bus.clock.now()
        self._truth[i] = (state.p, state.v, now - age)
        self._tracks[i].add(now - age, state.p.tolist())

    @property
    def flown(self) -> dict[int, float]:
        """Length flown by each drone, in truth, m.

        It is 0 for a drone that has never taken off and that no cameras see: its estimate drifts.
        """
        return {
            i: 0.0 if self._stands(i) else track.length
            for i, track in self._tracks.items()
        }

    def _stands(self, i: int) -> bool:
        """Return whether the drone says that it has never taken off, and no cameras see it."""
        return i in self.statuses and i not in self._flew and i in self.unseen

    @property
    def places(self) -> dict[int, Vec]:
        """True place at which each drone was last seen: (3,) m, world."""
        return {i: p for i, (p, _, _) in self._truth.items()}

    @property
    def tracks(self) -> dict[int, list[tuple[float, ...]]]:
        """True track of each drone: rows of t in s and p in m, world."""
        return {i: track.rows for i, track in self._tracks.items()}

    @property
    def law_s(self) -> float | None:
        """Seconds since the law began; None before and after the law."""
        began = self._law_began
        return (
            None if began is None or self._law_ended else self.bus.clock.now() - began
        )

    def _hear_status(self, i: int, status: Status, age: float) -> None:
        self.statuses[i] = status
        if status.phase not in GROUNDED_PHASES:
            self._flew.add(i)
        if self.go_at is None and status.task != WAITING_TASK:
            self.go_at = self.bus.clock.now()
        flying = status.phase in ("hovering", "mission") and status.task == LAW_TASK
        if self.goal and flying and self._law_began is None:
            self._law_began = self.bus.clock.now()
        if self._law_began is not None and status.task == "landing":
            self._law_ended = True

    def _hear_log(self, line: str, age: float) -> None:
        self.log.append(line)

    def _look(self) -> None:
        if len(self._truth) < len(self.ids):
            return
        now = self.bus.clock.now()
        self._compare(now)
        if self._law_began is not None and not self._law_ended:
            far = max(
                float(np.linalg.norm(self._truth[i][0] - self.goal[i]))
                for i in self.goal
            )
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
        ids = [
            i
            for i in self.ids
            if now - self._truth[i][2] <= SCORE_LIMITS.comparable_age
        ]
        if len(ids) < 2:
            return
        p, v, when = (
            np.array(column)
            for column in zip(*(self._truth[i] for i in ids), strict=True)
        )
        places = p + (now - when)[:, None] * v
        is_known = np.isfinite(places).all(axis=1)
        if is_known.sum() < 2:
            return
        places = places[is_known]
        ids = [i for i, known in zip(ids, is_known, strict=True) if known]
        stands = np.array([self._stands(i) for i in ids])
        self.min_separation = min(self.min_separation, _find_least_gap(places, stands))
        touching = SWARM_LIMITS.touching_distance
        for a, b in list_near_pairs(places, touching).tolist():
            gap = math.dist(places[a], places[b])
            if gap < touching and not (stands[a] and stands[b]):
                pair = (ids[a], ids[b])
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
