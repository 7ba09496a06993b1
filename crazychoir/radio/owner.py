"""The owner of one dongle, in a process of its own.

The agents of its drones run in other processes.
"""

import logging
import math
from dataclasses import dataclass
from typing import Any

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.checks import limit_area
from crazychoir.config.dongle_plan import capacity_of, is_inline
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.robots import find_sender
from crazychoir.errors import Refused, error_text
from crazychoir.radio.budget import plan_dongles
from crazychoir.radio.drone.firmware_access import FirmwareAccess
from crazychoir.radio.drone.pose_broadcast import PoseBroadcast
from crazychoir.radio.drone.radio_drone import RadioDrone, SharedRadio
from crazychoir.radio.drone.timing import LINK_CHECK_RATE, SILENCE_LIMITS
from crazychoir.radio.link.dongles import PROCESS_DONGLES
from crazychoir.radio.link.toc_cache import TableOfContents, tables_folder
from crazychoir.radio.link.writer import SendPacer
from crazychoir.radio.visibility import BodySights
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.safety.rules.guard import Fence
from crazychoir.simulation.remote import BodyRequests, RemoteBody

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class OwnerLimits:
    """How fast the owner of a dongle sends, and when it takes over or gives up a drone."""

    command_silence: float = 1.0
    """s: time without a command after which a drone counts as left by its agent."""
    capacity_share: float = 0.9
    """Share of a dongle's capacity at which packets are sent to it."""
    landing_time: float = 15.0
    """s: time in which flying drones may land after the owner was asked to end."""


OWNER_LIMITS = OwnerLimits()


class RadioProcess(Actor):
    """The owner of one dongle of a swarm: links to its drones, which pilots in other processes fly.

    A drone that its agent has left is landed by its firmware. The owner ends after it was asked to,
    once no drone flies.

    dongle: number of the dongle
    process: name of this process
    host: name of this host
    incarnation: number of this life of the process
    """

    name = "radios"

    def __init__(
        self,
        clock: Clock,
        config: SwarmConfig,
        dongle: int,
        process: str,
        host: str,
        incarnation: int,
    ) -> None:
        self.clock = clock
        self.config = config
        self.dongle = dongle
        self.bus = Bus(clock, process=process, host=host)
        self.ids = config.topology.dongles[dongle]
        self.plan = plan_dongles(config)[dongle]
        """What the dongle sends."""
        rate = self.plan.setpoint_rate
        self.broadcast = (
            PoseBroadcast(clock, config.radio.pose_rate)
            if self.plan.broadcasts
            else None
        )
        """Tells the poses of all drones; None: each drone is sent its own."""
        for i in self.ids:
            self.bus.port(PORT_ADDRESSES.body_offset + i, incarnation)
        shared = SharedRadio(
            TableOfContents(tables_folder()),
            self._turns().turn,
            BodySights(self.bus, config, PORT_ADDRESSES.body_offset + self.ids[0]),
            self.broadcast,
            self.plan.echo_rate,
        )
        self.drones = {
            i: RadioDrone(
                self.bus,
                config,
                i,
                find_sender(config, i),
                rate,
                shared,
            )
            for i in self.ids
        }
        self.bodies = {
            i: RemoteBody(
                self.bus.ports[PORT_ADDRESSES.body_offset + i],
                drone,
                drone.commands,
                drone.setup.kind,
                flight=config.flight,
                requests=BodyRequests(
                    ask=drone.requested_logs.ask,
                    arm=drone.motors.arm,
                    firmware=FirmwareAccess(
                        drone.setup, drone.link, drone.commands.on_board
                    ).requests,
                ),
            )
            for i, drone in self.drones.items()
        }
        self.rate = rate
        """Hz of set-points for each drone."""
        self.failure = ""
        """Reason why the process failed; empty if it did not."""
        self._missing = ""
        self._ending = 0.0
        self._limit = Fence.box(*limit_area(config))
        self._supervisor = Supervisor(clock, f"dongle {dongle}", self._failed)

    def _turns(self) -> SendPacer:
        """Return the pace of packets: a little less than the dongle carries.

        Packets that wait in the dongle become old.
        """
        carried = max(capacity_of(self.config, self.dongle), self.plan.packet_rate)
        return SendPacer(self.clock, OWNER_LIMITS.capacity_share * carried)

    async def serve(self, *services: Actor) -> None:
        """Run the drones and services until the owner ends."""
        try:
            await self._supervisor.run([*services, *self.drones.values(), self])
        finally:
            if self.broadcast is not None:
                self.broadcast.end()

    async def run(self) -> None:
        """Publish the state of the links, and look after drones that receive no commands."""
        tick = 0
        every = round(LINK_CHECK_RATE / DRONE_TOPICS.link.rate)
        began = self.clock.now()
        async for _ in self.clock.ticks(LINK_CHECK_RATE):
            self._look_at_dongle(self.clock.now() - began)
            for i, body in self.bodies.items():
                body.look()
                self._keep_inside(i, body)
                if self.drones[i].is_orphan:
                    body.abandon()
            tick += 1
            if tick % every == 0:
                for drone in self.drones.values():
                    drone.report.publish()
            if self._ending and self._alone():
                self._leave()

    def _look_at_dongle(self, age: float) -> None:
        """End this process if the dongle was unplugged.

        A new process is the surest way to find a dongle again. A dongle that was missing from the
        start is waited for as long as its drones are.

        age: s since the start
        """
        before = self._missing
        self._missing = PROCESS_DONGLES.failure(self.config.drone(self.ids[0]).uri)
        if not self._missing:
            self._require_inline()
            return
        used = any(math.isfinite(drone.link.silence) for drone in self.drones.values())
        if before and (used or age > self.config.radio.connect_deadline):
            self.abort(self._missing)
        elif not (before or used):
            log.error("dongle %d: %s", self.dongle, self._missing)

    def _require_inline(self) -> None:
        """End this process if the dongle cannot do what the swarm file says: it was planned with it."""
        uri = self.config.drone(self.ids[0]).uri
        if (
            is_inline(self.config, self.dongle)
            and PROCESS_DONGLES.is_inline(uri) is False
        ):
            self.abort(
                "its swarm file says inline = true, but this is no Crazyradio 2.0 with firmware 5.1 or newer. "
                "Update its firmware, or set inline = false"
            )

    def _keep_inside(self, i: int, body: RemoteBody) -> None:
        """Cut the motors of a drone beyond the limit area while its agent is silent.

        This is done only if the drone can receive the command. A drone that has been silent for
        long is left alone: it may be carried about.
        """
        drone = self.drones[i]
        now = self.clock.now()
        flies = (
            drone.estimate.is_flying and drone.link.silence < SILENCE_LIMITS.link_lost
        )
        seen = (
            drone.view.place
            if flies and body.silence > OWNER_LIMITS.command_silence
            else None
        )
        if (
            seen is not None
            and now - seen[0] < OWNER_LIMITS.command_silence
            and (beyond := self._limit.outside(*seen[1].p)) > 0.0
        ):
            body.stop(f"{beyond:.2f} m outside the limit area, without a commander")

    def _alone(self) -> bool:
        """Return whether no drone is commanded and none flies, or the time to land has passed."""
        commanded = any(
            body.silence < OWNER_LIMITS.command_silence for body in self.bodies.values()
        )
        flying = any(drone.estimate.is_flying for drone in self.drones.values())
        return self.clock.now() > self._ending or not (commanded or flying)

    def _leave(self) -> None:
        """End: all drones have landed, or had the time to land."""
        if flying := [
            str(i) for i, drone in self.drones.items() if drone.estimate.is_flying
        ]:
            self.abort(
                f"ends {OWNER_LIMITS.landing_time:g} s after it was told to; not known to have "
                f"landed: {', '.join(flying)}"
            )
        self._supervisor.stop()

    def end(self, reason: str) -> None:
        """End as soon as no drone flies."""
        self._ending = self._ending or self.clock.now() + OWNER_LIMITS.landing_time

    def abort(self, reason: str) -> None:
        """End at once."""
        self.failure = self.failure or reason
        log.error("dongle %d: %s", self.dongle, reason)
        self._supervisor.stop()

    def refuse(self, refused: Refused) -> None:
        """End because another process owns these drones already."""
        self.abort(str(refused))

    def _failed(self, actor: Actor, error: Exception, again: bool) -> None:
        text = f"{actor.name} failed: {error_text(error)}"
        if isinstance(actor, RadioDrone):
            log.error("drone %d: %s", actor.drone, text)
        else:
            self.abort(text)

    def report(self) -> dict[str, Any]:
        """Return a summary of the links for the final report."""
        return {
            "success": not self.failure,
            "reason": self.failure,
            "dongle": self.dongle,
            "setpoints_hz": self.rate,
            "planned_load": self.plan.load,
            "poses": self._describe_poses(),
            "drones": {
                i: {
                    "state": drone.link.state,
                    "release": drone.preparation.release,
                    "reconnected": drone.link.reconnected,
                    "refused": drone.landing.refused_plans,
                    "malformed": drone.malformed,
                }
                for i, drone in self.drones.items()
            },
        }

    def _describe_poses(self) -> dict[str, Any] | None:
        """Return how many poses were broadcast, and how old they were then; None without broadcasts."""
        if self.broadcast is None:
            return None
        age = self.broadcast.age
        return {
            "broadcast": self.broadcast.sent,
            "age_s": None if math.isnan(age) else round(age, 4),
        }
