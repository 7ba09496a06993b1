"""crazychoir validate --filters: the errors of the filters on recorded poses, as tables or JSON."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from crazychoir.errors import ConfigError
from crazychoir.launch.console import ANSWER_CONSOLE, write_json

if TYPE_CHECKING:
    from crazychoir.simulation.identification.filter_scores import FilterErrors

DETAILED_RATE = 100
"""Hz: the rate for which the errors of each flight are shown: that of the recorded poses."""
DETAILED_FILTERS = ("derivative", "kalman, no commands", "kalman")
"""Filters for which they are shown."""
FILTER_NOTE = (
    "RMSE against the derivative of the smoothed places (110 ms) and, without gaps, against the gyroscope. With "
    "gaps 2 % of the poses are lost, and there is one gap in 3 s. Commands: recorded motors and gyroscope. "
    "At 240 Hz the poses are the smoothed flight with the noise of the recorded poses."
)


def refuse_other_options(options: dict[str, Path | bool | None]) -> None:
    """Raise ConfigError if an option is given that --filters does not follow.

    options: their values by name; None or False for an option that is not given
    """
    given = [name for name, value in options.items() if value]
    if given:
        raise ConfigError(
            "--filters", f"{' and '.join(given)} beside it", "--platform and --json"
        )


def compare_filters(
    files: list[Path], drone: int | str | None, platform: str, as_json: bool
) -> None:
    """Score the filters on the poses of recorded flights, and print the errors.

    drone: its id or name in recordings of several

    Raises ConfigError if a file is no flight, or the platform is not known.
    """
    from crazychoir.platforms import find_platform
    from crazychoir.recording.recorded_flight import read_any_flight
    from crazychoir.simulation.identification.filter_scores import score_filters

    row = find_platform(platform, "--platform")
    flights = [read_any_flight(path, drone) for path in files]
    scored = score_filters(flights, row)
    names = [flight.name for flight in flights]
    if as_json:
        write_json(_describe(scored, platform, names))
        return
    ANSWER_CONSOLE.print(_build_filter_table(scored, len(names), platform))
    ANSWER_CONSOLE.print(_build_flight_table(scored, names))
    ANSWER_CONSOLE.print(FILTER_NOTE)


def _describe(
    scored: "list[FilterErrors]", platform: str, names: list[str]
) -> dict[str, Any]:
    """Return the answer for JSON."""
    return {
        "success": True,
        "platform": platform,
        "flights": names,
        "filters": [errors.figures() for errors in scored],
    }


def _build_filter_table(
    scored: "list[FilterErrors]", count: int, platform: str
) -> Table:
    """Build the table of each filter at each rate."""
    from crazychoir.simulation.identification.filter_scores import GAP_LENGTHS

    flights = f"{count} flight" + "s" * (count > 1)
    table = _make_table(
        f"body rates, rad/s, and velocity, mm/s: {flights}, {platform}",
        ("Hz", "rates", *GAP_LENGTHS),
    )
    rows: dict[tuple[int, str], list[str]] = {}
    for errors in scored:
        figures = errors.figures()
        row = rows.setdefault((errors.rate, errors.filter), [])
        if not row:
            row.append(f"{figures['rates_rad_s']:.2f}")
        row.append(f"{figures['velocity_mm_s']:.1f}")
    for (rate, name), row in rows.items():
        table.add_row(name, str(rate), *row)
    return table


def _build_flight_table(scored: "list[FilterErrors]", names: list[str]) -> Table:
    """Build the table of the velocity errors in each flight, without gaps."""
    from crazychoir.simulation.identification.filter_scores import NO_GAPS

    chosen = [
        errors
        for errors in scored
        if errors.rate == DETAILED_RATE
        and errors.gaps == NO_GAPS
        and errors.filter in DETAILED_FILTERS
    ]
    table = _make_table(
        f"velocity, mm/s, {DETAILED_RATE} Hz, {NO_GAPS}",
        tuple(errors.filter for errors in chosen),
    )
    for number, name in enumerate(names):
        table.add_row(
            name, *(f"{1e3 * errors.velocity[number]:.1f}" for errors in chosen)
        )
    return table


def _make_table(title: str, headings: tuple[str, ...]) -> Table:
    """Make a table with a column of names and columns of numbers."""
    table = Table(
        "", title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    return table
