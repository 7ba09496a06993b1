"""How exactly a drone flies a path: the controllers alone behind two plants, and the whole stack in virtual time."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from crazychoir.control.choice import Controls, controls
from crazychoir.control.controller import HierarchicalController
from crazychoir.control.gains import Gains
from crazychoir.control.margin import Plant
from crazychoir.control.position import FlatnessPositionCtrl
from crazychoir.planning.figure import Figure, circle, eight
from crazychoir.platforms import Platform
from crazychoir.simulation.world import World
from crazychoir.types import State

TICK = 0.01
SETTLE = 4.0
"""s at full speed that do not count."""
SECONDS = 20.0
"""s that do."""
RAMP = 4.0
"""s from rest to full speed."""
DELAY = 0.02
"""s until a command is obeyed, at the motor level."""
LOST = 1.0
"""m from the reference at which a flight is given up."""
CORNERS = tuple(product((-0.05, 0.05), (-0.03, 0.03), ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))))
"""Errors of the thrust and of the mass, and (roll, pitch) in degrees by which the cameras see the drone tilted."""

Say = Callable[[str], None]
Path = Literal["circle", "eight-1", "eight-2"]
PATHS: tuple[Path, ...] = ("circle", "eight-1", "eight-2")


def path(name: Path, center: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Figure:
    """The circle of 0.4 m in 40 s; the eight of 2 m by 1 m at a peak of 1 or 2 m/s."""
    if name == "circle":
        return circle(center, 0.4, 40.0, (RAMP + SETTLE + SECONDS) / 40.0, RAMP)
    period = 2.0 * math.pi * math.sqrt(2.0) / float(name[-1])
    return eight(center, 1.0, 0.5, period, (RAMP + SETTLE + SECONDS) / period, RAMP)


def counts(t: float) -> bool:
    """Whether this instant of a path is at full speed and settled."""
    return RAMP + SETTLE <= t <= RAMP + SETTLE + SECONDS - RAMP


@dataclass(frozen=True)
class Row:
    """One figure of the table: rmse_mm None if the drone was lost."""

    plant: str
    path: str
    controller: str
    corner: str
    rmse_mm: float | None
    peak_mm: float | None


def row(plant: str, name: str, controller: str, corner: str, errors: list[np.ndarray] | None) -> Row:
    """The root mean square and the largest distance from the reference."""
    if not errors:
        return Row(plant, name, controller, corner, None, None)
    distances = 1e3 * np.linalg.norm(errors, axis=1)
    return Row(plant, name, controller, corner, float(np.sqrt(np.mean(distances**2))), float(distances.max()))


# The controllers alone: they see the truth, each tick of 10 ms ----------------------------------------------------


def alone(world: World, chosen: Controls, figure: Figure) -> list[np.ndarray] | None:
    """Errors (3,) m of a flight that sees the truth; None if the drone is lost. It starts at the start of the path."""
    link, errors = world.link(0, chosen.sender.kind), []
    chosen.trim.frozen = False
    for k in range(round(figure.duration / TICK)):
        t = k * TICK
        state, reference = State(world.states[0].copy()), figure.sample(t)
        error = state.p - reference.p
        if not np.linalg.norm(error) < LOST:
            return None
        if counts(t):
            errors.append(error)
        command = chosen.tracker.command(state, reference, t)
        if command is not None:
            link.send(command)
        world.step()
    return errors


def original() -> Gains:
    """The gains of CrazyChoir for its Webots simulation, per mass, without what ours feed forward or learn."""
    m = 0.038
    return Gains(kp=(0.4 / m, 0.4 / m, 1.25 / m), kv=(0.2 / m, 0.2 / m, 0.4 / m), kr=(16.0, 16.0, 0.2))


def original_controls(platform: Platform, plant: Plant) -> Controls:
    """Ours with the original's gains, nothing fed forward early and nothing learnt."""
    chosen, gains = controls(platform=platform, plant=plant), original()
    assert isinstance(chosen.tracker, HierarchicalController)  # noqa: S101 - it sends fpqr
    chosen.tracker.pos_strategy, chosen.tracker.attitude_strategy.gains = FlatnessPositionCtrl(gains, platform), gains
    return chosen
