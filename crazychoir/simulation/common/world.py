"""The contract of every engine, which lets the code above it work with any simulated world."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from crazychoir.errors import ConfigError
from crazychoir.platforms import Platform
from crazychoir.types import (
    FPQR,
    FRPY,
    XYZ,
    Acc,
    Bools,
    Command,
    Drive,
    FullState,
    Ints,
    Mat,
    Pose,
    State,
    Vel,
)

COMMAND_TYPES: dict[str, tuple[type[Any], ...]] = {
    "fpqr": (FPQR,),
    "frpy": (FRPY,),
    "vel": (Vel, XYZ),
    "xyz": (XYZ,),
    "fullstate": (FullState, XYZ),
    "acc": (Acc, XYZ),
    "drive": (Drive,),
}
"""Command types that are sent for each `sender` of a swarm file.

Streams of velocities, full states and accelerations end with the XYZ that stops the drone.
"acc" and "drive" belong to robots that do not fly; their uri determines the command type.
"""
Position = tuple[float, float, float]  # m, world


@dataclass(frozen=True)
class WorldSetup:
    """The world that an engine is asked to make: a set of drones, one row a drone."""

    ids: tuple[int, ...]
    """Ids of the drones."""
    uris: tuple[str, ...]
    """Uris as in the swarm file; an engine may interpret the part behind its scheme as it likes."""
    homes: tuple[Position, ...]
    """Start position of each drone in m, world."""
    yaws: tuple[float, ...]
    """Start heading of each drone in rad."""
    platforms: tuple[Platform, ...]
    """Platform of each drone."""
    options: Mapping[str, Any]
    """Options of the engine: [plant] or [motors], for engines of others [world.options]."""
    wind: Position
    """Wind velocity in m/s, world."""
    seed: int
    """Seed of every random draw."""
    dt: float
    """Seconds of one step."""
    mass_error: float = 0.0
    """Share by which each body is heavier than its platform."""
    thrust_error: float = 0.0
    """Share by which each body's rotors pull harder than its platform says."""
    bodies: tuple[Platform, ...] = ()
    """Calibrated body of each drone; empty: the platforms."""
    thrust_factors: tuple[float, ...] = ()
    """Calibrated thrust of each drone as a share of its body's; empty: 1."""

    def build_bodies(
        self, apply: Callable[[Platform, float, float], Platform]
    ) -> list[Platform]:
        """Return the true body of each drone.

        apply: returns a platform with relative errors of mass and thrust, see `mismatch`
        """
        rows = self.bodies or self.platforms
        factors = self.thrust_factors or (1.0,) * len(rows)
        return [
            apply(row, self.mass_error, (1.0 + self.thrust_error) * factor - 1.0)
            for row, factor in zip(rows, factors, strict=True)
        ]


class DroneLink(Protocol):
    """The link to one drone."""

    def send(self, command: Command) -> None:
        """Let the drone obey this command until the next one."""
        ...

    def cut(self) -> None:
        """Stop the motors for good."""
        ...


class World(Protocol):
    """All drones that one engine simulates; each `step` advances all of them by dt."""

    ids: tuple[int, ...]
    """The drones, in the order of the rows."""
    dt: float
    """Seconds of one step."""
    states: Mat
    """(N, 13): rows laid out as State.flat, changed in place by `step`."""
    flies: tuple[str, ...]
    """Kinds of commands that its drones obey, keys of COMMAND_TYPES."""
    command_timeout: float | None
    """Seconds without a command before a flying drone gets no thrust.

    None: the drone has firmware with its own rule for missing commands.
    """

    @property
    def time(self) -> float:
        """Seconds since the start."""
        ...

    @property
    def crashed(self) -> list[int]:
        """The broken drones."""
        ...

    def step(self) -> None:
        """Advance every drone by dt."""
        ...

    def link(self, i: int, kind: str) -> DroneLink:
        """Return the link to drone i for commands of this kind.

        Raises ConfigError if the drones of this world do not obey this kind.
        """
        ...

    def see(self, i: int, pose: Pose) -> None:
        """Pass a camera pose of drone i to its estimator on board, as a radio would.

        A world without estimators on board does nothing.
        """
        ...

    def state(self, i: int) -> State:
        """Return a copy of the true state of drone i."""
        ...

    def resting(self, i: int) -> bool:
        """Return True if drone i stands on the floor."""
        ...

    def harm(self, i: int) -> str:
        """Return what broke drone i; empty if it is not broken."""
        ...

    def closest(self) -> tuple[int, int, float]:
        """Return the two closest drones and their distance in m; (-1, -1, inf) for one drone."""
        ...

    def min_separation(self) -> float:
        """Return the smallest distance between two drones in m; inf for one drone."""
        ...


class RowWorld(World, Protocol):
    """A world that takes the commands of all its drones by one call, as an engine may."""

    takes_rows: tuple[str, ...]
    """Kinds of commands that it takes so, keys of COMMAND_TYPES: with four numbers each."""

    def take_commands(self, inputs: Mat, is_new: Ints) -> None:
        """Let drones obey these commands until the next ones, as their links would.

        inputs: (n, 4): rows laid out as `flat` of the commands, one a drone
        is_new: (n,): 1 for a drone with a new command
        """
        ...


class FrameWorld(World, Protocol):
    """A world that takes the poses of all its drones by one call, as an engine may."""

    def see_frame(self, flat: Mat, seen: Bools) -> None:
        """Pass the poses of one exposure to the estimators on board, as `see` does for one drone.

        flat: (n, 7): rows laid out as Pose.flat, one a drone
        seen: (n,): whether the drone was seen
        """
        ...


def make_unsupported_kind_error(
    drone: int, kind: str, flies: tuple[str, ...]
) -> ConfigError:
    """Return the error for a command kind that the world of this drone does not obey."""
    do = "Set sender in [control] or in its [[roles]], or give it another uri."
    return ConfigError(
        f"drone {drone}: sender", kind, f"{', '.join(flies)}: what its world flies", do
    )
