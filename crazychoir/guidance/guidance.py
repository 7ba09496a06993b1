"""CFGuidance, the base class of missions: a coroutine with the verbs of the paper."""

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

from crazychoir.control.position import FLATNESS_LIMITS
from crazychoir.errors import ConfigError, Refused
from crazychoir.flight.goals import require_path, require_trajectory
from crazychoir.flight.pilot import Pilot
from crazychoir.guidance.awaited_call import (
    as_coroutine_function,
    find_call_from,
    remember_calls,
    watch_coroutines,
)
from crazychoir.guidance.flights import (
    FLIGHT_LIMITS,
    FLYING_MODES,
    SETTLING_LIMITS,
    fly_to_the_end,
    reach_place,
    require_running,
    wait_for_command,
    wait_until_ready,
    wait_until_settled,
    wait_while,
)
from crazychoir.guidance.member import (
    FLIGHT_LOOK_INTERVAL,
    HELD_FLIGHT_PATIENCE,
    Interrupted,
    Member,
    describe_state,
    get_state,
    wait_for_touchdown,
)
from crazychoir.guidance.sensors import SensorReadings
from crazychoir.guidance.user_hook import shorten_value_text
from crazychoir.optimization.rounds.checks import require_graph
from crazychoir.planning.feasibility import Limits, check_references, sample_references
from crazychoir.planning.trajectory import Trajectory
from crazychoir.safety.rules.modes import Mode
from crazychoir.team.algorithm_run import WakingTimes, run_algorithm
from crazychoir.team.communicator import Communicator
from crazychoir.team.graph import Graph
from crazychoir.team.round import Round
from crazychoir.types import Point, Reference, State, Vec

log = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")
COMMAND_TIMEOUT = 1800.0
"""s: how long a drone waits on the ground for an operator, in a run that has one."""
WATCHED_BY_RUNTIME = frozenset({"mission", "asked"})
"""Coroutine functions that the runtime itself awaits."""


class CommunicatorVerb(Generic[P, R]):
    """A method of the communicator, offered as a method of CFGuidance.

    Arguments, defaults and documentation stay those of the communicator.
    """

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
        return MethodType(_call_verb, (guidance, self.verb))


@as_coroutine_function
def _call_verb(
    verb: "tuple[CFGuidance, Callable[..., Any]]", *args: Any, **kwargs: Any
) -> Any:
    """Call a verb of the communicator for a guidance, and remember the call until it is awaited."""
    caller = sys._getframe(1)
    guidance, function = verb
    communicator = guidance.member.communicator
    return find_call_from(
        caller.f_code.co_filename,
        caller.f_lineno,
        guidance,
        function,
        communicator,
        *args,
        **kwargs,
    )


class CFGuidance:
    """The decisions of one drone. Write `mission`.

    The return value of `mission` is this drone's part of the result.

    The runtime calls `bind` before `mission`, so `__init__` is free for the parameters of the
    mission.
    """

    member: Member
    """The drone, its team and its communicator. Set by `bind`."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Remember the calls of a user's own coroutine functions until they are awaited."""
        super().__init_subclass__(**kwargs)
        watch_coroutines(cls, WATCHED_BY_RUNTIME)

    def bind(self, member: Member) -> None:
        """Connect this guidance to its drone."""
        self.member = member

    @abstractmethod
    async def mission(self) -> dict[str, Any]:
        """Fly the whole mission, from the ground to the ground, and return its result."""

    async def asked(self, verb: str, arguments: dict[str, Any]) -> Any:
        """Answer a command of an operator that only this mission knows.

        Raises Refused if the mission does not know the command, or will not obey it.
        """
        raise Refused(f"drone {self.id}", f"this mission has no command {verb!r}")

    def route(self) -> list[Vec]:
        """Return the places that the drone flies to, in their order, as far as they are planned.

        Each place is (3,) m, world. A picture shows them.
        """
        return []

    def led(self, path: Trajectory) -> str:
        """Fly a path of the operator as part of the mission.

        Returns what the drone does, in words.

        Raises Refused if the mission does not allow it.
        """
        raise Refused(
            f"drone {self.id}", "its mission controls it: hold the drone first"
        )

    @property
    def id(self) -> int:
        """The id of this drone."""
        return self.member.id

    @property
    def graph(self) -> Graph:
        """The communication graph of the team."""
        return self.member.communicator.graph.at(0)

    @property
    def state(self) -> State:
        """The newest estimate of this drone's own state.

        Before the first pose it is a level state at the home of the drone.
        """
        return get_state(self.member)

    def log(self, *names: str, period: float = 0.1) -> SensorReadings:
        """Return the readings of this drone's sensors, by the firmware's names.

        Example: `self.log("pm.vbat", period=0.5)["pm.vbat"]` is the battery voltage in V. A reading
        is None before the first value, and when three values in a row are missing. `age(name)` is
        the age of a value in s. Another call with the same arguments returns the same readings. On
        the radio one packet carries 26 bytes, such as six floats: ask for few values, and seldom.

        names: log variables of the firmware.
        period: s between two values, a multiple of 0.01 s up to 2.55 s.
        Raises ConfigError for names that the platform does not have; it suggests the nearest name.
        """
        if self.member.sensors is None:
            raise ConfigError(
                f"drone {self.id}: log",
                ", ".join(names),
                "nothing: this drone has no sensors",
            )
        return self.member.sensors.log(names, period)

    # Talking --------------------------------------------------------------------------

    send = CommunicatorVerb(Communicator.send)
    receive = CommunicatorVerb(Communicator.receive)
    asynchronous_receive = CommunicatorVerb(Communicator.asynchronous_receive)
    neighbors_exchange = CommunicatorVerb(Communicator.neighbors_exchange)

    @remember_calls
    async def optimize(
        self,
        algorithm: Round,
        channel: str = "optimize",
        deadline: float | None = None,
        pace: WakingTimes | None = None,
    ) -> None:
        """Run a distributed algorithm to its end, together with the neighbours; end the channel.

        All drones must be done in the same round. A drone that is done earlier ends the channel,
        and a drone that waits for it gets ChannelEnded. An algorithm with `asynchronous = True`
        wakes at its `pace`, steps with the latest message of each neighbour, and never waits for a
        neighbour. If the algorithm fails at one drone it ends at all drones: there with the error,
        elsewhere with AgentFailed.

        algorithm: the algorithm, with the problem of this drone.
        channel: name of the channel for its messages.
        deadline: s for each round, None for 60 s.
        pace: when an asynchronous algorithm wakes.
        Raises ConfigError if the algorithm does not work on the graph.
        """
        communicator = self.member.communicator
        require_graph(algorithm, communicator.graph)
        await run_algorithm(
            communicator, algorithm, channel=channel, deadline=deadline, pace=pace
        )
        if not getattr(algorithm, "asynchronous", False):
            await communicator.close(channel)

    @remember_calls
    async def rendezvous(self, channel: str = "rendezvous") -> None:
        """Wait until the whole team has come to this point.

        The drones exchange as many empty rounds as the diameter of the graph.
        In a run with an operator a drone waits up to HELD_FLIGHT_PATIENCE s for drones that are started later.
        """
        deadline = HELD_FLIGHT_PATIENCE if self.member.config.flight.operator else None
        for _ in range(max(1, self.graph.diameter())):
            await self.neighbors_exchange(None, channel=channel, deadline=deadline)

    # Flying ---------------------------------------------------------------------------

    @remember_calls
    async def take_off(self, height: float | None = None) -> None:
        """Take off to `height`, and return when the drone is there.

        The goal stays inside the fence, 0.1 m off its edge. In a run with an operator the first
        take-off waits for two commands: for the take-off, at most COMMAND_TIMEOUT s on the ground, and
        then for the start, at most HELD_FLIGHT_PATIENCE s in the air. A drone that is held or has no pose yet
        waits on the ground. If the safety table or an operator stops the rise, the drone continues
        as in `go_to`. A drone that is already in the air goes to the height in the same way.

        height: m above the ground, None for the take-off height of the swarm file.
        Raises ConfigError for a height beyond the fence, Interrupted if the drone may not rise, and
        all errors of `go_to`.
        """
        self.require_height(height, "take_off()")
        pilot = self.member.pilot
        if pilot.permission.awaits_start:
            await _wait_for_operator(self.member, height)
        await wait_until_ready(self.member)
        goal = pilot.follower.get_place_above(height)
        await wait_while(self.member, pilot.take_off(height), Mode.TAKEOFF)
        if pilot.gap(goal) > SETTLING_LIMITS.risen_distance:
            await reach_place(self.member, goal)
        await wait_until_settled(self.member, goal)
        if why := pilot.judge.ground_watch.explain_wrong_thrust():
            pilot.land(why)
            raise Interrupted(f"drone {self.id}: {why}")

    def require_height(self, height: object, where: str) -> None:
        """Raise ConfigError for a take-off to a height beyond the fence.

        height: m above the ground, None for the take-off height of the swarm file.
        where: the call, for the error.
        """
        pilot = self.member.pilot
        top = pilot.setup.fence.high[2] - pilot.setup.limits.ground
        if height is None or not pilot.setup.controls.takes_off:
            return
        rise = _convert_number(height)
        if rise is None or not 0.0 <= rise <= top:
            found = shorten_value_text(height)
            do = "It must be a single number, for example float(...)."
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
        """Prepare the mission before any drone flies: compile code that takes long to compile.

        Raises ConfigError for flights that are not possible.
        """

    @remember_calls
    async def wait_for_start(self) -> None:
        """Wait on the ground for the start command of the operator, and then for the team.

        In a run without an operator it returns at once. It is for missions in which each drone
        takes off at its own time, or not at all. Such a mission calls it first.
        """
        pilot = self.member.pilot
        if pilot.permission.awaits_start:
            await wait_for_command(
                self.member,
                "start",
                COMMAND_TIMEOUT,
                lambda: pilot.permission.awaits_start,
            )
            await self.rendezvous("started")
            await self.member.communicator.close("started")

    @remember_calls
    async def go_to(
        self, p: Point, duration: float = 0.0, yaw: float | None = None
    ) -> None:
        """Fly to a place, and return when the drone is there.

        It waits, at most HELD_FLIGHT_PATIENCE s, while an operator holds the drone or the safety
        table brakes it, and where it gives way to others, as to a drone that stands at p. A place
        above its home is flown to as near as the guard allows.
        Raises ConfigError, before the drone moves, if p is no place, or is outside the fence, at
        its edge, or on the floor. Raises Interrupted when the pilot lands, and when p cannot be
        reached.
        """
        place = self.member.pilot.follower.require_goal(
            f"drone {self.id}: go_to()", p, yaw, duration
        )
        await reach_place(self.member, place, duration, yaw)

    @remember_calls
    async def fly(self, trajectory: Trajectory) -> None:
        """Go to the start of a trajectory, fly it, and return when the drone is at its end.

        If the safety table brakes the drone, for example while the cameras do not see it, the
        flight continues from the place where it stopped.

        trajectory: any object with `duration` s, `sample(t)` and `done(t)`, such as
            `minimum_snap(...)` and `circle(...)` of planning/.
        Raises ConfigError, before the drone moves, if the trajectory leaves the fence or is faster
        than [flight] allows. Raises Interrupted if the flight is stopped on the way, such as by a
        hold, or does not end where the trajectory ends.
        """
        trajectory = require_trajectory(f"drone {self.id}: fly()", trajectory)
        require_feasible(trajectory, self.member.pilot)
        await fly_to_the_end(self.member, trajectory, self.go_to)

    @remember_calls
    async def land(self) -> None:
        """Come down and stop the motors.

        A drone that its operator holds waits in the air, at most HELD_FLIGHT_PATIENCE s.
        Raises Interrupted if it does not end on the ground, for example because its motors were
        cut.
        """
        pilot = self.member.pilot
        ends = self.member.clock.now() + HELD_FLIGHT_PATIENCE
        while (
            pilot.permission.held
            and pilot.mode in FLYING_MODES
            and self.member.clock.now() < ends
        ):
            await self.sleep(FLIGHT_LOOK_INTERVAL)
        pilot.land()
        await wait_for_touchdown(pilot, FLIGHT_LIMITS.touchdown_time)
        if pilot.mode is not Mode.GROUND:
            raise Interrupted(f"drone {self.id}: {describe_state(pilot)}")

    def follow(self, reference: Reference) -> None:
        """Fly this reference. Renew it before it is stale.

        A reference that cannot be flown is ignored. The log names the reason, once for each line of
        code.
        """
        require_running(self.member)
        pilot = self.member.pilot
        if pilot.follow(reference) is False:
            caller = sys._getframe(1)
            place = f"{caller.f_code.co_filename}:{caller.f_lineno}"
            said: set[str] = self.__dict__.setdefault(
                "_said_at", set()
            )  # lines of code with a reference that was not flown
            if place not in said:
                said.add(place)
                log.warning(
                    "drone %d: %s: follow(): %s", self.id, place, pilot.notes.text
                )

    @remember_calls
    async def sleep(self, seconds: float) -> None:
        """Wait for some seconds, in the time of the swarm."""
        await self.member.clock.sleep(seconds, drone=self.id)


async def _wait_for_operator(member: Member, height: float | None) -> None:
    """Wait for the commands of the operator to take off and to start.

    height: m above the ground, None for the take-off height of the swarm file.
    """
    pilot = member.pilot
    member.rise = height
    await wait_for_command(
        member, "take-off", COMMAND_TIMEOUT, lambda: not pilot.airborne
    )
    await wait_for_command(
        member,
        "start",
        HELD_FLIGHT_PATIENCE,
        lambda: pilot.permission.awaits_start and pilot.airborne,
    )


def require_feasible(trajectory: Trajectory, pilot: Pilot) -> None:
    """Raise ConfigError for a trajectory that leaves the room of the guard, or breaks a limit.

    The limits are those of the drone and of [flight].
    """
    flight = pilot.setup.limits
    platform = pilot.setup.controls.platform
    t, path = sample_references(trajectory)
    limits = Limits(
        v_max=flight.speed_limit,
        a_max=flight.acceleration_limit,
        mass=platform.mass,
        thrust_max=FLATNESS_LIMITS.acceleration_share * platform.max_thrust,
        rate_max=platform.max_rate,
    )
    require_path("trajectory", t, path, pilot.guard, pilot.setup.controls.planar)
    check_references(t, path, limits)


def _convert_number(value: object) -> float | None:
    """Return the value as a float, or None if it is not one number.

    An array is not a number, even with one element.
    """
    try:
        return (
            float(value)
            if isinstance(value, SupportsFloat) and np.asarray(value).ndim == 0
            else None
        )
    except (TypeError, ValueError, OverflowError):
        return None
