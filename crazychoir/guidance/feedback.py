"""A law as a mission: CFDistributedFeedback, and what is said of a law that returns what cannot be flown."""

import asyncio
import logging
import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from crazychoir.bus.topics import STATE
from crazychoir.control.gains import FORMATION, Gains
from crazychoir.errors import ConfigError
from crazychoir.flight.references import taken, unflyable
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.member import Interrupted, Member, raisable, standing
from crazychoir.guidance.neighbour_state import Hearing, Paired, VelocitySum
from crazychoir.guidance.user_hook import Hook, place_of
from crazychoir.runtime.clock import SECOND, wake
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import (
    Acceleration,
    FullState,
    Goto,
    Heard,
    Reference,
    State,
    Velocity,
)

log = logging.getLogger(__name__)
LAW = "feedback law"
"""The task that a status names while a CFDistributedFeedback runs."""
SLOWEST, FASTEST = 1e-3, 1000.0
"""Hz, of a law."""
FOR_EVER = 1e9
"""s, of a law that does not end: timers count in nanoseconds."""
TAKEOFF, LAW_MODES = Mode.TAKEOFF, (Mode.HOVER, Mode.FOLLOW)


class CFDistributedFeedback(CFGuidance):
    """A feedback law on own and neighbours' states. Write `step`; it runs at `rate` Hz and never waits.

    `heard[j]` is the newest State of neighbour j, with its `age`; absent when beyond the topic's maximum age. If none
    has come since the last step it is moved on, p + v age, attitude as it was. Velocities, its own too, make up for
    those that were lost or flown for too long because a step was late, see VelocitySum: a law may sum them up.
    A new state of its own triggers it: what it wants is flown in the same tick.
    rate: Hz, at most that of the poses;  duration: s of the law, after everybody hovers;  gains: of the control that
    flies its Accelerations;  rest: s that it hovers before: what its control learns of thrust and trim while it hovers
    is all that it knows while it flies Accelerations;  paired: whether it hears neighbours as Paired does: place and
    velocity of the tick in which their acceleration was commanded, held with it while nothing comes; its own velocity
    is then what its neighbours hear: differences would be amplified by a large graph.
    """

    rate = 100.0
    duration = 20.0
    gains: Gains = FORMATION
    rest = 0.0
    paired = False

    @abstractmethod
    def step(self, me: State, heard: Heard) -> Reference | None:
        """The reference to fly until the next step; None lets the drone come to rest and hover."""

    def bind(self, member: Member) -> None:
        """Meet the drone, and listen to the neighbours' states."""
        super().bind(member)
        member.pilot.controls.lead_by(self.gains)
        bus = member.communicator.port.bus
        self._hearings: dict[int, Hearing | Paired] = {}
        for j in self.graph.in_neighbors(self.id):
            hearing = self._hearings[j] = self._hearing(f"drone {self.id} state of {j}")
            bus.subscribe(
                STATE, j, self.id, hearing, self.rate if self.rate < STATE.rate else 0.0
            )
        self._own = self._sum()
        self._measured = 0.0
        self._unheard = dict.fromkeys(self._hearings, 0)
        self._steps = self._nothing = self._refused = 0
        self._amiss = ""
        self._law: asyncio.Future[None] | None = None
        self._period_ns = self._due_ns = 0
        self._me = self.state
        self._stages = bus.stages
        bus.subscribe(
            STATE,
            self.id,
            self.id,
            Call(member.clock, self._moved, f"drone {self.id} state"),
        )

    def _hearing(self, name: str) -> Hearing | Paired:
        if self.paired:
            return Paired(self.member.clock, name, 1.0 / self.member.config.mocap.rate)
        return Hearing(self.member.clock, name, self._sum())

    def _sum(self) -> VelocitySum:
        member = self.member
        return VelocitySum(
            member.pilot.filter.cutoff, 1.0 / member.config.mocap.rate, 1.0 / self.rate
        )

    async def mission(self) -> dict[str, Any]:
        """Take off, wait for the others, run the law, land.

        Returns law_s: s that the law ran;  references: how often `step` returned one that could be flown;  place:
        (3,) m, where it has ended;  unheard_s: {j: s of the law in which nothing fresh was heard of neighbour j};
        refused_references: how many could not be flown, if any;  refused: why, if these are most of them. It
        has failed if `step` returned references of which none could be flown.
        """
        await self.take_off(self.height())
        await self.sleep(self.rest)
        await self.rendezvous()
        self.member.report = lambda: {"task": LAW}
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
        usable = self._steps - self._nothing - self._refused
        result = {
            "law_s": law_s,
            "references": usable,
            "place": place,
            "unheard_s": unheard,
        }
        if self._refused:
            result["refused_references"] = self._refused
        if self._refused > usable:
            result["refused"] = self._useless()
        return result | (
            {"success": False, "reason": self._useless()}
            if self._refused and not usable
            else {}
        )

    def _useless(self) -> str:
        """Return in how many steps the law gave what cannot be flown, and why the last of these cannot."""
        where = f"drone {self.id}: the law gave no usable reference in {self._refused} of {self._steps} steps"
        others = self._steps - self._refused
        if others > 0 and self._nothing == others:
            where += " (None in the others)"
        return f"{where}: {self._amiss}"

    def height(self) -> float | None:
        """m, of the take-off; None for that of the swarm file. Asked before anybody flies, and at the take-off."""
        return None

    def foresee(self, member: Member) -> None:
        """Raise ConfigError for a `height` that fails, or does not end, and for a take-off beyond the fence.

        And for a `rate` and a `duration` that are no such numbers; a law may last for ever.
        """
        for name, least, most, unit in (
            ("rate", SLOWEST, FASTEST, "Hz"),
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
        """Its height; None, too, if that needs what `bind` or the mission gives: it is asked again at the take-off."""
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
        """Let `step` run for `duration` s; raises what `step` raises, and Interrupted when the pilot stops obeying."""
        clock = self.member.clock
        self._period_ns = round(SECOND / self.rate)
        self._due_ns = clock.now_ns()
        self._own.forget()
        for hearing in self._hearings.values():
            hearing.forget()
        self._law = asyncio.get_running_loop().create_future()
        seconds = min(float(self.duration), FOR_EVER)
        end = clock.call_at(
            self._due_ns + round(seconds * SECOND), wake, self._law, drone=self.id
        )
        try:
            await self._law
        finally:
            self._law = None
            end.cancel()

    def _moved(self, me: State, age: float) -> None:
        """A new state: decide when all drones of this process have said theirs."""
        if self._law is not None:
            self._me = me
            self._stages.decide.append(self._decide)

    def _decide(self) -> None:
        """Call `step` if it is due. Its errors end the law, not the tick, which is not its alone."""
        law = self._law
        if law is None or law.done():
            return
        pilot = self.member.pilot
        try:
            late_ns = self.member.clock.now_ns() - self._due_ns
            if late_ns < -pilot.period_ns // 2 or pilot.mode is TAKEOFF:
                return
            self._due_ns += max(1, late_ns // self._period_ns + 1) * self._period_ns
            if pilot.mode not in LAW_MODES:
                raise Interrupted(f"drone {self.id}: {standing(pilot)}{self._deaf()}")
            reference = self._stepped(self._me)
            self._steps += 1
            if reference is None:
                self._nothing += 1
                pilot.hover()
            elif not pilot.follow(reference):
                self._not_taken(reference)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - whoever awaits the law gets it
            law.set_exception(raisable(error, f"drone {self.id}: step"))

    def _stepped(self, me: State) -> Reference | None:
        """What `step` wants, under the eyes of the watchdog."""
        watchdog = self.member.watchdog
        measured = self.member.pilot.filter.measured
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
        """Count what can never be flown, and say once why."""
        self._refused += 1
        if taken(reference) is None:
            why = f"{amiss(reference)}; {unflyable(reference)}"
        else:
            why = self.member.pilot.unflown(reference)
        self._amiss = f"{why} ({place_of(self.step)})"
        if self._refused == 1:
            log.warning("drone %d: %s: not flown", self.id, self._amiss)

    def _deaf(self) -> str:
        """Whom it does not hear: the usual reason of a law that says nothing."""
        silent = ", ".join(
            str(j) for j, box in self._hearings.items() if box.fresh() is None
        )
        return f"; hears nothing of drone(s) {silent}" if silent else ""

    def hear(self, held: int) -> Heard:
        """The neighbours' states for this step, those that are not stale; held: poses since the last step."""
        heard: Heard = {}
        now_ns = self.member.clock.now_ns()
        for j, hearing in self._hearings.items():
            state = hearing.state(now_ns, held)
            if state is not None:
                heard[j] = state
        return heard


def amiss(reference: object) -> str:
    """Why what a law has returned can never be flown."""
    numbers: list[Any]
    match reference:
        case Acceleration():
            numbers = [reference.a, reference.yaw]
            size = 3
        case FullState():
            numbers = [reference.flat]
            size = 14
        case Velocity():
            numbers = [reference.v, reference.yaw]
            size = 3
        case Goto():
            numbers = [reference.p, reference.yaw, reference.duration]
            size = 3
        case _:
            of = f" {reference.shape}" if isinstance(reference, np.ndarray) else ""
            found = f"{type(reference).__name__}{of}"
            kinds = (
                "Acceleration(...), Velocity(...), FullState(...), Goto(...) or None"
            )
            return f"step() must return {kinds}; found {found}"
    kind = type(reference).__name__
    found = " ".join(f"{numbers}"[1:-1].split())
    return f"step() must return finite numbers, {kind} of ({size},); found {kind}({found:.80})"


def idle(results: Mapping[int, Mapping[str, Any]]) -> bool:
    """Whether all drones flew laws that returned None in every step: nobody moved."""
    return bool(results) and all(
        r.get("success") and r.get("references") == 0 for r in results.values()
    )
