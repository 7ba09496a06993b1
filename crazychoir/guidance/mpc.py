"""Distributed model predictive control in flight: plans are agreed on one step ahead, beside a law that flies them."""

import asyncio
import contextlib
import logging
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from crazychoir.errors import CrazyChoirError
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.timed import Way
from crazychoir.optimization.predictive_control import (
    Prediction,
    PredictiveControl,
    SequentialMPC,
    integrators,
)
from crazychoir.types import FullState, Heard, State, Vec

log = logging.getLogger(__name__)
CHANNEL = "mpc"
TALKS = 10
"""Times in a step that a drone listens, and says again what it has decided: so often it may be lost."""
TUBE = 0.1
"""m, off its plan, from which on a drone plans from where it is."""


@dataclass(frozen=True)
class Motion:
    """How a drone may move in the plane, and what it wants: to be at its goal, at rest.

    step: h s;  horizon: T steps;  speed, acceleration, jerk: largest in x and in y, m/s, m/s2, m/s3;
    place, rate, effort: weights of the distance from the goal, of v and a, of the jerk.
    """

    step: float = 0.4
    horizon: int = 10
    speed: float = 0.6
    acceleration: float = 1.0
    jerk: float = 4.0
    place: float = 1.0
    rate: float = 0.1
    effort: float = 0.05

    def prediction(self, low: Vec, high: Vec) -> Prediction:
        """x = (p - goal, v, a), u the jerk, each of x and y; a plan ends at rest, and stays there.

        low, high: (2,) m, the box in which p - goal stays.
        """
        A, B = integrators(self.step, 2)
        most = [*2 * [self.speed], *2 * [self.acceleration]]
        both = np.vstack([np.eye(6), -np.eye(6)])
        push = np.vstack([np.eye(2), -np.eye(2)])
        return Prediction(
            A=A,
            B=B,
            C=np.eye(2, 6),
            Q=np.diag([*2 * [self.place], *4 * [self.rate]]),
            R=self.effort * np.eye(2),
            E=both,
            f=np.concatenate([high, most, -low, most]),
            G=push,
            h=np.full(4, self.jerk),
            T=self.horizon,
            Z=np.eye(6)[2:],
        )


class MPCGuidance(CFDistributedFeedback):
    """Flies to its goal in the plane while it stays within `reach` of what its neighbours still have to go.

        |(p_i - goal_i) - (p_j - goal_j)| <= reach  in x and in y, at the steps of all plans

    The plan of a step is agreed on during the step before, see SequentialMPC, beside the law, which never waits: it
    flies what was decided when the step begins, else its own last plan. A plan begins where the last one leads (the
    nominal state of a tube controller; what flies it holds the drone in the tube); a drone that is pushed further than
    TUBE off stays there, and plans from there. The constraints hold for the plans: they are not tightened by the tube,
    but by what is left for tracking in flight, and a drone that is pushed may leave `reach` until its next plan.
    goal: (2,) m;  reach: m.  Result: how many steps were solved, loosened, kept, infeasible, see Tally;  way, of `Way`.
    Source: Richards & How 2007, see SequentialMPC; Mayne, Seron & Rakovic 2005, Automatica 41(2), for the tube.
    """

    def __init__(
        self,
        goal: Vec,
        motion: Motion,
        low: Vec,
        high: Vec,
        reach: float,
        neighbors: tuple[int, ...],
    ) -> None:
        self.goal = np.asarray(goal, float)
        self.motion = motion
        self.way = Way()
        self.control = PredictiveControl(
            motion.prediction(low, high), reach if neighbors else None
        )
        self.mates = neighbors

    async def run_law(self) -> None:
        """The law, and the talk beside it as long as it lasts."""
        place = self.state.p
        self._next = self.member.clock.now() + self.motion.step
        self._z = place[2]
        self._off = False
        self._x = np.concatenate([place[:2] - self.goal, np.zeros(4)])
        self._u = np.zeros(2)
        self.scheme = SequentialMPC(self.id, self.mates, self.control, self._x)
        talk = asyncio.create_task(self._talk(), name=f"drone {self.id} talk")
        try:
            await super().run_law()
        finally:
            talk.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await talk

    def step(self, me: State, heard: Heard) -> FullState:
        """Where the plan is now: a polynomial of degree 3 from step to step."""
        now = self.member.clock.now()
        h = self.motion.step
        while now >= self._next - 1e-9:
            self._begin(me)
        self.way.note(now, me.p)
        x = self._x
        u = self._u
        s = now - self._next + h
        p = x[0:2]
        v = x[2:4]
        a = x[4:6]
        place = self.goal + p + s * (v + s * (0.5 * a + s * u / 6.0))
        self._off = bool(np.linalg.norm(me.p[:2] - place) > TUBE)
        return FullState.at(
            (*place, self._z),
            (*(v + s * (a + 0.5 * s * u)), 0.0),
            (*(a + s * u), 0.0),
            (*u, 0.0),
        )

    def _begin(self, me: State) -> None:
        """A step begins: what is decided is flown, and the next one is to be decided from where it leads."""
        if self._off:
            self.scheme.restart(np.concatenate([me.p[:2] - self.goal, np.zeros(4)]))
        self._x, self._u = self.scheme.x, self.scheme.advance()
        self._next += self.motion.step

    async def _talk(self) -> None:
        """Listen, decide, say it, again and again: what is lost is said once more."""
        clock = self.member.clock
        scheme = self.scheme
        pause = self.motion.step / TALKS
        try:
            while True:
                failed = scheme.tally.infeasible
                scheme.step(
                    await self.asynchronous_receive(self.mates, channel=CHANNEL)
                )
                if scheme.tally.infeasible > failed:
                    log.warning(
                        "drone %d: %s: it goes on with its last plan",
                        self.id,
                        scheme.tally.why,
                    )
                await self.send(scheme.message(), self.mates, channel=CHANNEL)
                await clock.sleep(pause, drone=self.id)
        except Exception as error:
            if self._law is not None and not self._law.done():
                self._law.set_exception(error)
            elif not isinstance(
                error, CrazyChoirError
            ):  # of a team that has ended, nothing is lost any more
                raise

    async def mission(self) -> dict[str, Any]:
        """The law, with how its steps went."""
        return {
            **await super().mission(),
            **asdict(self.scheme.tally),
            "way": self.way.rows,
        }
