"""Check that the times of a recording are in s; refuse other units, with a guess of the unit."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from crazychoir.errors import ConfigError


@dataclass(frozen=True, slots=True)
class RecordedTimeLimits:
    """Limits by which the unit of recorded times, and jumps of their clock, are recognised."""

    largest_time: float = 1e11
    """s: a larger number is no time in s. From 1970 until now it is 1.8e9 s, or 1.8e12 ms.
    """
    longest_gap: float = 600.0
    """s between two rows: with a longer gap the clock of the recording was set, and a replay would
    wait for as long.
    """
    slowest_period: float = 2.0
    """s: half of the rows of a recording come faster, where times are in s."""
    plausible_periods: tuple[float, ...] = (1e-4, 1.0)
    """s: shortest and longest period of rows, for guessing the unit of times that are not in s.
    """


RECORDED_TIME_LIMITS = RecordedTimeLimits()


TIME_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # s


def require_seconds(
    path: str | Path, lines: Sequence[int], times: Sequence[float], least: int = 3
) -> None:
    """Raise ConfigError for times that are in another unit than s: too large, or too far from each other.

    lines: where each row stands in the file.
    times: of each row.
    least: how many different times there must be to judge how far they are from each other.
    """
    largest, line = max(zip(map(abs, times), lines, strict=True))
    different = sorted(set(times))
    periods = sorted(b - a for a, b in itertools.pairwise(different))
    period = periods[len(periods) // 2] if periods else 0.0
    if largest < RECORDED_TIME_LIMITS.largest_time and (
        len(different) < least or period < RECORDED_TIME_LIMITS.slowest_period
    ):
        return
    found = f"t = {times[lines.index(line)]!r}, rows {period:g} apart"
    fits = [
        unit
        for unit, factor in TIME_UNITS.items()
        if RECORDED_TIME_LIMITS.plausible_periods[0]
        <= period * factor
        <= RECORDED_TIME_LIMITS.plausible_periods[1]
    ]
    do = (
        f"They are {' or '.join(fits)}, as it seems: convert t to s."
        if fits
        else "Convert t to s."
    )
    allowed = (
        f"t in s: below {RECORDED_TIME_LIMITS.largest_time:g} s, from any origin, and "
        f"mostly less than {RECORDED_TIME_LIMITS.slowest_period:g} s apart"
    )
    raise ConfigError(f"{path}, line {line}", found, allowed, do)


def require_later(path: str | Path, line: int, before: float, t: float) -> None:
    """Raise ConfigError where the clock of a recording goes back, or ahead by more than a replay can wait.

    line: where t stands in the file.
    before: s, the time of the row before.
    t: s.
    """
    where = f"{path}, line {line}"
    do = "The clock of the recording was set there: cut the file in two, or shift the times that follow."
    if t < before:
        raise ConfigError(where, f"t = {t!r}", f"{before!r} or more, as before", do)
    if t - before > RECORDED_TIME_LIMITS.longest_gap:
        raise ConfigError(
            where,
            f"t = {t!r}, {t - before:.6g} s after the row before",
            f"{RECORDED_TIME_LIMITS.longest_gap:g} s",
            do,
        )
