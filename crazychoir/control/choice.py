"""Which controllers a drone gets: by its row in the swarm file, its platform and what it is flown through."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crazychoir.config.tables import Control
from crazychoir.control.attitude import (
    ATTITUDE_ON_BOARD,
    AngleAttitudeCtrl,
    AttitudeControl,
    GeometryAttitudeCtrl,
)
from crazychoir.control.controller import CrazyflieController, HierarchicalController
from crazychoir.control.gains import FORMATION, OF_TRACKING, RANGES, STANDARD, Gains
from crazychoir.control.handlers import AccelerationTraj, FullStateTraj
from crazychoir.control.margin import REQUIRED, Plant, margin
from crazychoir.control.position import FlatnessAccelerationCtrl, FlatnessPositionCtrl
from crazychoir.control.senders import (
    CommunicationHandler,
    FPQRSender,
    FRPYSender,
    FullStateSender,
    VelSender,
    XYZSender,
)
from crazychoir.control.trim import Trim
from crazychoir.control.velocity import (
    FullStateController,
    VelocityController,
    VelocityCtrlStrategy,
    WaypointController,
)
from crazychoir.errors import ConfigError
from crazychoir.platforms import PAPER, Platform

SENDERS: dict[str, type[CommunicationHandler]] = {
    "fpqr": FPQRSender,
    "frpy": FRPYSender,
    "vel": VelSender,
    "xyz": XYZSender,
    "fullstate": FullStateSender,
}
ON_BOARD = ("vel", "xyz", "fullstate")
"""Senders for which the gains are those of the firmware."""


@dataclass
class Controls:
    """The controllers of one drone.

    tracker: of FullStates;  follower: of Accelerations, None if what is sent cannot be one;  trim: what both know of
    the drone;  gains: of the tracker;  takes_off: a robot that does not is where it flies, on the floor too;
    planar: its height is not its to choose.
    """

    platform: Platform
    plant: Plant
    tracker: CrazyflieController
    follower: CrazyflieController | None
    trim: Trim
    gains: Gains
    takes_off: bool = True
    planar: bool = False

    @property
    def sender(self) -> CommunicationHandler:
        """What speaks to the drone."""
        return self.tracker.command_sender

    @property
    def tuned(self) -> dict[str, Any]:
        """The gains that it flies by, by name; none for one that is flown by those of its firmware, or is no drone."""
        if not isinstance(self.tracker, HierarchicalController):
            return {}
        return {name: getattr(self.gains, name) for name in OF_TRACKING}

    def lead_by(self, gains: Gains) -> None:
        """Fly Accelerations with these gains from the next tick on: a law knows what it needs beneath."""
        if isinstance(self.follower, HierarchicalController):
            self.follower.pos_strategy.gains = gains
            self.follower.attitude_strategy.gains = gains

    def retune(self, gains: Gains) -> None:
        """Fly with other gains from the next tick on; ConfigError if they are not stable behind this drone."""
        require_stable(gains, self.platform, self.plant, sender=self.sender.kind)
        self.gains = gains
        if isinstance(self.tracker, HierarchicalController):
            self.tracker.pos_strategy.gains = gains
            self.tracker.attitude_strategy.gains = gains


def controls(
    choice: Control | None = None,
    platform: Platform = PAPER,
    plant: Plant = "lightweight",
    rate_lag: float = 0.03,
    command_delay: float = 0.02,
    where: str = "control",
) -> Controls:
    """The controllers that a row [control] or [[roles]] asks for.

    rate_lag: s, of the lightweight plant;  command_delay: s;  where: names the row in errors.
    Raises ConfigError for gains that are not stable behind this platform.
    """
    choice = Control() if choice is None else choice
    sender = choice.sender or "fpqr"
    late = (
        STANDARD.on_motors(platform, command_delay)
        if plant == "motors"
        else STANDARD.on_rates(rate_lag, command_delay)
    )
    gains = changed(late, choice.gains, f"{where}.gains")
    require_stable(gains, platform, plant, where, sender)
    if choice.gains and sender in ON_BOARD:
        found = f"gains for the sender {sender}"
        allowed = "none: the firmware's own fly what it is sent"
        raise ConfigError(
            f"{where}.gains", found, allowed, "Leave them out, or send fpqr or frpy."
        )
    trim = Trim()
    send = SENDERS[sender]()
    if sender == "vel":
        tracker: CrazyflieController = VelocityController(
            VelocityCtrlStrategy(), send, FullStateTraj()
        )
        return Controls(platform, plant, tracker, None, trim, gains)
    if sender == "fullstate":
        return Controls(
            platform,
            plant,
            FullStateController(send, FullStateTraj()),
            None,
            trim,
            gains,
        )
    if sender == "xyz":
        return Controls(
            platform,
            plant,
            WaypointController(send, FullStateTraj()),
            None,
            trim,
            gains,
        )
    attitudes: list[AttitudeControl] = [
        AngleAttitudeCtrl(row, platform)
        if sender == "frpy"
        else GeometryAttitudeCtrl(row, platform)
        for row in (gains, FORMATION)
    ]
    tracker = HierarchicalController(
        FlatnessPositionCtrl(gains, platform, trim),
        attitudes[0],
        send,
        FullStateTraj(),
        choice.position_rate,
    )
    follower = HierarchicalController(
        FlatnessAccelerationCtrl(FORMATION, platform, trim),
        attitudes[1],
        send,
        AccelerationTraj(),
    )
    return Controls(platform, plant, tracker, follower, trim, gains)


def changed(gains: Gains, values: dict[str, Any], where: str) -> Gains:
    """These gains with some others; ConfigError names what there is, or the range."""
    known = {name: getattr(gains, name) for name in OF_TRACKING}
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
        low, high = RANGES.get(name, (0.0, math.inf))
        if not np.all((np.asarray(value) >= low) & (np.asarray(value) <= high)):
            raise ConfigError(f"{where}.{name}", value, f"{low:g} to {high:g}")
        known[name] = tuple(map(float, value)) if shape else float(value)
    return replace(gains, **known)


def require_stable(
    gains: Gains,
    platform: Platform,
    plant: Plant,
    where: str = "control",
    sender: str = "fpqr",
) -> None:
    """Refuse gains that leave less delay margin than REQUIRED, with the lag of the rotors 1.3 times as identified.

    Behind roll and pitch, "frpy", the attitude is controlled on board, whatever kr is.
    """
    if sender == "frpy":
        gains = replace(gains, kr=(ATTITUDE_ON_BOARD, ATTITUDE_ON_BOARD, gains.kr[2]))
    left = margin(gains, platform, plant)
    if left < REQUIRED:
        raise ConfigError(
            f"{where}.gains",
            f"kp {gains.kp}, kv {gains.kv}, kr {gains.kr}, ki {gains.ki_thrust}, {gains.ki_trim}",
            f"gains that bear {1e3 * REQUIRED:.0f} ms more delay behind {platform.name} with 1.3 times its lag",
            f"Move towards the standard: kp {STANDARD.kp}, kv {STANDARD.kv}, kr {STANDARD.kr}.",
            f"they bear {1e3 * left:.0f} ms",
        )
