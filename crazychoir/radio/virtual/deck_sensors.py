"""The decks of virtual drones that measure where the drones are, or how fast they fly."""

import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.radio.virtual.faults import Faults
from crazychoir.radio.virtual.port import DronePort
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld


@dataclass(frozen=True, slots=True)
class DeckModel:
    """How the decks on board measure."""

    period: int = 2
    """Steps of the world between two poses from a deck on board."""
    position_noise: float = 0.001
    """m: standard deviation, for each axis, of a position from a deck."""
    velocity_noise: float = 0.02
    """m/s: standard deviation, for each axis, of a velocity from a flow deck."""


DECK_MODEL = DeckModel()


class DeckSensors:
    """Gives the estimators of virtual drones the measurements of their decks.

    ports: ports by drone
    faults: faults by drone
    seed: seed of the noise
    """

    def __init__(
        self,
        world: CrazyflieWorld,
        ports: Mapping[int, DronePort],
        faults: Mapping[int, Faults],
        seed: int,
    ) -> None:
        self._world = world
        self._ports = ports
        self._faults = faults
        self._noise = random.Random(f"{seed} decks")  # noqa: S311 - a simulated sensor

    def measure(self) -> None:
        """Give the estimators the measurements of decks.

        A lighthouse deck measures the position, a flow deck the velocity.
        """
        for i, port in self._ports.items():
            if self._faults[i].deck_lost:
                continue
            state = self._world.states[self._world.row[i]]
            onboard = port.drone.onboard
            if port.drone.flows:
                onboard.measured_velocity(
                    state[3:6] + self._draw_error(DECK_MODEL.velocity_noise),
                    DECK_MODEL.velocity_noise,
                )
            if port.drone.positioned:
                onboard.external_pose(
                    state[:3] + self._draw_error(DECK_MODEL.position_noise),
                    state[6:10].copy(),
                )

    def _draw_error(self, std: float) -> Any:
        return np.array([self._noise.gauss(0.0, std) for _ in range(3)])
