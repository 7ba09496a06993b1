"""Aggregative optimisation in flight: a team tracks its common optimum while it flies there."""

import asyncio
import contextlib
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from crazychoir.errors import CrazyChoirError
from crazychoir.guidance.aggregative_rows import (
    AGGREGATIVE_ROW,
    build_aggregative_team,
)
from crazychoir.guidance.decision.team import Ids, Rows, TeamLaw, step_alone
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.timed import Way
from crazychoir.optimization.algorithms.aggregative_tracking import (
    AggregativeProblem,
    AggregativeTracking,
)
from crazychoir.planning.smoothing import GoalSmoother
from crazychoir.types import Heard, Mat, Reference, State, Vec

AGGREGATIVE_CHANNEL = "aggregative"
"""Channel of the tracking rounds."""
SPEED_SHARE = 0.5
"""Share of speed_limit that references use.

The rest is left for a drone that is pushed off its reference.
"""
ACCELERATION_SHARE = 0.9
"""Share of acceleration_limit that references use."""


@dataclass(frozen=True)
class Defence:
    """The cost of a defender between its intruder, the common target, and its team.

        f_i(x_i, s) = a |x_i - r_i|^2 + b |s - t|^2 + c |x_i - s|^2,   s = (1/N) sum_j x_j
        grad_1 f_i = 2 a (x_i - r_i) + 2 c (x_i - s),   grad_2 f_i = 2 b (s - t) - 2 c (x_i - s)

    x_i: (d,) m, the defender; s: (d,) m, the mean of the team; r_i: (d,) m, its intruder. The
    weights a, b, c >= 0 satisfy a + b > 0 and a + c > 0.
    """

    target: Vec
    """t: (d,) m, the target."""
    intruder: float = 1.0
    """a: weight of the distance to the intruder."""
    goal: float = 1.0
    """b: weight of the distance between the team's mean and the target."""
    team: float = 1.0
    """c: weight of the distance to the team's mean."""

    def gradient_own(self, x: Vec, s: Vec, r: Vec) -> Vec:
        """Return grad_1 f_i, (d,)."""
        return 2.0 * self.intruder * (x - r) + 2.0 * self.team * (x - s)

    def gradient_mean(self, x: Vec, s: Vec) -> Vec:
        """Return grad_2 f_i, (d,)."""
        return 2.0 * self.goal * (s - self.target) - 2.0 * self.team * (x - s)

    def optimum(self, r: Mat) -> Mat:
        """Return the minimum of sum_i f_i over all x_i, in closed form.

            s = (a mean(r) + b t) / (a + b),   x_i = (a r_i + c s - b (s - t)) / (a + c)

        With equal weights x_i = (r_i + t) / 2.

        r: (N, d) m: places of the intruders.
        Returns (N, d) m.
        """
        a = self.intruder
        b = self.goal
        c = self.team
        s = (a * r.mean(axis=0) + b * self.target) / (a + b)
        found: Mat = (a * r + c * s - b * (s - self.target)) / (a + c)
        return found


class AggregativeGuidance(CFDistributedFeedback):
    """Flies to its own x_i of an aggregative problem while its team solves the problem.

    The problem may change, and messages may be lost. A subclass writes `algorithm`. The rounds run
    beside the law, at most `round_rate` a second, and repeat lost messages. The law never waits for
    them: it flies to the newest x_i through a Smoother, and comes to rest there when no round ends.
    The permanent loss of a mate ends the law, with the reason.

    The result also holds rounds, x ((d,) m, the last x_i), and way, see `Way`.

    mates: ids of the neighbours that take part.
    round_rate: Hz.
    """

    agent: AggregativeTracking
    """This drone's part of the algorithm."""
    watched: int | None = None
    """Id of the neighbour to watch; None: none."""

    def __init__(self, mates: tuple[int, ...], round_rate: float = 20.0) -> None:
        self.mates = mates
        self.round_rate = round_rate
        self.way = Way()
        self.own: Rows = np.zeros(1, AGGREGATIVE_ROW)
        """(1,) of AGGREGATIVE_ROW: what the steps of the law use."""
        self.own["intruder_edge"] = -1

    @classmethod
    def for_team(cls, laws: Sequence[Self], neighbors: Sequence[Ids]) -> TeamLaw:
        """Return the step of all drones of a process: the text of the law is there."""
        return build_aggregative_team(laws, neighbors)

    @abstractmethod
    def algorithm(self, place: Vec) -> AggregativeTracking:
        """Return this drone's part of the algorithm.

        Its x_i, (2,) or (3,) m, is where the drone should be.

        place: (3,) m: where the drone is when the law begins.
        """

    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return a reference one period further on the way to x_i."""
        return step_alone(self, me, heard, self.member.clock)

    def note(self, now: float, p: Vec) -> None:
        """Note where the drone is, (3,) m."""
        self.way.note(now, p)

    async def run_law(self) -> None:
        """Run the law, and beside it the rounds as long as the law lasts."""
        flight = self.member.config.flight
        place = self.state.p.copy()
        self.agent = self.algorithm(place)
        v_max = SPEED_SHARE * flight.speed_limit
        a_max = ACCELERATION_SHARE * flight.acceleration_limit
        self.own["smoother"] = GoalSmoother(place, v_max, a_max, 1.0 / self.rate).rows
        self.own["stepped_ns"] = self.member.clock.now_ns()
        self.own["goal"] = place
        self._take_result()
        rounds = asyncio.create_task(self._rounds(), name=f"drone {self.id} rounds")
        try:
            await super().run_law()
        finally:
            rounds.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await rounds

    def _take_result(self) -> None:
        """Fly to the newest x_i from now on."""
        x = self.agent.x
        self.own["goal"][0, : len(x)] = x

    async def _rounds(self) -> None:
        """Run round after round. An error of a round ends the law."""
        clock = self.member.clock
        agent = self.agent
        due = self.member.clock.now()
        try:
            while not agent.done:
                heard = await self.neighbors_exchange(
                    agent.message(), self.mates, self.mates, channel=AGGREGATIVE_CHANNEL
                )
                agent.step(heard)
                self._take_result()
                due = max(due + 1.0 / self.round_rate, clock.now())
                await clock.sleep(due - clock.now(), drone=self.id)
        except Exception as error:
            if self.fail(error):
                return
            # The law has ended: errors of the team do not matter any more.
            if not isinstance(error, CrazyChoirError):
                raise

    async def mission(self) -> dict[str, Any]:
        """Run the law, and add the result of the optimisation."""
        result = await super().mission()
        return {
            **result,
            "rounds": self.agent.k,
            "x": self.agent.x.tolist(),
            "way": self.way.rows,
        }


class Defender(AggregativeGuidance):
    """A drone of a Defence, between the target and its own intruder.

    It sees the intruder's present place.

    The result also holds intruder_way, see `Way`.

    mates: ids of the neighbours that take part.
    defence: the cost.
    intruder: id of the drone to watch, or the place (2,) m of an intruder that stands still.
    weights: row {j: w_ij} of the mates and itself, doubly stochastic.
    step_size: step size of AggregativeTracking.
    round_rate: Hz.
    """

    def __init__(
        self,
        mates: tuple[int, ...],
        defence: Defence,
        intruder: int | Vec,
        weights: Mapping[int, float],
        step_size: float = 0.05,
        round_rate: float = 20.0,
    ) -> None:
        super().__init__(mates, round_rate)
        self.defence = defence
        self.weights = weights
        self.step_size = step_size
        if isinstance(intruder, int):
            self.watched = intruder
        else:
            self.own["intruder"][0, 0:2] = intruder
        self.intruder_way = Way()

    @property
    def r(self) -> Vec:
        """(2,) m: the newest known place of the intruder."""
        return self.own["intruder"][0, 0:2].copy()

    def algorithm(self, place: Vec) -> AggregativeTracking:
        """Return the tracking with phi_i(x) = x in the plane.

        An intruder that was not heard yet is where it stands before the flight.
        """
        one = np.eye(2)
        if self.watched is not None:
            self.own["intruder"] = self.member.config.drone(self.watched).home
        problem = AggregativeProblem(
            aggregate=lambda x: x,
            jacobian=lambda x: one,
            gradient_own=lambda x, s: self.defence.gradient_own(x, s, self.r),
            gradient_sigma=self.defence.gradient_mean,
        )
        return AggregativeTracking(
            self.id, place[:2], self.weights, problem, self.step_size
        )

    def note(self, now: float, p: Vec) -> None:
        """Note where the drone is, (3,) m, and where its intruder is."""
        super().note(now, p)
        self.intruder_way.note(now, self.r)

    async def mission(self) -> dict[str, Any]:
        """Run the law, and add where its intruder was."""
        return {**await super().mission(), "intruder_way": self.intruder_way.rows}
