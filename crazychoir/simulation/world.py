"""What every engine of a simulated world can do, so that nobody who flies in it knows which one it is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from crazychoir.errors import ConfigError
from crazychoir.math3d import Mat
from crazychoir.platforms import Platform
from crazychoir.types import Command, State

Position = tuple[float, float, float]


@dataclass(frozen=True)
class WorldSetup:
    """What an engine is asked for: a world of these drones, row by row.

    homes: m, yaws: rad, where they stand;  uris: as in the swarm file, after whose scheme an engine may read what it
    likes;  options: of the engine ([plant], [motors], for the engines of others [world.options]);  wind: m/s, world
    frame;  seed: of every random draw;  dt: s, of one step.
    """

    ids: tuple[int, ...]
    uris: tuple[str, ...]
    homes: tuple[Position, ...]
    yaws: tuple[float, ...]
    platforms: tuple[Platform, ...]
    options: Mapping[str, Any]
    wind: Position
    seed: int
    dt: float


class Link(Protocol):
    """The way to one drone."""

    def send(self, command: Command) -> None:
        """Let the drone obey this until the next one; raises ConfigError for a kind that its engine does not fly."""
        ...

    def cut(self) -> None:
        """Stop the motors for good."""
        ...


class World(Protocol):
    """All drones that one engine simulates, advanced together by one `step` of dt.

    ids: the drones, row by row;  states: (N, 13), rows laid out as State.flat, changed in place by `step`;
    flies: the kinds of commands that its drones obey;  command_timeout: s without a command after which a drone that
    flies gets no thrust; None: its firmware knows what to do.
    """

    ids: tuple[int, ...]
    dt: float
    states: Mat
    flies: tuple[type[Any], ...]
    command_timeout: float | None

    @property
    def time(self) -> float:
        """s since the start."""
        ...

    @property
    def crashed(self) -> list[int]:
        """Drones that are broken."""
        ...

    def step(self) -> None:
        """Advance every drone by dt."""
        ...

    def link(self, i: int) -> Link:
        """The way to drone i."""
        ...

    def state(self, i: int) -> State:
        """The truth about drone i, a copy."""
        ...

    def resting(self, i: int) -> bool:
        """Does drone i stand on the floor?"""
        ...

    def harm(self, i: int) -> str:
        """What has broken drone i; empty if nothing has."""
        ...

    def closest(self) -> tuple[int, int, float]:
        """The closest two drones and their distance in m; (-1, -1, inf) for one drone."""
        ...

    def min_separation(self) -> float:
        """m, the smallest distance between two drones; inf for one drone."""
        ...


def not_flown(drone: int, command: object, flies: str) -> ConfigError:
    """The error for a command of a kind that the drone's engine does not fly."""
    do = "Choose a controller that sends one of these, or another uri for the drone."
    return ConfigError(f"drone {drone}: command", type(command).__name__, f"{flies}: what its engine flies", do)


def names(kinds: tuple[type[Any], ...]) -> str:
    """Names of kinds of commands."""
    return ", ".join(kind.__name__ for kind in kinds)
