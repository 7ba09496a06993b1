"""crazychoir validate: compare the motor-level simulator with recorded flights of real drones."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table

from crazychoir.cli.recordings.filter_tables import (
    compare_filters,
    refuse_other_options,
)
from crazychoir.cli.shared.drone_choice import parse_drone_word
from crazychoir.errors import ConfigError, CrazyChoirError
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
    from crazychoir.simulation.identification.closed_loop_scores import ClosedLoopScore
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
LOOP_HEADINGS = (
    "speed",
    "apart mm",
    "tracking mm",
    "lag s",
    "rest mm",
    "height mm",
    "tilt deg",
    "laps mm",
)
"""Headings of the table of flights in closed loop."""
CLOSED_LOOP_NOTE = (
    "Closed loop: the recorded set-points flown again by the simulated firmware. Pairs are recorded and simulated "
    "figures. Apart: RMSE between both. Tracking: RMSE against the set-points; rest: behind the lag. "
    "Laps: scatter of the radius over the laps of a circle."
)
OPEN_LOOP_NOTE = (
    "RMSE of open-loop predictions, each 0.5 s of flight, from the recorded motors and battery. "
    "Trims: thrust and three angular offsets, from the flight before the prediction; those of the first "
    "3 s are scored on later windows."
)


def validate(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Recorded flights of one drone: .mcap of --record, or .npz.",
            show_default=False,
        ),
    ],
    platform: Annotated[
        str, typer.Option(help="Platform of the simulated drone.")
    ] = "cf21",
    drone: Annotated[
        str | None,
        typer.Option(help="The drone in an .mcap of several, by its id or name."),
    ] = None,
    fit: Annotated[
        bool,
        typer.Option(
            "--fit", help="Also fit the parameters, for each flight to the others."
        ),
    ] = False,
    filters: Annotated[
        bool,
        typer.Option(
            "--filters", help="Score the velocity filters on the poses, nothing else."
        ),
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw the errors over the time ahead into this file."),
    ] = None,
    paths: Annotated[
        Path | None,
        typer.Option(help="Draw recorded and simulated paths into this file."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Compare the simulator with recorded flights of a real drone.

    Predicts each half second of the flights open loop, with the motor-level simulator and simpler models, and flies
    recorded set-points again in closed loop.
    """
    set_up_logging()
    if filters:
        try:
            refuse_other_options({"--fit": fit, "--picture": picture, "--paths": paths})
            compare_filters(files, parse_drone_word(drone), platform, as_json)
        except CrazyChoirError as error:
            exit_with_error(error, as_json)
        return
    from crazychoir.platforms import find_platform
    from crazychoir.recording.recorded_flight import read_any_flight
    from crazychoir.simulation.identification.closed_loop import fly_again
    from crazychoir.simulation.identification.closed_loop_scores import (
        find_medians,
        score_closed_loop,
    )
    from crazychoir.simulation.identification.models import compare_models
    from crazychoir.simulation.identification.picture import draw_errors, draw_paths
    from crazychoir.simulation.identification.windows import find_windows

    outputs = CommandOutputs()
    try:
        row = find_platform(platform, "--platform")
        require_drawable(picture)
        require_drawable(paths)
        word = parse_drone_word(drone)
        read = [read_any_flight(path, word) for path in files]
        windows = find_windows(read)
        scored = compare_models(windows, row, fit, ERROR_CONSOLE.print)
        flown = fly_again([one for one in read if one.setpoints is not None], row)
        loops = [score_closed_loop(one) for one in flown]
        if paths is not None and not flown:
            raise ConfigError(
                "--paths",
                "no flight with set-points that its firmware followed",
                "flights with sp and sp_yaw",
            )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    flights = f"{len(files)} flight" + "s" * (len(files) > 1)
    title = f"{len(windows.start)} windows of {flights}, platform {platform}"
    if picture is not None:
        with outputs.writing("--picture"):
            draw_errors(picture, scored, title)
    if paths is not None:
        with outputs.writing("--paths"):
            draw_paths(paths, flown)
    if as_json:
        write_json(
            {
                "success": not outputs.failed,
                "platform": platform,
                "windows": len(windows.start),
                "flights": _describe_flights(windows, scored),
                "models": {errors.model: errors.figures() for errors in scored},
                "closed_loop": [loop.figures() for loop in loops],
                "closed_loop_medians": find_medians(loops),
                "picture": picture,
                "paths": paths,
                **outputs.told,
            }
        )
    else:
        _show(windows, scored, title)
        if loops:
            ANSWER_CONSOLE.print(_build_loop_table(loops))
            ANSWER_CONSOLE.print(CLOSED_LOOP_NOTE)
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
            "notes": list(flight.notes),
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
    for flight in windows.flights:
        for note in flight.notes:
            ANSWER_CONSOLE.print(f"{flight.name}: {note}", highlight=False)


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


def _build_loop_table(loops: "list[ClosedLoopScore]") -> Table:
    """Build the table of the flights in closed loop, with medians for each speed."""
    from crazychoir.simulation.identification.closed_loop_scores import find_medians

    table = _make_table("closed loop", "flight", LOOP_HEADINGS)
    for loop in loops:
        real = loop.real
        other = loop.simulated
        laps = ""
        if real.scatter_mm is not None and other.scatter_mm is not None:
            laps = f"{real.scatter_mm:.0f} {other.scatter_mm:.0f}"
        table.add_row(
            loop.flight,
            loop.speed,
            f"{loop.difference_mm:.0f}",
            f"{real.tracking_mm:.0f} {other.tracking_mm:.0f}",
            f"{real.lag_s:.2f} {other.lag_s:.2f}",
            f"{real.rest_mm:.0f} {other.rest_mm:.0f}",
            f"{real.height_mm:.0f} {other.height_mm:.0f}",
            f"{real.tilt_deg:.1f} {other.tilt_deg:.1f}",
            laps,
        )
    for speed, medians in find_medians(loops).items():
        table.add_row(
            f"median of {medians['flights']:.0f}",
            speed,
            f"{medians['difference_mm']:.0f}",
            f"x {medians['ratio']:.2f}",
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
