"""One virtual Crazyflie without I/O.

It takes packets, returns answers, and sends logs and texts as time passes.
"""

import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from crazychoir.firmware.release import DESCRIBED_RELEASE
from crazychoir.firmware.requests import LINK_CHANNELS
from crazychoir.firmware.timeouts import FIRMWARE_TIMEOUTS
from crazychoir.platforms import Platform
from crazychoir.radio.protocol.crtp import (
    CrtpPort,
    Packet,
)
from crazychoir.radio.protocol.receive_buffer import (
    FirmwareAssertion,
    ReceiveBuffer,
    check_sent,
)
from crazychoir.radio.virtual.console import FirmwareConsole
from crazychoir.radio.virtual.flight import FlightService, VersionService
from crazychoir.radio.virtual.logs import LogService
from crazychoir.radio.virtual.memories import LIGHTHOUSE_DECK, MemoryService
from crazychoir.radio.virtual.parameter_effects import WriteEffects
from crazychoir.radio.virtual.parameters import ParameterService
from crazychoir.radio.virtual.power import PowerManagement
from crazychoir.radio.virtual.readings import make_readings
from crazychoir.radio.virtual.tables import tables_of
from crazychoir.simulation.onboard.commander import SETPOINT_PRIORITIES
from crazychoir.simulation.onboard.logs import FIRMWARE_LOG_READERS
from crazychoir.simulation.onboard.onboard import Onboard

log = logging.getLogger(__name__)
SOURCE_ANSWER = b"Bitcraze Crazyflie".ljust(30, b"\0")
"""Answer to a request for the source of a link."""
FLIGHT_PORTS = (
    CrtpPort.COMMANDER,
    CrtpPort.SETPOINT,
    CrtpPort.HIGH_LEVEL,
    CrtpPort.LOCALIZATION,
    CrtpPort.SUPERVISOR,
    CrtpPort.PLATFORM,
)
"""Ports of packets that concern the flight."""


BOOT_TIME = 1000
"""ms after a restart in which a drone hears nothing."""
IGNORED_PLAN_TIME = 1000
"""ms after a plan until a warning that a set-point still has control. The plan then has no
effect.
"""


@dataclass(frozen=True, slots=True)
class ModelledDrone:
    """The decks that are modelled."""

    decks: tuple[str, ...] = ("bcFlow2", LIGHTHOUSE_DECK, "bcMultiranger")
    """Decks that a drone carries by default; the lighthouse deck gives it its position."""
    position_deck: str = LIGHTHOUSE_DECK
    """Deck that gives a drone its position."""
    velocity_deck: str = "bcFlow2"
    """Deck that gives a drone its velocity."""


MODELLED_DRONE = ModelledDrone()


@dataclass
class DroneIdentity:
    """The properties that distinguish a drone from others."""

    name: str = "virtual Crazyflie"
    """Name for log lines."""
    number: int = 0xE7
    """Last byte of its address."""
    release: str = DESCRIBED_RELEASE
    """Release of its firmware."""
    device: str = "Crazyflie 2.1"
    """Kind of drone, as the firmware tells it."""
    decks: tuple[str, ...] = ()
    """Decks that it carries."""


@dataclass
class PersistentContent:
    """Data that survive a restart."""

    parameters: dict[str, float] = field(default_factory=dict)
    """Persistent parameters, by name."""
    memories: dict[int, bytearray] = field(default_factory=dict)
    """Memories, by type."""


def device_name_of(platform: Platform) -> str:
    """Return the kind of drone that a drone of this platform tells (platformConfigGetDeviceTypeName)."""
    return f"{DroneIdentity.device}{' Brushless' if platform.firmware.needs_arming else ''}"


class VirtualCrazyflie:
    """The answers of the firmware; its model flies the body in a world that the caller steps.

    onboard: model of the firmware
    identity: properties of the drone
    truth: returns the position of the body, m, world
    """

    def __init__(
        self,
        onboard: Onboard,
        identity: DroneIdentity | None = None,
        truth: Callable[[], Sequence[float]] = lambda: (0.0, 0.0, 0.0),
    ) -> None:
        self.onboard = onboard
        self.identity = DroneIdentity() if identity is None else identity
        self.truth = truth
        self.kept = PersistentContent()
        self.starts = 0
        """Number of times that the drone was switched on."""
        self.received = 0
        """Packets received."""
        self.sent = 0
        """Packets sent."""
        self.rates = (0.0, 0.0)
        self._counted = (0, 0, 0)
        self._deaf_until = 0
        self._heard = 0
        self._start("")

    @property
    def decks(self) -> tuple[str, ...]:
        """Decks that the drone carries."""
        return self.identity.decks

    @property
    def has_position_deck(self) -> bool:
        """Whether the drone carries the deck that measures its position."""
        return MODELLED_DRONE.position_deck in self.decks

    @property
    def positioned(self) -> bool:
        """Whether a deck gives the estimator its position."""
        forwards = self.parameters.read("lighthouse.fwdToEstimator")
        return self.has_position_deck and bool(forwards)

    @property
    def flows(self) -> bool:
        """Whether a deck gives the estimator its velocity."""
        has_deck = MODELLED_DRONE.velocity_deck in self.decks
        return has_deck and not self.parameters.read("motion.disable")

    @property
    def uptime(self) -> int:
        """Milliseconds since the drone was switched on."""
        return int(self.onboard.record["tick"])

    @property
    def booting(self) -> bool:
        """Whether the drone still starts and hears nothing."""
        return self.uptime < self._deaf_until

    def _start(self, failure: str) -> None:
        me = self.identity
        on = self.onboard
        tables = tables_of(me.decks, on.firmware)
        self.starts += 1
        self.power = PowerManagement()
        self.console = FirmwareConsole(on)
        self._echoes: deque[tuple[int, Packet]] = deque()
        self.memories = MemoryService(
            on, self.kept.memories, me.number, me.decks, self._take_tester_reset
        )
        self.parameters = ParameterService(on, tables.parameters, self.kept.parameters)
        for deck in me.decks:
            self.parameters.set(f"deck.{deck}", 1.0)
        effects = WriteEffects(on, self.parameters, bool(failure), self.console.say)
        self.parameters.written = effects.apply
        self.flight = FlightService(
            on,
            me.number,
            VersionService(me.release, me.device),
            self.parameters.read,
            self.parameters.set,
        )
        self._readings = make_readings(self)
        self.logs = LogService(tables.logs, self.read_log)
        self._receiver = ReceiveBuffer()
        self.console.say_start(me.device, me.release, me.decks, failure)
        self.parameters.set("system.selftestPassed", float(not failure))
        self.parameters.restore()

    def computes(self, name: str) -> bool:
        """Return whether the drone or the firmware model computes a log variable."""
        return name in self._readings or name in FIRMWARE_LOG_READERS

    def read_log(self, name: str) -> float:
        """Return a log variable; 0 if neither the drone nor the firmware model computes it."""
        if name in self._readings:
            return self._readings[name]()
        return self.onboard.log(name) if name in FIRMWARE_LOG_READERS else 0.0

    def _take_tester_reset(self) -> bool:
        """Return whether memTst.resetW is set, and clear it."""
        is_set = self.parameters.read("memTst.resetW") != 0.0
        self.parameters.set("memTst.resetW", 0.0)
        return is_set

    def restart(self, why: str = "") -> None:
        """Switch the drone off and on.

        why: reason for this program's log
        """
        self.onboard.restart()
        self._begin_anew(why, "")

    def fail_assertion(self, failure: str) -> None:
        """Reset the drone as its firmware does when an assertion fails.

        Its motors stop and its link is lost. After the reset the drone answers, but its self-test
        fails: its sensors, estimator, supervisor and motors stay off until it is switched off and
        on (system.c, cfassert.c).

        failure: assertion that has failed
        """
        self.onboard.restart(is_tested=False)
        self._begin_anew(f"assertion failed: {failure}", failure)

    def _begin_anew(self, why: str, failure: str) -> None:
        counted = self.flight.zeros, self.flight.malformed, self.flight.unknown
        refuses = self.flight.refuses
        self.rates = (0.0, 0.0)
        self._counted = (0, self.received, self.sent)
        self._deaf_until = BOOT_TIME
        self._heard = 0
        self._start(failure)
        self.flight.zeros, self.flight.malformed, self.flight.unknown = counted
        self.refuse_arming(refuses)
        if why:
            log.warning("%s: reset: %s", self.identity.name, why)

    def _fail(self, where: str, error: Exception) -> None:
        log.error(
            "%s: %s: %s: %s",
            self.identity.name,
            where,
            type(error).__name__,
            error,
            exc_info=error,
        )
        self.restart(f"{where} has failed")

    def refuse_arming(self, refuses: bool) -> None:
        """Set whether the checks before flight fail; a flying drone flies on."""
        self.flight.refuses = refuses
        record = self.onboard.record
        record["auto_arm"] = not (refuses or self.onboard.firmware.needs_arming)
        if refuses and not record["flying"]:
            self.onboard.arm(False)

    def take(self, packet: Packet) -> Iterator[Packet]:
        """Return the answers to a packet.

        There are none while the drone starts, or if the packet makes it restart.
        """
        if self.booting:
            return
        self.received = self.received + 1
        self._heard = self.uptime
        try:
            for answer in self._take(packet):
                self.sent += 1
                yield check_sent(answer)
            if self.parameters.read("system.doAssert"):
                raise FirmwareAssertion("the parameter system.doAssert")
        except FirmwareAssertion as error:
            self.fail_assertion(str(error))
        except Exception as error:  # noqa: BLE001 - an error of one drone must not end the others
            self._fail(
                f"a packet of port {packet.port}, channel {packet.channel}", error
            )

    def _take(self, packet: Packet) -> Iterator[Packet]:
        port = packet.port
        received = self._receiver.receive(packet)
        if port in FLIGHT_PORTS:
            yield from self.flight.take(received)
        elif port == CrtpPort.LOG:
            yield from self.logs.take(received, self.uptime)
        elif port == CrtpPort.PARAMETERS:
            yield from self.parameters.take(packet)
        elif port == CrtpPort.MEMORY:
            yield from self.memories.take(received)
        elif port == CrtpPort.LINK and packet.channel == LINK_CHANNELS.echo:
            yield from self._echo(packet)
        elif port == CrtpPort.LINK and packet.channel == LINK_CHANNELS.source:
            yield Packet(CrtpPort.LINK, LINK_CHANNELS.source, SOURCE_ANSWER)
        elif port != CrtpPort.LINK:
            self.flight.unknown += 1

    def _echo(self, packet: Packet) -> Iterator[Packet]:
        """Return an echo at once, or send it later: each waits crtpsrv.echoDelay ms for itself."""
        delay = int(self.parameters.read("crtpsrv.echoDelay"))
        if delay == 0 and not self._echoes:
            yield packet
        else:
            last = self._echoes[-1][0] if self._echoes else self.uptime
            self._echoes.append((last + delay, packet))

    def pass_time(self) -> Iterator[Packet]:
        """Return the packets that the drone sends by itself, up to the time of its model."""
        try:
            for packet in self._says():
                self.sent += 1
                yield packet
        except Exception as error:  # noqa: BLE001 - an error of one drone must not end the others
            self._fail("what it says by itself", error)

    def _says(self) -> Iterator[Packet]:
        now = self.uptime
        self._watch(now)
        if self.booting:
            return
        if self.logs.running and now - self._heard > FIRMWARE_TIMEOUTS.link_silence:
            self.logs.blocks.clear()
        yield from self.console.take()
        while self._echoes and self._echoes[0][0] <= now:
            yield self._echoes.popleft()[1]
        yield from self.logs.due(now)

    def _watch(self, now: int) -> None:
        """Check the battery and the plans, and twice a second the packet rates."""
        self.console.watch(now)
        read = self.parameters.read
        vbat = float(self.onboard.record["vbat"])
        self.power.look(now, vbat, read("pm.lowVoltage"), read("pm.criticalLowVoltage"))
        if self.onboard.record["priority"] <= SETPOINT_PRIORITIES.high_level:
            self.flight.planned_at = None
        elif (
            self.flight.planned_at is not None
            and now - self.flight.planned_at > IGNORED_PLAN_TIME
        ):
            self.flight.planned_at = None
            told = "plans, but a set-point holds control: send_notify_setpoint_stop ends it"
            log.warning("%s: %s", self.identity.name, told)
        if self.flight.undefined is not None:
            log.warning(
                "%s: starts trajectory %d, which is not defined: "
                "its firmware answers 0 and does nothing",
                self.identity.name,
                self.flight.undefined,
            )
            self.flight.undefined = None
        then, received, sent = self._counted
        if now - then >= FIRMWARE_TIMEOUTS.link_statistics:
            seconds = 1e-3 * (now - then)
            self.rates = (
                (self.received - received) / seconds,
                (self.sent - sent) / seconds,
            )
            self._counted = (now, self.received, self.sent)
