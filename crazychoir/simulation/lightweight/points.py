"""Worlds of robots that do not fly: single integrators, double integrators and unicycles.

The robots do not influence each other, and there is no floor.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.math3d import yaw_of
from crazychoir.simulation.common.truth import Truth
from crazychoir.simulation.common.world import WorldSetup, make_unsupported_kind_error
from crazychoir.types import XYZ, Command, Vec


@dataclass(frozen=True, slots=True)
class GroundRobotLimits:
    """Limits that decide when a robot stops, stands still, or drives straight."""

    command_timeout: float = 0.5
    """Seconds without a command before a robot stops."""
    standing_speed: float = 1e-3
    """Speed in m/s below which a robot counts as standing still."""
    straight_half_turn: float = 1e-9
    """Half the turn of a step, in rad, up to which a unicycle is moved on a straight line."""


GROUND_ROBOT_LIMITS = GroundRobotLimits()


class Robots(Truth):
    """Robots that follow their last command exactly over each step.

    inputs: (N, n): the last command of each robot
    stands: (N,): True for a robot that the last command stopped
    cut: (N,): True for a robot that is stopped for good
    """

    kind: str
    size: int
    command_timeout: float | None = GROUND_ROBOT_LIMITS.command_timeout

    def __init__(self, setup: WorldSetup) -> None:
        super().__init__(
            setup.ids,
            np.array(setup.homes, dtype=float),
            np.array(setup.yaws),
            setup.platforms,
            setup.dt,
        )
        self.flies: tuple[str, ...] = (self.kind,)
        self.inputs = np.zeros((len(self.ids), self.size))
        self.stands, self.cut = np.zeros((2, len(self.ids)), dtype=bool)

    def link(self, i: int, kind: str) -> "RobotLink":
        """Return the link to robot i.

        Raises ConfigError if the kind is not that of these robots.
        """
        if kind != self.kind:
            raise make_unsupported_kind_error(i, kind, self.flies)
        return RobotLink(self, self.row[i])

    def resting(self, i: int) -> bool:
        """Return True if robot i stands still."""
        return (
            float(np.linalg.norm(self.states[self.row[i], 3:6]))
            < GROUND_ROBOT_LIMITS.standing_speed
        )

    def step(self) -> None:
        """Advance every robot by dt."""
        for x, u, stands in zip(
            self.states, self.inputs, self.stands | self.cut, strict=True
        ):
            if stands:
                x[3:6] = x[10:13] = 0.0
            else:
                self.move(x, u, self.dt)
        self.tick += 1

    @abstractmethod
    def move(self, x: Vec, u: Vec, h: float) -> None:
        """Replace the state x (13,) by the state h s later under the input u (n,)."""


@dataclass
class RobotLink:
    """The link to one robot of a world in this process.

    A command with a number that is not finite is ignored.
    """

    world: Robots
    row: int

    def send(self, command: Command) -> None:
        """Follow the command until the next one.

        An XYZ means stop: the robot stands still until the next command.
        """
        if isinstance(command, XYZ):
            self.world.stands[self.row] = True
        elif np.all(np.isfinite(command.flat)):
            self.world.inputs[self.row] = command.flat
            self.world.stands[self.row] = False

    def cut(self) -> None:
        """Stop the robot for good."""
        self.world.cut[self.row] = True


class SingleIntegrators(Robots):
    """Points with the command as their velocity.

        p' = u,  psi' = r

    u: m/s, from Vel
    r: rad/s, from Vel
    """

    kind = "vel"
    size = 4

    def move(self, x: Vec, u: Vec, h: float) -> None:
        """Move the point by one step."""
        x[0:3] += h * u[0:3]
        x[3:6] = u[0:3]
        _turn(x, yaw_of(x[6:10]) + h * float(u[3]), float(u[3]))


class DoubleIntegrators(Robots):
    """Points with the command as their acceleration.

        p'' = u

    u: m/s2, from Acc
    """

    kind = "acc"
    size = 3

    def move(self, x: Vec, u: Vec, h: float) -> None:
        """Move the point by one step."""
        x[0:3] += h * x[3:6] + 0.5 * h * h * u
        x[3:6] += h * u


class Unicycles(Robots):
    """Robots with two wheels on one axle, in the horizontal plane of their start positions.

        x' = v cos psi,  y' = v sin psi,  psi' = w

    In one step a robot moves on an arc of a circle of length v h.
    v: m/s, from Drive
    w: rad/s, from Drive
    """

    kind = "drive"
    size = 2

    def move(self, x: Vec, u: Vec, h: float) -> None:
        """Move the robot by one step."""
        v, w = u.tolist()
        yaw = yaw_of(x[6:10])
        half = 0.5 * h * w
        chord = (
            v
            * h
            * (
                math.sin(half) / half
                if abs(half) > GROUND_ROBOT_LIMITS.straight_half_turn
                else 1.0
            )
        )
        x[0] += chord * math.cos(yaw + half)
        x[1] += chord * math.sin(yaw + half)
        yaw += h * w
        x[3:6] = v * math.cos(yaw), v * math.sin(yaw), 0.0
        _turn(x, yaw, w)


def _turn(x: Vec, yaw: float, rate: float) -> None:
    """Set the heading and the turn rate of a level robot."""
    x[6:10] = 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    x[10:13] = 0.0, 0.0, rate


def single_integrators(setup: WorldSetup) -> SingleIntegrators:
    """Make the world of sim://single."""
    return SingleIntegrators(setup)


def double_integrators(setup: WorldSetup) -> DoubleIntegrators:
    """Make the world of sim://double."""
    return DoubleIntegrators(setup)


def unicycles(setup: WorldSetup) -> Unicycles:
    """Make the world of sim://unicycle."""
    return Unicycles(setup)
