"""Aggregative optimisation in flight: a team tracks what all of it wants together, and flies there meanwhile."""

import asyncio
import contextlib
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.errors import CrazyChoirError
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.member import Member
from crazychoir.guidance.timed import Way
from crazychoir.optimization.algorithms.aggregative_tracking import AggregativeTracking
from crazychoir.planning.smoothing import Smoother
from crazychoir.types import FullState, Heard, Mat, State, Vec

CHANNEL = "aggregative"
SPEED_SHARE, ACCELERATION_SHARE = 0.5, 0.9
"""Of [flight], that references use: what is left is for who is pushed off its reference."""


@dataclass(frozen=True)
class Defence:
    """A defender between its intruder, the target of all, and its team.

        f_i(x_i, s) = a |x_i - r_i|^2 + b |s - t|^2 + c |x_i - s|^2,   s = (1/N) sum_j x_j
        grad_1 f_i = 2 a (x_i - r_i) + 2 c (x_i - s),   grad_2 f_i = 2 b (s - t) - 2 c (x_i - s)

    r_i: (d,) m, the intruder;  t: (d,) m, the target;  intruder, goal, team: the weights a, b, c >= 0,
    a + b > 0, a + c > 0.
    """

    target: Vec
    intruder: float = 1.0
    goal: float = 1.0
    team: float = 1.0

    def gradient_own(self, x: Vec, s: Vec, r: Vec) -> Vec:
        """grad_1 f_i (d,)."""
        return 2.0 * self.intruder * (x - r) + 2.0 * self.team * (x - s)

    def gradient_mean(self, x: Vec, s: Vec) -> Vec:
        """grad_2 f_i (d,)."""
        return 2.0 * self.goal * (s - self.target) - 2.0 * self.team * (x - s)

    def optimum(self, r: Mat) -> Mat:
        """Where all x_i are at the minimum of sum_i f_i, in closed form.

            s = (a mean(r) + b t) / (a + b),   x_i = (a r_i + c s - b (s - t)) / (a + c)

        With equal weights x_i = (r_i + t) / 2.  r: (N, d);  returns (N, d).
        """
        a = self.intruder
        b = self.goal
        c = self.team
        s = (a * r.mean(axis=0) + b * self.target) / (a + b)
        found: Mat = (a * r + c * s - b * (s - self.target)) / (a + c)
        return found


class AggregativeGuidance(CFDistributedFeedback):
    """Flies to its own x_i of an aggregative problem while its team solves it, over lossy links, and as it changes.

    A subclass writes `algorithm`. Rounds run beside the law, at most `round_rate` a second, with the `mates` alone, and
    repeat what is lost; the law never waits for them: it flies to the newest x_i, through a Smoother, and comes to
    rest there when no round ends. A mate that is lost for good ends the law, with the reason.
    mates: the neighbours that take part;  round_rate: Hz.
    Result: rounds;  x: (d,) m, the last;  way, of `Way`.
    """

    agent: AggregativeTracking
    smoother: Smoother

    def __init__(self, mates: tuple[int, ...], round_rate: float = 20.0) -> None:
        self.mates = mates
        self.round_rate = round_rate
        self.way = Way()

    @abstractmethod
    def algorithm(self, place: Vec) -> AggregativeTracking:
        """This drone's part, from its place (3,) m when the law begins; x_i is where it is to be, (2,) or (3,) m."""

    def bind(self, member: Member) -> None:
        """Meet the drone."""
        super().bind(member)
        self._place = np.zeros(3)
        self._last = 0.0

    def step(self, me: State, heard: Heard) -> FullState:
        """One period on the way to x_i."""
        now = self.member.clock.now()
        x = self.agent.x
        self.way.note(now, me.p)
        seconds = now - self._last
        self._last = now
        return self.smoother.step(np.array([*x, *self._place[len(x) :]]), seconds)

    async def run_law(self) -> None:
        """The law, and the rounds beside it as long as it lasts."""
        flight = self.member.config.flight
        place = self.state.p.copy()
        self._place, self._last = place, self.member.clock.now()
        self.agent = self.algorithm(place)
        v_max = SPEED_SHARE * flight.speed_limit
        a_max = ACCELERATION_SHARE * flight.acceleration_limit
        self.smoother = Smoother(place, v_max, a_max, 1.0 / self.rate)
        rounds = asyncio.create_task(self._rounds(), name=f"drone {self.id} rounds")
        try:
            await super().run_law()
        finally:
            rounds.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await rounds

    async def _rounds(self) -> None:
        """Round after round; what ends them ends the law."""
        clock = self.member.clock
        agent = self.agent
        due = self.member.clock.now()
        try:
            while not agent.done:
                heard = await self.neighbors_exchange(
                    agent.message(), self.mates, self.mates, channel=CHANNEL
                )
                agent.step(heard)
                due = max(due + 1.0 / self.round_rate, clock.now())
                await clock.sleep(due - clock.now(), drone=self.id)
        except Exception as error:
            if self._law is not None and not self._law.done():
                self._law.set_exception(error)
            elif not isinstance(
                error, CrazyChoirError
            ):  # of a team that has ended, nothing is lost any more
                raise

    async def mission(self) -> dict[str, Any]:
        """The law, with what came of the optimisation."""
        result = await super().mission()
        return {
            **result,
            "rounds": self.agent.k,
            "x": self.agent.x.tolist(),
            "way": self.way.rows,
        }


class Defender(AggregativeGuidance):
    """A drone of a Defence: between its own intruder, which it sees where it is now, and the target.

    intruder: the drone that it hears of, or the place (2,) m where it stands;  weights: row {j: w_ij} of the mates and
    itself, doubly stochastic;  step_size: of AggregativeTracking.  Result: also intruder_way, of `Way`.
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
        self.seen: int | None = intruder if isinstance(intruder, int) else None
        self.r = (
            np.zeros(2) if isinstance(intruder, int) else np.asarray(intruder, float)
        )
        self.intruder_way = Way()

    def algorithm(self, place: Vec) -> AggregativeTracking:
        """phi_i(x) = x in the plane; an intruder that was not heard of yet is where it stands before the flight."""
        one = np.eye(2)
        if self.seen is not None:
            self.r = np.array(self.member.config.drone(self.seen).home[:2])
        return AggregativeTracking(
            self.id,
            place[:2],
            self.weights,
            lambda x: x,
            lambda x: one,
            lambda x, s: self.defence.gradient_own(x, s, self.r),
            self.defence.gradient_mean,
            self.step_size,
        )

    def step(self, me: State, heard: Heard) -> FullState:
        """See the intruder, while it is heard of, and fly on."""
        if self.seen is not None and self.seen in heard:
            self.r = heard[self.seen].p[:2].copy()
        self.intruder_way.note(self.member.clock.now(), self.r)
        return super().step(me, heard)

    async def mission(self) -> dict[str, Any]:
        """The law, with where its intruder was."""
        return {**await super().mission(), "intruder_way": self.intruder_way.rows}
