"""Repeat the command to land until the planner on board confirms it."""

import math

from crazychoir.control.senders import STOP_COMMAND
from crazychoir.firmware.results import FIRMWARE_RESULTS, LANDING_RESULTS
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.command_transmitter import CommandTransmitter
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.drone.timing import REPEAT_RULES
from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import XYZ


class LandingRepeater:
    """Repeats the command to land, and the command to stop after it, because packets get lost."""

    def __init__(
        self,
        setup: DroneSetup,
        link: CurrentLink,
        estimate: OwnEstimate,
        transmitter: CommandTransmitter,
    ) -> None:
        self.command: XYZ | None = None
        """The command to land; None if the drone is not to land."""
        self.refused_plans = 0
        """Count of commands that the planner on board has refused."""
        self._setup = setup
        self._clock = setup.clock
        self._link = link
        self._estimate = estimate
        self._transmitter = transmitter
        self._due_ns = 0
        # ns: when the drone was told to land over a link that may have carried it.
        self._told_ns: int | None = None
        # s: when the landing is over; infinite before the planner has answered.
        self._landed_at = math.inf

    def begin(self, command: XYZ) -> None:
        """Begin to land with this command; a second landing does not change the first."""
        if self.command is None or self._link.connection is None:
            self.command = self.command or command
            self._due_ns = 0

    def forget(self) -> None:
        """End the landing: another command follows, or the drone stands."""
        self.command = None
        self._landed_at = math.inf
        self._told_ns = None

    def go_on(self) -> None:
        """Repeat the command to land until the planner on board confirms it.

        After that, repeat that no more set-points follow, until the landing should be over and its plan
        has ended on board. Then repeat the command to stop.
        """
        if self.command is None:
            return
        if not self._estimate.is_flying:
            self.forget()
            return
        now_ns = self._clock.now_ns()
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + round(REPEAT_RULES.land_period * NS_PER_SECOND)
        if math.isinf(self._landed_at):
            if self._told_ns is None or self._link.is_quiet():
                self._told_ns = now_ns
            self._transmitter.transmit(self.command)
        elif self._is_landing():
            self._transmitter.relax()
        else:
            self._due_ns = now_ns + round(REPEAT_RULES.stop_period * NS_PER_SECOND)
            self._transmitter.transmit(STOP_COMMAND)

    def is_under_way(self) -> bool:
        """Return whether the drone lands, or will land when the command arrives.

        Its motors must not be stopped before that.
        """
        if self.command is None or not self._estimate.is_flying:
            return False
        if self._landed_at < math.inf:
            return self._is_landing()
        return (
            self._link.is_quiet()
            or self._told_ns is None
            or self._clock.now_ns() - self._told_ns
            < REPEAT_RULES.vain_time * NS_PER_SECOND
        )

    def _is_landing(self) -> bool:
        """Return whether the landing that the planner has confirmed is not over.

        It may take longer than planned, as in a virtual drone on a loaded machine, and a stop of the motors would
        let the drone fall. So the firmware is believed that its planner still flies the drone, but not for ever,
        and only while the drone is heard.
        """
        late = self._clock.now() - self._landed_at
        if late < 0.0:
            return True
        bits = self._estimate.supervisor
        is_planned = bool(bits & SUPERVISOR_BITS.planned)
        has_ended = bool(bits & SUPERVISOR_BITS.plan_ended)
        is_believed = late < REPEAT_RULES.longest_overrun and not self._link.is_quiet()
        return is_planned and not has_ended and is_believed

    def hear(self, packet: Packet) -> None:
        """Take an answer of the planner on board; other packets are ignored."""
        if packet.port != CrtpPort.HIGH_LEVEL or len(packet.data) < 4:
            return
        result = packet.data[3]
        if packet.data[:1] == PACKET_FORMS["land"].head and self.command is not None:
            if self._told_ns is None:
                return  # the answer to an earlier landing, which has been ended since
            if result in LANDING_RESULTS:
                self._confirm(self.command)
                return
            self._due_ns = self._clock.now_ns() + round(
                REPEAT_RULES.refused_pause * NS_PER_SECOND
            )
        if result != FIRMWARE_RESULTS.done:
            self.refused_plans += 1
            self._setup.warn(
                "planner", f"its planner refuses command {packet.data[0]} with {result}"
            )

    def _confirm(self, command: XYZ) -> None:
        """Note when the landing that the planner has confirmed will be over."""
        duration = float(command.flat[4])
        over = self._clock.now() + duration + REPEAT_RULES.stop_delay
        self._landed_at = min(self._landed_at, over)
        self._transmitter.relax()
