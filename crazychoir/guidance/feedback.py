"""CFDistributedFeedback: a feedback law as a mission."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.control.gains import FORMATION_GAINS, Gains
from crazychoir.errors import ConfigError
from crazychoir.guidance.decision.law_stage import LawStage
from crazychoir.guidance.decision.team import Ids, TeamLaw
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.member import Member
from crazychoir.guidance.running_law import RunningLaw
from crazychoir.guidance.user_hook import Hook
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import Heard, Reference, State

LAW_TASK = "feedback law"
"""The task in the status while a CFDistributedFeedback runs."""


@dataclass(frozen=True, slots=True)
class LawTiming:
    """Limits of the rate and of the duration of a law."""

    lowest_rate: float = 1e-3
    """Hz: lowest rate of a law."""
    highest_rate: float = 1000.0
    """Hz: highest rate of a law."""
    longest_duration: float = 1e9
    """s: duration of a law without an end, since timers count in nanoseconds."""


LAW_TIMING = LawTiming()


class CFDistributedFeedback(CFGuidance):
    """A feedback law on the states of this drone and its neighbours. Write `step`.

    `step` runs at `rate` Hz and never waits. A new state of the drone triggers it, and its
    reference is flown in the same tick.

    `heard[j]` is the newest State of neighbour j, with its `age`. It is absent when it is older
    than the maximum age of the topic. If no state has come since the last step it is extrapolated:
    position p + v age, attitude unchanged. All velocities, also the drone's own, are corrected for
    states that were lost, or were flown for too long because a step was late (see VelocitySum). A
    law may therefore sum them up.
    """

    rate = 100.0
    """Hz, at most the rate of the poses."""
    duration = 20.0
    """s: duration of the law, from the moment when all drones hover."""
    gains: Gains = FORMATION_GAINS
    """Gains of the control that flies the Accelerations of the law."""
    rest = 0.0
    """s: how long the drone hovers before the law.

    While it hovers its control learns thrust and trim. It learns nothing more while it flies
    Accelerations.
    """
    paired = False
    """Receive the states of neighbours as Paired delivers them.

    Position and velocity are those of the tick in which the acceleration was commanded, and all
    three are held together while no message comes. The drone's own velocity is then the velocity
    that its neighbours receive, because a large graph would amplify any difference.
    """

    _began_ns: int | None = None
    """ns of the clock at which the law began."""

    @abstractmethod
    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return the reference to fly until the next step. None lets the drone stop and hover.

        me: the drone's own state.
        heard: {j: state of neighbour j}.
        """

    @classmethod
    def for_team(cls, laws: Sequence[Self], neighbors: Sequence[Ids]) -> TeamLaw | None:
        """Return the step of all drones of this class in the process at once, or None.

        None: `step` is called drone by drone. A class that writes both lets `step` return
        `step_alone(...)`, so that the law has one text. The function that is returned gets a Team in
        each tick. What does not change in flight is prepared here: this is called when laws begin.

        laws: the laws, one a row of the team.
        neighbors: ids of the neighbours of each law, in the order of the team's edges.
        """
        return None

    def bind(self, member: Member) -> None:
        """Connect the law to its drone, and subscribe to the states of the neighbours."""
        super().bind(member)
        member.pilot.setup.controls.lead_by(self.gains)
        bus = member.communicator.port.bus
        tick = member.pilot.tick
        self._stage = (
            LawStage(tick, bus.impairment) if member.laws is None else member.laws
        )
        neighbors = self.graph.in_neighbors(self.id)
        self._running = RunningLaw(self, member, tuple(neighbors))
        member.communicator.port.life_signs.append(self._running.find_heard_ns)
        rate = self.rate if self.rate < DRONE_TOPICS.state.rate else 0.0
        for j, hearing in zip(neighbors, self._running.hearings, strict=True):
            if j in tick.batch.places:
                hearing.take_from(tick.batch.places[j], rate)
            elif tick.airspace is not None and j in tick.airspace.places:
                hearing.take_from_frames(tick.airspace.places[j], rate)
                bus.subscribe(DRONE_TOPICS.framed_state, j, self.id, hearing)
            else:
                bus.subscribe(DRONE_TOPICS.state, j, self.id, hearing, rate)
        self._is_running = False

    async def mission(self) -> dict[str, Any]:
        """Take off, wait for the others, run the law, land.

        Returns the report:
        law_s: s that the law ran
        references: number of feasible references that `step` returned
        place: (3,) m, where the law ended
        unheard_s: {j: s of the law without a fresh message of neighbour j}
        refused_references: number of references that could not be flown, if any
        refused: reason, if these are most references
        The mission has failed if `step` returned references, but none of them could be flown.
        """
        await self.take_off(self.height())
        await self.sleep(self.rest)
        await self.rendezvous()
        self.member.report = lambda: {"task": LAW_TASK}
        self.member.announce()
        started = self.member.clock.now()
        await self.run_law()
        law_s = self.member.clock.now() - started
        place = self.state.p.tolist()
        self.member.pilot.hover()
        self.member.report = lambda: {"task": "landing"}
        self.member.announce()
        await self.land()
        unheard = {
            j: steps / self.rate for j, steps in self._running.unheard.items() if steps
        }
        result = {
            "law_s": law_s,
            "references": self._running.tally.usable,
            "place": place,
            "unheard_s": unheard,
        }
        return result | self._running.tally.list_faults()

    def height(self) -> float | None:
        """Return the take-off height in m above the ground, or None for that of the swarm file.

        It is called before any drone flies, and again at the take-off.
        """
        return None

    def foresee(self, member: Member) -> None:
        """Check `rate`, `duration` and `height` before any drone flies.

        A law may last for ever.
        Raises ConfigError for a rate or a duration that is not an allowed number, for a `height`
        that fails or does not return, and for a take-off beyond the fence.
        """
        for name, least, most, unit in (
            ("rate", LAW_TIMING.lowest_rate, LAW_TIMING.highest_rate, "Hz"),
            ("duration", 0.0, math.inf, "s"),
        ):
            value = getattr(self, name)
            if not (
                isinstance(value, int | float | np.number)
                and value > 0.0
                and least <= value <= most
            ):
                where = f"drone {member.id}: {type(self).__name__}.{name}"
                allowed = f"{least:g} to {most:g}" if least else "above 0"
                raise ConfigError(where, value, f"a number of {unit}, {allowed}")
        self.member = member
        try:
            self.require_height(self._foreseen(), "height()")
        finally:
            del self.member

    def _foreseen(self) -> float | None:
        """Return the height of the law as far as it is known before the flight.

        None if `height` needs values that `bind` or the mission sets: the take-off calls it again.
        """
        code = getattr(self.height, "__code__", None)
        file = code.co_filename if code else type(self).__name__
        hook = Hook(
            file,
            "height",
            self.height,
            (),
            "m above the ground, or None: that of the swarm file",
        )
        hook.check()
        try:
            height: float | None = hook()
        except ConfigError as error:
            if not isinstance(error.__cause__, AttributeError):
                raise
            return None
        return height

    async def run_law(self) -> None:
        """Call `step` at its rate for `duration` s.

        Raises all errors of `step`, and Interrupted when the pilot stops obeying.
        """
        clock = self.member.clock
        now_ns = clock.now_ns()
        ended = self._running.start(now_ns)
        seconds = min(float(self.duration), LAW_TIMING.longest_duration)
        end = clock.call_at(
            now_ns + round(seconds * NS_PER_SECOND), self._running.end, drone=self.id
        )
        self._stage.enter(self._running)
        self._began_ns = now_ns
        self._is_running = True
        try:
            await ended
        finally:
            self._is_running = False
            self._stage.leave(self._running)
            end.cancel()

    @property
    def elapsed(self) -> float:
        """s since the law of this drone began; 0 before.

        The laws of a team do not begin in one instant: each begins when its drone has heard that
        all hover, and a lost message is sent again after some tenths of a second.
        """
        if self._began_ns is None:
            return 0.0
        return (self.member.clock.now_ns() - self._began_ns) / NS_PER_SECOND

    def fail(self, error: BaseException) -> bool:
        """End the law with an error; return False if it does not run any more."""
        return self._is_running and self._running.fail(error)

    def renew_team(self) -> None:
        """Call `for_team` again before the next step, because numbers of this law have changed."""
        self._stage.renew()


def are_all_idle(results: Mapping[int, Mapping[str, Any]]) -> bool:
    """Return whether all drones flew laws that returned None in every step.

    Then no drone has moved.
    """
    return bool(results) and all(
        r.get("success") and r.get("references") == 0 for r in results.values()
    )
