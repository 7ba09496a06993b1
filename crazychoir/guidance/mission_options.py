"""[mission_options] and the `options` of drones as tables.

It holds the functions that read them, and the types that missions share.
"""

from collections.abc import Collection
from typing import Annotated, Literal, TypeVar

from msgspec import Meta

from crazychoir.config.reader import read_table
from crazychoir.config.shared_values import share
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import DroneTable, Height, Id, Swarm, SwarmTable
from crazychoir.errors import ConfigError
from crazychoir.team.graph import describe_ids

T = TypeVar("T", bound=SwarmTable)
"""The table that a mission reads."""
Coordinate = Annotated[float, Meta(ge=-1000, le=1000)]
Spot = Annotated[
    tuple[Coordinate, Coordinate],
    Meta(description="a place [x, y] in m, within 1000 m", examples=[[1.0, 2.5]]),
]
Spots = Annotated[
    tuple[tuple[Coordinate, Coordinate], ...],
    Meta(
        description="places [x, y] in m, within 1000 m",
        examples=[[[1.0, 2.5], [0.0, 1.0]]],
    ),
]
Place = tuple[Coordinate, Coordinate, Coordinate]
Places = Annotated[
    dict[Id, Place],
    Meta(
        description="a table of drone ids and places [x, y, z] in m, within 1000 m",
        examples=[{"0": [0.0, 0.0, 1.0]}],
    ),
]
Spread = Annotated[float, Meta(ge=0, le=10)]
Spreads = Annotated[
    tuple[Spread, Spread, Spread],
    Meta(
        description="three lengths in m, 0 to 10, at most so far along x, y and z",
        examples=[[0.3, 0.3, 0.2]],
    ),
]
Offset = Annotated[
    float, Meta(ge=0, le=10, description="a length in m, 0 to 10", examples=[0.1])
]
Length = Annotated[
    float,
    Meta(
        gt=0, le=100, description="a length in m, above 0, at most 100", examples=[0.4]
    ),
]
Gain = Annotated[
    float,
    Meta(gt=0, le=1000, description="a gain, above 0, at most 1000", examples=[1.6]),
]
Duration = Annotated[
    float,
    Meta(
        gt=0, le=1e6, description="a time in s, above 0, at most 1e6", examples=[20.0]
    ),
]
Period = Annotated[
    float,
    Meta(
        gt=0, le=600, description="a time in s, above 0, at most 600", examples=[10.0]
    ),
]
Ramp = Annotated[
    float, Meta(ge=0, le=600, description="a time in s, 0 to 600", examples=[5.0])
]
Laps = Annotated[
    float,
    Meta(
        gt=0, le=20, description="a number of laps, above 0, at most 20", examples=[2.0]
    ),
]

Yaw = Annotated[
    Annotated[float, Meta(ge=-7, le=7)] | Literal["along"],
    Meta(description='an angle in rad, -7 to 7, or "along"', examples=["along"]),
]


class NoOptions(SwarmTable, frozen=True, kw_only=True):
    """The table of a mission without options, or of drones without options."""


class HeightOption(SwarmTable, frozen=True, kw_only=True):
    """`options` of a drone that may take off to its own height."""

    height: Height | None = None
    """m above the ground: take-off height, instead of that of the swarm file."""


def given(config: SwarmConfig, kind: type[T]) -> T:
    """Return [mission_options] as the table `kind`.

    It is read once for each swarm file.
    Raises ConfigError with the key, what was found and what is allowed.
    """
    return share(config, _read_mission_options, kind)


def _read_mission_options(config: SwarmConfig, kind: type[T]) -> T:
    return read_table(
        config.mission_options, kind, f"swarm {config.name}", "mission_options", Swarm
    )


def own(config: SwarmConfig, drone: DroneTable, kind: type[T]) -> T:
    """Return the `options` of a drone as the table `kind`.

    Raises ConfigError with the key, what was found and what is allowed.
    """
    return read_table(
        drone.options, kind, f"swarm {config.name}: drone {drone.id}", "options", Swarm
    )


def require_none(config: SwarmConfig) -> None:
    """Raise ConfigError for `options` of drones, in a mission that has none for them."""
    for drone in config.drones:
        own(config, drone, NoOptions)


def require_no_options(config: SwarmConfig) -> None:
    """Raise ConfigError for any option, in a mission that has none."""
    given(config, NoOptions)
    require_none(config)


def require_each(config: SwarmConfig, found: Collection[int], key: str) -> None:
    """Raise ConfigError unless [mission_options] has a place for each drone, and for no other id.

    found: the ids with a place.
    key: the key of the places, for the error.
    """
    if tuple(sorted(found)) != config.ids:
        where = f"swarm {config.name}: mission_options.{key}"
        allowed = f"one for each drone, {describe_ids(config.ids)}"
        raise ConfigError(where, f"places of drones {sorted(found)}", allowed)
