"""Numeric options of the command line: each option names its limits and refuses infinite numbers.

The error says what was found, what is allowed, and what was probably meant.
"""

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from crazychoir.errors import ConfigError

if TYPE_CHECKING:
    from crazychoir.team.graph import Graph


@dataclass(frozen=True, slots=True)
class OptionLimits:
    """Largest numbers that options of commands take."""

    time: float = 31_536_000.0
    """Longest time that an option takes, s."""
    seed: int = 2**63 - 1
    """Largest seed."""
    number: int = 1_000_000
    """Largest count."""
    drones: int = 10_000
    """Largest number of drones."""
    agents: int = 1_000_000
    """Largest number of simulated agents."""


OPTION_LIMITS = OptionLimits()


UNIT_FACTORS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
"""Length in s of the units that users may write."""
_NUMBER_WITH_UNIT = re.compile(
    r"([0-9.]+(?:e[+-]?[0-9]+)?)\s*(ms|s|min|h)", re.IGNORECASE
)


@dataclass(frozen=True)
class RealNumber:
    """Reads a finite number within limits."""

    least: float = -math.inf
    """Lower limit."""
    most: float = math.inf
    """Upper limit."""
    open_below: bool = False
    """Whether `least` itself is not allowed."""
    unit: str = ""
    """"share" or "s", used to suggest what was probably meant; else empty."""

    def __call__(self, text: str | float) -> float:
        """Return the number.

        Raises typer.BadParameter, which names the option, with the allowed numbers.
        """
        try:
            number = float(text)
        except ValueError:
            raise _build_refusal(
                str(text), self.allowed, self._meant(str(text))
            ) from None
        above = self.least < number if self.open_below else self.least <= number
        if not (math.isfinite(number) and above and number <= self.most):
            raise _build_refusal(str(text), self.allowed, self._hint(number))
        return number

    @property
    def allowed(self) -> str:
        """The limits in words."""
        kind = {"s": "a finite number of s", "share": "a probability"}.get(
            self.unit, "a finite number"
        )
        above = "above " if self.open_below else ""
        if self.least == -math.inf:
            return (
                kind
                if self.most == math.inf
                else f"{kind}, at most {_format_limit(self.most)}"
            )
        if self.most == math.inf:
            return f"{kind}, {above}{_format_limit(self.least)}{'' if above else ' or more'}"
        if self.open_below:
            return f"{kind}, above {_format_limit(self.least)}, at most {_format_limit(self.most)}"
        return f"{kind}, {_format_limit(self.least)} to {_format_limit(self.most)}"

    def _hint(self, number: float) -> str:
        """Return what was probably meant by a number that is not allowed."""
        if self.unit == "share" and 1.0 < number <= 100.0:
            return f"{number:g} % is {number / 100.0:g}."
        return ""

    def _meant(self, text: str) -> str:
        """Return what was probably meant by a text that is no number."""
        bare = text.strip()
        if bare.endswith("%") and _is_number(bare[:-1]):
            return f"{bare[:-1].strip()} % is {float(bare[:-1]) / 100.0:g}."
        if _is_number(bare.replace(",", ".", 1)):
            return f"Write {bare.replace(',', '.', 1)}."
        match = _NUMBER_WITH_UNIT.fullmatch(bare)
        if match and self.unit == "s" and _is_number(match[1]):
            return f"Write {float(match[1]) * UNIT_FACTORS[match[2].lower()]:g}."
        return ""


@dataclass(frozen=True)
class WholeNumber:
    """Reads a whole number within limits."""

    least: int
    """Lower limit."""
    most: int
    """Upper limit."""

    def __call__(self, text: str | int) -> int:
        """Return the number.

        Raises typer.BadParameter, which names the option, with the allowed numbers.
        """
        allowed = f"a whole number, {self.least} to {self.most}"
        try:
            number = int(text)
        except ValueError:
            raise _build_refusal(
                str(text), allowed, _suggest_whole(str(text))
            ) from None
        if not self.least <= number <= self.most:
            raise _build_refusal(str(text), allowed, "")
        return number


def _build_refusal(found: str, allowed: str, hint: str) -> typer.BadParameter:
    return typer.BadParameter(
        f"found {_quote_shortened(found)}; allowed: {allowed}. {hint}".rstrip()
    )


def real(
    text: str,
    *names: str,
    least: float = -math.inf,
    most: float = math.inf,
    open_below: bool = False,
) -> Any:
    """Return an option that takes a finite number.

    text: its help
    names: its names, such as "--speed"; without any, that of the parameter
    least: lower limit
    most: upper limit
    open_below: whether `least` itself is not allowed
    """
    return _option(text, names, RealNumber(least, most, open_below))


def share(text: str, *names: str) -> Any:
    """Return an option that takes a share, 0 to 1."""
    return _option(text, names, RealNumber(0.0, 1.0, unit="share"))


def seconds(
    text: str,
    *names: str,
    least: float = 0.0,
    most: float = OPTION_LIMITS.time,
    open_below: bool = False,
) -> Any:
    """Return an option that takes a time in s."""
    return _option(text, names, RealNumber(least, most, open_below, unit="s"))


def whole(
    text: str, *names: str, least: int = 1, most: int = OPTION_LIMITS.number
) -> Any:
    """Return an option that takes a whole number."""
    return _option(text, names, WholeNumber(least, most))


def size(text: str, *names: str) -> Any:
    """Return an option for a number of drones, or of things with at most one for each drone."""
    return whole(text, *names, most=OPTION_LIMITS.drones)


def seed(text: str, *names: str) -> Any:
    """Return an option that takes a seed."""
    return whole(text, *names, least=0, most=OPTION_LIMITS.seed)


def _option(text: str, names: tuple[str, ...], reader: RealNumber | WholeNumber) -> Any:
    return typer.Option(
        *names,
        help=text,
        parser=reader,
        metavar="<int>" if isinstance(reader, WholeNumber) else "<float>",
    )


def build_named_graph(
    text: str, size: int, seed: int, directed: bool = False
) -> "Graph":
    """Return the graph that --graph names, for `size` drones.

    Raises ConfigError, which names the option.
    """
    from crazychoir.team.graph import (
        graph_from_name,  # numerics: --help does not need them
    )

    try:
        return graph_from_name(text, size, seed, directed)
    except ConfigError as error:
        raise ConfigError("--graph", error.found, error.allowed, error.do) from error


def parse_finite_numbers(
    text: str, where: str, allowed: str, count: int | None = None
) -> list[float]:
    """Return the numbers of a text such as "1,0.5,1.2".

    where: name of the option, for the error
    allowed: what the option takes, for the error
    count: required number of numbers; None for any
    Raises ConfigError for another text, a number that is not finite, or another count.
    """
    try:
        found = [float(word) for word in text.strip().strip("[]()").split(",")]
    except ValueError:
        found = []
    if (
        not found
        or not all(map(math.isfinite, found))
        or count not in (None, len(found))
    ):
        raise ConfigError(where, _quote_shortened(text), allowed)
    return found


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _suggest_whole(text: str) -> str:
    """Return how to write a whole number that has another form; empty for other texts."""
    if _is_number(text) and float(text).is_integer() and abs(float(text)) < 1e15:
        return f"Write {float(text):.0f}."
    return ""


def _format_limit(limit: float) -> str:
    return f"{limit:.0f}" if float(limit).is_integer() else f"{limit:g}"


def _quote_shortened(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."
