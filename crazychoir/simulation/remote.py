"""Links between a drone and its body in two processes.

RemoteLink is the drone's end; RemoteBody obeys its commands at the other end.
"""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from crazychoir.bus.codec import encode
from crazychoir.bus.commands import ANSWER_TEXTS, Commander, CommandServer
from crazychoir.bus.message import Message
from crazychoir.bus.port import PORT_ADDRESSES, Port
from crazychoir.bus.topics import DRONE_TOPICS, MESSAGE_TOPICS
from crazychoir.config.tables import FlightTable
from crazychoir.errors import CodecError, Refused
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.point_to_point import PEAK_SPEED
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.runtime.mailbox import Call, Latest
from crazychoir.simulation.common.world import COMMAND_TYPES, DroneLink
from crazychoir.types import (
    FPQR,
    FRPY,
    XYZ,
    Acc,
    Body,
    Command,
    Drive,
    FullState,
    State,
    Vel,
)

log = logging.getLogger(__name__)
COMMAND_SIZES: dict[type[Any], int] = {
    FPQR: 4,
    FRPY: 4,
    Vel: 4,
    XYZ: 5,
    FullState: 14,
    Acc: 3,
    Drive: 2,
}
"""Count of numbers in a command of each kind."""
THRUST_KINDS = ("fpqr", "frpy")
"""Kinds of commands with a thrust: without them the drone falls."""


@dataclass(frozen=True, slots=True)
class RemoteTimeouts:
    """Times in seconds after which the two ends of a remote link stop waiting."""

    owner_gone: float = 3.0
    """Seconds of silence after which a world's owner counts as gone for good.

    By then all its drones have stopped their motors or are landed by their firmware.
    """
    streamed_landing: float = 0.4
    """Seconds without a command before a drone with streamed commands is told to land.

    This applies if its firmware can land it. Without this command the firmware would level the drone
    after 0.5 s and let it fall after 2 s.
    """
    goal_landing: float = 1.0
    """Seconds without a command before a drone with "xyz" commands is told to land.

    Such a drone gets a goal seldom, and would hover forever after its last goal.
    """
    process_hang: float = 1.0
    """Seconds between two checks of the silent owners beyond which this process itself may have hung.

    The checks run four times a second.
    """
    arming_answer: float = 3.0
    """Seconds to wait for the answer to an arming request."""
    log_answer: float = 30.0
    """Seconds to wait for the owner's answer to a request for log variables."""
    waiting_warning: float = 5.0
    """Seconds after which a drone that waits for its world logs a warning."""


REMOTE_TIMEOUTS = RemoteTimeouts()


MOTORS_CUT_TEXT = "its motors were cut: they stay off until its world is started again"
_EMPTY_PAYLOAD = encode(None)


class RemoteLink:
    """The link from a pilot to its drone, if another process owns that drone (its "body").

    The owner of bodies is the process of a simulated world or of a radio dongle. Lost commands are
    not resent, because each tick of the pilot sends a newer one. After the motors were cut, each
    tick sends the cut instead. While the owner is silent it may land the drone, so no command is
    sent until it is heard again.

    port: the port of the drone
    owner: name of the owner, for messages
    gone: s of silence after which the owner counts as gone for good
    """

    def __init__(
        self,
        port: Port,
        owner: str = "its world's owner (crazychoir-world)",
        gone: float = REMOTE_TIMEOUTS.owner_gone,
    ) -> None:
        self.port = port
        self.owner = owner
        self.gone = gone
        self._body = PORT_ADDRESSES.body_offset + port.address
        self._cut = self._heard = False
        self._sent = 0
        """Commands sent: the number of the last one."""
        self._commander, self._asking = Commander(port), list[asyncio.Task[None]]()
        self.found_flying: Callable[[], None] = lambda: None
        """Called if the body is in the air at the first report, also the first after a silence.

        An earlier agent flew it, or its firmware is landing it.
        """
        self.found_cut: Callable[[str], None] = lambda why: None
        """Called with the reason if the motors are off for good because an earlier agent cut them.
        """
        self._condition: Latest[Body] = Latest(
            port.bus.clock, f"drone {port.address} body", DRONE_TOPICS.body.max_age
        )
        port.bus.subscribe(DRONE_TOPICS.body, self._body, port.address, self._condition)
        port.bus.subscribe(
            DRONE_TOPICS.body,
            self._body,
            port.address,
            Call(port.bus.clock, self._begin, "body"),
        )

    def _begin(self, body: Body, age: float) -> None:
        """Start to send commands: the first report of the body has arrived."""
        if not self._heard:
            self._heard = True
            if body.cut:
                self.found_cut(MOTORS_CUT_TEXT)
            elif body.flying:
                self.found_flying()

    def send(self, command: Command) -> None:
        """Send the command, unless the body is silent.

        No command is sent before the first report says whether the body flies, because the first
        command stops its motors. After a cut, the cut is sent instead.
        """
        if self._cut:
            self.cut()
        elif self._heard and not self.unheard():
            self._sent += 1
            message = Message(
                DRONE_TOPICS.command, self.port.address, encode(command), self._sent
            )
            self.port.send(message, (self._body,))
        else:
            self._heard = False

    def unheard(self) -> bool:
        """Return True if no recent report of the body has arrived; commands may be lost as well."""
        return self.silence > DRONE_TOPICS.body.max_age

    def flying(self) -> bool:
        """Return True if the body is in the air according to its last report."""
        body = self._condition.peek()
        return body is not None and body.flying and self.silence < self.gone

    def ask(self, names: tuple[str, ...], period: float) -> None:
        """Ask the body to publish these log variables; a refusal is logged as an error."""
        asking = asyncio.get_running_loop().create_task(self._ask(names, period))
        self._asking.append(asking)

    async def _ask(self, names: tuple[str, ...], period: float) -> None:
        try:
            answer = await self._commander.request(
                self._body,
                "log",
                REMOTE_TIMEOUTS.log_answer,
                names=list(names),
                period=period,
            )
        except TimeoutError:
            log.error(
                "drone %d: log: no answer of %s within %g s",
                self.port.address,
                self.owner,
                REMOTE_TIMEOUTS.log_answer,
            )
            return
        if answer.kind != ANSWER_TEXTS.done:
            log.error("%s", answer.detail)

    async def arm(self) -> str:
        """Arm motors that need it, and return the owner's answer.

        Raises Refused with the reason if the owner refuses or does not answer.
        """
        return str(await self.request("arm", REMOTE_TIMEOUTS.arming_answer))

    async def request(self, verb: str, seconds: float, **arguments: Any) -> Any:
        """Let the owner do something with the body, and return its answer.

        seconds: s: deadline for the answer
        Raises Refused with the reason if the owner refuses or does not answer.
        """
        where = f"drone {self.port.address}"
        try:
            answer = await self._commander.request(
                self._body, verb, seconds, **arguments
            )
        except TimeoutError:
            raise Refused(
                where, f"no answer of {self.owner} within {seconds:g} s"
            ) from None
        if answer.kind != ANSWER_TEXTS.done:
            raise Refused(where, str(answer.detail))
        return answer.detail

    def cut(self) -> None:
        """Stop the motors for good."""
        self._cut = True
        message = Message(MESSAGE_TOPICS.cut, self.port.address, _EMPTY_PAYLOAD)
        self.port.send(message, (self._body,))

    @property
    def silence(self) -> float:
        """Seconds since the owner's last report of the body; infinite before the first."""
        return self._condition.age()

    def problems(self) -> list[str]:
        """Return the reasons why the drone may not take off, according to the last report."""
        body = self._condition.peek()
        return [MOTORS_CUT_TEXT] if body is not None and body.cut else []

    def harm(self) -> str:
        """Return what broke the body, or a text that the owner is silent."""
        body = self._condition.fresh()
        if body is not None:
            return body.harm
        if not math.isfinite(self.silence):
            return f"{self.owner} has not said how it is"
        return f"{self.owner} is silent for {self.silence:.1f} s"


class OwnerWatch(Actor):
    """Detects that the owner of a drone has gone; it waits for an owner that has not come yet.

    clock: the clock of the process
    links: the links of the drones by id
    gone: called once with each drone after its owner has gone
    """

    name = "owner watch"

    def __init__(
        self, clock: Clock, links: Mapping[int, RemoteLink], gone: Callable[[int], None]
    ) -> None:
        self.clock = clock
        self.links = dict(links)
        self.gone = gone

    async def run(self) -> None:
        """Check the silence of all owners at the rate of their reports.

        If this process itself hung, for example because it was suspended, one check is skipped so
        that waiting reports are read first.
        """
        patient_until = self.clock.now() + REMOTE_TIMEOUTS.waiting_warning
        before = self.clock.now()
        async for _ in self.clock.ticks(DRONE_TOPICS.body.rate):
            stood_still = self.clock.now() - before > REMOTE_TIMEOUTS.process_hang
            before = self.clock.now()
            if stood_still:
                continue
            waiting = [i for i, link in self.links.items() if link.silence == math.inf]
            if waiting and self.clock.now() > patient_until:
                patient_until = math.inf
                for i in waiting:
                    log.warning("drone %d: waiting for %s", i, self.links[i].owner)
            for i in [
                i
                for i, link in self.links.items()
                if link.gone < link.silence < math.inf
            ]:
                del self.links[i]
                self.gone(i)


class BodyObserver(Protocol):
    """Questions about the body of a drone, answered by a simulated world or by a radio."""

    flies: tuple[str, ...]
    """Kinds of commands that its drones obey, keys of COMMAND_TYPES."""
    command_timeout: float | None
    """Seconds without a command before a flying drone gets no thrust; None: no such limit."""

    def resting(self, i: int) -> bool:
        """Return True if drone i stands on the floor."""
        ...

    def state(self, i: int) -> State:
        """Return the state of drone i."""
        ...


@dataclass(frozen=True, slots=True)
class BodyRequests:
    """Requests about a body beside its commands, each carried out by the owner of the body."""

    ask: Callable[[list[str], float], None] | None = None
    """Publishes these log variables, with this period in s; None if the owner cannot."""
    arm: Callable[[], Awaitable[str]] | None = None
    """Arms the motors and returns the answer; None if the owner cannot."""
    firmware: Mapping[str, Callable[[dict[str, Any]], Awaitable[Any]]] = field(
        default_factory=dict
    )
    """Requests for the firmware of the drone, by verb."""


NO_BODY_REQUESTS = BodyRequests()


class RemoteBody:
    """The other end of a RemoteLink: a body that obeys only the commands of its own agent.

    An emergency stop is accepted from any operator, even without an agent.

    port: the port of the body
    world: answers questions about the body
    link: the link of the world for commands of this kind
    kind: kind of command in the swarm file
    obeyed: called after each command that was passed on
    flight: height of the ground and landing speed for a drone without commands
    requests: what the owner of the body does on request
    """

    def __init__(
        self,
        port: Port,
        world: BodyObserver,
        link: DroneLink,
        kind: str,
        obeyed: Callable[[], None] = lambda: None,
        flight: FlightTable | None = None,
        requests: BodyRequests = NO_BODY_REQUESTS,
    ) -> None:
        self.port = port
        self.world = world
        self.link = link
        self.kind = kind
        self.obeyed = obeyed
        self._ask = requests.ask
        self._arm = requests.arm
        self._firmware = requests.firmware
        self.flight = FlightTable() if flight is None else flight
        self.drone = port.address - PORT_ADDRESSES.body_offset
        self.refused = 0
        self._clock = port.bus.clock
        self._commanded_ns: int | None = None
        self.was_cut = False
        """True if the motors were cut: they stay off until the world is started again."""
        self._idle = False
        port.handlers[DRONE_TOPICS.command.number] = self._commanded
        port.handlers[MESSAGE_TOPICS.cut.number] = self._cut
        CommandServer(port, self._execute, self._stop)

    @property
    def silence(self) -> float:
        """Seconds since the last command; infinite before the first."""
        return (
            math.inf
            if self._commanded_ns is None
            else (self._clock.now_ns() - self._commanded_ns) / NS_PER_SECOND
        )

    @property
    def flying(self) -> bool:
        """True if commands have brought the body into the air."""
        return (
            self._commanded_ns is not None
            and not self.was_cut
            and not self.world.resting(self.drone)
        )

    def look(self) -> None:
        """Bring the drone down if its agent is gone or hangs.

        With a planner on board the drone is told to land. Without a planner it gets the command
        for no thrust and no speed after the timeout of its world. If the world has no timeout
        either, its engine decides.
        """
        on_board = "xyz" in self.world.flies
        if not on_board:
            limit = self.world.command_timeout
        elif self.kind == "xyz":
            limit = REMOTE_TIMEOUTS.goal_landing
        else:
            limit = REMOTE_TIMEOUTS.streamed_landing
        if limit is None or self._idle or not limit < self.silence < math.inf:
            return
        self._idle, rests = True, self.world.resting(self.drone)
        if not self.was_cut:
            self.link.send(self._down(rests) if on_board else self._nothing())
        if not rests:
            if on_board:
                does = "landing"
            elif self.kind in THRUST_KINDS:
                does = "no thrust"
            else:
                does = "stands still"
            log.warning(
                "drone %d: no command for %.2f s, limit %.2f s: %s",
                self.drone,
                self.silence,
                limit,
                does,
            )

    def abandon(self) -> None:
        """Land a drone that flies without a command since its owner was started."""
        log.warning("drone %d: flies without a commander: landing", self.drone)
        self.link.send(self._down(False))

    def stop(self, reason: str) -> None:
        """Cut the motors for good, whichever agent commands the drone."""
        if not self.was_cut:
            log.error("drone %d: %s: motors cut", self.drone, reason)
            self._stop(True)

    def _nothing(self) -> Command:
        """Return the command for no thrust and no speed."""
        kinds = COMMAND_TYPES[self.kind]
        stop: Command = (
            XYZ("stop", np.zeros(5))
            if XYZ in kinds
            else kinds[0](np.zeros(COMMAND_SIZES[kinds[0]]))
        )
        return stop

    def _down(self, rests: bool) -> XYZ:
        """Return the command that lands the drone by its planner, or stops it if it is at rest.

        The heading stays as it is.
        """
        state = self.world.state(self.drone)
        flight = self.flight
        seconds = max(
            1.0, PEAK_SPEED * (float(state.p[2]) - flight.ground) / flight.landing_speed
        )
        return XYZ(
            "stop" if rests else "land",
            np.array([0.0, 0.0, flight.ground, yaw_of(state.q), seconds]),
        )

    def _commanded(self, message: Message, age: float) -> None:
        try:
            command = message.open()
        except CodecError:
            self.port.counters.malformed += 1
            return
        if message.source != self.drone or not _is_well_formed(command):
            self.port.counters.malformed += 1
        elif not isinstance(
            command, COMMAND_TYPES[self.kind]
        ) and not self._lands_by_itself(command):
            sent = type(command).__name__
            self._refuse(
                f"drone {self.drone}: its agent sends {sent}, the swarm file says {self.kind}"
            )
        elif self.was_cut:
            self._refuse(f"drone {self.drone}: {MOTORS_CUT_TEXT}")
        else:
            self._commanded_ns = self._clock.now_ns()
            self._idle = False
            self.link.send(command)
            self.obeyed()

    def _lands_by_itself(self, command: Any) -> bool:
        """Return True for a landing command to a drone with a planner on board.

        The planner can land the drone, whatever kind of command the swarm file names.
        """
        return (
            isinstance(command, XYZ)
            and command.verb == "land"
            and "xyz" in self.world.flies
        )

    def _refuse(self, reason: str) -> None:
        """Count a refused command and log the first one."""
        self.refused += 1
        if self.refused == 1:
            log.error("%s", reason)

    def _cut(self, message: Message, age: float) -> None:
        if message.source == self.drone:
            self._commanded_ns = self._clock.now_ns()
            self._stop(True)

    def _stop(self, on: bool) -> None:
        """Cut the motors for good if `on`; they stay off until the world is started again.

        Clearing the emergency stop does not start them.
        """
        if on:
            self.was_cut = True
            self.link.cut()

    async def _execute(self, verb: str, arguments: dict[str, Any]) -> Any:
        if verb == "log" and self._ask is not None:
            return self._ask(arguments["names"], arguments["period"])
        if verb == "arm" and self._arm is not None:
            if self.was_cut:
                raise Refused(f"body of drone {self.drone}", "its motors were cut")
            return await self._arm()
        if verb in self._firmware:
            return await self._firmware[verb](arguments)
        raise Refused(
            f"body of drone {self.drone}",
            f"{verb!r} is its agent's; only an emergency stop counts here",
        )


def _is_well_formed(command: Any) -> bool:
    """Return True if the command has the right count of numbers, all finite.

    The sum is finite exactly if all numbers are, and is fast to test.
    """
    flat = command.flat
    fits = flat.shape == (COMMAND_SIZES[type(command)],) and flat.dtype == np.float64
    return fits and math.isfinite(sum(flat.tolist()))
