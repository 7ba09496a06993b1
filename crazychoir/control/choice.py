"""The choice of a drone's controllers, by its row in the swarm file, platform and sender."""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from crazychoir.config.tables import ControlTable
from crazychoir.control.attitude import (
    FIRMWARE_ATTITUDE_GAIN,
    AngleAttitudeCtrl,
    AttitudeControl,
    GeometryAttitudeCtrl,
)
from crazychoir.control.controller import CrazyflieController, HierarchicalController
from crazychoir.control.firmware import (
    FullStateController,
    VelocityController,
    WaypointController,
)
from crazychoir.control.gains import (
    FORMATION_GAINS,
    GAIN_RANGES,
    STANDARD_GAINS,
    TRACKING_GAIN_NAMES,
    Gains,
)
from crazychoir.control.handlers import AccelerationTraj, FullStateTraj
from crazychoir.control.margin import REQUIRED_DELAY_MARGIN, Plant, compute_delay_margin
from crazychoir.control.position import FlatnessAccelerationCtrl, FlatnessPositionCtrl
from crazychoir.control.rows import make_control_rows
from crazychoir.control.senders import (
    CommunicationHandler,
    FPQRSender,
    FRPYSender,
    FullStateSender,
    VelSender,
    XYZSender,
)
from crazychoir.control.trim import Trim
from crazychoir.control.velocity import VelocityCtrlStrategy
from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import Records
from crazychoir.platforms import PAPER_PLATFORM, Platform

SENDERS_BY_KIND: dict[str, type[CommunicationHandler]] = {
    "fpqr": FPQRSender,
    "frpy": FRPYSender,
    "vel": VelSender,
    "xyz": XYZSender,
    "fullstate": FullStateSender,
}
"""The sender of each kind that a swarm file may name."""
FIRMWARE_GAIN_SENDERS = ("vel", "xyz", "fullstate")
"""Senders that leave the gains to the firmware."""
PLACE_SENDERS = ("xyz", "fullstate")
"""Senders of places, to which the position control of the firmware flies."""


@dataclass
class Controls:
    """The controllers of one drone or robot."""

    platform: Platform
    """The platform that it is."""
    plant: Plant
    """The plant behind the commands."""
    tracker: CrazyflieController
    """Controller of FullState references."""
    follower: CrazyflieController | None
    """Controller of Acceleration references; None if the sender cannot send them."""
    trim: Trim
    """Errors of the drone's thrust and attitude that both controllers know."""
    gains: Gains
    """Gains of the tracker."""
    takes_off: bool = True
    """False for a robot that drives, or that moves at any height without a take-off."""
    planar: bool = False
    """True for a robot that does not choose its height."""
    rows: Records = field(default_factory=make_control_rows)
    """(1,) of CONTROL_ROW: the record of the compiled controllers."""

    @property
    def sender(self) -> CommunicationHandler:
        """The handler that sends to the drone."""
        return self.tracker.command_sender

    @property
    def tuned(self) -> dict[str, Any]:
        """The gains in use, by name.

        Empty for a drone that its firmware's gains fly, and for other robots.
        """
        if not isinstance(self.tracker, HierarchicalController):
            return {}
        return {name: getattr(self.gains, name) for name in TRACKING_GAIN_NAMES}

    def lead_by(self, gains: Gains) -> None:
        """Fly Acceleration references with these gains from the next tick on.

        A law of guidance chooses them, because its stability depends on them.
        """
        if isinstance(self.follower, HierarchicalController):
            self.follower.pos_strategy.gains = gains
            self.follower.attitude_strategy.gains = gains

    def retune(self, gains: Gains) -> None:
        """Fly with other gains from the next tick on.

        Raises ConfigError if they are not stable on this drone.
        """
        require_stable(gains, self.platform, self.plant, sender=self.sender.kind)
        self.gains = gains
        if isinstance(self.tracker, HierarchicalController):
            self.tracker.pos_strategy.gains = gains
            self.tracker.attitude_strategy.gains = gains
        self.oppose_moment()

    def oppose_moment(self) -> None:
        """Let the controllers cancel the moment of speed, as early as the gains say that the drone is late.

        The lightweight plant has none.
        """
        if self.plant == "lightweight":
            return
        for controller in (self.tracker, self.follower):
            if isinstance(controller, HierarchicalController):
                controller.feed_forward.know_moment(
                    self.platform, self.gains.thrust_delay
                )


def make_controls(
    choice: ControlTable | None = None,
    platform: Platform = PAPER_PLATFORM,
    plant: Plant = "lightweight",
    rate_lag: float = 0.03,
    command_delay: float = 0.02,
    where: str = "control",
    rows: Records | None = None,
) -> Controls:
    """Return the controllers of a row [control] or [[roles]].

    choice: the row
    platform: of the drone
    plant: behind the commands
    rate_lag: s, lag of the body rates of the lightweight plant
    command_delay: s, until the drone receives a command
    where: name of the row in errors
    rows: (1,) of CONTROL_ROW, the record of the controllers, begun anew; None for an array of its
        own
    Raises ConfigError for gains that are not stable on this platform, or that the sender leaves to
    the firmware.
    """
    choice = ControlTable() if choice is None else choice
    sender = choice.sender or "fpqr"
    late = (
        STANDARD_GAINS.on_motors(platform, command_delay)
        if plant == "motors"
        else STANDARD_GAINS.on_rates(rate_lag, command_delay)
    )
    gains = change_gains(late, choice.gains, f"{where}.gains")
    require_stable(gains, platform, plant, where, sender)
    if choice.gains and sender in FIRMWARE_GAIN_SENDERS:
        found = f"gains for the sender {sender}"
        allowed = "none: the firmware's own fly what it is sent"
        raise ConfigError(
            f"{where}.gains", found, allowed, "Leave them out, or send fpqr or frpy."
        )
    rows = make_control_rows() if rows is None else rows
    rows[:] = make_control_rows()
    trim = Trim(rows["trim"])
    send = SENDERS_BY_KIND[sender]()
    follower = None
    if sender in FIRMWARE_GAIN_SENDERS:
        tracker: CrazyflieController = _make_firmware_tracker(send, rows["tracker"])
    else:
        tracker = HierarchicalController(
            FlatnessPositionCtrl(gains, platform, trim, rows["tracker"]["position"]),
            _make_attitude_control(gains, platform, sender, rows["tracker"]),
            send,
            FullStateTraj(),
            choice.position_rate,
            rows["tracker"],
        )
        follower = HierarchicalController(
            FlatnessAccelerationCtrl(
                FORMATION_GAINS, platform, trim, rows["follower"]["position"]
            ),
            _make_attitude_control(FORMATION_GAINS, platform, sender, rows["follower"]),
            send,
            AccelerationTraj(),
            rows=rows["follower"],
        )
    controls = Controls(platform, plant, tracker, follower, trim, gains, rows=rows)
    controls.oppose_moment()
    return controls


def _make_firmware_tracker(
    send: CommunicationHandler, rows: Records
) -> CrazyflieController:
    """Return the controller of a drone that its firmware's gains fly.

    send: makes the commands
    rows: (1,) of CONTROLLER_ROW, the record of the controller
    """
    handler = FullStateTraj()
    if send.kind == "vel":
        strategy = VelocityCtrlStrategy(rows=rows["velocity"])
        return VelocityController(strategy, send, handler, rows)
    if send.kind == "fullstate":
        return FullStateController(send, handler)
    return WaypointController(send, handler)


def _make_attitude_control(
    gains: Gains, platform: Platform, sender: str, rows: Records
) -> AttitudeControl:
    """Return the attitude control of a sender of thrusts.

    gains: the gains
    platform: of the drone
    sender: "fpqr" or "frpy"
    rows: (1,) of CONTROLLER_ROW, the record of its controller
    """
    if sender == "frpy":
        return AngleAttitudeCtrl(gains, platform, rows["attitude"])
    return GeometryAttitudeCtrl(gains, platform, rows["attitude"])


def change_gains(gains: Gains, values: dict[str, Any], where: str) -> Gains:
    """Return these gains with some values replaced.

    gains: the gains
    values: new values by name
    where: name in errors
    Raises ConfigError for an unknown name, or a value of another shape or out of range.
    """
    known = {name: getattr(gains, name) for name in TRACKING_GAIN_NAMES}
    for name, value in values.items():
        if name not in known:
            raise ConfigError(f"{where}.{name}", value, f"one of {', '.join(known)}")
        shape = np.shape(known[name])
        fits = np.shape(value) == shape and np.issubdtype(
            np.asarray(value).dtype, np.number
        )
        if not (
            fits and np.all(np.isfinite(value)) and np.all(np.asarray(value) >= 0.0)
        ):
            kind = (
                "three finite numbers, none negative"
                if shape
                else "a finite number, not negative"
            )
            raise ConfigError(f"{where}.{name}", value, kind)
        low, high = GAIN_RANGES.get(name, (0.0, math.inf))
        if not np.all((np.asarray(value) >= low) & (np.asarray(value) <= high)):
            raise ConfigError(f"{where}.{name}", value, f"{low:g} to {high:g}")
        known[name] = tuple(map(float, value)) if shape else float(value)
    return replace(gains, **known)


@lru_cache(maxsize=64)  # most drones of a swarm have the same gains and platform
def _find_margin(gains: Gains, platform: Platform, plant: Plant) -> float:
    return compute_delay_margin(gains, platform, plant)


def require_stable(
    gains: Gains,
    platform: Platform,
    plant: Plant,
    where: str = "control",
    sender: str = "fpqr",
) -> None:
    """Raise ConfigError for gains that leave less delay margin than REQUIRED_DELAY_MARGIN.

    The lag of the rotors is assumed to be 1.3 times as long as identified. For the sender "frpy" the
    firmware controls roll and pitch, so their kr does not matter.
    """
    if sender == "frpy":
        gains = replace(
            gains, kr=(FIRMWARE_ATTITUDE_GAIN, FIRMWARE_ATTITUDE_GAIN, gains.kr[2])
        )
    left = _find_margin(gains, platform, plant)
    if left < REQUIRED_DELAY_MARGIN:
        raise ConfigError(
            f"{where}.gains",
            f"kp {gains.kp}, kv {gains.kv}, kr {gains.kr}, ki {gains.ki_thrust}, {gains.ki_trim}",
            f"gains that bear {1e3 * REQUIRED_DELAY_MARGIN:.0f} ms more delay behind "
            f"{platform.name} with 1.3 times its lag",
            f"Move towards the standard: kp {STANDARD_GAINS.kp}, kv {STANDARD_GAINS.kv}, kr {STANDARD_GAINS.kr}.",
            f"they bear {1e3 * left:.0f} ms",
        )
