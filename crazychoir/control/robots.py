"""Controllers of robots that do not fly: single and double integrators, and unicycles.

The uri of a robot decides which of them it gets.
"""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from crazychoir.config.checks import WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import FlightTable
from crazychoir.control.choice import Controls
from crazychoir.control.controller import CrazyflieController
from crazychoir.control.gains import STANDARD_GAINS
from crazychoir.control.handlers import AccelerationTraj, FullStateTraj
from crazychoir.control.senders import (
    AccSender,
    CommunicationHandler,
    DriveSender,
    VelSender,
)
from crazychoir.control.trim import Trim
from crazychoir.control.unicycle import UnicycleCtrl
from crazychoir.numerics.math3d import saturate, wrap_angle, yaw_of
from crazychoir.platforms import PAPER_PLATFORM
from crazychoir.types import State, Vec

ROBOT_TICK_TIMEOUT = 0.1
"""Seconds without a tick after which a robot counts as standing."""


class RobotStrategy(Protocol):
    """Turns a state and a reference into the input of the robot."""

    def input(self, state: State, reference: Vec) -> Vec:
        """Return the input for a reference (14,); state and reference are finite."""
        ...


class RobotController(CrazyflieController):
    """Follows references by a strategy, with inputs that change at a limited rate.

        |u_k - u_k-1| <= a_max h,  in the first `smooth` entries

    A robot that obeys velocities at once must not jump: it would be beyond the fence before its
    filter had seen it move. After ROBOT_TICK_TIMEOUT s without a tick, u_k-1 counts as zero.

    strategy: makes the input
    size: n, of the input
    sender: makes the commands
    smooth: number of limited entries
    a_max: m/s2
    """

    def __init__(
        self,
        strategy: RobotStrategy,
        size: int,
        sender: CommunicationHandler,
        smooth: int = 0,
        a_max: float = math.inf,
    ) -> None:
        super().__init__(sender, FullStateTraj())
        self.strategy = strategy
        self.size = size
        self.smooth = smooth
        self.a_max = a_max
        self._sent = np.zeros(smooth)
        self._at = -math.inf

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return the strategy's input, limited in its change."""
        if not math.isfinite(sum(state.flat.tolist()) + sum(reference.tolist())):
            return None
        u = self.strategy.input(state, reference)
        h = now - self._at
        self._at = now
        if self.smooth:
            sent = self._sent if h < ROBOT_TICK_TIMEOUT else np.zeros(self.smooth)
            self._sent = sent + saturate(
                u[: self.smooth] - sent, self.a_max * min(h, ROBOT_TICK_TIMEOUT)
            )
            u[: self.smooth] = self._sent
        return u

    def blind(self) -> Vec:
        """Return zeros: the robot stands still, or keeps its velocity if it obeys accelerations."""
        return np.zeros(self.size)


class AccelerationController(CrazyflieController):
    """Sends accelerations as they are."""

    def __init__(self, sender: CommunicationHandler) -> None:
        super().__init__(sender, AccelerationTraj())

    def law(self, state: State, reference: Vec, now: float) -> Vec | None:
        """Return a_d of the reference."""
        a: Vec = reference[6:9].copy()
        return a if math.isfinite(sum(a.tolist())) else None

    def blind(self) -> Vec:
        """Return no acceleration."""
        return np.zeros(3)


class SingleIntegratorCtrl:
    """Control of a single integrator by velocity and turn rate.

        u = v_d + k (p_d - p),  |u| <= v_max
        psi' = psi_d' + k (psi_d - psi), the short way

    k: 1/s
    v_max: m/s
    """

    def __init__(self, k: float = 2.0, v_max: float = 1.0) -> None:
        self.k = k
        self.v_max = v_max

    def input(self, state: State, reference: Vec) -> Vec:
        """Return (4,): velocity m/s, turn rate rad/s."""
        u = saturate(reference[3:6] + self.k * (reference[0:3] - state.p), self.v_max)
        return np.append(
            u, reference[13] + self.k * wrap_angle(reference[12] - yaw_of(state.q))
        )


class DoubleIntegratorCtrl:
    """Control of a double integrator by acceleration.

        u = a_d + kv (v_d - v) + kp (p_d - p),  |u| <= a_max

    kp: 1/s2
    kv: 1/s
    a_max: m/s2
    """

    def __init__(self, kp: float = 4.0, kv: float = 4.0, a_max: float = 4.0) -> None:
        self.kp = kp
        self.kv = kv
        self.a_max = a_max

    def input(self, state: State, reference: Vec) -> Vec:
        """Return (3,) m/s2."""
        pull = self.kv * (reference[3:6] - state.v) + self.kp * (
            reference[0:3] - state.p
        )
        return saturate(reference[6:9] + pull, self.a_max)


def make_single_integrator_controls(flight: FlightTable) -> Controls:
    """Return the controls of a point that gets velocities.

    Its velocity may be twice the speed limit, so that it can catch up with its reference.
    """
    strategy = SingleIntegratorCtrl(v_max=2.0 * flight.speed_limit)
    return _make_robot_controls(
        RobotController(
            strategy, 4, VelSender(), smooth=3, a_max=2.0 * flight.acceleration_limit
        )
    )


def make_double_integrator_controls(flight: FlightTable) -> Controls:
    """Return the controls of a point that gets accelerations."""
    strategy = DoubleIntegratorCtrl(a_max=2.0 * flight.acceleration_limit)
    send = AccSender()
    return _make_robot_controls(
        RobotController(strategy, 3, send), AccelerationController(send)
    )


def make_unicycle_controls(flight: FlightTable) -> Controls:
    """Return the controls of a robot with two wheels on one axle, which gets (v, w)."""
    strategy = UnicycleCtrl(v_max=flight.speed_limit)
    a_max = 2.0 * flight.acceleration_limit
    return _make_robot_controls(
        RobotController(strategy, 2, DriveSender(), smooth=1, a_max=a_max), planar=True
    )


def _make_robot_controls(
    tracker: CrazyflieController,
    follower: CrazyflieController | None = None,
    planar: bool = False,
) -> Controls:
    """Return the controls of a robot that does not take off."""
    return Controls(
        PAPER_PLATFORM,
        "lightweight",
        tracker,
        follower,
        Trim(),
        STANDARD_GAINS,
        takes_off=False,
        planar=planar,
    )


ROBOT_CONTROLS: dict[str, tuple[str, Callable[[FlightTable], Controls]]] = {
    WORLD_URIS.single_integrator: ("vel", make_single_integrator_controls),
    WORLD_URIS.double_integrator: ("acc", make_double_integrator_controls),
    WORLD_URIS.unicycle: ("drive", make_unicycle_controls),
}
"""For each uri of a robot: the kind of command it gets, and its controllers."""


def find_sender(config: SwarmConfig, i: int) -> str:
    """Return the kind of command that robot i gets.

    Its uri says so, or its row [control] or [[roles]].
    """
    uri = config.drone(i).uri
    return (
        ROBOT_CONTROLS[uri][0]
        if uri in ROBOT_CONTROLS
        else str(config.control_of(i).sender)
    )
