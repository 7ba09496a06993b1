"""What every engine of a simulated world can do, so that nobody who flies in it knows which one it is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.types import (
    FPQR,
    FRPY,
    XYZ,
    Acc,
    Command,
    Drive,
    FullState,
    Mat,
    Pose,
    State,
    Vel,
)

KINDS: dict[str, tuple[type[Any], ...]] = {
    "fpqr": (FPQR,),
    "frpy": (FRPY,),
    "vel": (Vel, XYZ),
    "xyz": (XYZ,),
    "fullstate": (FullState, XYZ),
    "acc": (Acc, XYZ),
    "drive": (Drive,),
}
"""What is sent for each `sender` of a swarm file: velocities, full states and accelerations end with the XYZ that
stops; the last two are of robots that do not fly, whose uri says what they are sent."""
Position = tuple[float, float, float]


@dataclass(frozen=True)
class WorldSetup:
    """What an engine is asked for: a world of these drones, row by row.

    homes: m, yaws: rad, where they stand;  uris: as in the swarm file, after whose scheme an engine may read what it
    likes;  options: of the engine ([plant], [motors], for the engines of others [world.options]);  wind: m/s, world
    frame;  seed: of every random draw;  dt: s, of one step;  mass_error, thrust_error: shares by which the bodies are
    heavier and pull harder than their platforms.
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
    mass_error: float = 0.0
    thrust_error: float = 0.0


class Link(Protocol):
    """The way to one drone."""

    def send(self, command: Command) -> None:
        """Let the drone obey this until the next one."""
        ...

    def cut(self) -> None:
        """Stop the motors for good."""
        ...


class World(Protocol):
    """All drones that one engine simulates, advanced together by one `step` of dt.

    ids: the drones, row by row;  states: (N, 13), rows laid out as State.flat, changed in place by `step`;
    flies: kinds of commands that its drones obey, of KINDS;  command_timeout: s without a command after which a drone
    that flies gets no thrust; None: its firmware knows what to do.
    """

    ids: tuple[int, ...]
    dt: float
    states: Mat
    flies: tuple[str, ...]
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

    def link(self, i: int, kind: str) -> Link:
        """The way to drone i for commands of this kind; raises ConfigError for one that is not flown here."""
        ...

    def see(self, i: int, pose: Pose) -> None:
        """The cameras have seen drone i: what its radio would tell its estimator; without one, nothing."""
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


def not_flown(drone: int, kind: str, flies: tuple[str, ...]) -> ConfigError:
    """The error for a kind of command that a drone's world does not fly."""
    do = "Set sender in [control] or in its [[roles]], or give it another uri."
    return ConfigError(
        f"drone {drone}: sender", kind, f"{', '.join(flies)}: what its world flies", do
    )
