"""What an observer makes of a swarm that flies: distances, lengths, how well a formation stands."""

import math
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from crazychoir.agent.drone import WAITING
from crazychoir.agent.operator_commands import STANDING
from crazychoir.bus.port import OBSERVER, Bus
from crazychoir.bus.topics import LOG, STATUS, TRUTH, Topic
from crazychoir.config.checks import TOUCHING
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.feedback import LAW
from crazychoir.guidance.mission import Mission, has
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.mailbox import Call
from crazychoir.types import State, Status, Vec

SETTLED = 0.01
"""m, from the goal: a formation is settled when every drone stays within it."""
COMPARABLE = 0.15
"""s: places that are older are not compared. Moved on by their velocity, two that brake with 2 m/s2 each are 0.05 m off
by then: enough to tell whether drones touch."""
DRAWN, LONGEST = 0.1, 2000
"""s between two places of a track, at first; and how many are kept: beyond that every other one goes."""
LOGGED = 1000
"""Log lines that a score keeps: the newest."""

Watch = Callable[["Score"], None]


@dataclass
class Score(Actor):
    """What an observer sees of a swarm: states, statuses, distances, lengths flown, distance from a goal.

    It is as large after an hour as after a minute.
    errors: (s since the law began, m of the drone that is farthest from its goal), the last time that anybody was
    beyond SETTLED, and the newest;  touching: {(i, j): m}, the least distance of pairs that came
    nearer than TOUCHING;  source: the address that says a topic of a drone;  unseen: drones that
    alone say where they are.
    """

    bus: Bus
    ids: tuple[int, ...]
    goal: dict[int, Vec] = field(default_factory=dict)
    watch: Watch = lambda score: None
    name: str = "score"
    address: int = OBSERVER
    source: Callable[[Topic, int], int] = lambda topic, i: i
    unseen: Collection[int] = ()

    def __post_init__(self) -> None:
        self.statuses: dict[int, Status] = {}
        self.log: deque[str] = deque(maxlen=LOGGED)
        self.min_separation = float("inf")
        self.touching: dict[tuple[int, int], float] = {}
        self._lengths = dict.fromkeys(self.ids, 0.0)
        self._flew: set[int] = set()
        self.errors: list[tuple[float, float]] = []
        self._tracks: dict[int, list[tuple[float, ...]]] = {i: [] for i in self.ids}
        self._apart = dict.fromkeys(self.ids, DRAWN)
        self._truth: dict[
            int, tuple[Vec, Vec, float]
        ] = {}  # p, v, and when they were so
        self._law_began: float | None = None
        self._law_ended = False
        self.go_at: float | None = None
        """s of its clock, when a drone was first heard to have begun."""
        if self.address not in self.bus.ports:
            self.bus.port(self.address)
        for i in self.ids:
            self._listen(TRUTH, i, partial(self._hear_truth, i))
            self._listen(STATUS, i, partial(self._hear_status, i))
            self._listen(LOG, i, self._hear_log)

    def _listen(
        self, topic: Topic, i: int, function: Callable[[Any, float], None]
    ) -> None:
        self.bus.subscribe(
            topic, self.source(topic, i), self.address, Call(self.bus.clock, function)
        )

    async def run(self) -> None:
        """Look at the whole swarm as often as truth comes."""
        async for _ in self.bus.clock.ticks(TRUTH.rate):
            self._look()
            self.watch(self)

    def _hear_truth(self, i: int, state: State, age: float) -> None:
        before = self._truth.get(i)
        if before is not None:
            self._lengths[i] += math.dist(state.p.tolist(), before[0].tolist())
        self._truth[i] = (state.p, state.v, self.bus.clock.now() - age)
        self._keep(i, self.bus.clock.now() - age, state.p)

    def _keep(self, i: int, t: float, p: Vec) -> None:
        """A place of the track, if it is time for one."""
        track = self._tracks[i]
        if track and t - track[-1][0] < self._apart[i] - 1e-6:
            return
        track.append((t, *p.tolist()))
        if len(track) > LONGEST:
            del track[1::2]
            self._apart[i] *= 2.0

    @property
    def flown(self) -> dict[int, float]:
        """m: how far each drone has moved, in truth; 0 for one that stands, however what it takes for that drifts."""
        return {
            i: 0.0 if self._stands(i) else length for i, length in self._lengths.items()
        }

    def _stands(self, i: int) -> bool:
        """Whether it has never taken off, as it says, and nobody but itself sees where it is."""
        return i in self.statuses and i not in self._flew and i in self.unseen

    @property
    def places(self) -> dict[int, Vec]:
        """(3,) m, world: where each drone was last seen, in truth."""
        return {i: p for i, (p, _, _) in self._truth.items()}

    @property
    def tracks(self) -> dict[int, list[tuple[float, ...]]]:
        """Rows t s, p m, world, of each drone, in truth."""
        return self._tracks

    @property
    def law_s(self) -> float | None:
        """s since the law began; None before and after it."""
        began = self._law_began
        return (
            None if began is None or self._law_ended else self.bus.clock.now() - began
        )

    def _hear_status(self, i: int, status: Status, age: float) -> None:
        self.statuses[i] = status
        if status.phase not in STANDING:
            self._flew.add(i)
        if self.go_at is None and status.task != WAITING:
            self.go_at = self.bus.clock.now()
        flying = status.phase in ("hovering", "mission") and status.task == LAW
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
            beyond = [error for error in self.errors if error[1] > SETTLED]
            self.errors = [*beyond[-1:], (now - self._law_began, far)]

    def _compare(self, now: float) -> None:
        """Distances of any two, of which something was heard lately, at one time, unless both have never flown."""
        ids = [i for i in self.ids if now - self._truth[i][2] <= COMPARABLE]
        if len(ids) < 2:
            return
        p, v, when = (
            np.array(column)
            for column in zip(*(self._truth[i] for i in ids), strict=True)
        )
        gaps = pdist(p + (now - when)[:, None] * v)
        stand = [self._stands(i) for i in ids]
        if any(stand):
            gaps[[a and b for a, b in combinations(stand, 2)]] = math.inf
        least = float(gaps.min())
        self.min_separation = min(self.min_separation, least)
        if least < TOUCHING:
            for pair, gap in zip(combinations(ids, 2), gaps.tolist(), strict=True):
                if gap < TOUCHING:
                    self.touching[pair] = min(gap, self.touching.get(pair, math.inf))

    def formation(self) -> dict[str, float | None]:
        """formation_error_m at the end of the law, settling_s until all stay within 1 cm of the goal (null: never)."""
        if not self.errors:
            return {}
        late = [t for t, far in self.errors if far > SETTLED]
        settled = (late[-1] if late else 0.0) if self.errors[-1][1] <= SETTLED else None
        return {"formation_error_m": self.errors[-1][1], "settling_s": settled}

    def messages(self) -> dict[str, int]:
        """Totals over the drones, from their last statuses."""
        of = self.statuses.values()
        return {
            name: sum(getattr(status, name) for status in of)
            for name in ("sent", "lost", "resent")
        }


def goal_of(mission: Mission, config: SwarmConfig) -> dict[int, Vec]:
    """Where the drones are to be, if the mission says so."""
    return (
        {i: np.asarray(p) for i, p in mission.goal(config).items()}
        if has(mission, "goal")
        else {}
    )
