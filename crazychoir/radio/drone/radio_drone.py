"""One drone that a dongle reaches: connected, told where it is, flown, and connected again when its link fails.

For the body that obeys its agent (simulation/remote.py) it is both the link to the drone and the place where it is.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Coroutine, Iterable
from typing import Any

import numpy as np

from crazychoir.bus.port import BODIES, EYES, Bus
from crazychoir.bus.topics import BODY, LINK, POSE, TELEMETRY, TRUTH
from crazychoir.config.radio_checks import MOTION, SPREADS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.control.senders import STOP
from crazychoir.errors import CodecError, ConfigError, LinkFailed, Refused
from crazychoir.mocap.view import RateLimit
from crazychoir.numerics.math3d import product, quaternion_of_yaw, yaw_of
from crazychoir.platforms import platform
from crazychoir.radio import checks
from crazychoir.radio.link.connection import WORDLESS, Connection
from crazychoir.radio.link.dongles import DongleFailed
from crazychoir.radio.link.firmware import Firmware
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.compressed import quaternion
from crazychoir.radio.protocol.crtp import FORMS, HIGH_LEVEL, Packet
from crazychoir.radio.protocol.handlers import (
    HANDLERS,
    RadioHandler,
    emergency,
    idles,
    pose_packet,
    position_packet,
)
from crazychoir.radio.protocol.thrust import command_a_newton
from crazychoir.radio.protocol.version_check import check_protocol
from crazychoir.radio.uptime import Uptime
from crazychoir.radio.visibility import RATE, Sights, TakeOff
from crazychoir.runtime.actor import ON_FAILURE, Actor
from crazychoir.runtime.clock import SECOND
from crazychoir.runtime.mailbox import Call, Latest
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.safety.identity.preflight_check import Standing, before_arming
from crazychoir.safety.rules.guard import Throttle
from crazychoir.simulation.telemetry import check_period
from crazychoir.types import XYZ, Body, Command, LinkStatus, Pose, State, Vec

log = logging.getLogger(__name__)
DEGRADED, LOST = 0.3, 2.5
"""s of silence after which a link is called so; after the second it is opened anew. Before, set-points go on leaving:
the firmware takes the first one that gets through, if it comes within 2 s."""
UNREACHED = 1.0
"""s of silence after which a drone that flies on by itself may not have obeyed what it was told last."""
ON_THE_FLOOR = 0.2
"""m above the ground, below which a drone that is seen stands, or may fall."""
LOOKS = 20.0
"""Hz, at which links are looked after."""
FIRST, AGAIN = 0.2, 1.0
"""s between two attempts to connect: until the deadline, and after it."""
REOPENS = 1.5
"""s that an attempt gets in flight: tables are known by then."""
TABLES = 30.0
"""s more that one gets that answers and is being told of, before its first flight: over a dongle that four share about
10 s of tables of contents, once a firmware."""
FORGOTTEN = 1.0
"""s without a log of one that answers otherwise: its firmware has dropped its blocks, as after 1 s of silence."""
UNHEARD, REFUSED, ORPHANED = 0.25, 1.0, 3.0
"""s between two words to land: until its planner answers, and where it refuses; and after which one that flies, and
that nobody commands, is landed."""
LANDING = (0, 1)
"""Results in the answers of one that lands now, or does so already."""
LANDED = 1.0
"""s later than a landing takes: its planner has ended it, and is not told to land any more, as it would begin anew."""
IN_VAIN = 3.0
"""s of words to land that are not answered, by one that is heard, after which its motors may be stopped instead."""
STOPS = 0.5
"""s between two plans to stop, of a drone that stands."""
WATCHDOG = 0.25
"""s between two words for the emergency-stop watchdog, which wants one a second."""
NEWEST = 0.1
"""s: an older pose is not told to a drone."""
LATELY = 1.0
"""s for which it counts where the cameras have seen it."""
JUMPS = 0.1
"""s for which poses jump until nothing can be told from how the body tilts."""
UNSEEN = 0.5
"""s without a pose after which it counts as not seen, however seldom poses are asked for."""
REMEDY = ": put its body right, out of the cameras' sight, or switch it off and on"
WAS_CUT = "its motors were cut: switch it off and on, and start the owner of its dongle (crazychoir-radio) again"
TRAILS, CATCHES_UP = 0.5, 1.8
"""m by which a drone may be behind the line that it flies; and of speed_limit, at which it comes to one that it is
further from: it has not heard those before."""
MILLI = 1e-3
OWN = (
    "stateEstimateZ.x",
    "stateEstimateZ.y",
    "stateEstimateZ.z",
    "stateEstimateZ.vx",
    "stateEstimateZ.vy",
    "stateEstimateZ.vz",
    "stateEstimateZ.quat",
)
WELL = ("pm.vbat", "supervisor.info")
POSITIONING = ("bcLighthouse4", "bcDWM1000", "bcLoco", "bcFlow2", "bcFlow")
COMMON = POSITIONING[:3]
"""Decks by which a drone knows where it is, by their parameters' names; and those in whose frame all drones are."""
SPREAD = ("kalman.varX", "kalman.varY", "kalman.varZ")


class RadioDrone(Actor):
    """Drone i of a swarm, whose agent's commands come to its body's port.

    kind: of commands;  rate: Hz of set-points;  contents: shared by all links of the process;  turn: waits
    until a packet may be sent;  sights: shared, too, None: its own.
    """

    name = "radio"
    restart = ON_FAILURE
    flies: tuple[str, ...] = ("xyz",)
    command_timeout: float | None = None

    def __init__(
        self,
        bus: Bus,
        config: SwarmConfig,
        i: int,
        kind: str,
        rate: float,
        contents: TableOfContents,
        turn: Callable[[], None] = lambda: None,
        sights: Sights | None = None,
    ) -> None:
        self.bus = bus
        self.clock = bus.clock
        self.config = config
        self.drone = i
        self.kind = kind
        self.port = bus.ports[BODIES + i]
        self.rate = rate
        self._contents = contents
        self._turn = turn
        self.row, self._platform = config.drone(i), platform(config.drone(i).platform)
        self.seen_by_cameras = self.row.pose == "mocap"
        self.connection: Connection | None = None
        self._opening: Connection | None = (
            None  # its link is being opened, or it is being asked who it is
        )
        self._work: asyncio.Task[None] | None = None
        self.handler: RadioHandler = HANDLERS[kind](self._platform)
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
        self._told_ns: int | None = (
            None  # when it was told to land, and may have heard it
        )
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
        self._pose: Latest[Pose] = Latest(self.clock, f"drone {i} pose", UNSEEN)
        self._take_off: TakeOff | None = None
        if self.seen_by_cameras:
            here = self.port.address
            self._take_off = TakeOff(i, sights or Sights(bus, config, here))
            self._told = RateLimit(config.radio.pose_rate)
            bus.subscribe(POSE, EYES + i, here, self._pose, RATE)
            bus.subscribe(
                POSE, EYES + i, here, Call(self.clock, self._seen, "pose"), RATE
            )

    # Its life -----------------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Connect, look after the link, connect again."""
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
            await self.clock.sleep(AGAIN if late and not self.flying else FIRST)

    async def _connect(self, connection: Connection, began: float) -> None:
        self._opening = connection
        deadline = self.config.radio.connect_deadline
        left = max(began + deadline - self.clock.now(), deadline / 4.0)
        await connection.open(
            REOPENS if self._prepared else left, 0.0 if self._prepared else TABLES
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
        self.connection, self._opening, self._up_ns = (
            connection,
            None,
            self.clock.now_ns(),
        )
        self.reconnected += self.state_of_link == "lost"
        self._change("up", self._only_lands)
        self._work = asyncio.get_running_loop().create_task(
            self._begin_all_asked(connection)
        )

    def _too_old(self, connection: Connection) -> ConfigError | None:
        """Why its firmware does not know what it would be sent."""
        try:
            check_protocol(
                connection.version, self.kind, self._platform, f"drone {self.drone}"
            )
        except ConfigError as error:
            return error
        return None

    async def _check(self, firmware: Firmware, refused: ConfigError | None) -> None:
        """ConfigError if it cannot be flown; one that flies, as somebody has left it, is landed first."""
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
        """One whose motors were cut is told so until it says that it has heard it, from its link's opening on."""
        async for _ in self.clock.ticks(LOOKS):
            if self._cut and not self._cut_heard:
                connection.urgent(emergency())

    async def _until_told(self, connection: Connection) -> None:
        """It has said whether it flies: somebody may have flown it there."""
        for _ in range(round(REOPENS * LOOKS)):
            if self._own_ns > self._logs_ns:
                return
            await self.clock.sleep(1.0 / LOOKS)
        raise LinkFailed(connection.uri, f"says nothing of itself within {REOPENS:g} s")

    def _learn_thrust(self, release: str) -> None:
        """What a newton is on board; ConfigError if that is not known."""
        if self.handler.needs_thrust:
            given = self.config.radio.thrust_map
            where = f"drone {self.drone}"
            self.handler.thrust = command_a_newton(
                release, self._platform, given, where
            )

    async def _prepare(self, firmware: Firmware) -> None:
        """What is done once, on the ground."""
        await firmware.set_all({"stabilizer.estimator": 2} | self.handler.parameters)
        await firmware.set_all(self.config.radio.parameters | self.row.parameters)
        if not self.seen_by_cameras:
            await self._require_frame(firmware)
            await self._place(firmware, np.array(self.row.home), self.row.yaw)
        self._prepared = True

    async def _require_frame(self, firmware: Firmware) -> None:
        """Several drones need one frame: that of a flow deck is its own, and drifts; ConfigError unless it may."""
        if self.config.radio.drift or len(self.config.ids) == 1:
            return
        decks = [deck for deck in POSITIONING if await firmware.has(f"deck.{deck}")]
        if not any(deck in COMMON for deck in decks):
            found = f"{', '.join(decks) or 'no deck'} on board: its frame drifts from that of the others"
            do = "Set drift = true in [radio] if the mission bears that, or let the cameras see it."
            if self.row.uri.startswith("udp://"):
                do += " A virtual drone gets a deck from `crazychoir virtual`, started with this swarm file."
            raise ConfigError(
                f"drone {self.drone}: pose", found, f"one of {', '.join(COMMON)}", do
            )

    async def _place(self, firmware: Firmware, p: Vec, yaw: float) -> None:
        """Let its estimator begin here."""
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
        seconds = REOPENS
        period = 1.0 / (max(rate, MOTION) if self.seen_by_cameras else rate)
        self._logs_ns = self.clock.now_ns()
        await connection.log("own", (*OWN, *WELL), period, self._take_own, seconds)
        if not self.seen_by_cameras:
            await connection.log(
                "spread", SPREAD, 1.0 / SPREADS, self._take_spread, seconds
            )

    async def _begin_logs_again(self, connection: Connection) -> None:
        """It says nothing of itself any more, whatever blocks it has."""
        self._logs_ns = self.clock.now_ns()
        try:
            await connection.reset_logs(REOPENS)
            await self._begin_logs(connection)
        except LinkFailed as error:
            if not self.flying:
                raise
            self._say("log", str(error))  # its set-points may get through nevertheless
        await self._begin_all_asked(connection)

    async def _look_after(self, connection: Connection) -> None:
        """Until it is silent for too long."""
        async for _ in self.clock.ticks(LOOKS, drone=self.drone):
            if self.why:
                raise LinkFailed(self.row.uri, self.why)
            if gone := connection.dongle_failure:
                raise DongleFailed(self.row.uri, gone)
            if self._only_lands and not self.flying:
                raise LinkFailed(self.row.uri, self._only_lands)
            if self.bus.stopped and self.flying and not self._cut:
                self.cut()
            silence = connection.silence
            if silence > LOST:
                raise LinkFailed(self.row.uri, f"silent for {silence:.1f} s")
            self.state_of_link = "degraded" if silence > DEGRADED else "up"
            if silence > UNREACHED:
                self._flown_here, self._up_ns = False, self.clock.now_ns()
            if failure := connection.failure:
                self._say("sending", f"a packet could not be sent: {failure}")
            if self.flying and (
                late := checks.link_problems(connection.latency, connection.answered)
            ):
                self._say("late", f"{'; '.join(late)}: what it is told comes late")
            self._feed_watchdog()
            self._go_on_landing()
            self._forgive()
            self._work_on(connection, silence)

    def _work_on(self, connection: Connection, silence: float) -> None:
        """What waits for answers is done beside, one thing at a time; raises what the last one has."""
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
        if (
            silence < DEGRADED
            and self.clock.now_ns() - max(self._own_ns, self._logs_ns)
            > FORGOTTEN * SECOND
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
        """Its link is gone, and with it the answers."""
        work = self._work
        self._work = None
        if work is not None:
            work.cancel()
            await asyncio.wait([work])
            _ = (
                work.cancelled() or work.exception()
            )  # whatever it was: the link has failed

    def _forgive(self) -> None:
        """Whoever has put its body right has had it out of the cameras' sight: it is judged anew when it takes off."""
        if (
            self._take_off is not None
            and not self.flying
            and self._pose.fresh() is None
        ):
            self._take_off.found = ""

    def _feed_watchdog(self) -> None:
        """The choice of [radio] watchdog: without us it is to cut its motors."""
        now_ns = self.clock.now_ns()
        self._fed = self._fed or (
            self.config.radio.watchdog and self.kind == "xyz" and self.flying
        )
        if (
            self._fed and now_ns >= self._watchdog_ns
        ):  # once begun it must go on, on the ground too
            self._watchdog_ns = now_ns + round(WATCHDOG * SECOND)
            self._send_now([FORMS["emergency_stop_watchdog"].packet()])

    def _go_on_landing(self) -> None:
        """Who has been told to land is told again until its planner does: a packet may be lost, and a link.

        From then on it is told that set-points have ended, until its landing has, and then to stop.
        """
        now_ns = self.clock.now_ns()
        if not self.flying or self._landing is None:
            self._landing = None
            self._landed_at = math.inf
            self._told_ns = None
        elif now_ns >= self._landing_ns:
            self._landing_ns = now_ns + round(UNHEARD * SECOND)
            if math.isinf(self._landed_at):
                if self._told_ns is None or self._silent():
                    self._told_ns = now_ns
                self._transmit(self._landing)
            elif self.clock.now() < self._landed_at:
                self._send_now(self.handler.relax)
            else:
                self._landing_ns = now_ns + round(STOPS * SECOND)
                self._transmit(STOP)

    @property
    def orphan(self) -> bool:
        """Whether it flies, this owner could tell it what to do, and nobody does."""
        up = (
            self.connection is not None
            and self.clock.now_ns() - self._up_ns > ORPHANED * SECOND
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
    """Why its link is not up."""
    place: tuple[float, Pose] | None = None
    """When, s, and where the cameras have seen it last, and were believed."""

    def _lost(self, reason: str) -> None:
        """From its connection: the driver has given up."""
        self.why = reason

    # What it is told ------------------------------------------------------------------------------------------------

    def send(self, command: Command) -> None:
        """Let the drone obey this: a set-point if it is time for one, a plan at once."""
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
            idles(command) and (self._flies_unheard() or self._comes_down())
        ):
            return  # it flies, and who sends may not know
        now_ns = self.clock.now_ns()
        stops = idles(command)
        if isinstance(command, XYZ):
            if stops and now_ns < self._stop_due_ns:
                return
            self._stop_due_ns = now_ns + round(STOPS * SECOND) if stops else 0
        elif now_ns < self._due_ns:
            return
        else:
            period_ns = round(SECOND / (self.rate or LOOKS))
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
        """Whether it flies on, as it says, though nobody here has reached it with a command; on the floor it stands."""
        low = self.config.flight.ground + ON_THE_FLOOR
        stands = (
            self.place is not None
            and self.clock.now() - self.place[0] < LATELY
            and self.place[1].p[2] < low
        )
        return self.flying and not self._flown_here and not stands

    def _comes_down(self) -> bool:
        """Whether it lands, or will as soon as it hears: it needs nobody who stops its motors before."""
        if self._landing is None or not self.flying:
            return False
        if self._landed_at < math.inf:
            return self.clock.now() < self._landed_at
        return (
            self._silent()
            or self._told_ns is None
            or self.clock.now_ns() - self._told_ns < IN_VAIN * SECOND
        )

    def _silent(self) -> bool:
        return self.connection is None or self.connection.silence > DEGRADED

    def _within_reach(self, command: Command) -> Command:
        """A line that ends far from where the drone is gets the time for it."""
        here = (
            self.place[1].p
            if self.place is not None and self.clock.now() - self.place[0] < LATELY
            else None
        )
        here = self._own.p if here is None and self._own is not None else here
        if here is None or not isinstance(command, XYZ) or command.verb != "line":
            return command
        far = math.dist(command.flat[0:3], here)
        fastest = CATCHES_UP * self.config.flight.speed_limit
        if far <= TRAILS + fastest * command.flat[4]:
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
            connection.forget(
                "command"
            )  # a set-point after it would take the drone from its planner
            self._send_now(packets)

    def _arm(self) -> None:
        """Once for a flight: its motors wait for it."""
        if self.supervisor & checks.ARMED or self._arming or self.connection is None:
            return
        self._arming = True
        self._do(self._armed(self.connection))

    async def arm(self) -> str:
        """Let its motors turn before its first command does; raises Refused with why not.

        Its firmware takes that back after a while without a flight; the first command arms it again.
        """
        if not self._platform.firmware.needs_arming:
            return "ready: its firmware waits for no arming"
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
        """Stop the motors for good: said until it is locked, or has been switched off and on."""
        self._cut = True
        if self._cut_heard:
            return
        if (way := self.connection or self._opening) is not None:
            way.urgent(emergency())

    def _send_now(self, packets: Iterable[Packet]) -> None:
        for packet in packets if self.connection is not None else ():
            self.connection.send(packet)  # type: ignore[union-attr]

    def _seen(self, pose: Pose, age: float) -> None:
        """The cameras have seen it: its own estimator, by which it lands if we fail, is told."""
        if not self._gate.believes(pose, self.clock.now(), self.flying):
            self._say(
                "jump",
                "its pose jumps: another body's, or a mistake of the cameras: its estimator is not told",
            )
            self._jumped_at = min(self._jumped_at, self.clock.now())
            if (
                self._take_off is not None
                and self.clock.now() - self._jumped_at > JUMPS
            ):
                self._take_off.give_up()
            return
        self.place = (self.clock.now() - age, pose)
        self._jumped_at = math.inf
        if self._astray():
            return  # it lands by its own sensors
        if (
            age <= NEWEST
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
        """From now on it says these log variables too; what it does not have is said in the log."""
        check_period(period, f"drone {self.drone}: log")
        self._asked[tuple(names)] = period
        if self.connection is not None:
            self._do(self._begin_asked(self.connection, tuple(names), period))

    async def _begin_asked(
        self, connection: Connection, names: tuple[str, ...], period: float
    ) -> None:
        try:
            await connection.log("asked", names, period, self._take_asked, REOPENS)
        except LinkFailed as error:
            self._say("log", str(error))

    async def _begin_all_asked(self, connection: Connection) -> None:
        for names, every in list(self._asked.items()):
            await self._begin_asked(connection, names, every)

    def _do(self, work: Any) -> None:
        """In the background, until it is done."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks = [other for other in self._tasks if not other.done()] + [task]

    async def on_stop(self) -> None:
        """Nothing is left behind."""
        for task in self._tasks:
            task.cancel()

    # What it says -----------------------------------------------------------------------------------------------------

    def _heard(self, packet: Packet) -> None:
        if packet.port != HIGH_LEVEL or len(packet.data) < 4:
            return
        result = packet.data[3]
        if packet.data[:1] == FORMS["land"].head and self._landing is not None:
            if self._told_ns is None:
                return  # of a landing before this one, that has been ended since
            if result in LANDING:
                self._landed_at = min(
                    self._landed_at,
                    self.clock.now() + float(self._landing.flat[4]) + LANDED,
                )
                self._send_now(self.handler.relax)
                return
            self._landing_ns = self.clock.now_ns() + round(REFUSED * SECOND)
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
        self._well = {name: values[name] for name in WELL}
        self._cut_heard = self._cut_heard or (
            self._cut and bool(self.supervisor & checks.LOCKED)
        )
        p = MILLI * np.array([values[name] for name in OWN[0:3]])
        v = MILLI * np.array([values[name] for name in OWN[3:6]])
        p, v, q = self._in_the_world(p, v, quaternion(int(values[OWN[6]])))
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
            self.port.publish(POSE, Pose(np.array([*p, *q])))
            self.port.publish(TRUTH, self._own)

    def _in_the_world(self, p: Vec, v: Vec, q: Vec) -> tuple[Vec, Vec, Vec]:
        """From the frame of the drone's own estimate: that of the cameras if it is told their poses, else [radio]'s."""
        radio = self.config.radio
        if self.seen_by_cameras or (radio.origin_yaw == 0.0 and not any(radio.origin)):
            return p, v, q
        c = math.cos(radio.origin_yaw)
        s = math.sin(radio.origin_yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        a = quaternion_of_yaw(radio.origin_yaw).tolist()
        b = q.tolist()
        turned = np.array(product((a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3])))
        return turn @ p + np.array(radio.origin), turn @ v, turned

    def _take_spread(self, values: dict[str, float], at: int) -> None:
        self._spread = values

    def _take_asked(self, values: dict[str, float], at: int) -> None:
        self.port.publish(
            TELEMETRY, {name: [float(value), 0.0] for name, value in values.items()}
        )

    @property
    def supervisor(self) -> int:
        """Bits of its firmware's supervisor; 0 before it has said them."""
        return int(self._well.get("supervisor.info", 0))

    @property
    def battery(self) -> float:
        """V; NaN before it has said it."""
        return self._well.get("pm.vbat", math.nan)

    @property
    def silence(self) -> float:
        """s since its last packet, by whatever connection; infinite before the first."""
        way = self.connection
        return min(
            math.inf if way is None else way.silence, self.clock.now() - self._heard_at
        )

    @property
    def flying(self) -> bool:
        """Whether its motors turn, or have within 2 s."""
        return bool(self.supervisor & checks.FLYING)

    def problems(self) -> list[str]:
        """Why it may not take off."""
        if self.connection is None:
            return [self.problem or self._comes()]
        if not (self._prepared and self._placed) and not self.flying:
            unseen = self.seen_by_cameras and self._pose.fresh() is None
            return ["the cameras do not see it" if unseen else "is being prepared"]
        begin = self._platform.battery.begin
        harm = self._harm()
        found = [harm] if harm else checks.supervisor_problems(self.supervisor)
        found += checks.battery_problems(self.battery, begin)
        found += [text + REMEDY for text in self._astray()] + [WAS_CUT] * self._cut
        if self.flying:
            return found
        found += checks.link_problems(self.connection.latency, self.connection.answered)
        return found + (self._unseen() if self.seen_by_cameras else self._unsure())

    def _comes(self) -> str:
        """How far its link has come, which has not failed."""
        if self._opening is None:
            return "is being connected"
        stage = self._opening.stage
        spoken = stage == WORDLESS and self._own_ns > self._logs_ns
        return "is being prepared" if spoken else f"is being connected, {stage} so far"

    def _harm(self) -> str:
        """What has broken it, empty if nothing has; of a virtual one, how it is switched off and on."""
        switch = self.row.uri.startswith("udp") and self.supervisor & checks.LOCKED
        hint = f" (`crazychoir virtual fault {self.drone} reboot=1`)" if switch else ""
        return checks.harm(self.supervisor) + hint

    def _astray(self) -> list[str]:
        """What its last take-off has shown of the body that is taken for its own."""
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
        drones = {j: Standing(home, None, None) for j, home in homes.items()}
        drones[self.drone] = Standing(homes.get(self.drone), own, self._pose.fresh())
        return before_arming(self.drone, drones)

    def _unsure(self) -> list[str]:
        """Of one that is to know itself where it is."""
        return checks.spread_problems(
            [self._spread.get(name, math.nan) for name in SPREAD]
        )

    def status(self) -> LinkStatus:
        """For its agent, and who looks on."""
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
        """Publish how it is."""
        self._has_flown = self._has_flown or self.flying
        self.port.publish(LINK, self.status())
        if self._own_ns:  # before, nobody knows whether it flies
            self.port.publish(BODY, Body(self._harm(), self.flying and not self._cut))

    # What its body's port asks -----------------------------------------------------------------------------------

    def resting(self, i: int) -> bool:
        """Does it stand? Its firmware says so 2 s later than who has stopped its motors."""
        return not self.flying or self._stopped

    def state(self, i: int) -> State:
        """Where the cameras have seen it lately, and were believed, or else it takes itself to be."""
        if self.place is not None and self.clock.now() - self.place[0] < LATELY:
            pose = self.place[1]
            return State(np.array([*pose.p, 0.0, 0.0, 0.0, *pose.q, 0.0, 0.0, 0.0]))
        return self._own or State.at(self.row.home)

    def _say(self, topic: str, text: str) -> None:
        if self._said.due(self.clock.now(), topic):
            log.warning("drone %d: %s", self.drone, text)
