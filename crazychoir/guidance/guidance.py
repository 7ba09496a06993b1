"""What a mission is written in: CFGuidance, a coroutine with the paper's verbs."""

import logging
import sys
from abc import abstractmethod
from collections.abc import Callable
from types import MethodType
from typing import (
    Any,
    Concatenate,
    Generic,
    ParamSpec,
    SupportsFloat,
    TypeVar,
    overload,
)

import numpy as np

from crazychoir.control.position import HEADROOM
from crazychoir.errors import ConfigError, Refused
from crazychoir.flight.goals import require_path, require_trajectory
from crazychoir.flight.pilot import OBEYS_NOTHING, Pilot
from crazychoir.guidance.awaited_call import (
    as_coroutine_function,
    awaited,
    called_from,
    watch_coroutines,
)
from crazychoir.guidance.member import (
    PATIENCE,
    SETTLE,
    Interrupted,
    Member,
    standing,
    touch_down,
)
from crazychoir.guidance.sensors import Readings
from crazychoir.guidance.turns import CLOSE, TURN, aside, blocked, first_at
from crazychoir.guidance.user_hook import shown
from crazychoir.optimization.rounds.checks import require_graph
from crazychoir.planning.feasibility import Limits, check_references, references
from crazychoir.planning.scaling import GETS_UP, Resumed
from crazychoir.planning.trajectory import Trajectory
from crazychoir.safety.rules.modes import HELD, Mode
from crazychoir.team.algorithm_run import Pace, run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph
from crazychoir.team.round import Round
from crazychoir.types import Point, Reference, State, Vec

log = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")
FLYING = (Mode.TAKEOFF, Mode.HOVER, Mode.FOLLOW)
UNFIT = 5.0
"""s that a drone gets to mend what keeps it on the ground, as a pose that does not come for a moment."""
ARRIVED = 0.2
"""m from a goal that counts as there."""
RISEN = 0.04
"""m from its height, above where it stood, beyond which a drone has not flown its take-off to the end."""
THERE, STILL, STOOD = 0.003, 0.02, 0.3
"""m, m/s, s: so near, slow and long a drone that has risen stands, and knows its thrust to some thousandths."""
PATIENT = 5.0
"""s that it gets for that."""
ATTEMPTS, TICK = 5, 1e-3
BLOWN = 2.0
"""s after the planned time of a flight in which a drone may still arrive: in a wind that it has yet to learn."""
TOUCHDOWN = 5.0
"""s beyond the planned time of a landing that a mission waits for its end."""
UNCOMMANDED = 1800.0
"""s that a drone waits on the ground for an operator, in a run that has one."""
GATES = {
    "take-off": "waits for its operator: take-off",
    "start": "waits for its operator: start",
}


WATCHED_BY_RUNTIME = frozenset({"mission", "asked"})
"""Coroutine functions that the runtime itself awaits."""


class Verb(Generic[P, R]):
    """A method of the communicator as a method of CFGuidance: the same arguments, defaults and documentation."""

    def __init__(self, verb: Callable[Concatenate[Communicator, P], R]) -> None:
        self.verb = verb

    @overload
    def __get__(
        self, guidance: None, owner: type
    ) -> Callable[Concatenate[Communicator, P], R]: ...
    @overload
    def __get__(self, guidance: "CFGuidance", owner: type) -> Callable[P, R]: ...
    def __get__(self, guidance: "CFGuidance | None", owner: type) -> Callable[..., R]:
        if guidance is None:
            return self.verb
        return MethodType(_talk, (guidance, self.verb))


@as_coroutine_function
def _talk(
    verb: "tuple[CFGuidance, Callable[..., Any]]", *args: Any, **kwargs: Any
) -> Any:
    """Call a verb of the communicator of a guidance, which is known until it is awaited."""
    caller = sys._getframe(1)
    guidance, function = verb
    communicator = guidance.member.communicator
    return called_from(
        caller.f_code.co_filename,
        caller.f_lineno,
        guidance,
        function,
        communicator,
        *args,
        **kwargs,
    )


class CFGuidance:
    """One drone's decisions. Write `mission`; what it returns is this drone's part of the result.

    `bind` is called by the runtime before `mission`; so `__init__` is free for the mission's own parameters.
    """

    member: Member

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Know the calls of a user's own coroutine functions until they are awaited."""
        super().__init_subclass__(**kwargs)
        watch_coroutines(cls, WATCHED_BY_RUNTIME)

    def bind(self, member: Member) -> None:
        """Meet the drone."""
        self.member = member

    @abstractmethod
    async def mission(self) -> dict[str, Any]:
        """The whole mission, from the ground to the ground."""

    async def asked(self, verb: str, arguments: dict[str, Any]) -> Any:
        """What an operator asks of this mission alone; returns the answer, or raises Refused."""
        raise Refused(f"drone {self.id}", f"this mission knows no command {verb!r}")

    def route(self) -> list[Vec]:
        """The places that it flies to one after the other, (3,) m, world, as far as they are planned: for a picture."""
        return []

    def led(self, path: Trajectory) -> str:
        """An operator wants it to fly this path, as part of its mission; returns what it does, or raises Refused."""
        raise Refused(f"drone {self.id}", "its mission flies it: hold it first")

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
        return (
            State.at(self.member.config.drone(self.id).home) if state is None else state
        )

    def log(self, *names: str, period: float = 0.1) -> Readings:
        """What this drone's sensors say, by the firmware's names: `self.log("pm.vbat", period=0.5)["pm.vbat"]`, V.

        A new value comes every `period` s, a multiple of 0.01 s up to 2.55 s, and `age(name)` says how old it is. None
        before the first, and when three are missing. The same call again returns the same readings.
        On the radio 26 bytes, as six floats, fit into one packet: ask for few, and seldom.
        Raises ConfigError for names that its platform does not have, with the nearest that it has.
        """
        if self.member.sensors is None:
            raise ConfigError(
                f"drone {self.id}: log",
                ", ".join(names),
                "nothing: this drone has no sensors",
            )
        return self.member.sensors.log(names, period)

    # Talking --------------------------------------------------------------------------------------------------

    send = Verb(Communicator.send)
    receive = Verb(Communicator.receive)
    asynchronous_receive = Verb(Communicator.asynchronous_receive)
    neighbors_exchange = Verb(Communicator.neighbors_exchange)

    @awaited
    async def optimize(
        self,
        algorithm: Round,
        channel: str = "optimize",
        deadline: float | None = None,
        pace: Pace | None = None,
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
        await run_algorithm(
            communicator, algorithm, channel=channel, deadline=deadline, pace=pace
        )
        if not getattr(algorithm, "asynchronous", False):
            await communicator.close(channel)

    @awaited
    async def rendezvous(self, channel: str = "rendezvous") -> None:
        """Go on only when the whole team is here: as many empty rounds as the graph's diameter.

        In a run with an operator it waits for those whom he starts later, at most PATIENCE s.
        """
        deadline = PATIENCE if self.member.config.flight.operator else None
        for _ in range(max(1, self.graph.diameter())):
            await self.neighbors_exchange(None, channel=channel, deadline=deadline)

    # Flying ---------------------------------------------------------------------------------------------------

    @awaited
    async def take_off(self, height: float | None = None) -> None:
        """Rise to `height` m above the ground (None: that of the swarm file), inside the fence, and be there.

        In a run with an operator it waits, the first time, for his take-off, at most UNCOMMANDED s on the ground, and
        then in the air for his start, at most PATIENCE s. It stays 0.1 m off the fence.
        A drone that is held, or not seen yet, waits on the ground; a rise that the safety table or an operator has
        stopped goes on as in `go_to`, which is also how a drone in the air gets to the height.
        Raises ConfigError for a height beyond the fence, Interrupted when it may not rise, and as `go_to`.
        """
        self.require_height(height, "take_off()")
        pilot = self.member.pilot
        if pilot.awaits_start:
            self.member.rise = height
            await self._told("take-off", UNCOMMANDED, lambda: not pilot.airborne)
            await self._told(
                "start", PATIENCE, lambda: pilot.awaits_start and pilot.airborne
            )
        ends = self.member.clock.now() + PATIENCE
        while (pilot.state is None or pilot.held) and self.member.clock.now() < ends:
            await self.sleep(SETTLE)
        ends = self.member.clock.now() + UNFIT
        while pilot.unfit() and self.member.clock.now() < ends:
            await self.sleep(SETTLE)
        self._may_fly()
        if pilot.state is None:
            raise Interrupted(f"drone {self.id}: no pose within {PATIENCE:g} s")
        goal = pilot.above(height)
        await self._while(pilot.take_off(height), Mode.TAKEOFF)
        if pilot.gap(goal) > RISEN:
            await self._fly_to_place(goal)
        await self._settle(goal)
        if why := pilot.misjudged():
            pilot.land(why)
            raise Interrupted(f"drone {self.id}: {why}")

    def require_height(self, height: object, where: str) -> None:
        """Raise ConfigError for a take-off to `height` m above the ground (None: the swarm file's) beyond the fence."""
        pilot = self.member.pilot
        top = pilot.fence.high[2] - pilot.limits.ground
        if height is None or not pilot.controls.takes_off:
            return
        rise = _number(height)
        if rise is None or not 0.0 <= rise <= top:
            found = shown(height)
            do = "It must be one number, as float(...)."
            if rise is not None:
                found = f"{rise!r}"
                do = "Lower it, or raise fence.max."
            raise ConfigError(
                f"drone {self.id}: {where}",
                found,
                f"0 to {top:g} m above the ground, by the fence",
                do,
            )

    def foresee(self, member: Member) -> None:
        """Look ahead, before anybody flies: compile what takes long; raise ConfigError for what cannot be flown."""

    @awaited
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
        member = self.member
        pilot = self.member.pilot
        ends = member.clock.now() + seconds
        report = member.report

        def lands() -> str:
            return (
                f", or lands in {max(0.0, ends - member.clock.now()):.0f} s"
                if pilot.airborne
                else ""
            )

        member.gate, member.report = gate, lambda: {"task": GATES[gate] + lands()}
        member.announce()
        while waits() and member.clock.now() < ends and not member.ended:
            if pilot.commanded and pilot.remaining() > 0.0:
                ends = member.clock.now() + seconds  # its operator is at work
            await self.sleep(SETTLE)
        member.gate = ""
        member.report = report
        self._may_fly()
        if waits():
            raise Interrupted(
                f"drone {self.id}: no {gate} by its operator within {seconds:g} s"
            )
        if pilot.mode is Mode.CUT:
            raise Interrupted(f"drone {self.id}: {standing(pilot)}")

    async def _settle(self, goal: Vec) -> None:
        """Wait, at most PATIENT s, until it has stood still at goal: then it has learnt its thrust and its trim."""
        clock = self.member.clock
        pilot = self.member.pilot
        stood = 0
        ends = clock.now() + PATIENT
        while pilot.mode in FLYING and clock.now() < ends and stood * SETTLE < STOOD:
            state = self.state
            there = (
                np.linalg.norm(state.p - goal) < THERE
                and np.linalg.norm(state.v) < STILL
            )
            stood = stood + 1 if there else 0
            await self.sleep(SETTLE)

    @awaited
    async def go_to(
        self, p: Point, duration: float = 0.0, yaw: float | None = None
    ) -> None:
        """Fly to p (3,) m, world, yaw rad (None: as it is), and be there; stopped by the safety table, it flies again.

        It waits, at most PATIENCE s, while an operator holds the drone or the safety table brakes it, and where it
        gives way to others, as to one who stands at p. A place above its home is flown to as near as the guard allows.
        Raises ConfigError, before it moves, for what is no place, and for a place outside the fence, at its edge, or on
        the floor; Interrupted when the pilot lands, and when p cannot be reached.
        """
        place = self.member.pilot.require_goal(
            f"drone {self.id}: go_to()", p, yaw, duration
        )
        await self._fly_to_place(place, duration, yaw)

    async def _fly_to_place(
        self, p: Vec, duration: float = 0.0, yaw: float | None = None
    ) -> None:
        """Fly to p (3,) m, which may be flown to, and be there."""
        attempts = 0
        hindered = 0
        pilot = self.member.pilot
        clock = self.member.clock
        ends = clock.now() + PATIENCE
        while attempts < ATTEMPTS and clock.now() < ends:
            self._may_fly()
            began = clock.now()
            seconds = pilot.go_to(p, yaw, duration)
            await self._while(seconds or SETTLE, Mode.TAKEOFF, Mode.FOLLOW)
            hindered = hindered + 1 if blocked(pilot) else 0
            blown = clock.now() + BLOWN if seconds > 0.0 and not hindered else 0.0
            while pilot.gap(p) >= ARRIVED and clock.now() < blown:
                await self._while(SETTLE, Mode.TAKEOFF, Mode.FOLLOW)
            if pilot.gap(p) < (CLOSE if hindered else ARRIVED):
                return
            attempts += seconds > 0.0 and pilot.clearance.gave_way < began
            if hindered > 2 and first_at(pilot, p) < self.id:
                await self._wait_aside(p)
        place = np.round(p, 2).tolist()
        why = HELD if pilot.held else pilot.note or "no reason"
        if pilot.is_replayed:
            why = OBEYS_NOTHING
        raise Interrupted(
            f"drone {self.id}: does not reach {place}, still {pilot.gap(p):.2f} m from it: {why}"
        )

    async def _wait_aside(self, p: Vec) -> None:
        """Leave a place to another one whose turn it is, at most TURN s."""
        pilot = self.member.pilot
        clock = self.member.clock
        ends = clock.now() + TURN
        await self._while(pilot.go_to(aside(self.state.p, p, pilot.fence)), Mode.FOLLOW)
        while first_at(pilot, p) < self.id and clock.now() < ends:
            await self._while(SETTLE, Mode.FOLLOW)

    @awaited
    async def fly(self, trajectory: Trajectory) -> None:
        """Go to where a trajectory begins, fly it, and be at its end.

        trajectory: anything with `duration` s, `sample(t)` and `done(t)`, as planning/ makes them: `minimum_snap(...)`,
        `circle(...)`.
        Braked by the safety table, as while the cameras do not see it, it goes on from where it was stopped.
        Raises ConfigError, before it leaves, if the trajectory leaves the fence or is faster than [flight] allows;
        Interrupted when the flight is stopped on the way, as by a hold, or not ended where the trajectory ends.
        """
        require_trajectory(f"drone {self.id}: fly()", trajectory)
        require_feasible(trajectory, self.member.pilot)
        pilot = self.member.pilot
        clock = self.member.clock
        left = trajectory
        attempts = 0
        end = trajectory.sample(trajectory.duration)
        ends = clock.now() + trajectory.duration + PATIENCE
        while attempts < ATTEMPTS and clock.now() < ends:
            start = left.sample(0.0)
            braked = pilot.braked
            await self.go_to(start.p, yaw=start.yaw)
            t = await self._flown(left)
            if pilot.flights.plan is left and pilot.gap(end.p) <= ARRIVED:
                return
            if pilot.braked == braked and not pilot.guard.acts:
                break
            if 0.0 < t < left.duration:
                flight = self.member.config.flight
                attempts += 1
                left = Resumed(
                    left,
                    t,
                    max(GETS_UP, 4.0 * flight.speed_limit / flight.acceleration_limit),
                )
            await self.sleep(SETTLE)
        why = HELD if pilot.held else standing(pilot)
        raise Interrupted(
            f"drone {self.id}: its trajectory of {trajectory.duration:.1f} s was not flown: {why}"
        )

    async def _flown(self, trajectory: Trajectory) -> float:
        """Begin it, and wait until it ends, or is stopped: s of it that were flown then."""
        pilot = self.member.pilot
        clock = self.member.clock
        t = 0.0
        left = pilot.fly(trajectory)
        while pilot.flights.plan is trajectory and left > 0.0:
            t = clock.now() - pilot.flights.start
            await self._while(min(SETTLE, max(left, TICK)), Mode.FOLLOW)
            left = pilot.remaining()
        return t

    @awaited
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
            raise Interrupted(f"drone {self.id}: {standing(pilot)}")

    def follow(self, reference: Reference) -> None:
        """Fly this reference; renew it before it is stale. One that cannot be flown is none, and the log says why."""
        self._may_fly()
        pilot = self.member.pilot
        if pilot.follow(reference) is False:
            caller = sys._getframe(1)
            place = f"{caller.f_code.co_filename}:{caller.f_lineno}"
            said: set[str] = self.__dict__.setdefault(
                "_said_at", set()
            )  # places whose reference was not flown
            if place not in said:
                said.add(place)
                log.warning("drone %d: %s: follow(): %s", self.id, place, pilot.note)

    @awaited
    async def sleep(self, seconds: float) -> None:
        """Wait, in the swarm's time."""
        await self.member.clock.sleep(seconds, drone=self.id)

    def _may_fly(self) -> None:
        """A mission that is over does not fly."""
        if self.member.ended:
            raise Interrupted(
                f"drone {self.id}: its mission is over: {self.member.ended}"
            )

    async def _while(self, seconds: float, *modes: Mode) -> None:
        """Wait for a flight of `seconds`, and while others hinder it.

        Raises Interrupted in other modes than these and hovering, as landing.
        """
        pilot = self.member.pilot
        flying = (*modes, Mode.HOVER)
        clock = self.member.clock
        ends = clock.now() + seconds - pilot.flights.waited
        while (
            pilot.mode in flying
            and (left := ends + pilot.flights.waited - clock.now()) > 0.0
        ):
            await self.sleep(min(SETTLE, max(left, 1e-3)))
        if pilot.mode not in flying:
            raise Interrupted(f"drone {self.id}: {standing(pilot)}")


def require_feasible(trajectory: Trajectory, pilot: Pilot) -> None:
    """Raise ConfigError for a trajectory that leaves the guard's room, or that the drone or [flight] forbids."""
    flight = pilot.limits
    platform = pilot.controls.platform
    t, path = references(trajectory)
    limits = Limits(
        v_max=flight.speed_limit,
        a_max=flight.acceleration_limit,
        mass=platform.mass,
        thrust_max=HEADROOM * platform.max_thrust,
        rate_max=platform.max_rate,
    )
    require_path("trajectory", t, path, pilot.guard, pilot.controls.planar)
    check_references(t, path, limits)


def _number(value: object) -> float | None:
    """The number that it is, None if it is none: an array is none, even of one."""
    try:
        return (
            float(value)
            if isinstance(value, SupportsFloat) and np.asarray(value).ndim == 0
            else None
        )
    except (TypeError, ValueError, OverflowError):
        return None
