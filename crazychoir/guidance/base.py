"""What a mission is written in: CFGuidance (a coroutine with the paper's verbs) and CFDistributedFeedback (a law)."""

import asyncio
import logging
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MethodType
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, overload

import numpy as np

from crazychoir.bus.topics import STATE
from crazychoir.control.gains import FORMATION, Gains
from crazychoir.control.position import HEADROOM
from crazychoir.errors import ConfigError, CrazyChoirError, Refused
from crazychoir.guidance.hearing import Hearing, Paired, VelocitySum
from crazychoir.guidance.sensors import Readings, Sensors
from crazychoir.optimization.checks import require_graph
from crazychoir.planning.feasibility import Limits, check
from crazychoir.planning.trajectory import Trajectory
from crazychoir.runtime.clock import SECOND, Clock, wake
from crazychoir.runtime.hanging import Guards
from crazychoir.runtime.mailbox import Call
from crazychoir.safety.modes import Mode
from crazychoir.safety.pilot import Pilot
from crazychoir.swarm.communicator import Communicator
from crazychoir.swarm.config import SwarmConfig
from crazychoir.swarm.graph import Graph
from crazychoir.swarm.round import Round
from crazychoir.swarm.running import Pace, run_algorithm
from crazychoir.types import Acceleration, FullState, Goto, Heard, Point, Reference, State, Vec, Velocity

log = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")
SETTLE = 0.05
LAW_MODES = (Mode.HOVER, Mode.FOLLOW)
TAKEOFF = Mode.TAKEOFF
FLYING = (TAKEOFF, *LAW_MODES)
ARRIVED = 0.2
"""m from a goal that counts as there."""
RISEN = 0.04
"""m from its height, above where it stood, beyond which a drone has not flown its take-off to the end."""
THERE, STILL, STOOD = 0.003, 0.02, 0.3
"""m, m/s, s: so near, slow and long a drone that has risen stands, and knows its thrust to some thousandths."""
PATIENT = 5.0
"""s that it gets for that."""
ATTEMPTS = 5
BLOWN = 2.0
"""s after the planned time of a flight in which a drone may still arrive: in a wind that it has yet to learn."""
PATIENCE = 300.0
"""s that a flight waits for a pilot that is held, or that the safety table has stopped; and for a first pose."""
TOUCHDOWN = 5.0
"""s beyond the planned time of a landing that a mission waits for its end."""
UNCOMMANDED = 1800.0
"""s that a drone waits on the ground for an operator, in a run that has one."""
GATES = {"take-off": "waits for its operator: take-off", "start": "waits for its operator: start"}
LAW = "feedback law"
"""The task that a status names while a CFDistributedFeedback runs."""


@dataclass
class Member:
    """What a guidance gets from its drone: who it is, its team, its way to talk, its way to fly."""

    id: int
    config: SwarmConfig
    clock: Clock
    communicator: Communicator
    pilot: Pilot
    watchdog: Guards | None = None
    report: Callable[[], dict[str, Any]] = dict
    """Says how the mission goes: task, round, cost, for the status."""
    announce: Callable[[], None] = lambda: None  # publishes the status now, not at its next tick
    ended: str = ""
    """Why the mission is over; from then on it flies no more, whatever it catches and goes on with."""
    sensors: Sensors | None = None
    gate: str = ""
    """The command of its operator, of GATES, that the mission waits for."""
    rise: float | None = None
    """m, the height of the take-off that it waits for; None: that of the swarm file."""


class Verb(Generic[P, R]):
    """A method of the communicator as a method of CFGuidance: the same arguments, defaults and documentation."""

    def __init__(self, verb: Callable[Concatenate[Communicator, P], R]) -> None:
        self.verb = verb

    @overload
    def __get__(self, guidance: None, owner: type) -> Callable[Concatenate[Communicator, P], R]: ...
    @overload
    def __get__(self, guidance: "CFGuidance", owner: type) -> Callable[P, R]: ...
    def __get__(self, guidance: "CFGuidance | None", owner: type) -> Callable[..., R]:
        return self.verb if guidance is None else MethodType(self.verb, guidance.member.communicator)


class CFGuidance:
    """One drone's decisions. Write `mission`; what it returns is this drone's part of the result.

    `bind` is called by the runtime before `mission`; so `__init__` is free for the mission's own parameters.
    """

    member: Member

    def bind(self, member: Member) -> None:
        """Meet the drone."""
        self.member = member

    @abstractmethod
    async def mission(self) -> dict[str, Any]:
        """The whole mission, from the ground to the ground."""

    async def asked(self, verb: str, arguments: dict[str, Any]) -> Any:
        """What an operator asks of this mission alone; returns the answer, or raises Refused."""
        raise Refused(f"drone {self.id}", f"this mission knows no command {verb!r}")

    @property
    def id(self) -> int:
        """This drone."""
        return self.member.id

    @property
    def graph(self) -> Graph:
        """Who talks to whom."""
        return self.member.communicator.graph.at(0)

    @property
    def state(self) -> State:
        """The newest estimate of this drone's own state."""
        state = self.member.pilot.state
        return State.at(self.member.config.drone(self.id).home) if state is None else state

    def log(self, *names: str, period: float = 0.1) -> Readings:
        """What this drone's sensors say, by the firmware's names: `self.log("pm.vbat", period=0.5)["pm.vbat"]`, V.

        A new value comes every `period` s, a multiple of 0.01 s up to 2.55 s, and `age(name)` says how old it is. None
        before the first, and when three are missing. The same call again returns the same readings.
        On the radio 26 bytes, as six floats, fit into one packet: ask for few, and seldom.
        Raises ConfigError for names that its platform does not have, with the nearest that it has.
        """
        if self.member.sensors is None:
            raise ConfigError(f"drone {self.id}: log", ", ".join(names), "nothing: this drone has no sensors")
        return self.member.sensors.log(names, period)

    # Talking --------------------------------------------------------------------------------------------------

    send = Verb(Communicator.send)
    receive = Verb(Communicator.receive)
    asynchronous_receive = Verb(Communicator.asynchronous_receive)
    neighbors_exchange = Verb(Communicator.neighbors_exchange)

    async def optimize(
        self, algorithm: Round, channel: str = "optimize", deadline: float | None = None, pace: Pace | None = None
    ) -> None:
        """Run a distributed algorithm to its end, together with the neighbours, and end the channel.

        deadline: s for each round, None for 60 s. All drones must be done in the same round: who is done earlier ends
        the channel, and who waits for it then gets ChannelEnded. One with `asynchronous = True` is woken at its `pace`,
        steps with the latest of each neighbour, and waits for nobody.
        Where it fails at one drone it ends at all, with the error there and AgentFailed elsewhere.
        Raises ConfigError if the graph is none for it.
        """
        communicator = self.member.communicator
        require_graph(algorithm, communicator.graph)
        await run_algorithm(communicator, algorithm, channel=channel, deadline=deadline, pace=pace)
        if not getattr(algorithm, "asynchronous", False):
            await communicator.close(channel)

    async def rendezvous(self, channel: str = "rendezvous") -> None:
        """Go on only when the whole team is here: as many empty rounds as the graph's diameter.

        In a run with an operator it waits for those whom he starts later, at most PATIENCE s.
        """
        deadline = PATIENCE if self.member.config.flight.operator else None
        for _ in range(max(1, self.graph.diameter())):
            await self.neighbors_exchange(None, channel=channel, deadline=deadline)

    # Flying ---------------------------------------------------------------------------------------------------

    async def take_off(self, height: float | None = None) -> None:
        """Rise to `height` m above the ground (None: that of the swarm file), inside the fence, and be there.

        In a run with an operator it waits, the first time, for his take-off, at most UNCOMMANDED s on the ground, and
        then in the air for his start, at most PATIENCE s.
        A drone that is held, or not seen yet, waits on the ground; a rise that the safety table or an operator has
        stopped goes on as in `go_to`, which is also how a drone in the air gets to the height.
        Raises Interrupted when it may not rise, and as `go_to`.
        """
        pilot = self.member.pilot
        if pilot.awaits_start:
            self.member.rise = height
            await self._told("take-off", UNCOMMANDED, lambda: not pilot.airborne)
            await self._told("start", PATIENCE, lambda: pilot.awaits_start and pilot.airborne)
        ends = self.member.clock.now() + PATIENCE
        while (pilot.state is None or pilot.held) and self.member.clock.now() < ends:
            await self.sleep(SETTLE)
        self._may_fly()
        if pilot.state is None:
            raise Interrupted(f"drone {self.id}: no pose within {PATIENCE:g} s")
        goal = pilot.above(height)
        await self._while(pilot.take_off(height), Mode.TAKEOFF)
        if pilot.gap(goal) > RISEN:
            await self.go_to(goal)
        await self._settle(goal)

    async def wait_for_start(self) -> None:
        """In a run with an operator, wait on the ground for his start, and for the team's; else go on at once.

        For missions that take off by themselves, each drone at its time or not at all: they call it before.
        """
        pilot = self.member.pilot
        if pilot.awaits_start:
            await self._told("start", UNCOMMANDED, lambda: pilot.awaits_start)
            await self.rendezvous("started")
            await self.member.communicator.close("started")

    async def _told(self, gate: str, seconds: float, waits: Callable[[], bool]) -> None:
        """Wait for a command of the operator, as long as `waits` says so; Interrupted after so many s without it."""
        member, pilot = self.member, self.member.pilot
        ends, report = member.clock.now() + seconds, member.report
        member.gate, member.report = gate, lambda: {"task": GATES[gate]}
        member.announce()
        while waits() and member.clock.now() < ends and not member.ended:
            await self.sleep(SETTLE)
        member.gate, member.report = "", report
        self._may_fly()
        if waits():
            raise Interrupted(f"drone {self.id}: no {gate} by its operator within {seconds:g} s")
        if pilot.mode is Mode.CUT:
            raise Interrupted(f"drone {self.id}: {pilot.mode.value}: {pilot.note}")

    async def _settle(self, goal: Vec) -> None:
        """Wait, at most PATIENT s, until it has stood still at goal: then it has learnt its thrust and its trim."""
        clock, pilot, stood = self.member.clock, self.member.pilot, 0
        ends = clock.now() + PATIENT
        while pilot.mode in FLYING and clock.now() < ends and stood * SETTLE < STOOD:
            state = self.state
            there = np.linalg.norm(state.p - goal) < THERE and np.linalg.norm(state.v) < STILL
            stood = stood + 1 if there else 0
            await self.sleep(SETTLE)

    async def go_to(self, p: Point, duration: float = 0.0, yaw: float | None = None) -> None:
        """Fly to p (3,) m, world, yaw rad (None: as it is), and be there; stopped by the safety table, it flies again.

        It waits, at most PATIENCE s, while an operator holds the drone or the safety table brakes it.
        Raises Interrupted when the pilot lands, and when p cannot be reached, as outside the fence.
        """
        attempts, ends = 0, self.member.clock.now() + PATIENCE
        while attempts < ATTEMPTS and self.member.clock.now() < ends:
            self._may_fly()
            seconds = self.member.pilot.go_to(p, yaw, duration)
            attempts += seconds > 0.0
            await self._while(seconds or SETTLE, Mode.TAKEOFF, Mode.FOLLOW)
            blown = self.member.clock.now() + BLOWN if seconds > 0.0 else 0.0
            while (gap := self.member.pilot.gap(p)) >= ARRIVED and self.member.clock.now() < blown:
                await self._while(SETTLE, Mode.TAKEOFF, Mode.FOLLOW)
            if gap < ARRIVED:
                return
        place = np.round(np.asarray(p), 2).tolist()
        why = "held by its operator" if self.member.pilot.held else self.member.pilot.note
        raise Interrupted(f"drone {self.id}: does not reach {place}, still {gap:.2f} m from it: {why or 'no reason'}")

    async def fly(self, trajectory: Trajectory) -> None:
        """Go to where a trajectory begins, fly it, and be at its end.

        trajectory: anything with `duration` s, `sample(t)` and `done(t)`, as planning/ makes them: `minimum_snap(...)`,
        `circle(...)`.
        Raises ConfigError, before it leaves, if the trajectory leaves the fence or is faster than [flight] allows;
        Interrupted when the flight is stopped on the way, as by a hold, or not ended where the trajectory ends.
        """
        if not all(hasattr(trajectory, name) for name in ("duration", "sample", "done")):
            do = "Make one of places: crazychoir.planning.minimum_snap.minimum_snap(places)."
            found = type(trajectory).__name__
            raise ConfigError(f"drone {self.id}: fly", found, "a trajectory: duration, sample(t), done(t)", do)
        self._require_feasible(trajectory)
        start, end = trajectory.sample(0.0), trajectory.sample(trajectory.duration)
        await self.go_to(start.p, yaw=start.yaw)
        pilot = self.member.pilot
        seconds = pilot.fly(trajectory)
        await self._while(seconds, Mode.FOLLOW)
        if seconds == 0.0 or pilot.gap(end.p) > ARRIVED:
            why = "held by its operator" if pilot.held else pilot.note
            raise Interrupted(f"drone {self.id}: its trajectory of {trajectory.duration:.1f} s was not flown: {why}")

    def _require_feasible(self, trajectory: Trajectory) -> None:
        pilot, flight = self.member.pilot, self.member.config.flight
        platform = pilot.controls.platform
        check(
            trajectory,
            Limits(
                v_max=flight.speed_limit, a_max=flight.acceleration_limit, mass=platform.mass,
                thrust_max=HEADROOM * platform.max_thrust, rate_max=platform.max_rate, low=pilot.fence.low,
                high=pilot.fence.high,
            ),
        )  # fmt: skip

    async def land(self) -> None:
        """Come down and stop the motors; a drone that its operator holds waits in the air, at most PATIENCE s.

        Raises Interrupted unless it ends on the ground, as when its motors were cut.
        """
        pilot = self.member.pilot
        ends = self.member.clock.now() + PATIENCE
        while pilot.held and pilot.mode in FLYING and self.member.clock.now() < ends:
            await self.sleep(SETTLE)
        pilot.land()
        await touch_down(pilot, TOUCHDOWN)
        if pilot.mode is not Mode.GROUND:
            raise Interrupted(f"drone {self.id}: {pilot.mode.value}: {pilot.note}")

    def follow(self, reference: Reference) -> None:
        """Fly this reference; renew it before it is stale."""
        self._may_fly()
        self.member.pilot.follow(reference)

    async def sleep(self, seconds: float) -> None:
        """Wait, in the swarm's time."""
        await self.member.clock.sleep(seconds, drone=self.id)

    def _may_fly(self) -> None:
        """A mission that is over does not fly."""
        if self.member.ended:
            raise Interrupted(f"drone {self.id}: its mission is over: {self.member.ended}")

    async def _while(self, seconds: float, *modes: Mode) -> None:
        """Wait for a flight of `seconds`, and while others hinder it.

        Raises Interrupted in other modes than these and hovering, as landing.
        """
        pilot, flying, clock = self.member.pilot, (*modes, Mode.HOVER), self.member.clock
        ends = clock.now() + seconds
        while pilot.mode in flying and (left := ends + pilot.flights.waited - clock.now()) > 0.0:
            await self.sleep(min(SETTLE, max(left, 1e-3)))
        if pilot.mode not in flying:
            raise Interrupted(f"drone {self.id}: {pilot.mode.value}: {pilot.note}")


async def touch_down(pilot: Pilot, grace: float) -> None:
    """Wait until a pilot's motors are off; at most `grace` s beyond the flight that it has planned, whenever it did."""
    clock = pilot.clock
    ends, patient = clock.now() + grace, clock.now() + PATIENCE
    while pilot.airborne and clock.now() < ends:
        if pilot.held and pilot.mode is Mode.HOVER:  # on its way home
            ends = clock.now() + grace
            if clock.now() > patient:
                pilot.land(f"held for {PATIENCE:g} s, with its mission over: landing")
        if pilot.remaining() > 0.0:
            ends = clock.now() + pilot.remaining() + grace
        await clock.sleep(SETTLE, drone=pilot.drone)


class Interrupted(CrazyChoirError):
    """The pilot does something else than what guidance asked: it lands, or its motors are cut."""


class CFDistributedFeedback(CFGuidance):
    """A feedback law on own and neighbours' states. Write `step`; it runs at `rate` Hz and never waits.

    `heard[j]` is the newest State of neighbour j, with its `age`; absent when beyond the topic's maximum age. If none
    has come since the last step it is moved on, p + v age, attitude as it was. Velocities, its own too, make up for
    those that were lost or flown for too long because a step was late, see VelocitySum: a law may sum them up.
    A new state of its own triggers it: what it wants is flown in the same tick.
    rate: Hz, at most that of the poses;  duration: s of the law, after everybody hovers;  gains: of the control that
    flies its Accelerations;  rest: s that it hovers before: what its control learns of thrust and trim while it hovers
    is all that it knows while it flies Accelerations;  paired: whether it hears neighbours as Paired does: place and
    velocity of the tick in which their acceleration was commanded, held with it while nothing comes.
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
            bus.subscribe(STATE, j, self.id, hearing, self.rate if self.rate < STATE.rate else 0.0)
        self._own, self._measured = self._sum(), 0.0
        self._unheard = dict.fromkeys(self._hearings, 0)
        self._steps = self._nothing = self._refused = 0
        self._amiss = ""
        self._law: asyncio.Future[None] | None = None
        self._period_ns = self._due_ns = 0
        self._me, self._stages = self.state, bus.stages
        bus.subscribe(STATE, self.id, self.id, Call(member.clock, self._moved, f"drone {self.id} state"))

    def _hearing(self, name: str) -> Hearing | Paired:
        if self.paired:
            return Paired(self.member.clock, name, 1.0 / self.member.config.mocap.rate)
        return Hearing(self.member.clock, name, self._sum())

    def _sum(self) -> VelocitySum:
        member = self.member
        return VelocitySum(member.pilot.filter.cutoff, 1.0 / member.config.mocap.rate, 1.0 / self.rate)

    async def mission(self) -> dict[str, Any]:
        """Take off, wait for the others, run the law, land.

        Returns law_s: s that the law ran;  references: how often `step` returned one that could be flown;  place:
        (3,) m, where it has ended;  unheard_s: {j: s of the law in which nothing fresh was heard of neighbour j}. It
        has failed if `step` returned references of which none could be flown.
        """
        await self.take_off(self.height())
        await self.sleep(self.rest)
        await self.rendezvous()
        self.member.report = lambda: {"task": LAW}
        self.member.announce()
        started = self.member.clock.now()
        await self.run_law()
        law_s, place = self.member.clock.now() - started, self.state.p.tolist()
        self.member.pilot.hover()
        self.member.report = lambda: {"task": "landing"}
        self.member.announce()
        await self.land()
        unheard = {j: steps / self.rate for j, steps in self._unheard.items() if steps}
        usable = self._steps - self._nothing - self._refused
        result = {"law_s": law_s, "references": usable, "place": place, "unheard_s": unheard}
        return result | ({"success": False, "reason": self._useless()} if self._refused and not usable else {})

    def _useless(self) -> str:
        """Why a law of which nothing could be flown has failed."""
        where = f"drone {self.id}: the law gave no usable reference in {self._refused} of {self._steps} steps"
        return f"{where}{' (None in the others)' if self._nothing else ''}: {self._amiss}"

    def height(self) -> float | None:
        """m, of the take-off; None for that of the swarm file."""
        return None

    async def run_law(self) -> None:
        """Let `step` run for `duration` s; raises what `step` raises, and Interrupted when the pilot stops obeying."""
        clock = self.member.clock
        self._period_ns = round(SECOND / self.rate)
        self._due_ns = clock.now_ns()
        self._own.forget()
        for hearing in self._hearings.values():
            hearing.forget()
        self._law = asyncio.get_running_loop().create_future()
        end = clock.call_at(self._due_ns + round(self.duration * SECOND), wake, self._law, drone=self.id)
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
        pilot, late_ns = self.member.pilot, self.member.clock.now_ns() - self._due_ns
        if late_ns < -pilot.period_ns // 2 or pilot.mode is TAKEOFF:
            return
        self._due_ns += max(1, late_ns // self._period_ns + 1) * self._period_ns
        try:
            if pilot.mode not in LAW_MODES:
                raise Interrupted(f"drone {self.id}: {pilot.mode.value}: {pilot.note}{self._deaf()}")
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
        watchdog, measured = self.member.watchdog, self.member.pilot.filter.measured
        poses = round((measured - self._measured) / self._own.h)  # a whole number: clocks jitter, cameras do not
        self._measured = measured
        heard = self.hear(poses)
        if poses == 1 and self._own.even:
            self._own.last = me
        else:
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
        self._refused, self._amiss = self._refused + 1, self.member.pilot.unflown(reference) or amiss(reference)
        if self._refused == 1:
            log.warning("drone %d: %s: not flown", self.id, self._amiss)

    def _deaf(self) -> str:
        """Whom it does not hear: the usual reason of a law that says nothing."""
        silent = ", ".join(str(j) for j, box in self._hearings.items() if box.fresh() is None)
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
            numbers, size = [reference.a, reference.yaw], 3
        case FullState():
            numbers, size = [reference.flat], 14
        case Velocity():
            numbers, size = [reference.v, reference.yaw], 3
        case Goto():
            numbers, size = [reference.p, reference.yaw, reference.duration], 3
        case _:
            of = f" {reference.shape}" if isinstance(reference, np.ndarray) else ""
            found = f"{type(reference).__name__}{of}"
            kinds = "Acceleration(...), Velocity(...), FullState(...), Goto(...) or None"
            return f"step() must return {kinds}; found {found}"
    kind, found = type(reference).__name__, " ".join(f"{numbers}"[1:-1].split())
    return f"step() must return finite numbers, {kind} of ({size},); found {kind}({found:.80})"


def idle(results: Mapping[int, Mapping[str, Any]]) -> bool:
    """Whether all drones flew laws that returned None in every step: nobody moved."""
    return bool(results) and all(r.get("success") and r.get("references") == 0 for r in results.values())


def raisable(error: BaseException, where: str) -> BaseException:
    """An error that a task may end with: what asyncio and generators take for signals of their own becomes ordinary."""
    if isinstance(error, Exception | SystemExit) and not isinstance(error, StopIteration):
        return error
    ordinary = RuntimeError(f"{where} raised {error!r}")
    ordinary.__cause__ = error
    return ordinary.with_traceback(error.__traceback__)
