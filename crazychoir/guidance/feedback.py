"""CFDistributedFeedback: a feedback law as a mission."""

import asyncio
import logging
import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.control.gains import FORMATION_GAINS, Gains
from crazychoir.errors import ConfigError
from crazychoir.flight.references import convert_reference, explain_refusal
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.law_tally import LawTally, explain_wrong_return
from crazychoir.guidance.member import (
    Interrupted,
    Member,
    describe_state,
    make_raisable,
)
from crazychoir.guidance.neighbour_state import (
    PairedStateMailbox,
    StateMailbox,
    VelocitySum,
)
from crazychoir.guidance.user_hook import Hook, locate_function
from crazychoir.runtime.clock import NS_PER_SECOND, wake_waiter
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Heard, Reference, State

log = logging.getLogger(__name__)
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


RISING_MODE = Mode.TAKEOFF
"""The mode in which a law waits for the end of the take-off."""
LAW_MODES = (Mode.HOVER, Mode.FOLLOW)
"""The modes of the pilot in which a law may fly."""


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

    @abstractmethod
    def step(self, me: State, heard: Heard) -> Reference | None:
        """Return the reference to fly until the next step. None lets the drone stop and hover.

        me: the drone's own state.
        heard: {j: state of neighbour j}.
        """

    def bind(self, member: Member) -> None:
        """Connect the law to its drone, and subscribe to the states of the neighbours."""
        super().bind(member)
        member.pilot.setup.controls.lead_by(self.gains)
        bus = member.communicator.port.bus
        self._hearings: dict[int, StateMailbox | PairedStateMailbox] = {}
        for j in self.graph.in_neighbors(self.id):
            hearing = self._hearings[j] = self._hearing(f"drone {self.id} state of {j}")
            bus.subscribe(
                DRONE_TOPICS.state,
                j,
                self.id,
                hearing,
                self.rate if self.rate < DRONE_TOPICS.state.rate else 0.0,
            )
        self._own = self._sum()
        self._measured = 0.0
        self._unheard = dict.fromkeys(self._hearings, 0)
        self._tally = LawTally(self.id)
        self._law: asyncio.Future[None] | None = None
        self._period_ns = self._due_ns = 0
        self._me = self.state
        self._stages = bus.stages
        bus.subscribe(
            DRONE_TOPICS.state,
            self.id,
            self.id,
            Call(member.clock, self._moved, f"drone {self.id} state"),
        )

    def _hearing(self, name: str) -> StateMailbox | PairedStateMailbox:
        if self.paired:
            return PairedStateMailbox(
                self.member.clock, name, 1.0 / self.member.config.mocap.rate
            )
        return StateMailbox(self.member.clock, name, self._sum())

    def _sum(self) -> VelocitySum:
        member = self.member
        return VelocitySum(
            member.pilot.stages.filter.cutoff,
            1.0 / member.config.mocap.rate,
            1.0 / self.rate,
        )

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
        unheard = {j: steps / self.rate for j, steps in self._unheard.items() if steps}
        result = {
            "law_s": law_s,
            "references": self._tally.usable,
            "place": place,
            "unheard_s": unheard,
        }
        return result | self._tally.list_faults()

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
        self._period_ns = round(NS_PER_SECOND / self.rate)
        self._due_ns = clock.now_ns()
        self._own.forget()
        for hearing in self._hearings.values():
            hearing.forget()
        self._law = asyncio.get_running_loop().create_future()
        seconds = min(float(self.duration), LAW_TIMING.longest_duration)
        end = clock.call_at(
            self._due_ns + round(seconds * NS_PER_SECOND),
            wake_waiter,
            self._law,
            drone=self.id,
        )
        try:
            await self._law
        finally:
            self._law = None
            end.cancel()

    def _moved(self, me: State, age: float) -> None:
        """Take a new state: decide when all drones of this process have published theirs."""
        if self._law is not None:
            self._me = me
            self._stages.decide.append(self._decide)

    def _decide(self) -> None:
        """Call `step` if it is due.

        Its errors end the law. They do not end the tick, because the tick belongs to other drones
        too.
        """
        law = self._law
        if law is None or law.done():
            return
        pilot = self.member.pilot
        try:
            late_ns = self.member.clock.now_ns() - self._due_ns
            if late_ns < -pilot.setup.period_ns // 2 or pilot.mode is RISING_MODE:
                return
            self._due_ns += max(1, late_ns // self._period_ns + 1) * self._period_ns
            if pilot.mode not in LAW_MODES:
                raise Interrupted(
                    f"drone {self.id}: {describe_state(pilot)}{self._deaf()}"
                )
            reference = self._stepped(self._me)
            tally = self._tally
            tally.steps += 1
            if reference is None:
                tally.hovered += 1
                pilot.hover()
            elif not pilot.follow(reference):
                self._not_taken(reference)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - run_law raises it
            law.set_exception(make_raisable(error, f"drone {self.id}: step"))

    def _stepped(self, me: State) -> Reference | None:
        """Return the reference of `step`, guarded by the watchdog."""
        watchdog = self.member.watchdog
        measured = self.member.pilot.stages.filter.measured
        poses = round(
            (measured - self._measured) / self._own.h
        )  # a whole number: clocks jitter, cameras do not
        self._measured = measured
        heard = self.hear(poses)
        if poses == 1 and self._own.even:
            self._own.last = me
        elif not self.paired:
            me = self._own.told(me, me.age, poses, poses)
        if len(heard) < len(self._hearings):
            for j in self._hearings:
                self._unheard[j] += j not in heard
        if watchdog is None:
            return self.step(me, heard)
        with watchdog.guard(f"drone {self.id} guidance"):
            return self.step(me, heard)

    def _not_taken(self, reference: object) -> None:
        """Count a reference that can never be flown, and log the reason once."""
        if convert_reference(reference) is None:
            why = f"{explain_wrong_return(reference)}; {explain_refusal(reference)}"
        else:
            why = self.member.pilot.follower.explain_unflown(reference)
        why = f"{why} ({locate_function(self.step)})"
        self._tally.refuse(why)
        if self._tally.refused == 1:
            log.warning("drone %d: %s: not flown", self.id, why)

    def _deaf(self) -> str:
        """Return the silent neighbours in words, or "".

        Missing neighbours are the usual reason for a law that gives no reference.
        """
        silent = ", ".join(
            str(j) for j, box in self._hearings.items() if box.fresh() is None
        )
        return f"; hears nothing of drone(s) {silent}" if silent else ""

    def hear(self, held: int) -> Heard:
        """Return the states of the neighbours for this step, without the stale ones.

        held: number of poses since the last step.
        """
        heard: Heard = {}
        now_ns = self.member.clock.now_ns()
        for j, hearing in self._hearings.items():
            state = hearing.state(now_ns, held)
            if state is not None:
                heard[j] = state
        return heard


def are_all_idle(results: Mapping[int, Mapping[str, Any]]) -> bool:
    """Return whether all drones flew laws that returned None in every step.

    Then no drone has moved.
    """
    return bool(results) and all(
        r.get("success") and r.get("references") == 0 for r in results.values()
    )
