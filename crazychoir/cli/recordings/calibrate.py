"""crazychoir calibrate: identify a drone from recordings of its flights."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table

from crazychoir.cli.shared.drone_choice import parse_drone_word, parse_one_drone
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.files.output_files import require_writable_file
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    CommandOutputs,
    exit_with_error,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.simulation.identification.calibration.estimate import Calibration
    from crazychoir.simulation.identification.calibration.flight import (
        CalibrationFlight,
    )

TRIM_KEY = "trim"
"""Key of a calibration that corrects poses."""
CALIBRATION_KEY = "calibration"
"""Key of a [[drones]] that is written."""
SHORTEST_GOOD_FLIGHT = 30.0
"""s: shorter flights are called short."""


def calibrate(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING...",
            help="Recordings of one drone: .mcap of --record, .npz, or .csv with named columns.",
            show_default=False,
        ),
    ],
    platform: Annotated[
        str | None,
        typer.Option(
            help="Platform of the drone; else that of --swarm, or cf21.",
            show_default=False,
        ),
    ] = None,
    drone: Annotated[
        str | None,
        typer.Option(help="The drone in an .mcap of several, by its id or name."),
    ] = None,
    swarm: Annotated[
        Path | None, typer.Option(help="Swarm file with the drone.", show_default=False)
    ] = None,
    target_drone: Annotated[
        str | None,
        typer.Option("--id", help="The drone in --swarm, by its id or name."),
    ] = None,
    write: Annotated[
        bool,
        typer.Option(
            "--write",
            help="Write it into --swarm; the rest of the file is unchanged.",
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Identify a drone from its flights.

    Finds thrust, imbalance of the motors, trim, lag of the rotors, drag, moment of speed, damping, noise and battery,
    each with its error. What the flights do not show stays as it was, and is said. Prints the key `calibration` of
    a drone of the swarm file.
    """
    set_up_logging()
    from crazychoir.simulation.identification.calibration.estimate import (
        calibrate as identify,
    )

    outputs = CommandOutputs()
    try:
        i = _find_id(swarm, target_drone)
        target = _find_target(swarm, write)
        row = _find_platform(platform, swarm, i)
        word = parse_drone_word(drone)
        flights = [_read_flight(path, word) for path in files]
        found = identify(flights, row)
        table = _merge_tables(_find_known(swarm, i), found.table, files)
        if target is not None and found.table:
            from crazychoir.config.editing import write_keys

            with outputs.writing("--write"):
                write_keys(target, {i or 0: {CALIBRATION_KEY: table}})
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    written = target is not None and bool(found.table) and not outputs.failed
    if as_json:
        write_json(
            {
                "success": not outputs.failed,
                "platform": row.name,
                "flights": [_describe_flight(flight) for flight in flights],
                "parameters": _describe_parameters(found),
                CALIBRATION_KEY: table,
                "written": written,
                **outputs.told,
            }
        )
    else:
        _show(found, flights)
        _show_table(table, i, written)
    outputs.say()
    if outputs.failed:
        raise typer.Exit(1)


def _find_id(swarm: Path | None, drone: str | None) -> int | None:
    """Return the id of the drone in the swarm file; raise ConfigError unless both or none are given."""
    from crazychoir.config.swarm_config import find_swarm

    if (drone is None) != (swarm is None):
        raise ConfigError(
            "--swarm, --id", "one of both", "both: the swarm file, and the drone in it"
        )
    choice = parse_one_drone(drone, "--id")
    return None if choice is None else choice.find(find_swarm(str(swarm))[0])[0]


def _find_target(swarm: Path | None, write: bool) -> Path | None:
    """Return the file to write; raise ConfigError unless it is named and can be written."""
    if not write:
        return None
    if swarm is None:
        raise ConfigError(
            "--write", "no swarm file", "--swarm FILE and --id N: where to write"
        )
    require_writable_file(swarm, "--write")
    return swarm


def _find_platform(name: str | None, swarm: Path | None, i: int | None) -> Any:
    """Return the platform of --platform, else of the drone in the swarm file, else cf21."""
    from crazychoir.config.swarm_config import find_swarm
    from crazychoir.platforms import find_platform

    if swarm is not None and i is not None:
        config, _ = find_swarm(str(swarm))
        row = config.drone(i)
        return find_platform(name or row.platform, "--platform")
    return find_platform(name or "cf21", "--platform")


def _read_flight(path: Path, drone: int | str | None) -> "CalibrationFlight":
    """Return one flight, ready to calibrate with; raise ConfigError if it cannot be used."""
    from crazychoir.recording.recorded_flight import RECORDING_SUFFIX
    from crazychoir.simulation.identification.calibration.columns import read_columns
    from crazychoir.simulation.identification.calibration.flight import make_flight

    if path.suffix == RECORDING_SUFFIX:
        from crazychoir.recording.flight_columns import read_flight_columns

        return make_flight(path.stem, read_flight_columns(path, drone))
    return make_flight(path.stem, read_columns(path))


def _describe_flight(flight: "CalibrationFlight") -> dict[str, Any]:
    notes = list(flight.notes)
    if flight.seconds < SHORTEST_GOOD_FLIGHT:
        notes.append(f"short: {flight.seconds:.0f} s can be used")
    return {"name": flight.name, "seconds": flight.seconds, "notes": notes}


def _describe_parameters(found: "Calibration") -> dict[str, Any]:
    """Return the parameters for JSON; numbers that are not finite become null."""
    from crazychoir.simulation.identification.calibration.estimate import (
        PARAMETER_RULES,
    )

    return {
        name: {
            "value": one.value,
            "unit": PARAMETER_RULES[name].unit,
            "found": one.found if math.isfinite(one.found) else None,
            "standard_error": one.deviation if math.isfinite(one.deviation) else None,
            "default": one.default,
            "identified": one.is_identified,
            "from": PARAMETER_RULES[name].source,
            "flights": one.flights,
        }
        for name, one in found.estimates.items()
    }


def _find_known(swarm: Path | None, i: int | None) -> dict[str, Any]:
    """Return what the swarm file has of the drone's calibration, without keys that it leaves out."""
    from msgspec import to_builtins

    from crazychoir.config.swarm_config import find_swarm

    if swarm is None or i is None:
        return {}
    config, _ = find_swarm(str(swarm))
    known = to_builtins(config.drone(i).calibration)
    return {name: value for name, value in known.items() if value is not None}


def _merge_tables(
    known: dict[str, Any], found: dict[str, Any], files: list[Path]
) -> dict[str, Any]:
    """Return what is known with what was found.

    A known trim stays if the flights are recordings of ours: their poses are corrected by it.

    Raises ConfigError if a value is outside what a swarm file may have.
    """
    from crazychoir.config.reader import read_table
    from crazychoir.config.tables import CalibrationTable
    from crazychoir.recording.recorded_flight import RECORDING_SUFFIX

    table = known | found
    if TRIM_KEY in known and any(path.suffix == RECORDING_SUFFIX for path in files):
        table[TRIM_KEY] = known[TRIM_KEY]
    read_table(table, CalibrationTable, CALIBRATION_KEY)
    return table


def _show(found: "Calibration", flights: "list[CalibrationFlight]") -> None:
    ANSWER_CONSOLE.print(_build_table(found, len(flights)))
    for flight in flights:
        described = _describe_flight(flight)
        for note in described["notes"]:
            ANSWER_CONSOLE.print(f"{flight.name}: {note}", highlight=False)
    left = [name for name, one in found.estimates.items() if not one.is_identified]
    if left:
        ANSWER_CONSOLE.print(
            f"Too little excitation, or flights that disagree: {', '.join(left)} stay at their defaults. Fly steps "
            "up and down for the lag, fast circles for drag and moment.",
            highlight=False,
        )


def _show_table(table: dict[str, Any], i: int | None, written: bool) -> None:
    """Say that the table is written, or print the key as it is written."""
    if written:
        ANSWER_CONSOLE.print(f"Written: {CALIBRATION_KEY} of drone {i}.")
    elif table:
        text = ", ".join(f"{key} = {value}" for key, value in table.items())
        ANSWER_CONSOLE.print(
            f"{CALIBRATION_KEY} = {{ {text} }}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )


def _build_table(found: "Calibration", flights: int) -> Table:
    """Build the table of parameters: value, error, default and source."""
    from crazychoir.simulation.identification.calibration.estimate import (
        PARAMETER_RULES,
    )

    title = f"{flights} flight{'s' * (flights > 1)}, platform {found.platform.name}"
    table = Table(
        "parameter",
        title=title,
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    for heading in ("value", "± 2 s.e.", "default", "unit"):
        table.add_column(heading, justify="right")
    table.add_column("from")
    for name, one in found.estimates.items():
        rule = PARAMETER_RULES[name]
        error = f"{2.0 * one.deviation:.2g}" if math.isfinite(one.deviation) else ""
        value = f"{one.value:.4g}" if one.is_identified else "default"
        table.add_row(name, value, error, f"{one.default:.4g}", rule.unit, rule.source)
    return table
