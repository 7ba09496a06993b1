"""One process of a swarm: its drones, each a small set of actors, wired; and its world."""

import asyncio
import hashlib
import logging
import socket
import struct
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.bus.commands import CommandServer
from crazychoir.bus.local import OBSERVER, Bus, Port
from crazychoir.bus.presence import Presence
from crazychoir.bus.topics import LOG, RESULT, STATUS
from crazychoir.errors import CrazyChoirError, Hung, Refused
from crazychoir.guidance.base import CFGuidance, Member, raisable, touch_down
from crazychoir.guidance.mission import Mission
from crazychoir.mocap.simulated import SimulatedMocap
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock, wake
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.runtime.watchdog import Stall, Watchdog
from crazychoir.safety.guard import Fence
from crazychoir.safety.pilot import Mode, Pilot
from crazychoir.simulation.integrator import CFIntegrator
from crazychoir.simulation.owner import EulerRatesLink, SimulatedLink, WorldOwner
from crazychoir.swarm.communicator import Communicator
from crazychoir.swarm.config import SwarmConfig
from crazychoir.swarm.impairment import impairment_of
from crazychoir.swarm.roster import Barrier
from crazychoir.types import Status

log = logging.getLogger(__name__)
VERSION = version("crazychoir")
LANDING_DEADLINE = 30.0
"""s, beyond the planned time of the descent, after which a drone that is still up has its motors cut."""
LAST_WORDS = 1.0
"""s after its drone is down that a mission which was ended has for its last messages, before it is cancelled again."""
FAREWELL = 1.5
"""s that a drone whose mission is over stays: others may lack its last messages, or the next roster from it."""
_HEAD = struct.Struct("<iiiq")
STOPPED = "emergency stop in force: it does not take off until `crazychoir stop --clear`"


class Trace:
    """Digest of a run in virtual time: every trajectory and every message between drones."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)
        self._parts: list[bytes] = []

    def message(self, destination: int, topic: int, source: int, number: int, payload: bytes) -> None:
        """One message as it arrives; observers are no part of the run."""
        if destination < OBSERVER:
            self._parts += (_HEAD.pack(destination, topic, source, number), payload)

    def update(self, part: bytes) -> None:
        """One step of the world; all that was heard since the last one goes into the hash in one call."""
        self._parts.append(part)
        self._take()

    def digest(self) -> str:
        """Hex digits."""
        self._take()
        return self._hash.hexdigest()

    def _take(self) -> None:
        self._hash.update(b"".join(self._parts))
        self._parts.clear()


def mission_hash(config: SwarmConfig, mission: Mission) -> str:
    """What all hosts must have in common: the swarm file, and the text of the mission."""
    text = Path(getattr(mission, "__file__", None) or "")
    code = text.read_bytes() if text.is_file() else b""
    return hashlib.blake2b(config.digest().encode() + code, digest_size=8).hexdigest()


@dataclass
class Drone:
    """The parts of one drone."""

    id: int
    port: Port
    barrier: Barrier
    communicator: Communicator
    pilot: Pilot
    guidance: CFGuidance
    supervisor: Supervisor
    result: dict[str, Any] = field(default_factory=dict)

    def status(self) -> Status:
        """What others see of it."""
        counters, monitor = self.port.counters, self.barrier.monitor
        news = self.guidance.member.report() if hasattr(self.guidance, "member") else {}
        cost = news.get("cost")
        return Status(
            phase=self.pilot.mode.value,
            task=str(news.get("task", "waiting for the others" if self.barrier.roster is None else "")),
            round=int(news.get("round", self.communicator.rounds)),
            cost=float("nan") if cost is None else float(cost),
            sent=counters.sent,
            lost=counters.lost,
            resent=counters.resent,
            dropped=counters.malformed + self.communicator.ahead,
            suspect=monitor.those(Presence.SUSPECT),
            gone=monitor.those(Presence.LOST),
            process=self.port.bus.process,
            host=self.port.bus.host,
            note=self.pilot.note,
        )


class GuidanceActor(Actor):
    """Waits for the team, runs the mission, and leaves the drone on the ground."""

    name = "guidance"

    def __init__(self, drone: Drone, config: SwarmConfig, watchdog: Watchdog | None) -> None:
        self.drone, self.config, self.watchdog = drone, config, watchdog
        self._life: asyncio.Task[dict[str, Any]] | None = None
        self._ended: asyncio.Future[None] | None = None
        self._member: Member | None = None
        self._aborted = ""

    async def run(self) -> None:
        """GO, mission, result; whatever ends the mission is a result, and the drone ends on the ground."""
        drone = self.drone
        self._ended = asyncio.get_running_loop().create_future()
        self._life = asyncio.create_task(self._mission(), name=f"drone {drone.id} guidance")
        try:
            ends: list[asyncio.Future[Any]] = [self._life, self._ended]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            if not self._life.done():
                await self._end(self._life)
            drone.result = self._outcome(self._life)
        except asyncio.CancelledError:
            drone.result = {"success": False, "reason": "the mission was cancelled"}
            drone.pilot.land("the mission was cancelled")
            raise
        finally:
            self._life.cancel()
            self._forbid("the mission has ended")
            await self._down()
            drone.result = self._judged(drone.result)
            drone.port.publish(RESULT, drone.result)
        await drone.port.bus.clock.sleep(FAREWELL, drone=drone.id)
        await self._until_cleared()

    async def _end(self, life: asyncio.Task[dict[str, Any]]) -> None:
        """An aborted mission may say its last words while its drone lands; then it is cancelled until it obeys."""
        clock, i = self.drone.port.bus.clock, self.drone.id
        await self._down()
        patient = clock.now() + LAST_WORDS
        while not life.done() and clock.now() < patient + LAST_WORDS:
            if clock.now() >= patient:
                life.cancel()
            await clock.sleep(0.05, drone=i)
        if not life.done():
            log.error("drone %d: its mission does not end when it is cancelled; left behind", i)

    def _outcome(self, life: asyncio.Task[dict[str, Any]]) -> dict[str, Any]:
        """What the mission has come to; an aborted one has failed, whatever it says."""
        pilot = self.drone.pilot
        error = life.exception() if life.done() and not life.cancelled() else None
        if self._aborted:
            return {"success": False, "reason": self._aborted}
        if error is None:
            pilot.land("the mission has ended in the air")
            return {"success": True, **life.result()}
        if isinstance(error, CrazyChoirError) and not isinstance(error, Hung):  # somebody lost, a refusal
            log.warning("drone %d: %s", self.drone.id, error)
            pilot.land(str(error))
            return {"success": False, "reason": str(error)}
        return {"success": False, "reason": self._broken(error)}

    def _judged(self, result: dict[str, Any]) -> dict[str, Any]:
        """The result, now that the drone is down: a success only if nobody had to bring it down."""
        pilot = self.drone.pilot
        reason = self._aborted or (pilot.note if pilot.mode is Mode.CUT else pilot.guard.latched)
        if not reason or not result.get("success"):
            return result
        return {**result, "success": False, "reason": f"drone {self.drone.id}: {reason}"}

    def _broken(self, error: BaseException) -> str:
        """The mission's own code has failed: the pilot hovers, then lands; the observers hear why."""
        at = traceback.extract_tb(error.__traceback__)[-1]
        cause = f"{type(error).__name__}: {error} ({at.filename}:{at.lineno} {at.name})"
        text = f"drone {self.drone.id}: guidance failed: {cause}"
        log.error("%s", text, exc_info=error)
        self.drone.port.publish(LOG, text)
        self.drone.pilot.guidance_failed(cause)
        return text

    def abort(self, reason: str) -> None:
        """End the mission where it is, for good."""
        self._aborted = self._aborted or reason
        self._forbid(reason)
        if self._life is not None:
            self._life.cancel()
        if self._ended is not None:
            wake(self._ended)

    def _forbid(self, reason: str) -> None:
        """Nothing that the mission leaves behind flies the drone again."""
        if self._member is not None:
            self._member.ended = self._member.ended or reason

    async def _mission(self) -> dict[str, Any]:
        drone = self.drone
        await self._until_cleared()
        await drone.barrier.go()
        if drone.port.bus.stopped:
            raise Refused(f"drone {drone.id}", STOPPED)
        member = Member(drone.id, self.config, drone.port.bus.clock, drone.communicator, drone.pilot, self.watchdog)
        member.announce = lambda: drone.port.publish(STATUS, drone.status())
        self._member = member
        drone.guidance.bind(member)
        try:
            result: object = await drone.guidance.mission()
        except SystemExit as end:
            raise RuntimeError(f"the mission called sys.exit({end.code!r})") from end
        except asyncio.CancelledError as cancelled:
            if self._life is not None and self._life.cancelling():
                raise
            raise raisable(cancelled, "the mission") from cancelled
        if result is not None and not isinstance(result, dict):
            raise TypeError(f"mission() returned a {type(result).__name__}; allowed: a dictionary, or nothing")
        return result or {}

    async def _down(self) -> None:
        """Wait until it is on the ground; a mission that was aborted has a pilot that lands already."""
        pilot = self.drone.pilot
        await touch_down(pilot, LANDING_DEADLINE)
        if pilot.airborne:
            pilot.cut("does not come down")

    async def _until_cleared(self) -> None:
        """An emergency stop outlives its mission: who starts, or restarts, hears of it from those who stay."""
        bus = self.drone.port.bus
        if bus.stopped and not self._aborted:
            log.warning("drone %d: %s", self.drone.id, STOPPED)
        while bus.stopped and not self._aborted:
            await bus.clock.sleep(0.1, drone=self.drone.id)


class StatusActor(Actor):
    """Tells how the drone is, four times a second."""

    name = "status"

    def __init__(self, drone: Drone) -> None:
        self.drone = drone

    async def run(self) -> None:
        """Publish on change of the clock."""
        async for _ in self.drone.port.bus.clock.ticks(STATUS.rate, drone=self.drone.id):
            self.drone.port.publish(STATUS, self.drone.status())


class Pacemaker(Actor):
    """Ticks the pilots whose poses do not come."""

    name = "pacemaker"

    def __init__(self, clock: Clock, pilots: list[Pilot], rate: float) -> None:
        self.clock, self.pilots, self.rate = clock, pilots, rate

    async def run(self) -> None:
        """One look a period."""
        async for _ in self.clock.ticks(self.rate):
            now_ns = self.clock.now_ns()
            for pilot in self.pilots:
                pilot.nudge(now_ns)


class Agent:
    """The drones `ids` of a swarm, in this process.

    link: opens the network (None: everything is here);  trace: digest of virtual time.
    """

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        mission: Mission,
        ids: tuple[int, ...],
        *,
        process: str = "local",
        incarnation: int = 1,
        trace: Trace | None = None,
        start_deadline: float | None = None,
    ) -> None:
        self.clock, self.config, self.mission, self.ids, self.trace = clock, config, mission, ids, trace
        host = config.drone(ids[0]).host or socket.gethostname().split(".")[0]
        self.bus = Bus(clock, impairment_of(config), process, host)
        self.bus.tap = trace.message if trace else None
        self.incarnation = incarnation
        self.watchdog: Watchdog | None = None
        self.alarm: Callable[[int, str], None] = lambda drone, text: None
        for i in ids:
            self.bus.port(i, incarnation)
        self.world = self._world()
        self.owner = self._owner()
        self._graph = config.graph()
        self._start_deadline = config.start_deadline if start_deadline is None else start_deadline
        self._digest = mission_hash(config, mission)
        self.drones: dict[int, Drone] = {i: self._drone(i) for i in ids}
        pilots = [drone.pilot for drone in self.drones.values()]
        self.pacemaker = Pacemaker(clock, pilots, config.mocap.rate)
        self.supervisor = Supervisor(clock, f"process {process}", self._shared_failed)
        self.services: list[Actor] = []
        self._guidances: dict[int, GuidanceActor] = {}

    def _world(self) -> CFIntegrator:
        config = self.config
        homes = np.array([config.drone(i).home for i in self.ids], dtype=float)
        yaws = np.array([config.drone(i).yaw for i in self.ids])
        plant = config.plant
        return CFIntegrator(
            self.ids, homes, yaws, rate_lag=plant.rate_lag, command_delay=plant.command_delay,
            inputs=plant.inputs,
        )  # fmt: skip

    def _drone(self, i: int) -> Drone:
        config, port = self.config, self.bus.ports[i]
        barrier = Barrier(
            port, self._graph, mission_hash=self._digest, version=VERSION, seed=config.seed, start=config.start,
            start_deadline=self._start_deadline, lost_after=config.lost_after,
        )  # fmt: skip
        communicator = Communicator(port, self._graph)
        communicator.follow(barrier)
        fence = Fence.box(config.fence.min, config.fence.max)
        pilot = Pilot(port, self._link(i), config.flight, fence, config.mocap.rate)
        supervisor = self._supervisor(i)
        drone = Drone(i, port, barrier, communicator, pilot, self.mission.guidance(i, config), supervisor)
        CommandServer(port, partial(self._execute, drone), partial(self._stop, drone))
        return drone

    def _supervisor(self, i: int) -> Supervisor:
        return Supervisor(self.clock, f"drone {i}", lambda actor, error, again: self._failed(i, actor, error, again))

    def _link(self, i: int) -> SimulatedLink:
        return (EulerRatesLink if self.config.plant.inputs == "euler" else SimulatedLink)(self.world, i)

    async def run(self) -> dict[int, dict[str, Any]]:
        """Fly the mission; returns each drone's result."""
        async with asyncio.TaskGroup() as group:
            owner = group.create_task(self.supervisor.run(self._shared()), name="world")
            drones = list(self.drones.values())
            others = [group.create_task(d.supervisor.run(self._flying(d)), name=f"drone {d.id}") for d in drones]
            guided = [group.create_task(self._guide(d), name=f"drone {d.id} life") for d in drones]
            await asyncio.wait(guided)
            for drone in drones:
                drone.supervisor.stop()
            await asyncio.wait(others)
            self.supervisor.stop()
            await owner
        return {i: drone.result for i, drone in self.drones.items()}

    def _owner(self) -> WorldOwner:
        """Whoever steps the world and looks at it."""
        mocap = self.config.mocap
        cameras = SimulatedMocap(
            self.ids, self.config.seed, noise_p=mocap.noise, noise_angle=mocap.noise_angle, dropout=mocap.dropout,
            latency_steps=round(mocap.latency * mocap.rate), dt=1.0 / mocap.rate,
        )  # fmt: skip
        return WorldOwner(self.bus, self.world, cameras, mocap.rate, self.trace)

    def _shared(self) -> list[Actor]:
        return [*self.services, self.owner, self.pacemaker]

    def _flying(self, drone: Drone) -> list[Actor]:
        return [drone.barrier.monitor, drone.pilot, StatusActor(drone)]

    async def _guide(self, drone: Drone) -> None:
        """The guidance has a supervisor of its own: it ends, and the drone flies on until it is down."""
        supervisor = self._supervisor(drone.id)
        actor = self._guidances[drone.id] = GuidanceActor(drone, self.config, self.watchdog)
        await supervisor.run([actor])

    def land_all(self, reason: str) -> None:
        """Somebody wants an end: every drone lands, every mission is over."""
        for drone in self.drones.values():
            drone.pilot.land(reason)
        for guidance in self._guidances.values():
            guidance.abort(reason)

    def cut_all(self, reason: str) -> None:
        """Stop all motors now."""
        for drone in self.drones.values():
            drone.pilot.cut(reason)

    def refuse(self, refused: Refused) -> None:
        """The swarm does not want this process: it ends, with the reason."""
        log.error("%s", refused)
        self.land_all(str(refused))

    def stalled(self, stall: Stall) -> None:
        """From the watchdog's thread: tell the others whose loop hangs, and where."""
        words = stall.actor.split()
        drone = int(words[1]) if len(words) > 1 and words[0] == "drone" and words[1].isdigit() else self.ids[0]
        self.alarm(drone, str(stall))

    def _shared_failed(self, actor: Actor, error: Exception, again: bool) -> None:
        """Without the world or the pacemaker nobody flies on: the drones land, or are cut by who still ticks them."""
        if actor is self.owner or actor is self.pacemaker:
            self.land_all(f"{actor.name} failed: {type(error).__name__}: {error}")

    def _failed(self, i: int, actor: Actor, error: Exception, again: bool) -> None:
        drone = self.drones[i]
        text = f"drone {i}: {actor.name} failed: {type(error).__name__}: {error}"
        drone.port.publish(LOG, text)
        if actor.name == "guidance":
            drone.result = {"success": False, "reason": text}
            drone.port.publish(RESULT, drone.result)
            drone.pilot.guidance_failed(f"{type(error).__name__}: {error}")
        elif actor.name == "pilot" and not again:
            drone.pilot.cut(text)

    async def _execute(self, drone: Drone, verb: str, arguments: dict[str, Any]) -> Any:
        """What operators may ask of a drone."""
        match verb:
            case "land":
                drone.pilot.land("landing on command")
                self._guidances[drone.id].abort("landed on command")
            case "hold" | "go":
                drone.pilot.hold(verb == "hold")
            case "impair":
                self.bus.impairment.update(arguments)
                return self.bus.impairment.describe()
            case "ping":
                return drone.pilot.mode.value
            case _:
                raise Refused(f"drone {drone.id}", f"no command {verb!r}; there are land, hold, go, impair, ping")
        return None

    def _stop(self, drone: Drone, on: bool) -> None:
        if on:
            drone.pilot.cut("emergency stop")
