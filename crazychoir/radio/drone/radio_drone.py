"""One drone behind a dongle: connect it, tell it its pose, fly it, and reconnect it.

For the body that obeys its agent (simulation/remote.py) this is both the link to the drone and the
source of its state.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Coroutine, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.radio_checks import RADIO_TRAFFIC
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.senders import STOP_COMMAND
from crazychoir.errors import CodecError, ConfigError, LinkFailed, Refused
from crazychoir.mocap.view import RateLimit
from crazychoir.numerics.math3d import quaternion_of_yaw, quaternion_product, yaw_of
from crazychoir.platforms import find_platform
from crazychoir.radio import checks
from crazychoir.radio.link.connection import AWAITING_LOG, Connection
from crazychoir.radio.link.dongles import DongleFailed
from crazychoir.radio.link.firmware import Firmware
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.compressed import unpack_quaternion
from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.radio.protocol.handlers import (
    RADIO_HANDLERS,
    RadioHandler,
    emergency_packets,
    is_idle_command,
    pose_packet,
    position_packet,
)
from crazychoir.radio.protocol.thrust import thrust_command_per_newton
from crazychoir.radio.protocol.version_check import check_protocol
from crazychoir.radio.uptime import Uptime
from crazychoir.radio.visibility import SIGHT_LIMITS, BodySights, TakeOffWatch
from crazychoir.runtime.actor import RESTART_ON_FAILURE, Actor
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.mailbox import Call, Latest
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.safety.identity.preflight_check import (
    GroundedDrone,
    find_arming_problems,
)
from crazychoir.safety.rules.guard import Throttle
from crazychoir.safety.rules.radio_watch import SupervisorBit
from crazychoir.simulation.telemetry import check_log_period
from crazychoir.types import XYZ, Body, Command, LinkStatus, Pose, State, Vec

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SilenceLimits:
    """Seconds without packets, logs or commands after which a link or a drone counts as troubled."""

    link_degraded: float = 0.3
    """s of silence after which a link is degraded. Set-points are still sent: the firmware takes
    the first that arrives, if it arrives within 2 s.
    """
    link_lost: float = 2.5
    """s of silence after which a link is lost and is opened again."""
    drone_unreached: float = 1.0
    """s of silence after which a drone may not have obeyed its last command."""
    logs_dropped: float = 1.0
    """s without a log from a drone that still answers: its firmware has dropped its log blocks.
    The firmware drops them after 1 s of silence.
    """
    drone_orphaned: float = 3.0
    """s without commands after which a flying drone is landed."""


SILENCE_LIMITS = SilenceLimits()


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """How a command is judged by the drone's position."""

    standing_height: float = 0.2
    """m above the ground below which a drone in view of the cameras stands, or may fall."""
    line_lag: float = 0.5
    """m by which a drone may be behind the line that it flies."""
    catch_up_factor: float = 1.8
    """Multiple of speed_limit for a drone further away: it has missed earlier lines."""


COMMAND_LIMITS = CommandLimits()


LINK_CHECK_RATE = 20.0
"""Hz at which links are checked."""


@dataclass(frozen=True, slots=True)
class ConnectAttempts:
    """Pauses between the attempts to connect, and their deadlines."""

    early_pause: float = 0.2
    """s: time between two attempts to connect, before the deadline."""
    late_pause: float = 1.0
    """s: time between two attempts to connect, after the deadline."""
    reopen_deadline: float = 1.5
    """s for an attempt to connect in flight; the tables of contents are known by then."""
    tables_deadline: float = 30.0
    """More s for a first connection, on the ground, that still loads its tables of contents. Over
    a dongle that four drones share, the tables take about 10 s, once for each firmware.
    """


CONNECT_ATTEMPTS = ConnectAttempts()


@dataclass(frozen=True, slots=True)
class RepeatRules:
    """When packets to land, to stop and to feed the watchdog are sent again."""

    land_period: float = 0.25
    """s between two commands to land until the planner on board answers."""
    refused_pause: float = 1.0
    """s until the next command to land after the planner has refused one."""
    landing_results: tuple[int, ...] = (0, 1)
    """Results in the answer of a planner that starts to land, or lands already."""
    stop_delay: float = 1.0
    """s after the planned end of a landing until the drone is told to stop. The planner has then
    ended the landing. The command to land is not repeated from then on: the planner would start
    a new landing.
    """
    vain_time: float = 3.0
    """s of unanswered commands to land after which the motors may be stopped instead. The link
    works meanwhile: otherwise the drone may still land when it receives the command.
    """
    stop_period: float = 0.5
    """s between two commands to stop, for a drone that stands."""
    watchdog_period: float = 0.25
    """s between two packets for the emergency-stop watchdog, which needs one a second."""


REPEAT_RULES = RepeatRules()


@dataclass(frozen=True, slots=True)
class CameraPoseLimits:
    """How old, rare or jumping the cameras' poses of a drone may be."""

    oldest_sent: float = 0.1
    """s: a drone is not told a pose that is older."""
    oldest_used: float = 1.0
    """s for which the last pose from the cameras is used as the drone's position."""
    longest_jump: float = 0.1
    """s of jumping poses after which the check of the take-off is given up."""
    longest_gap: float = 0.5
    """s without a pose after which the drone counts as not seen, at any rate of poses."""


CAMERA_POSE_LIMITS = CameraPoseLimits()


@dataclass(frozen=True, slots=True)
class ProblemTexts:
    """Texts about a drone that may not take off."""

    wrong_body: str = ": correct the position of its body, out of sight of the cameras, or switch the drone off and on"
    """Advice for a drone with the wrong body."""
    motors_cut: str = (
        "its motors were cut: switch it off and on, and start the owner of its "
        "dongle (crazychoir-radio) again"
    )
    """Problem of a drone with motors that were cut."""


PROBLEM_TEXTS = ProblemTexts()


LOG_UNIT = 1e-3
"""SI units in a unit of the logs (mm, mm/s)."""


@dataclass(frozen=True, slots=True)
class FirmwareNames:
    """Names of the log variables and parameters that are read from a drone."""

    estimate: tuple[str, ...] = (
        "stateEstimateZ.x",
        "stateEstimateZ.y",
        "stateEstimateZ.z",
        "stateEstimateZ.vx",
        "stateEstimateZ.vy",
        "stateEstimateZ.vz",
        "stateEstimateZ.quat",
    )
    """Log variables of the drone's own estimate."""
    health: tuple[str, ...] = ("pm.vbat", "supervisor.info")
    """Log variables of its battery and its supervisor."""
    positioning_decks: tuple[str, ...] = (
        "bcLighthouse4",
        "bcDWM1000",
        "bcLoco",
        "bcFlow2",
        "bcFlow",
    )
    """Names of the parameters for decks that locate a drone."""
    common_frame_decks: tuple[str, ...] = positioning_decks[:3]
    """Positioning decks that give all drones one common frame."""
    variances: tuple[str, ...] = ("kalman.varX", "kalman.varY", "kalman.varZ")
    """Log variables with the variances of the drone's own position."""


FIRMWARE_NAMES = FirmwareNames()


class RadioDrone(Actor):
    """Drone i of a swarm; its agent's commands come to the port of its body.

    kind: kind of its commands
    rate: Hz of set-points
    contents: tables of contents, shared by all links of the process
    turn: waits until a packet may be sent
    sights: bodies that the cameras see, shared by all drones of the process; None: the drone makes
      its own
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
        contents: TableOfContents,
        turn: Callable[[], None] = lambda: None,
        sights: BodySights | None = None,
    ) -> None:
        self.bus = bus
        self.clock = bus.clock
        self.config = config
        self.drone = i
        self.kind = kind
        self.port = bus.ports[PORT_ADDRESSES.body_offset + i]
        self.rate = rate
        self._contents = contents
        self._turn = turn
        self.row, self._platform = (
            config.drone(i),
            find_platform(config.drone(i).platform),
        )
        self.seen_by_cameras = self.row.pose == "mocap"
        self.connection: Connection | None = None
        # The connection while it is opened and the drone answers the first questions.
        self._opening: Connection | None = None
        self._work: asyncio.Task[None] | None = None
        self.handler: RadioHandler = RADIO_HANDLERS[kind](self._platform)
        self.release = ""
        self.state_of_link = "connecting"
        self.why = ""
        self.refused_plans = self.reconnected = self.malformed = 0
        self._stopped = True
        self._cut = self._placed = self._prepared = self._arming = self._fed = (
            self._flown_here
        ) = False
        self._cut_heard = False
        self._landing: XYZ | None = None
        # ns: when the drone was told to land over a link that may have carried it.
        self._told_ns: int | None = None
        self._landed_at = math.inf
        self._only_lands = ""
        self._due_ns = self._stop_due_ns = self._watchdog_ns = 0
        self._own: State | None = None
        self._own_ns = self._logs_ns = self._landing_ns = self._up_ns = 0
        self._uptime = Uptime()
        self._well: dict[str, float] = {}
        self._spread: dict[str, float] = {}
        self._said = Throttle()
        self._gate = PoseGate()
        self._has_flown = False
        self._heard_at = -math.inf
        self._jumped_at = math.inf
        self._asked: dict[tuple[str, ...], float] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._pose: Latest[Pose] = Latest(
            self.clock, f"drone {i} pose", CAMERA_POSE_LIMITS.longest_gap
        )
        self._take_off: TakeOffWatch | None = None
        if self.seen_by_cameras:
            here = self.port.address
            self._take_off = TakeOffWatch(i, sights or BodySights(bus, config, here))
            self._told = RateLimit(config.radio.pose_rate)
            bus.subscribe(
                DRONE_TOPICS.pose,
                PORT_ADDRESSES.camera_offset + i,
                here,
                self._pose,
                SIGHT_LIMITS.pose_rate,
            )
            bus.subscribe(
                DRONE_TOPICS.pose,
                PORT_ADDRESSES.camera_offset + i,
                here,
                Call(self.clock, self._seen, "pose"),
                SIGHT_LIMITS.pose_rate,
            )

    # Connecting and looking after the link --------------------------------------------------------

    async def run(self) -> None:
        """Connect, look after the link, and connect again when it fails."""
        began = self.clock.now()
        while True:
            self.why = ""
            connection = Connection(
                self.clock,
                self.row.uri,
                self._contents,
                self._lost,
                self._heard,
                self._turn,
            )
            insists = asyncio.get_running_loop().create_task(self._insist(connection))
            try:
                await self._connect(connection, began)
                await self._look_after(connection)
            except (LinkFailed, ConfigError) as error:
                self._failed(error, began)
            finally:
                insists.cancel()
                self._heard_at = max(
                    self._heard_at, self.clock.now() - connection.silence
                )
                self.connection = self._opening = None
                await self._end_work()
                await connection.close()
            late = self.clock.now() - began > self.config.radio.connect_deadline
            await self.clock.sleep(
                CONNECT_ATTEMPTS.late_pause
                if late and not self.flying
                else CONNECT_ATTEMPTS.early_pause
            )

    async def _connect(self, connection: Connection, began: float) -> None:
        self._opening = connection
        deadline = self.config.radio.connect_deadline
        left = max(began + deadline - self.clock.now(), deadline / 4.0)
        await connection.open(
            CONNECT_ATTEMPTS.reopen_deadline if self._prepared else left,
            0.0 if self._prepared else CONNECT_ATTEMPTS.tables_deadline,
        )
        firmware = Firmware(connection)
        refused = self._too_old(connection)
        try:
            await self._begin_logs(connection)
            await self._until_told(connection)
        except LinkFailed as error:
            raise refused or error from None
        if self.bus.stopped and self.flying:
            self.cut()
        await self._check(firmware, refused)
        if not self._prepared and not self.flying:
            await self._prepare(firmware)
        if self.why:
            raise LinkFailed(self.row.uri, self.why)
        self.connection = connection
        self._opening = None
        self._up_ns = self.clock.now_ns()
        self.reconnected += self.state_of_link == "lost"
        self._change("up", self._only_lands)
        self._work = asyncio.get_running_loop().create_task(
            self._begin_all_asked(connection)
        )

    def _too_old(self, connection: Connection) -> ConfigError | None:
        """Return why the firmware does not know the packets that it would receive, or None."""
        try:
            check_protocol(
                connection.version, self.kind, self._platform, f"drone {self.drone}"
            )
        except ConfigError as error:
            return error
        return None

    async def _check(self, firmware: Firmware, refused: ConfigError | None) -> None:
        """Raise ConfigError if the drone cannot be flown with its firmware.

        A drone that another program left in flight is accepted, but may only land.
        """
        if refused is None and not self.release:
            release = await firmware.release()
            try:
                self._learn_thrust(release)
                self.release = release
            except ConfigError as error:
                refused = error
        if refused is not None and not self.flying:
            raise refused
        self._only_lands = str(refused or "")

    async def _insist(self, connection: Connection) -> None:
        """Repeat the emergency stop until a drone with cut motors confirms it.

        The packets are sent from the opening of the link on.
        """
        async for _ in self.clock.ticks(LINK_CHECK_RATE):
            if self._cut and not self._cut_heard:
                connection.urgent(emergency_packets())

    async def _until_told(self, connection: Connection) -> None:
        """Wait until the drone has told whether it flies: another program may have started it.

        Raises LinkFailed if it does not tell in time.
        """
        for _ in range(round(CONNECT_ATTEMPTS.reopen_deadline * LINK_CHECK_RATE)):
            if self._own_ns > self._logs_ns:
                return
            await self.clock.sleep(1.0 / LINK_CHECK_RATE)
        raise LinkFailed(
            connection.uri,
            f"sends no status within {CONNECT_ATTEMPTS.reopen_deadline:g} s",
        )

    def _learn_thrust(self, release: str) -> None:
        """Set the thrust command a newton.

        Raises ConfigError if it is not known for this release.
        """
        if self.handler.needs_thrust:
            given = self.config.radio.thrust_map
            where = f"drone {self.drone}"
            self.handler.thrust = thrust_command_per_newton(
                release, self._platform, given, where
            )

    async def _prepare(self, firmware: Firmware) -> None:
        """Set the parameters and, for a drone without cameras, start its estimator.

        This is done once, on the ground.
        """
        await firmware.set_all({"stabilizer.estimator": 2} | self.handler.parameters)
        await firmware.set_all(self.config.radio.parameters | self.row.parameters)
        if not self.seen_by_cameras:
            await self._require_frame(firmware)
            await self._place(firmware, np.array(self.row.home), self.row.yaw)
        self._prepared = True

    async def _require_frame(self, firmware: Firmware) -> None:
        """Raise ConfigError if several drones have no common frame, unless [radio] allows drift.

        The frame of a flow deck is the drone's own, and drifts.
        """
        if self.config.radio.drift or len(self.config.ids) == 1:
            return
        decks = [
            deck
            for deck in FIRMWARE_NAMES.positioning_decks
            if await firmware.has(f"deck.{deck}")
        ]
        if not any(deck in FIRMWARE_NAMES.common_frame_decks for deck in decks):
            found = f"{', '.join(decks) or 'no deck'} on board: its frame drifts from the frame of the others"
            do = "Set drift = true in [radio] if the mission tolerates drift, or let the cameras see the drone."
            if self.row.uri.startswith("udp://"):
                do += " A virtual drone gets a deck from `crazychoir virtual`, started with this swarm file."
            raise ConfigError(
                f"drone {self.drone}: pose",
                found,
                f"one of {', '.join(FIRMWARE_NAMES.common_frame_decks)}",
                do,
            )

    async def _place(self, firmware: Firmware, p: Vec, yaw: float) -> None:
        """Start the drone's estimator at this pose.

        p: (3,) m
        yaw: rad
        """
        initial = dict(
            zip(("initialX", "initialY", "initialZ"), p.tolist(), strict=True)
        ) | {"initialYaw": yaw}
        await firmware.set_all(
            {f"kalman.{name}": value for name, value in initial.items()}
        )
        if self.flying:
            return
        await firmware.set("kalman.resetEstimation", 1)
        await firmware.set("kalman.resetEstimation", 0)
        self._placed = True

    async def _begin_logs(self, connection: Connection) -> None:
        rate = self.config.radio.log_rate
        seconds = CONNECT_ATTEMPTS.reopen_deadline
        period = 1.0 / (
            max(rate, RADIO_TRAFFIC.least_attitude_rate)
            if self.seen_by_cameras
            else rate
        )
        self._logs_ns = self.clock.now_ns()
        await connection.log(
            "own",
            (*FIRMWARE_NAMES.estimate, *FIRMWARE_NAMES.health),
            period,
            self._take_own,
            seconds,
        )
        if not self.seen_by_cameras:
            await connection.log(
                "spread",
                FIRMWARE_NAMES.variances,
                1.0 / RADIO_TRAFFIC.uncertainty_rate,
                self._take_spread,
                seconds,
            )

    async def _begin_logs_again(self, connection: Connection) -> None:
        """Start the logs again, because the drone sends none any more."""
        self._logs_ns = self.clock.now_ns()
        try:
            await connection.reset_logs(CONNECT_ATTEMPTS.reopen_deadline)
            await self._begin_logs(connection)
        except LinkFailed as error:
            if not self.flying:
                raise
            self._say("log", str(error))  # set-points may still reach the drone
        await self._begin_all_asked(connection)

    async def _look_after(self, connection: Connection) -> None:
        """Look after the link until it fails. Raises LinkFailed then."""
        async for _ in self.clock.ticks(LINK_CHECK_RATE, drone=self.drone):
            if self.why:
                raise LinkFailed(self.row.uri, self.why)
            if gone := connection.dongle_failure:
                raise DongleFailed(self.row.uri, gone)
            if self._only_lands and not self.flying:
                raise LinkFailed(self.row.uri, self._only_lands)
            if self.bus.stopped and self.flying and not self._cut:
                self.cut()
            silence = connection.silence
            if silence > SILENCE_LIMITS.link_lost:
                raise LinkFailed(self.row.uri, f"silent for {silence:.1f} s")
            self.state_of_link = (
                "degraded" if silence > SILENCE_LIMITS.link_degraded else "up"
            )
            if silence > SILENCE_LIMITS.drone_unreached:
                self._flown_here, self._up_ns = False, self.clock.now_ns()
            if failure := connection.failure:
                self._say("sending", f"a packet could not be sent: {failure}")
            if self.flying and (
                late := checks.link_problems(connection.latency, connection.answered)
            ):
                self._say("late", f"{'; '.join(late)}: messages to it arrive late")
            self._feed_watchdog()
            self._go_on_landing()
            self._forgive()
            self._work_on(connection, silence)

    def _work_on(self, connection: Connection, silence: float) -> None:
        """Do work that waits for answers in a task of its own, one piece at a time.

        Raises the error of the last piece.
        """
        work = self._work
        if work is not None and not work.done():
            return
        self._work = None
        if work is not None:
            work.result()
        if (more := self._due_work(connection, silence)) is not None:
            self._work = asyncio.get_running_loop().create_task(more)

    def _due_work(
        self, connection: Connection, silence: float
    ) -> Coroutine[Any, Any, None] | None:
        """Return the next piece of work; None if none is due.

        The work is to start the logs again, to prepare the drone, or to start its estimator.
        """
        if (
            silence < SILENCE_LIMITS.link_degraded
            and self.clock.now_ns() - max(self._own_ns, self._logs_ns)
            > SILENCE_LIMITS.logs_dropped * NS_PER_SECOND
        ):
            return self._begin_logs_again(connection)
        if self.flying:
            return None
        if not self._prepared:
            return self._prepare(Firmware(connection))
        pose = self._pose.fresh()
        if self.seen_by_cameras and not self._placed and pose is not None:
            return self._place(Firmware(connection), pose.p, yaw_of(pose.q))
        return None

    async def _end_work(self) -> None:
        """End the work that waits for answers, because the link is gone."""
        work = self._work
        self._work = None
        if work is not None:
            work.cancel()
            await asyncio.wait([work])
            # Read the error, so that asyncio does not log it: the link has failed anyway.
            _ = work.cancelled() or work.exception()

    def _forgive(self) -> None:
        """Forget the fault of the last take-off once the cameras no longer see the landed drone.

        To put a body right, the user takes it out of the cameras' sight. The next take-off checks
        it again.
        """
        if (
            self._take_off is not None
            and not self.flying
            and self._pose.fresh() is None
        ):
            self._take_off.found = ""

    def _feed_watchdog(self) -> None:
        """Feed the emergency-stop watchdog if [radio] watchdog is set.

        Without this process the drone then cuts its motors.
        """
        now_ns = self.clock.now_ns()
        self._fed = self._fed or (
            self.config.radio.watchdog and self.kind == "xyz" and self.flying
        )
        # Once started it must be fed, on the ground too.
        if self._fed and now_ns >= self._watchdog_ns:
            self._watchdog_ns = now_ns + round(
                REPEAT_RULES.watchdog_period * NS_PER_SECOND
            )
            self._send_now([PACKET_FORMS["emergency_stop_watchdog"].packet()])

    def _go_on_landing(self) -> None:
        """Repeat the command to land until the planner on board confirms it.

        Packets get lost, and links too. Then repeat that set-points have ended, until the landing
        should be over, and then the command to stop.
        """
        now_ns = self.clock.now_ns()
        if not self.flying or self._landing is None:
            self._landing = None
            self._landed_at = math.inf
            self._told_ns = None
        elif now_ns >= self._landing_ns:
            self._landing_ns = now_ns + round(REPEAT_RULES.land_period * NS_PER_SECOND)
            if math.isinf(self._landed_at):
                if self._told_ns is None or self._silent():
                    self._told_ns = now_ns
                self._transmit(self._landing)
            elif self.clock.now() < self._landed_at:
                self._send_now(self.handler.relax)
            else:
                self._landing_ns = now_ns + round(
                    REPEAT_RULES.stop_period * NS_PER_SECOND
                )
                self._transmit(STOP_COMMAND)

    @property
    def orphan(self) -> bool:
        """Whether the drone flies, this owner can reach it, and no agent commands it."""
        up = (
            self.connection is not None
            and self.clock.now_ns() - self._up_ns
            > SILENCE_LIMITS.drone_orphaned * NS_PER_SECOND
        )
        return (
            up
            and not self._cut
            and self.flying
            and not self._flown_here
            and self._landing is None
        )

    def _failed(self, error: Exception, began: float) -> None:
        self.problem = str(error)
        if isinstance(error, ConfigError):
            self._change("refused", str(error))
        elif self._prepared:
            self._change("lost", str(error))
        elif self.clock.now() - began > self.config.radio.connect_deadline:
            self._change("absent", str(error))
        if self.state_of_link != "connecting" and self._said.due(
            self.clock.now(), self.state_of_link
        ):
            log.error("drone %d: %s: %s", self.drone, self.state_of_link, error)

    def _change(self, state: str, why: str) -> None:
        if state == "up" and self.state_of_link != "up":
            log.info("drone %d: connected, firmware %s", self.drone, self.release)
        self.state_of_link = state
        self.why = ""
        self.problem = why

    problem = ""
    """Reason why the link is not up."""
    place: tuple[float, Pose] | None = None
    """Time in s and pose at which the cameras last saw the drone, among accepted poses."""

    def _lost(self, reason: str) -> None:
        """Note that the driver has given up; called by the connection."""
        self.why = reason

    # What the drone is sent -----------------------------------------------------------------------

    def send(self, command: Command) -> None:
        """Send a command to the drone: a set-point when the next one is due, a plan at once."""
        if self._cut:
            return
        if isinstance(command, XYZ) and command.verb == "land":
            if self._landing is None or self.connection is None:
                self._landing = self._landing or command
                self._landing_ns = 0
            return
        if self._only_lands:
            return
        if self.connection is None or (
            is_idle_command(command) and (self._flies_unheard() or self._comes_down())
        ):
            return  # the drone flies, and the sender may not know it
        now_ns = self.clock.now_ns()
        stops = is_idle_command(command)
        if isinstance(command, XYZ):
            if stops and now_ns < self._stop_due_ns:
                return
            self._stop_due_ns = (
                now_ns + round(REPEAT_RULES.stop_period * NS_PER_SECOND) if stops else 0
            )
        elif now_ns < self._due_ns:
            return
        else:
            period_ns = round(NS_PER_SECOND / (self.rate or LINK_CHECK_RATE))
            self._due_ns = max(self._due_ns + period_ns, now_ns - period_ns // 2)
        if self._platform.firmware.needs_arming and not stops:
            self._arm()
        if self._take_off is not None and not stops and not self.flying:
            self._take_off.begin(self.clock.now())
        self._stopped = stops
        self._landing = None
        self._landed_at = math.inf
        self._told_ns = None
        self._flown_here = self._flown_here or not (stops or self._silent())
        self._transmit(self._within_reach(command))

    def _flies_unheard(self) -> bool:
        """Return whether the drone says that it flies, but no command of this process reached it.

        A drone on the floor does not count.
        """
        low = self.config.flight.ground + COMMAND_LIMITS.standing_height
        stands = (
            self.place is not None
            and self.clock.now() - self.place[0] < CAMERA_POSE_LIMITS.oldest_used
            and self.place[1].p[2] < low
        )
        return self.flying and not self._flown_here and not stands

    def _comes_down(self) -> bool:
        """Return whether the drone lands, or will land when the command arrives.

        Its motors must not be stopped before that.
        """
        if self._landing is None or not self.flying:
            return False
        if self._landed_at < math.inf:
            return self.clock.now() < self._landed_at
        return (
            self._silent()
            or self._told_ns is None
            or self.clock.now_ns() - self._told_ns
            < REPEAT_RULES.vain_time * NS_PER_SECOND
        )

    def _silent(self) -> bool:
        return (
            self.connection is None
            or self.connection.silence > SILENCE_LIMITS.link_degraded
        )

    def _within_reach(self, command: Command) -> Command:
        """Return the command; a line that ends far from the drone gets more time."""
        here = (
            self.place[1].p
            if self.place is not None
            and self.clock.now() - self.place[0] < CAMERA_POSE_LIMITS.oldest_used
            else None
        )
        here = self._own.p if here is None and self._own is not None else here
        if here is None or not isinstance(command, XYZ) or command.verb != "line":
            return command
        far = math.dist(command.flat[0:3], here)
        fastest = COMMAND_LIMITS.catch_up_factor * self.config.flight.speed_limit
        if far <= COMMAND_LIMITS.line_lag + fastest * command.flat[4]:
            return command
        return XYZ("line", np.array([*command.flat[0:4], far / fastest]))

    def _transmit(self, command: Command) -> None:
        connection = self.connection
        assert connection is not None  # noqa: S101 - callers have looked
        try:
            packets = self.handler.packets(command)
        except CodecError as error:
            self.malformed += 1
            self._say("malformed", f"not sent: {error}")
            return
        if len(packets) == 1 and (
            not isinstance(command, XYZ) or command.verb == "line"
        ):
            connection.newest("command", packets[0])
        else:
            # A set-point after the plan would take control from the planner.
            connection.forget("command")
            self._send_now(packets)

    def _arm(self) -> None:
        """Arm the drone, once a flight: its motors wait for this."""
        if (
            self.supervisor & checks.ReadinessBit.ARMED
            or self._arming
            or self.connection is None
        ):
            return
        self._arming = True
        self._do(self._armed(self.connection))

    async def arm(self) -> str:
        """Arm the drone before its first command does; return a text about the result.

        The firmware disarms again after a while without a flight; then the first command arms the
        drone.
        Raises Refused if the drone cannot be armed.
        """
        if not self._platform.firmware.needs_arming:
            return "ready: its firmware needs no arming"
        if self.connection is None or self._cut:
            raise Refused(
                f"drone {self.drone}", self.problem or self.why or "its motors were cut"
            )
        try:
            await Firmware(self.connection).arm()
        except LinkFailed as error:
            raise Refused(f"drone {self.drone}", str(error)) from error
        return "armed"

    async def _armed(self, connection: Connection) -> None:
        try:
            await Firmware(connection).arm()
        except LinkFailed as error:
            self._say("arm", str(error))
        finally:
            self._arming = False

    def cut(self) -> None:
        """Stop the motors for good.

        The packet is repeated until the drone is locked or was switched off and on.
        """
        self._cut = True
        if self._cut_heard:
            return
        if (way := self.connection or self._opening) is not None:
            way.urgent(emergency_packets())

    def _send_now(self, packets: Iterable[Packet]) -> None:
        for packet in packets if self.connection is not None else ():
            self.connection.send(packet)  # type: ignore[union-attr]

    def _seen(self, pose: Pose, age: float) -> None:
        """Take a pose from the cameras, and send it to the drone's estimator.

        With this estimate the drone lands if this process fails.
        """
        if not self._gate.believes(pose, self.clock.now(), self.flying):
            self._say(
                "jump",
                "its pose jumps (another body, or an error of the cameras): it is not sent to the estimator",
            )
            self._jumped_at = min(self._jumped_at, self.clock.now())
            if (
                self._take_off is not None
                and self.clock.now() - self._jumped_at > CAMERA_POSE_LIMITS.longest_jump
            ):
                self._take_off.give_up()
            return
        self.place = (self.clock.now() - age, pose)
        self._jumped_at = math.inf
        if self._astray():
            return  # the drone lands with its own sensors
        if (
            age <= CAMERA_POSE_LIMITS.oldest_sent
            and self.connection is not None
            and self._told.passes(self.clock.now())
        ):
            watched = self._take_off is not None and self._take_off.watched
            try:
                self.connection.newest(
                    "pose", position_packet(pose) if watched else pose_packet(pose)
                )
            except CodecError:
                self.malformed += 1

    def ask(self, names: Iterable[str], period: float) -> None:
        """Let the drone log these variables too, from now on.

        Unknown variables are reported in the log.

        period: s
        """
        check_log_period(period, f"drone {self.drone}: log")
        self._asked[tuple(names)] = period
        if self.connection is not None:
            self._do(self._begin_asked(self.connection, tuple(names), period))

    async def _begin_asked(
        self, connection: Connection, names: tuple[str, ...], period: float
    ) -> None:
        try:
            await connection.log(
                "asked",
                names,
                period,
                self._take_asked,
                CONNECT_ATTEMPTS.reopen_deadline,
            )
        except LinkFailed as error:
            self._say("log", str(error))

    async def _begin_all_asked(self, connection: Connection) -> None:
        for names, every in list(self._asked.items()):
            await self._begin_asked(connection, names, every)

    def _do(self, work: Any) -> None:
        """Run a coroutine in the background."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks = [other for other in self._tasks if not other.done()] + [task]

    async def on_stop(self) -> None:
        """Cancel the work in the background."""
        for task in self._tasks:
            task.cancel()

    # What the drone answers -----------------------------------------------------------------------

    def _heard(self, packet: Packet) -> None:
        if packet.port != CrtpPort.HIGH_LEVEL or len(packet.data) < 4:
            return
        result = packet.data[3]
        if packet.data[:1] == PACKET_FORMS["land"].head and self._landing is not None:
            if self._told_ns is None:
                return  # the answer to an earlier landing, which has been ended since
            if result in REPEAT_RULES.landing_results:
                self._landed_at = min(
                    self._landed_at,
                    self.clock.now()
                    + float(self._landing.flat[4])
                    + REPEAT_RULES.stop_delay,
                )
                self._send_now(self.handler.relax)
                return
            self._landing_ns = self.clock.now_ns() + round(
                REPEAT_RULES.refused_pause * NS_PER_SECOND
            )
        if result != 0:
            self.refused_plans += 1
            self._say(
                "planner", f"its planner refuses command {packet.data[0]} with {result}"
            )

    def _take_own(self, values: dict[str, float], at: int) -> None:
        if self._uptime.restarted(self.clock.now(), at):
            self.why = "it has been started again"
            self._cut_heard = self._cut
            self._prepared = self._placed = self._fed = self._has_flown = False
            self.release = ""
            if self._take_off is not None:
                self._take_off.found = ""
            self._uptime = Uptime()
        if self._uptime.overtaken(at):
            return
        taken = self._uptime.taken(self.clock.now(), at)
        self._well = {name: values[name] for name in FIRMWARE_NAMES.health}
        self._cut_heard = self._cut_heard or (
            self._cut and bool(self.supervisor & SupervisorBit.LOCKED)
        )
        p = LOG_UNIT * np.array([values[name] for name in FIRMWARE_NAMES.estimate[0:3]])
        v = LOG_UNIT * np.array([values[name] for name in FIRMWARE_NAMES.estimate[3:6]])
        p, v, q = self._in_the_world(
            p, v, unpack_quaternion(int(values[FIRMWARE_NAMES.estimate[6]]))
        )
        self._own, self._own_ns = (
            State(np.array([*p, *v, *q, 0.0, 0.0, 0.0])),
            self.clock.now_ns(),
        )
        latency = math.nan if self.connection is None else self.connection.latency
        if self._take_off is not None and self._take_off.note(
            taken, q, self.flying, latency
        ):
            self.report()
        if not self.seen_by_cameras:
            self.port.publish(DRONE_TOPICS.pose, Pose(np.array([*p, *q])))
            self.port.publish(DRONE_TOPICS.truth, self._own)

    def _in_the_world(self, p: Vec, v: Vec, q: Vec) -> tuple[Vec, Vec, Vec]:
        """Return p, v and q in the world, from the frame of the drone's own estimate.

        That frame is the world if the drone is told the cameras' poses; otherwise [radio] gives its
        origin and yaw.
        """
        radio = self.config.radio
        if self.seen_by_cameras or (radio.origin_yaw == 0.0 and not any(radio.origin)):
            return p, v, q
        c = math.cos(radio.origin_yaw)
        s = math.sin(radio.origin_yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        a = quaternion_of_yaw(radio.origin_yaw).tolist()
        b = q.tolist()
        turned = np.array(
            quaternion_product((a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3]))
        )
        return turn @ p + np.array(radio.origin), turn @ v, turned

    def _take_spread(self, values: dict[str, float], at: int) -> None:
        self._spread = values

    def _take_asked(self, values: dict[str, float], at: int) -> None:
        self.port.publish(
            DRONE_TOPICS.telemetry,
            {name: [float(value), 0.0] for name, value in values.items()},
        )

    @property
    def supervisor(self) -> int:
        """Bits of the firmware's supervisor; 0 before the first log."""
        return int(self._well.get("supervisor.info", 0))

    @property
    def battery(self) -> float:
        """V; NaN before the first log."""
        return self._well.get("pm.vbat", math.nan)

    @property
    def silence(self) -> float:
        """Seconds since its last packet over any connection; infinite before the first."""
        way = self.connection
        return min(
            math.inf if way is None else way.silence, self.clock.now() - self._heard_at
        )

    @property
    def flying(self) -> bool:
        """Whether the motors turn, or have turned within 2 s."""
        return bool(self.supervisor & checks.ReadinessBit.FLYING)

    def problems(self) -> list[str]:
        """Return why the drone may not take off."""
        if self.connection is None:
            return [self.problem or self._comes()]
        if not (self._prepared and self._placed) and not self.flying:
            unseen = self.seen_by_cameras and self._pose.fresh() is None
            return ["the cameras do not see it" if unseen else "is being prepared"]
        begin = self._platform.battery.begin
        harm = self._harm()
        found = [harm] if harm else checks.supervisor_problems(self.supervisor)
        found += checks.battery_problems(self.battery, begin)
        found += [text + PROBLEM_TEXTS.wrong_body for text in self._astray()] + [
            PROBLEM_TEXTS.motors_cut
        ] * self._cut
        if self.flying:
            return found
        found += checks.link_problems(self.connection.latency, self.connection.answered)
        return found + (self._unseen() if self.seen_by_cameras else self._unsure())

    def _comes(self) -> str:
        """Return how far the link has come that is being opened."""
        if self._opening is None:
            return "is being connected"
        stage = self._opening.stage
        spoken = stage == AWAITING_LOG and self._own_ns > self._logs_ns
        return "is being prepared" if spoken else f"is being connected, {stage} so far"

    def _harm(self) -> str:
        """Return what has damaged or locked the drone; empty if nothing has.

        For a virtual drone the text also tells how to restart it.
        """
        switch = (
            self.row.uri.startswith("udp") and self.supervisor & SupervisorBit.LOCKED
        )
        hint = f" (`crazychoir virtual fault {self.drone} reboot=1`)" if switch else ""
        return checks.describe_harm(self.supervisor) + hint

    def _astray(self) -> list[str]:
        """Return the fault of the last take-off: the body does not move as the drone does."""
        return (
            [self._take_off.found]
            if self._take_off is not None and self._take_off.found
            else []
        )

    def _unseen(self) -> list[str]:
        own = (
            None
            if self._own is None
            else Pose(np.array([*self._own.p, *self._own.flat[6:10]]))
        )
        homes = (
            {}
            if self._has_flown
            else {j: np.array(self.config.drone(j).home) for j in self.config.seen}
        )
        drones = {j: GroundedDrone(home, None, None) for j, home in homes.items()}
        drones[self.drone] = GroundedDrone(
            homes.get(self.drone), own, self._pose.fresh()
        )
        return find_arming_problems(self.drone, drones)

    def _unsure(self) -> list[str]:
        """Return why a drone without cameras does not know its position well enough."""
        return checks.spread_problems(
            [self._spread.get(name, math.nan) for name in FIRMWARE_NAMES.variances]
        )

    def status(self) -> LinkStatus:
        """Return the state of the link for its agent and for observers."""
        way = self.connection
        known = (
            {}
            if way is None
            else {"latency": way.latency, "answered": way.answered, "rssi": way.rssi}
        )
        return LinkStatus(
            self.state_of_link,
            self.silence,
            battery=float(self.battery),
            supervisor=self.supervisor,
            flying=self.flying,
            problems=self.problems(),
            release=self.release,
            refused=self.refused_plans,
            reconnected=self.reconnected,
            astray="; ".join(self._astray()),
            **known,
        )

    def report(self) -> None:
        """Publish the state of the link and of the body."""
        self._has_flown = self._has_flown or self.flying
        self.port.publish(DRONE_TOPICS.link, self.status())
        if self._own_ns:  # before the first log it is unknown whether the drone flies
            self.port.publish(
                DRONE_TOPICS.body, Body(self._harm(), self.flying and not self._cut)
            )

    # What the body asks ---------------------------------------------------------------------------

    def resting(self, i: int) -> bool:
        """Return whether the drone stands.

        The firmware says so 2 s after the motors have stopped; here it counts from the command to
        stop.
        """
        return not self.flying or self._stopped

    def state(self, i: int) -> State:
        """Return the last recent pose from the cameras, at rest.

        Without such a pose it is the drone's own estimate, or its home before the first log.
        """
        if (
            self.place is not None
            and self.clock.now() - self.place[0] < CAMERA_POSE_LIMITS.oldest_used
        ):
            pose = self.place[1]
            return State(np.array([*pose.p, 0.0, 0.0, 0.0, *pose.q, 0.0, 0.0, 0.0]))
        return self._own or State.at(self.row.home)

    def _say(self, topic: str, text: str) -> None:
        if self._said.due(self.clock.now(), topic):
            log.warning("drone %d: %s", self.drone, text)
