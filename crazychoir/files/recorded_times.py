"""The times of a recording, which must be in s: other units are guessed, and refused."""

import itertools
from collections.abc import Sequence
from pathlib import Path

from crazychoir.errors import ConfigError

LARGEST_TIME = 1e11  # s
"""What is beyond is no time in seconds, from whatever origin: 1970 was 1.8e9 s ago, which are 1.8e12 ms."""
LONGEST_GAP = 600.0  # s
"""Between two rows: beyond, the clock of the recording was set, and a replay would wait for as long."""
SLOWEST_PERIOD = 2.0  # s
"""Half of the rows of a recording come faster than that, where times are in s."""
PERIODS = (1e-4, 1.0)  # s
"""Between two rows of a recording, for guessing the unit of times that are not in s."""
UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # s


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
    if largest < LARGEST_TIME and (len(different) < least or period < SLOWEST_PERIOD):
        return
    found = f"t = {times[lines.index(line)]!r}, rows {period:g} apart"
    fits = [
        unit
        for unit, factor in UNITS.items()
        if PERIODS[0] <= period * factor <= PERIODS[1]
    ]
    do = (
        f"They are {' or '.join(fits)}, as it seems: convert t to s."
        if fits
        else "Convert t to s."
    )
    allowed = f"t in s: below {LARGEST_TIME:g} s, from any origin, and mostly less than {SLOWEST_PERIOD:g} s apart"
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
    if t - before > LONGEST_GAP:
        raise ConfigError(
            where,
            f"t = {t!r}, {t - before:.6g} s after the row before",
            f"{LONGEST_GAP:g} s",
            do,
        )
