"""Worlds of robots that do not fly: single and double integrators, and unicycles; each for itself, without a floor."""

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.math3d import yaw_of
from crazychoir.simulation.common.truth import Truth
from crazychoir.simulation.common.world import WorldSetup, not_flown
from crazychoir.types import XYZ, Command, Vec

SILENCE = 0.5
"""s without a command after which such a robot stands still."""
STANDS = 1e-3
"""m/s, below which it does."""
STRAIGHT = 1e-9
"""rad in a step, below which a unicycle goes straight on."""


class Robots(Truth):
    """Robots that obey their last command exactly over each step.

    inputs: (N, n), what they are commanded;  stands: (N,), who has its brakes on;  cut: (N,), who has them for good.
    """

    kind: str
    size: int
    command_timeout: float | None = SILENCE

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
        """The way to robot i; raises ConfigError for another kind than its own."""
        if kind != self.kind:
            raise not_flown(i, kind, self.flies)
        return RobotLink(self, self.row[i])

    def resting(self, i: int) -> bool:
        """Does robot i stand still?"""
        return float(np.linalg.norm(self.states[self.row[i], 3:6])) < STANDS

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
        """Replace the state x (13,) by the one h s later, under the input u (n,)."""


@dataclass
class RobotLink:
    """The way to one robot of a world in this process; a command that is not finite counts for nothing."""

    world: Robots
    row: int

    def send(self, command: Command) -> None:
        """Obeyed until the next one; the XYZ that stops puts the brakes on until then."""
        if isinstance(command, XYZ):
            self.world.stands[self.row] = True
        elif np.all(np.isfinite(command.flat)):
            self.world.inputs[self.row] = command.flat
            self.world.stands[self.row] = False

    def cut(self) -> None:
        """It stands still, for good."""
        self.world.cut[self.row] = True


class SingleIntegrators(Robots):
    """Points that move as they are told.

        p' = u,  psi' = r

    u: m/s, r: rad/s, of Vel.
    """

    kind = "vel"
    size = 4

    def move(self, x: Vec, u: Vec, h: float) -> None:
        """One step."""
        x[0:3] += h * u[0:3]
        x[3:6] = u[0:3]
        _turn(x, yaw_of(x[6:10]) + h * float(u[3]), float(u[3]))


class DoubleIntegrators(Robots):
    """Points with inertia.

        p'' = u

    u: m/s2, of Acc.
    """

    kind = "acc"
    size = 3

    def move(self, x: Vec, u: Vec, h: float) -> None:
        """One step."""
        x[0:3] += h * x[3:6] + 0.5 * h * h * u
        x[3:6] += h * u


class Unicycles(Robots):
    """Wheels on one axle, in the plane of their homes.

        x' = v cos psi,  y' = v sin psi,  psi' = w

    v: m/s, w: rad/s, of Drive: over a step an arc of a circle, of the length v h.
    """

    kind = "drive"
    size = 2

    def move(self, x: Vec, u: Vec, h: float) -> None:
        """One step."""
        v, w = u.tolist()
        yaw = yaw_of(x[6:10])
        half = 0.5 * h * w
        chord = v * h * (math.sin(half) / half if abs(half) > STRAIGHT else 1.0)
        x[0] += chord * math.cos(yaw + half)
        x[1] += chord * math.sin(yaw + half)
        yaw += h * w
        x[3:6] = v * math.cos(yaw), v * math.sin(yaw), 0.0
        _turn(x, yaw, w)


def _turn(x: Vec, yaw: float, rate: float) -> None:
    """Heading and turn rate of a level robot."""
    x[6:10] = 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    x[10:13] = 0.0, 0.0, rate


def single_integrators(setup: WorldSetup) -> SingleIntegrators:
    """The engine of sim://single."""
    return SingleIntegrators(setup)


def double_integrators(setup: WorldSetup) -> DoubleIntegrators:
    """The engine of sim://double."""
    return DoubleIntegrators(setup)


def unicycles(setup: WorldSetup) -> Unicycles:
    """The engine of sim://unicycle."""
    return Unicycles(setup)
