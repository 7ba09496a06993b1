"""crazychoir validate: compare the motor-level simulator with recorded flights of real drones."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table

from crazychoir.errors import CrazyChoirError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    CommandOutputs,
    exit_with_error,
    require_drawable,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.simulation.identification.scores import OpenLoopErrors
    from crazychoir.simulation.identification.windows import FlightWindows

MODEL_HEADINGS = (
    "0.1 s mm",
    "deg",
    "0.25 s mm",
    "deg",
    "0.5 s mm",
    "m/s",
    "deg",
)
"""Headings of the table of models: errors at three times ahead."""
OPEN_LOOP_NOTE = (
    "RMSE of open-loop predictions, each 0.5 s of flight, from the recorded motors and battery. "
    "Trims: thrust and three angular offsets, from the flight before the prediction; those of the first "
    "3 s are scored on later windows."
)


def validate(
    files: Annotated[
        list[Path],
        typer.Argument(help="Recorded flights of one drone, .npz.", show_default=False),
    ],
    platform: Annotated[
        str, typer.Option(help="Platform of the simulated drone.")
    ] = "cf21",
    fit: Annotated[
        bool,
        typer.Option(
            "--fit", help="Also fit the parameters, for each flight to the others."
        ),
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw the errors over the time ahead into this file."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Compare the simulator with recorded flights of a real drone.

    Predicts each half second of the flights open loop, with the motor-level simulator and simpler models.
    """
    set_up_logging()
    from crazychoir.platforms import find_platform
    from crazychoir.simulation.identification.flights import read_flight
    from crazychoir.simulation.identification.models import compare_models
    from crazychoir.simulation.identification.picture import draw_errors
    from crazychoir.simulation.identification.windows import find_windows

    outputs = CommandOutputs()
    try:
        row = find_platform(platform, "--platform")
        require_drawable(picture)
        windows = find_windows([read_flight(path) for path in files])
        scored = compare_models(windows, row, fit, ERROR_CONSOLE.print)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    flights = f"{len(files)} flight" + "s" * (len(files) > 1)
    title = f"{len(windows.start)} windows of {flights}, platform {platform}"
    if picture is not None:
        with outputs.writing("--picture"):
            draw_errors(picture, scored, title)
    if as_json:
        write_json(
            {
                "success": not outputs.failed,
                "platform": platform,
                "windows": len(windows.start),
                "flights": _describe_flights(windows, scored),
                "models": {errors.model: errors.figures() for errors in scored},
                "picture": picture,
                **outputs.told,
            }
        )
    else:
        _show(windows, scored, title)
    outputs.say()
    if outputs.failed:
        raise typer.Exit(1)


def _describe_flights(
    windows: "FlightWindows", scored: "list[OpenLoopErrors]"
) -> dict[str, Any]:
    """Return for each flight its windows, gaps, tilt of the markers, and RMSE of the position after 0.5 s in mm."""
    flights = {}
    for number, flight in enumerate(windows.flights):
        own = windows.flight == number
        flights[flight.name] = {
            "windows": int(own.sum()),
            "share_in_gaps": flight.left_out,
            "marker_tilt_rad": list(flight.marker_tilt),
            "position_mm_after_0.5_s": {
                errors.model: float(errors.rmse(-1, number)[0])
                for errors in scored
                if (errors.flight == number).any()
            },
        }
    return flights


def _show(windows: "FlightWindows", scored: "list[OpenLoopErrors]", title: str) -> None:
    ANSWER_CONSOLE.print(_build_model_table(scored, title))
    ANSWER_CONSOLE.print(_build_flight_table(windows, scored))
    ANSWER_CONSOLE.print(OPEN_LOOP_NOTE)


def _build_model_table(scored: "list[OpenLoopErrors]", title: str) -> Table:
    """Build the table of the errors of each model."""
    from crazychoir.simulation.identification.scores import SCORED_ROWS

    table = _make_table(title, "model", MODEL_HEADINGS)
    for errors in scored:
        early, middle, late = (errors.rmse(row) for row in SCORED_ROWS)
        table.add_row(
            errors.model,
            f"{early[0]:.1f}",
            f"{early[2]:.1f}",
            f"{middle[0]:.1f}",
            f"{middle[2]:.1f}",
            f"{late[0]:.0f}",
            f"{late[1]:.2f}",
            f"{late[2]:.1f}",
        )
    return table


def _build_flight_table(
    windows: "FlightWindows", scored: "list[OpenLoopErrors]"
) -> Table:
    """Build the table of the position errors in each flight."""
    from crazychoir.simulation.identification.models import SHOWN_MODELS

    table = _make_table(
        "position after 0.5 s, mm",
        "flight",
        ("windows", "in gaps", *SHOWN_MODELS.values()),
    )
    for name, flight in _describe_flights(windows, scored).items():
        errors = flight["position_mm_after_0.5_s"]
        table.add_row(
            name,
            str(flight["windows"]),
            f"{flight['share_in_gaps']:.0%}",
            *(
                f"{errors[model]:.0f}" if model in errors else ""
                for model in SHOWN_MODELS
            ),
        )
    return table


def _make_table(title: str, first: str, headings: tuple[str, ...]) -> Table:
    """Make a table with a column of names and columns of numbers."""
    table = Table(
        first, title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    return table
