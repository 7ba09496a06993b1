"""Distributed model predictive control in flight.

The drones agree on plans one step ahead, beside the law that flies them.
"""

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
MPC_CHANNEL = "mpc"
"""Channel of the plans."""
TALKS_PER_STEP = 10
"""How often a drone listens and repeats its decision in a step.

It works if at least one of these messages arrives.
"""
TUBE_RADIUS = 0.1
"""m: a drone farther from its plan plans from where it is."""


@dataclass(frozen=True)
class Motion:
    """How a drone may move in the plane. It wants to be at rest at its goal."""

    step: float = 0.4
    """h, s."""
    horizon: int = 10
    """T, number of steps."""
    speed: float = 0.6
    """m/s: largest, in x and in y."""
    acceleration: float = 1.0
    """m/s2: largest, in x and in y."""
    jerk: float = 4.0
    """m/s3: largest, in x and in y."""
    place: float = 1.0
    """Weight of the distance from the goal."""
    rate: float = 0.1
    """Weight of v and a."""
    effort: float = 0.05
    """Weight of the jerk."""

    def prediction(self, low: Vec, high: Vec) -> Prediction:
        """Return the prediction model with x = (p - goal, v, a) and the jerk u, each in x and y.

        A plan ends at rest, and stays there.

        low: (2,) m: lower corner of the box in which p - goal stays.
        high: (2,) m: upper corner of that box.
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
    """Flies to its goal in the plane, within `reach` of what its neighbours still have to go.

        |(p_i - goal_i) - (p_j - goal_j)| <= reach   in x and in y, at the steps of all plans

    The drones agree on the plan of a step during the step before, see SequentialMPC, beside the
    law. The law never waits: when the step begins it flies the decided plan, else its own last
    plan.

    A plan begins where the last plan leads: the nominal state of a tube controller, while the
    flight control holds the drone in the tube. A drone that is pushed more than TUBE_RADIUS off its plan
    stops and plans from where it is. The constraints hold for the plans. They are not tightened by
    the tube, but by a margin for tracking in flight. A drone that is pushed may leave `reach` until
    its next plan.

    The result also holds the number of steps that were solved, loosened, kept and infeasible, see
    Tally, and way, see `Way`.

    goal: (2,) m.
    motion: how the drone may move.
    low: (2,) m: lower corner of the box in which p - goal stays.
    high: (2,) m: upper corner of that box.
    reach: m.
    neighbors: ids of the neighbours.
    Source: Richards & How 2007, see SequentialMPC; Mayne, Seron & Rakovic 2005, Automatica 41(2),
    for the tube.
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
        """Run the law, and beside it the messages as long as the law lasts."""
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
        """Return the point of the plan that is due now.

        The plan is a polynomial of degree 3 from step to step.
        """
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
        self._off = bool(np.linalg.norm(me.p[:2] - place) > TUBE_RADIUS)
        return FullState.at(
            (*place, self._z),
            (*(v + s * (a + 0.5 * s * u)), 0.0),
            (*(a + s * u), 0.0),
            (*u, 0.0),
        )

    def _begin(self, me: State) -> None:
        """Begin a step: fly the decided plan, and plan the next step from where it leads."""
        if self._off:
            self.scheme.restart(np.concatenate([me.p[:2] - self.goal, np.zeros(4)]))
        self._x, self._u = self.scheme.x, self.scheme.advance()
        self._next += self.motion.step

    async def _talk(self) -> None:
        """Listen, decide and send the decision, again and again, because messages may be lost."""
        clock = self.member.clock
        scheme = self.scheme
        pause = self.motion.step / TALKS_PER_STEP
        try:
            while True:
                failed = scheme.tally.infeasible
                scheme.step(
                    await self.asynchronous_receive(self.mates, channel=MPC_CHANNEL)
                )
                if scheme.tally.infeasible > failed:
                    log.warning(
                        "drone %d: %s: it goes on with its last plan",
                        self.id,
                        scheme.tally.why,
                    )
                await self.send(scheme.message(), self.mates, channel=MPC_CHANNEL)
                await clock.sleep(pause, drone=self.id)
        except Exception as error:
            if self.fail(error):
                return
            # The law has ended: errors of the team do not matter any more.
            if not isinstance(error, CrazyChoirError):
                raise

    async def mission(self) -> dict[str, Any]:
        """Run the law, and add how its steps went."""
        return {
            **await super().mission(),
            **asdict(self.scheme.tally),
            "way": self.way.rows,
        }
