"""The arguments of the commands of an operator, as a drone accepts them."""

from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct

from crazychoir.agent.order_times import LONGEST_VELOCITY
from crazychoir.bus.codec import MAX_PAYLOAD
from crazychoir.errors import ConfigError
from crazychoir.planning.piecewise import POLYNOMIAL_DEGREE, Piecewise

PIECE_SIZE = 8 * (4 * (POLYNOMIAL_DEGREE + 1) + 1)
"""Bytes of a piece of a path in a message."""
MOST_PIECES = MAX_PAYLOAD // PIECE_SIZE - 10
"""Largest number of pieces of a path in one message."""
Metres = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
"""m."""
Speed = Annotated[float, Meta(ge=-20.0, le=20.0)]
"""m/s."""
Angle = Annotated[float, Meta(ge=-7.0, le=7.0)]
"""rad, or rad/s."""
Seconds = Annotated[float, Meta(ge=0.0, le=600.0)]
"""s."""
Slowdown = Annotated[float, Meta(ge=0.01, le=100.0)]
"""Factor on a duration."""
A = TypeVar("A", bound="CommandArguments")


class CommandArguments(Struct, frozen=True, forbid_unknown_fields=True):
    """The arguments of a command; none, in this base class."""


class TakeOffArguments(CommandArguments, frozen=True):
    """The arguments of `take-off`."""

    height: Annotated[float, Meta(ge=0.0, le=1000.0)] | None = None
    """m above the ground. None: the height that the mission wants."""
    duration: Seconds = 0.0
    """s, or 0: as fast as the limits allow."""


class LandArguments(CommandArguments, frozen=True):
    """The arguments of `land`."""

    height: Annotated[float, Meta(ge=0.0, le=1000.0)] = 0.0
    """m above the ground: height of the floor on which the drone lands, such as a table."""
    duration: Seconds = 0.0
    """s of the way down, or 0: as fast as the limits allow."""


class OperatorGoal(CommandArguments, frozen=True):
    """The arguments of `go-to`."""

    p: tuple[Metres, Metres, Metres]
    """(3,) m, world."""
    yaw: Angle | None = None
    """rad. None: keep the present yaw."""
    duration: Seconds = 0.0
    """s, or 0: as fast as the limits allow."""
    relative: bool = False
    """Whether p and yaw count from the present set-point."""
    speed: Annotated[float, Meta(gt=0.0, le=20.0)] | None = None
    """m/s: largest speed on the way, if `duration` and the limits do not demand less."""


class OperatorVelocity(CommandArguments, frozen=True):
    """The arguments of `velocity`."""

    v: tuple[Speed, Speed, Speed]
    """(3,) m/s, world."""
    yaw_rate: Angle = 0.0
    """rad/s."""
    duration: Annotated[float, Meta(gt=0.0, le=LONGEST_VELOCITY)] = 1.0
    """s after which the drone comes to rest, unless a newer command comes before.

    At most LONGEST_VELOCITY: a script renews the command for a longer flight.
    """


class OnBoardFlight(CommandArguments, frozen=True):
    """How the planner on board flies an uploaded trajectory."""

    timescale: Annotated[float, Meta(ge=0.05, le=20.0)] = 1.0
    """Factor on its duration."""
    reversed: bool = False
    """Whether it is flown from its end to its start."""

    def apply(self, path: Piecewise) -> Piecewise:
        """Return the uploaded path as the planner on board flies it."""
        slowed = path.slowed(self.timescale)
        return slowed.reversed() if self.reversed else slowed


class PathArguments(CommandArguments, frozen=True):
    """The arguments of `fly` beside the path itself."""

    timescale: Slowdown = 1.0
    """Factor on the duration of the path: 2 is half the speed."""
    reverse: bool = False
    """Whether to fly from the end of the path to its start."""
    relative: bool = False
    """Whether to shift the path so that it starts at the present set-point."""
    on_board: OnBoardFlight | None = None
    """How the planner on board flies the path from its memory. None: the agent flies it."""


def convert_arguments(verb: str, found: dict[str, Any], kind: type[A]) -> A:
    """Return the arguments of a command. Raises ConfigError with the reason for wrong ones."""
    try:
        return msgspec.convert(found, kind)
    except msgspec.ValidationError as error:
        names = ", ".join(kind.__struct_fields__) or "none"
        raise ConfigError(verb, str(error), f"the arguments {names}") from error


def convert_path(arguments: dict[str, Any]) -> tuple[Piecewise, PathArguments]:
    """Return the path in the arguments of `fly`, as it is to be flown, and the other arguments.

    The path is not shifted yet. Raises ConfigError for wrong arguments.
    """
    given = dict(arguments)
    try:
        path = Piecewise(given.pop("coefficients"), given.pop("durations"))
    except (KeyError, TypeError, ValueError) as error:
        found = f"{type(error).__name__}: {error}"
        allowed = "coefficients (k, 4, 8) and durations (k,)"
        raise ConfigError("fly", found, allowed) from error
    asked = convert_arguments("fly", given, PathArguments)
    turned = path.reversed() if asked.reverse else path
    return (turned if asked.timescale == 1.0 else turned.slowed(asked.timescale)), asked


def path_message(path: Piecewise, **arguments: Any) -> dict[str, Any]:
    """Return the arguments of `fly`.

    arguments: those of PathArguments
    Raises ConfigError for a path that is too long for one message.
    """
    if len(path.durations) > MOST_PIECES:
        raise ConfigError(
            "path",
            f"{len(path.durations)} pieces",
            f"at most {MOST_PIECES}",
            "Draw less at once.",
        )
    return {
        "coefficients": path.coefficients.copy(),
        "durations": path.durations,
        **arguments,
    }
