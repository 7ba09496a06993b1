"""crazychoir plot: draw a recording as pictures and tables."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table

from crazychoir.errors import CrazyChoirError
from crazychoir.files.output_files import output_file, require_writable_folder
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    CommandOutputs,
    exit_with_error,
    set_up_logging,
    warn_of_gaps,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.api.recorded_data import RecordedData
    from crazychoir.recording.analysis.plots import Pictures
    from crazychoir.recording.mcap.reading import Recording

FIGURE_HEADINGS = {
    "source": "place by",
    "flown_m": "flown m",
    "highest_m": "highest m",
    "fastest_m_s": "fastest m/s",
    "compared_s": "compared s",
    "tracking_rmse_m": "RMSE m",
    "tracking_max_m": "worst m",
    "estimation_rmse_m": "state RMSE m",
}
"""Heading of each figure in the table."""
RMSE_NOTE = (
    "RMSE, worst: its place against the reference position, for so many seconds as there was one (a law that commands "
    "accelerations has none). State RMSE: truth against what the drone took for its position."
)
STATE_SOURCE_NOTE = (
    "By state: the drone's own estimate of its position, because its true position was not "
    "recorded."
)


def plot(
    file: Annotated[
        Path, typer.Argument(help="Recording of `crazychoir run --record`.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the files; else FILE without .mcap.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Draw plots of a recorded flight, and write its tables.

    Plots: top, space, tracking, heights, separation, tasks, messages,
    convergence, and log variables.
    The tables (CSV) are written beside the pictures.
    """
    set_up_logging()
    from crazychoir.api.recorded_data import (
        read_data,
    )  # takes 1 s, which --help does not need

    outputs = CommandOutputs()
    folder = out or file.with_suffix("")
    files: list[Path] = []
    try:
        data = read_data(file)
        pictures, missing = data.pictures()
        require_writable_folder(folder, "--out")
        with outputs.writing("--out"):
            _write(data, pictures, folder, files)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    recording = data.recording
    figures = data.figures()
    warn_of_gaps(recording, f"only its first {figures['seconds']:.1f} s are there")
    if as_json:
        told = {"file": file, **recording.lacks, "about": recording.about}
        success = not outputs.failed
        write_json(
            {
                "success": success,
                **told,
                "files": files,
                "not_drawn": missing,
                **outputs.told,
                **figures,
            }
        )
    else:
        _show(recording, figures)
        if missing:
            text = "; ".join(f"{name}: {why}" for name, why in missing.items())
            ANSWER_CONSOLE.print(
                f"Not drawn: {text}", markup=False, highlight=False, soft_wrap=True
            )
        names = ", ".join(path.stem for path in files if path.suffix == ".png")
        text = f"In {folder}/: {names} (.png and .pdf), and what they show as tables (.csv)"
        ANSWER_CONSOLE.print(text, markup=False, highlight=False, soft_wrap=True)
    outputs.say()
    if outputs.failed:
        raise typer.Exit(1)


def _write(
    data: "RecordedData", pictures: "Pictures", folder: Path, files: list[Path]
) -> None:
    """Draw and write the files into the folder; each written file is appended to `files`."""
    from crazychoir.recording.analysis.plots import draw

    for name, picture in pictures.items():
        files += draw({name: picture}, folder)
    for name, write in data.tables().items():
        path = folder / f"{name}.csv"
        with output_file(path, "--out") as place:
            write(place)
        files.append(path)


def _show(recording: "Recording", figures: dict[str, Any]) -> None:
    about = recording.about
    least = figures["min_separation_m"]
    title = f"{about['mission']}, seed {about['seed']}, {figures['seconds']:.2f} s of {about['time']} time"
    table = Table(
        "drone",
        *FIGURE_HEADINGS.values(),
        title=title,
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    for i, own in figures["drones"].items():
        table.add_row(str(i), *(_cell(own[key]) for key in FIGURE_HEADINGS))
    if not figures["drones"]:
        ANSWER_CONSOLE.print(title, markup=False, highlight=False, soft_wrap=True)
        return
    ANSWER_CONSOLE.print(table)
    ANSWER_CONSOLE.print(RMSE_NOTE)
    if any(own["source"] == "state" for own in figures["drones"].values()):
        ANSWER_CONSOLE.print(STATE_SOURCE_NOTE)
    if least is not None:
        ANSWER_CONSOLE.print(
            f"Least distance of two drones: {least:.3f} m", highlight=False
        )
    if "formation_error_m" in figures:
        settling = figures["settling_s"]
        when = "not settled" if settling is None else f"settled after {settling:.2f} s"
        text = f"Error of the formation at its end: {figures['formation_error_m']:.4f} m, {when}"
        ANSWER_CONSOLE.print(text, highlight=False)


def _cell(figure: float | str | None) -> str:
    if figure is None:
        return ""
    return figure if isinstance(figure, str) else f"{figure:.3f}"
