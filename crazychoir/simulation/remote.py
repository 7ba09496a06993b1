"""A drone and its body in two processes: the link at the drone's end, and what obeys it at the other."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol

import numpy as np

from crazychoir.bus.codec import encode
from crazychoir.bus.commands import DONE, Commander, CommandServer
from crazychoir.bus.port import BODIES, Port
from crazychoir.bus.topics import BODY, COMMAND, CUT
from crazychoir.config.tables import Flight
from crazychoir.errors import CodecError, Refused
from crazychoir.numerics.math3d import yaw_of
from crazychoir.planning.point_to_point import PEAK_SPEED
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import SECOND, Clock
from crazychoir.runtime.mailbox import Call, Latest
from crazychoir.simulation.common.world import KINDS, Link
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
SIZES: dict[type[Any], int] = {
    FPQR: 4,
    FRPY: 4,
    Vel: 4,
    XYZ: 5,
    FullState: 14,
    Acc: 3,
    Drive: 2,
}
"""Numbers in a command of each kind."""
THRUST = ("fpqr", "frpy")
"""Kinds of commands that carry a drone."""
GONE = 3.0
"""s of silence after which a world's owner does not come back: all its drones have stopped their motors by then, or
are landed by their firmware."""
HANDS_OVER = 0.4
"""s without a command after which a drone that is streamed commands is told to land by itself, if its firmware can:
before that would level it out (0.5 s), and let it fall (2 s)."""
LANDS = 1.0
"""The same of one that is sent places, seldom, and would fly on for good."""
STOOD_STILL = 1.0
"""s between two looks at who is silent, of four a second, beyond which the silence may be our own."""
ARMS = 3.0
"""s for an answer of who was asked to arm a drone."""
ASKS = 30.0
"""s for which a drone asks for log variables until its world's owner answers."""
PATIENT = 5.0
"""s after which a drone that waits for its world says so."""
OFF = "its motors were cut: they stay off until its world is started again"
_NOTHING = encode(None)


class RemoteLink:
    """The way to a drone whose body is in the process of an owner, of the world or of its dongle.

    The newest command counts, and each tick of the pilot brings one, so none is resent. From a cut on the cut itself is
    what goes out with each tick, so that a lost message delays it by a tick. An owner that falls silent may land the
    drone meanwhile: no command leaves until it is heard again.

    gone: s of silence after which the owner does not come back.
    """

    def __init__(
        self,
        port: Port,
        owner: str = "its world's owner (crazychoir-world)",
        gone: float = GONE,
    ) -> None:
        self.port = port
        self.owner = owner
        self.gone = gone
        self._body = BODIES + port.address
        self._cut = self._heard = False
        self._commander, self._asking = Commander(port), list[asyncio.Task[None]]()
        self.found_flying: Callable[[], None] = lambda: None
        """Called if the body is in the air when it is heard first, or again after a silence: an agent before us flew
        it, or its firmware is landing it."""
        self.found_cut: Callable[[str], None] = lambda why: None
        """Called, with the words, if its motors are found to be off for good, as an agent before us has cut them."""
        self._condition: Latest[Body] = Latest(
            port.bus.clock, f"drone {port.address} body", BODY.max_age
        )
        port.bus.subscribe(BODY, self._body, port.address, self._condition)
        port.bus.subscribe(
            BODY, self._body, port.address, Call(port.bus.clock, self._begin, "body")
        )

    def _begin(self, body: Body, age: float) -> None:
        """Somebody says how it is: from now on commands leave."""
        if not self._heard:
            self._heard = True
            if body.cut:
                self.found_cut(OFF)
            elif body.flying:
                self.found_flying()

    def send(self, command: Command) -> None:
        """On its way; not before it is known whether the body flies already: the first command stops its motors."""
        if self._cut:
            self.cut()
        elif self._heard and not self.unheard():
            self.port.send(COMMAND, (self._body,), encode(command))
        else:
            self._heard = False

    def unheard(self) -> bool:
        """Whether nobody says how the body is: commands may not arrive either."""
        return self.silence > BODY.max_age

    def flying(self) -> bool:
        """Whether the body is in the air, as far as is known."""
        body = self._condition.peek()
        return body is not None and body.flying and self.silence < self.gone

    def ask(self, names: tuple[str, ...], period: float) -> None:
        """Let the body say these log variables; what it does not have is said in the log."""
        asking = asyncio.get_running_loop().create_task(self._ask(names, period))
        self._asking.append(asking)

    async def _ask(self, names: tuple[str, ...], period: float) -> None:
        try:
            answer = await self._commander.request(
                self._body, "log", ASKS, names=list(names), period=period
            )
        except TimeoutError:
            log.error(
                "drone %d: log: no answer of %s within %g s",
                self.port.address,
                self.owner,
                ASKS,
            )
            return
        if answer.kind != DONE:
            log.error("%s", answer.detail)

    async def arm(self) -> str:
        """Let motors turn that wait for it; raises Refused with what its owner says."""
        try:
            answer = await self._commander.request(self._body, "arm", ARMS)
        except TimeoutError:
            raise Refused(
                f"drone {self.port.address}",
                f"no answer of {self.owner} within {ARMS:g} s",
            ) from None
        if answer.kind != DONE:
            raise Refused(f"drone {self.port.address}", str(answer.detail))
        return str(answer.detail)

    def cut(self) -> None:
        """Stop the motors for good."""
        self._cut = True
        self.port.send(CUT, (self._body,), _NOTHING)

    @property
    def silence(self) -> float:
        """s since the world's owner has said how the body is; infinite before the first time."""
        return self._condition.age()

    def problems(self) -> list[str]:
        """Why its drone may not take off, as far as is known."""
        body = self._condition.peek()
        return [OFF] if body is not None and body.cut else []

    def harm(self) -> str:
        """What has broken the body, or that nobody says how it is."""
        body = self._condition.fresh()
        if body is not None:
            return body.harm
        if not math.isfinite(self.silence):
            return f"{self.owner} has not said how it is"
        return f"{self.owner} is silent for {self.silence:.1f} s"


class OwnerWatch(Actor):
    """Says of which drones the world's owner has gone; it waits for one that has not come yet.

    gone: called with each of them, once.
    """

    name = "owner watch"

    def __init__(
        self, clock: Clock, links: Mapping[int, RemoteLink], gone: Callable[[int], None]
    ) -> None:
        self.clock = clock
        self.links = dict(links)
        self.gone = gone

    async def run(self) -> None:
        """As often as a body says how it is; who stood still himself, as while he was stopped, hears first."""
        patient_until = self.clock.now() + PATIENT
        before = self.clock.now()
        async for _ in self.clock.ticks(BODY.rate):
            stood_still = self.clock.now() - before > STOOD_STILL
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


class Place(Protocol):
    """What is asked about the body of a drone: of a simulated world, or of a radio."""

    flies: tuple[str, ...]
    command_timeout: float | None

    def resting(self, i: int) -> bool:
        """Does drone i stand on the floor?"""
        ...

    def state(self, i: int) -> State:
        """Where it is."""
        ...


class RemoteBody:
    """The other end: the body of one drone obeys what comes at its port from that drone, and nobody else.

    But an emergency stop counts from any operator, whether the drone's agent is there or not.

    link: of the world, for commands of this kind;  obeyed: called after each command that was;  flight: how one that is
    left alone lands;  ask: lets the world's owner publish these log variables, every so many s;  arm: lets its
    motors turn.
    """

    def __init__(
        self,
        port: Port,
        world: Place,
        link: Link,
        kind: str,
        obeyed: Callable[[], None] = lambda: None,
        flight: Flight | None = None,
        ask: Callable[[list[str], float], None] | None = None,
        arm: Callable[[], Awaitable[str]] | None = None,
    ) -> None:
        self.port = port
        self.world = world
        self.link = link
        self.kind = kind
        self.obeyed = obeyed
        self._ask = ask
        self._arm = arm
        self.flight = Flight() if flight is None else flight
        self.drone = port.address - BODIES
        self.refused = 0
        self._clock = port.bus.clock
        self._commanded_ns: int | None = None
        self.was_cut = False
        """Whether its motors were cut: they stay off until its world is started again."""
        self._idle = False
        port.handlers[COMMAND.number] = self._commanded
        port.handlers[CUT.number] = self._cut
        CommandServer(port, self._execute, self._stop)

    @property
    def silence(self) -> float:
        """s since the last command; infinite before the first."""
        return (
            math.inf
            if self._commanded_ns is None
            else (self._clock.now_ns() - self._commanded_ns) / SECOND
        )

    @property
    def flying(self) -> bool:
        """Whether commands have brought it into the air."""
        return (
            self._commanded_ns is not None
            and not self.was_cut
            and not self.world.resting(self.drone)
        )

    def look(self) -> None:
        """Nobody flies it any more, as its agent is gone or hangs: its planner on board lands it, if it has one.

        One that has none gets no thrust, as soon as its world says so; without that it is left to its engine.
        """
        on_board = "xyz" in self.world.flies
        limit = (
            self.world.command_timeout
            if not on_board
            else LANDS
            if self.kind == "xyz"
            else HANDS_OVER
        )
        if limit is None or self._idle or not limit < self.silence < math.inf:
            return
        self._idle, rests = True, self.world.resting(self.drone)
        if not self.was_cut:
            self.link.send(self._down(rests) if on_board else self._nothing())
        if not rests:
            does = (
                "landing"
                if on_board
                else "no thrust"
                if self.kind in THRUST
                else "stands still"
            )
            log.warning(
                "drone %d: no command for %.2f s, limit %.2f s: %s",
                self.drone,
                self.silence,
                limit,
                does,
            )

    def abandon(self) -> None:
        """It flies, and nobody has commanded it since its owner was started: it is landed."""
        log.warning("drone %d: flies, and nobody commands it: landing", self.drone)
        self.link.send(self._down(False))

    def stop(self, reason: str) -> None:
        """Motors off for good, whoever commands it."""
        if not self.was_cut:
            log.error("drone %d: %s: motors cut", self.drone, reason)
            self._stop(True)

    def _nothing(self) -> Command:
        """Neither thrust nor speed."""
        kinds = KINDS[self.kind]
        stop: Command = (
            XYZ("stop", np.zeros(5))
            if XYZ in kinds
            else kinds[0](np.zeros(SIZES[kinds[0]]))
        )
        return stop

    def _down(self, rests: bool) -> XYZ:
        """To the ground by the planner on board, whose heading stays; one that rests stops its motors."""
        state = self.world.state(self.drone)
        flight = self.flight
        seconds = max(
            1.0, PEAK_SPEED * (float(state.p[2]) - flight.ground) / flight.landing_speed
        )
        return XYZ(
            "stop" if rests else "land",
            np.array([0.0, 0.0, flight.ground, yaw_of(state.q), seconds]),
        )

    def _commanded(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        try:
            command = self.port.bus.open(COMMAND.number, payload)
        except CodecError:
            self.port.counters.malformed += 1
            return
        if source != self.drone or not _whole(command):
            self.port.counters.malformed += 1
        elif not isinstance(command, KINDS[self.kind]) and not self._lands_by_itself(
            command
        ):
            sent = type(command).__name__
            self._refuse(
                f"drone {self.drone}: its agent sends {sent}, the swarm file says {self.kind}"
            )
        elif self.was_cut:
            self._refuse(f"drone {self.drone}: {OFF}")
        else:
            self._commanded_ns = self._clock.now_ns()
            self._idle = False
            self.link.send(command)
            self.obeyed()

    def _lands_by_itself(self, command: Any) -> bool:
        """Whatever it is sent, its firmware can land it."""
        return (
            isinstance(command, XYZ)
            and command.verb == "land"
            and "xyz" in self.world.flies
        )

    def _refuse(self, reason: str) -> None:
        """Say so, once."""
        self.refused += 1
        if self.refused == 1:
            log.error("%s", reason)

    def _cut(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        if source == self.drone:
            self._commanded_ns = self._clock.now_ns()
            self._stop(True)

    def _stop(self, on: bool) -> None:
        """Motors off for good: where the stop is cleared, they stay off until the world is started again."""
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
        raise Refused(
            f"body of drone {self.drone}",
            f"{verb!r} is its agent's; only an emergency stop counts here",
        )


def _whole(command: Any) -> bool:
    """Whether it has its kind's numbers, all of them finite: their sum is."""
    flat = command.flat
    fits = flat.shape == (SIZES[type(command)],) and flat.dtype == np.float64
    return fits and math.isfinite(sum(flat.tolist()))
