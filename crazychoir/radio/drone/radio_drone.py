"""One drone behind a dongle: connect it, look after its link, and connect it again.

For the body that obeys its agent (simulation/remote.py) it is the source of its state; its
`commands` are the link to the drone.
"""

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.bus.port import Bus
from crazychoir.config.dongle_plan import RADIO_TRAFFIC
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, LinkFailed
from crazychoir.numerics.math3d import yaw_of
from crazychoir.radio import checks
from crazychoir.radio.drone.background_tasks import BackgroundTasks
from crazychoir.radio.drone.camera_view import CameraView
from crazychoir.radio.drone.command_gate import CommandGate
from crazychoir.radio.drone.command_transmitter import CommandTransmitter
from crazychoir.radio.drone.console_reader import ConsoleReader
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.landing_repeater import LandingRepeater
from crazychoir.radio.drone.link_report import LinkReport
from crazychoir.radio.drone.motor_switch import MotorSwitch
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.drone.pose_broadcast import PoseBroadcast
from crazychoir.radio.drone.preparation import Preparation
from crazychoir.radio.drone.requested_logs import RequestedLogs
from crazychoir.radio.drone.timing import (
    CONNECT_ATTEMPTS,
    LINK_CHECK_RATE,
    SILENCE_LIMITS,
)
from crazychoir.radio.drone.watchdog_feed import WatchdogFeed
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.dongles import DongleFailed
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.handlers import RADIO_HANDLERS, RadioHandler
from crazychoir.radio.visibility import BodySights
from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import State, Vec


def _send_at_once() -> None:
    """Let a packet leave without waiting for a turn."""


@dataclass(frozen=True, slots=True)
class SharedRadio:
    """What all drones of one process share."""

    contents: TableOfContents
    """Tables of contents."""
    turn: Callable[[], None] = _send_at_once
    """Waits until a packet may be sent."""
    sights: BodySights | None = None
    """Bodies that the cameras see; None: each drone makes its own."""
    broadcast: PoseBroadcast | None = None
    """Tells the poses of all drones; None: each drone is sent its own."""
    echo_rate: float = RADIO_TRAFFIC.echo_rate
    """Hz of echoes of each link."""


class RadioDrone(Actor):
    """Connects drone i of a swarm, looks after its link, and connects it again after a failure.

    Its agent's commands come to the port of its body.

    kind: kind of its commands
    rate: Hz of set-points
    """

    name = "radio"
    restart = RESTART_ON_FAILURE
    flies: tuple[str, ...] = ("xyz",)
    """Kinds of commands that the drone obeys."""
    command_timeout: float | None = None
    """s without a command after which a flying drone gets no thrust; None: its firmware decides."""

    def __init__(
        self,
        bus: Bus,
        config: SwarmConfig,
        i: int,
        kind: str,
        rate: float,
        shared: SharedRadio,
    ) -> None:
        setup = DroneSetup(bus, config, i, kind, rate)
        link = CurrentLink(setup)
        tasks = BackgroundTasks()
        estimate = OwnEstimate(setup, self._note_restart, self._note_log)
        handler = RADIO_HANDLERS[kind](setup.platform)
        transmitter = CommandTransmitter(setup, link, handler)
        motors = MotorSwitch(setup, link, estimate, tasks)
        landing = LandingRepeater(setup, link, estimate, transmitter)
        view = CameraView(setup, link, estimate, shared.sights, shared.broadcast)
        preparation = Preparation(setup, handler, estimate)
        self.drone = i
        self.clock = bus.clock
        self.setup = setup
        self.link = link
        self.handler: RadioHandler = handler
        self.estimate = estimate
        self.view = view
        self.preparation = preparation
        self.landing = landing
        self.motors = motors
        self.commands = CommandGate(
            setup, link, estimate, view, landing, motors, transmitter
        )
        self.watchdog = WatchdogFeed(setup, link, estimate)
        self.requested_logs = RequestedLogs(setup, link, tasks)
        self.report = LinkReport(
            setup, link, estimate, view, preparation, motors, landing
        )
        self._shared = shared
        self._transmitter = transmitter
        self._tasks = tasks
        self._work: asyncio.Task[None] | None = None

    # Connecting -----------------------------------------------------------------------------------

    async def run(self) -> None:
        """Connect, look after the link, and connect again when it fails."""
        began = self.clock.now()
        while True:
            self.link.why = ""
            connection = Connection(
                self.clock,
                self.setup.row.uri,
                self._shared.contents,
                self.link.lose,
                ConsoleReader(self.setup, self.landing.hear).hear,
                self._shared.turn,
                self._shared.echo_rate,
            )
            insists = asyncio.get_running_loop().create_task(
                self.motors.insist(connection)
            )
            try:
                await self._connect(connection, began)
                await self._look_after(connection)
            except (LinkFailed, ConfigError) as error:
                self.link.fail(error, self.preparation.is_prepared, began)
            finally:
                insists.cancel()
                self.link.drop(connection)
                await self._end_work()
                await connection.close()
            waited = self.clock.now() - began
            is_late = waited > self.setup.config.radio.connect_deadline
            await self.clock.sleep(
                CONNECT_ATTEMPTS.late_pause
                if is_late and not self.estimate.is_flying
                else CONNECT_ATTEMPTS.early_pause
            )

    async def _connect(self, connection: Connection, began: float) -> None:
        """Open this connection, and use it once the drone has answered the first questions.

        began: s: time of the first attempt to connect
        """
        self.link.opening = connection
        await self._open(connection, began)
        firmware = ConnectedFirmware(connection)
        refused = self.preparation.find_version_problem(connection)
        try:
            await self.estimate.begin_logs(connection)
            await self.estimate.wait_for_log(connection)
        except LinkFailed as error:
            raise refused or error from None
        if self.setup.bus.stopped and self.estimate.is_flying:
            self.motors.cut()
        self.link.only_lands = await self.preparation.check_release(firmware, refused)
        if not (self.preparation.is_prepared or self.estimate.is_flying):
            await self.preparation.prepare(firmware)
        if self.link.why:
            raise LinkFailed(self.setup.row.uri, self.link.why)
        self.link.take_up(connection, self.preparation.release)
        self._work = asyncio.get_running_loop().create_task(
            self.requested_logs.begin_all(connection)
        )

    async def _open(self, connection: Connection, began: float) -> None:
        """Open this connection; a drone that was prepared before has little time to answer.

        began: s: time of the first attempt to connect
        """
        if self.preparation.is_prepared:
            await connection.open(CONNECT_ATTEMPTS.reopen_deadline, 0.0)
            return
        deadline = self.setup.config.radio.connect_deadline
        left = max(began + deadline - self.clock.now(), deadline / 4.0)
        await connection.open(left, CONNECT_ATTEMPTS.tables_deadline)

    # Looking after the link -----------------------------------------------------------------------

    async def _look_after(self, connection: Connection) -> None:
        """Look after the link until it fails. Raises LinkFailed then."""
        async for _ in self.clock.ticks(LINK_CHECK_RATE, drone=self.drone):
            self._raise_failure(connection)
            is_flying = self.estimate.is_flying
            if self.setup.bus.stopped and is_flying and not self.motors.is_cut:
                self.motors.cut()
            silence = connection.silence
            if silence > SILENCE_LIMITS.link_lost:
                raise LinkFailed(self.setup.row.uri, f"silent for {silence:.1f} s")
            self.link.note_silence(silence)
            if silence > SILENCE_LIMITS.drone_unreached:
                self.commands.note_silence()
            if failure := connection.failure:
                self.setup.warn("sending", f"a packet could not be sent: {failure}")
            if is_flying:
                self._warn_of_late_link(connection)
            self.watchdog.feed()
            self.landing.go_on()
            self.view.forgive_fault()
            self._work_on(connection, silence)

    def _raise_failure(self, connection: Connection) -> None:
        """Raise LinkFailed if the link cannot be used any more."""
        uri = self.setup.row.uri
        if self.link.why:
            raise LinkFailed(uri, self.link.why)
        if gone := connection.dongle_failure:
            raise DongleFailed(uri, gone)
        if self.link.only_lands and not self.estimate.is_flying:
            raise LinkFailed(uri, self.link.only_lands)

    def _warn_of_late_link(self, connection: Connection) -> None:
        late = checks.link_problems(connection.latency, connection.answered)
        if late:
            self.setup.warn("late", f"{'; '.join(late)}: messages to it arrive late")

    def _work_on(self, connection: Connection, silence: float) -> None:
        """Do work that waits for answers in a task of its own, one piece at a time.

        Raises the error of the last piece.

        silence: s since the last packet
        """
        work = self._work
        if work is not None and not work.done():
            return
        self._work = None
        if work is not None:
            work.result()
        if (more := self._find_due_work(connection, silence)) is not None:
            self._work = asyncio.get_running_loop().create_task(more)

    def _find_due_work(
        self, connection: Connection, silence: float
    ) -> Coroutine[Any, Any, None] | None:
        """Return the next piece of work; None if none is due.

        The work is to start the logs again, to prepare the drone, or to start its estimator.

        silence: s since the last packet
        """
        if silence < SILENCE_LIMITS.link_degraded and self.estimate.is_overdue:
            return self._begin_logs_again(connection)
        if self.estimate.is_flying:
            return None
        if not self.preparation.is_prepared:
            return self.preparation.prepare(ConnectedFirmware(connection))
        if not self.setup.seen_by_cameras or self.preparation.is_placed:
            return None
        pose = self.view.pose.fresh()
        if pose is None:
            return None
        return self.preparation.place(
            ConnectedFirmware(connection), pose.p, yaw_of(pose.q)
        )

    async def _begin_logs_again(self, connection: Connection) -> None:
        """Start the logs again, because the drone sends none any more."""
        try:
            await self.estimate.reset_logs(connection)
        except LinkFailed as error:
            if not self.estimate.is_flying:
                raise
            self.setup.warn("log", str(error))  # set-points may still reach the drone
        await self.requested_logs.begin_all(connection)

    async def _end_work(self) -> None:
        """End the work that waits for answers, because the link is gone."""
        work = self._work
        self._work = None
        if work is not None:
            work.cancel()
            await asyncio.wait([work])
            # Read the error, so that asyncio does not log it: the link has failed anyway.
            _ = work.cancelled() or work.exception()

    async def on_stop(self) -> None:
        """Cancel the work in the background."""
        self._tasks.cancel()

    # What the drone says --------------------------------------------------------------------------

    def _note_restart(self) -> None:
        """Forget what the drone was told: it has been started again."""
        self.link.lose("it has been started again")
        self.motors.note_restart()
        self.preparation.forget()
        self.watchdog.is_started = False
        self.report.has_flown = False
        self.view.forget_fault()

    def _note_log(self, taken: float, q: Vec) -> None:
        """Compare the drone's motion with that of its body.

        taken: s: when the log was taken
        q: (4,), body to world: attitude that the drone estimates
        """
        self.motors.note_log()
        take_off = self.view.take_off
        if take_off is None:
            return
        connection = self.link.connection
        latency = math.nan if connection is None else connection.latency
        if take_off.note(taken, q, self.estimate.is_flying, latency):
            self.report.publish()

    # What its owner and its body ask --------------------------------------------------------------

    @property
    def is_orphan(self) -> bool:
        """Whether the drone flies, this owner can reach it, and no agent commands it."""
        if self.link.connection is None or self.motors.is_cut:
            return False
        up_ns = self.clock.now_ns() - self.link.up_ns
        return (
            up_ns > SILENCE_LIMITS.drone_orphaned * NS_PER_SECOND
            and self.estimate.is_flying
            and not self.commands.has_flown_here
            and self.landing.command is None
        )

    @property
    def malformed(self) -> int:
        """Count of commands and poses that did not fit into a packet."""
        return self._transmitter.malformed + self.view.malformed

    def resting(self, i: int) -> bool:
        """Return whether the drone stands.

        The firmware says so 2 s after the motors have stopped; here it counts from the command to
        stop.
        """
        return not self.estimate.is_flying or self.commands.has_stopped

    def state(self, i: int) -> State:
        """Return the last recent pose from the cameras, at rest.

        Without such a pose it is the drone's own estimate, or its home before the first log.
        """
        pose = self.view.find_recent_pose()
        if pose is not None:
            return State(np.array([*pose.p, 0.0, 0.0, 0.0, *pose.q, 0.0, 0.0, 0.0]))
        return self.estimate.state or State.at(self.setup.row.home)
