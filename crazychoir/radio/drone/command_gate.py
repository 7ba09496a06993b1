"""Which commands a drone is sent, and when."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.radio.drone.camera_view import CameraView
from crazychoir.radio.drone.command_transmitter import CommandTransmitter
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.firmware_access import OnBoardTrajectory
from crazychoir.radio.drone.landing_repeater import LandingRepeater
from crazychoir.radio.drone.motor_switch import MotorSwitch
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.drone.timing import LINK_CHECK_RATE, REPEAT_RULES
from crazychoir.radio.protocol.handlers import is_idle_command
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import XYZ, Command, Vec


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


class CommandGate:
    """Lets the commands of an agent through to its drone when they are due and do no harm.

    It is the link to the drone for the body that obeys the agent (simulation/remote.py).
    """

    def __init__(
        self,
        setup: DroneSetup,
        link: CurrentLink,
        estimate: OwnEstimate,
        view: CameraView,
        landing: LandingRepeater,
        motors: MotorSwitch,
        transmitter: CommandTransmitter,
    ) -> None:
        self.has_stopped = True
        """Whether the last command asked for motors that are off."""
        self.has_flown_here = False
        """Whether a command of this process has reached the drone and let it fly."""
        self.on_board = OnBoardTrajectory(setup)
        """The trajectory that the planner on board flies by itself."""
        self._setup = setup
        self._clock = setup.clock
        self._link = link
        self._estimate = estimate
        self._view = view
        self._landing = landing
        self._motors = motors
        self._transmitter = transmitter
        self._setpoint_due_ns = 0
        self._stop_due_ns = 0

    def send(self, command: Command) -> None:
        """Send a command to the drone: a set-point when the next one is due, a plan at once."""
        if self._motors.is_cut:
            return
        if self.on_board.covers(command, self._find_position()):
            self._note_flight()
            return
        if isinstance(command, XYZ) and command.verb == "land":
            self._landing.begin(command)
            return
        link = self._link
        if link.only_lands or link.connection is None:
            return
        stops = is_idle_command(command)
        if stops and (self._flies_unheard() or self._landing.is_under_way()):
            return  # the drone flies, and the sender may not know it
        if not self._is_due(command, stops):
            return
        if not stops:
            self._begin_flight()
        self.has_stopped = stops
        if self._landing.command is not None:
            self._landing.forget()
        if not stops:
            self._note_flight()
        self._transmitter.transmit(self._slow_far_line(command))

    def cut(self) -> None:
        """Stop the motors for good."""
        self._motors.cut()

    def note_silence(self) -> None:
        """Note that the drone may not have obeyed its last command."""
        self.has_flown_here = False

    def _note_flight(self) -> None:
        """Note that the drone flies as this process commands, if it can be reached."""
        if not (self.has_flown_here or self._link.is_quiet()):
            self.has_flown_here = True

    def _is_due(self, command: Command, stops: bool) -> bool:
        """Return whether this command may leave now, and note when the next one may.

        stops: whether the command asks for motors that are off
        """
        now_ns = self._clock.now_ns()
        if isinstance(command, XYZ):
            if not stops:
                self._stop_due_ns = 0
                return True
            if now_ns < self._stop_due_ns:
                return False
            self._stop_due_ns = now_ns + round(REPEAT_RULES.stop_period * NS_PER_SECOND)
            return True
        if now_ns < self._setpoint_due_ns:
            return False
        period_ns = round(NS_PER_SECOND / (self._setup.rate or LINK_CHECK_RATE))
        self._setpoint_due_ns = max(
            self._setpoint_due_ns + period_ns, now_ns - period_ns // 2
        )
        return True

    def _begin_flight(self) -> None:
        """Arm motors that wait for it, and watch a take-off from its first command on."""
        if self._setup.platform.firmware.needs_arming:
            self._motors.arm_for_flight()
        take_off = self._view.take_off
        if take_off is not None and not self._estimate.is_flying:
            take_off.begin(self._clock.now())

    def _flies_unheard(self) -> bool:
        """Return whether the drone says that it flies, but no command of this process reached it.

        A drone on the floor does not count.
        """
        if self.has_flown_here or not self._estimate.is_flying:
            return False
        pose = self._view.find_recent_pose()
        low = self._setup.config.flight.ground + COMMAND_LIMITS.standing_height
        return pose is None or not pose.p[2] < low

    def _slow_far_line(self, command: Command) -> Command:
        """Return the command; a line that ends far from the drone gets more time."""
        if not isinstance(command, XYZ) or command.verb != "line":
            return command
        here = self._find_position()
        if here is None:
            return command
        far = math.dist(command.flat[0:3], here)
        limit = self._setup.config.flight.speed_limit
        fastest = COMMAND_LIMITS.catch_up_factor * limit
        if far <= COMMAND_LIMITS.line_lag + fastest * command.flat[4]:
            return command
        return XYZ("line", np.array([*command.flat[0:4], far / fastest]))

    def _find_position(self) -> Vec | None:
        """Return (3,) m, where the cameras or its own estimate place the drone; None if neither does."""
        pose = self._view.find_recent_pose()
        if pose is not None:
            return pose.p
        return None if self._estimate.state is None else self._estimate.state.p
