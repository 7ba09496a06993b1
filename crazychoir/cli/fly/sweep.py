"""Fly a mission many times in virtual time, on all cores: `crazychoir sweep`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table as ShownTable

from crazychoir.config.number_lists import parse_spans
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.files.output_files import require_writable_file, save_figure
from crazychoir.launch import number_options as options
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
    from crazychoir.api.table import Table

FILE_SUFFIX = ".runs.jsonl"
"""Suffix, in place of .csv, of the file that keeps the runs beside a table."""
MOST_SHOWN_GROUPS = 6
"""Largest number of groups of runs that the table of medians shows."""
LEAST_WHOLE_FIGURE = 1000
"""Figures from here on are shown as whole numbers."""
PICTURED_FIGURES = ("settling_s", "cost")
"""Figures that a picture shows if no other is asked for, the first that there is."""
SEEDS_ALLOWED = "seeds, with commas between, as 1-20 or 3,5-7"
"""What --seeds takes, for errors."""


def sweep(
    mission: Annotated[
        str,
        typer.Argument(
            help="Mission in agents/, mission file (.py) or swarm file (.toml)."
        ),
    ],
    seeds: Annotated[str, typer.Option(help="Seeds, as 1-20 or 3,5-7.")] = "0-9",
    loss: Annotated[
        str | None,
        typer.Option(help="Shares of messages that are lost, as 0,0.2,0.4."),
    ] = None,
    drones: Annotated[
        str | None, typer.Option(help="Numbers of drones, as 4,11,30.")
    ] = None,
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="NAME=V1,V2: values of a mission option, or of TABLE.KEY of the swarm file. May be repeated.",
        ),
    ] = None,
    jobs: Annotated[
        int | None, options.size("Number of processes; else one a core.")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="Where to write the table (CSV).")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            help="Where to draw the median of a figure over the values (PNG, PDF)."
        ),
    ] = None,
    figure: Annotated[
        str | None,
        typer.Option(
            help="Figure that --picture draws; else settling_s or cost, or the first one."
        ),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            help="Where to keep the runs, to go on after Ctrl-C; else beside the CSV file."
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Fly a mission in virtual time for each seed, loss and option; print medians and quartiles.

    After Ctrl-C the table shows the runs that have ended, and the same command
    goes on where it was. A run that fails is a row of the table, with its reason.
    """
    set_up_logging()
    from crazychoir import api  # takes 1 s, which --help does not need

    outputs = CommandOutputs()
    kept = csv.with_suffix(FILE_SUFFIX) if file is None and csv is not None else file
    try:
        if csv is not None:
            require_writable_file(csv, "--csv", (".csv",), parents=True)
        require_drawable(picture)
        if figure is not None and picture is None:
            raise ConfigError("--figure", figure, "a figure for --picture")
        chosen = dict(parse_values(text) for text in values or ())
        table = api.sweep(
            mission,
            seeds=parse_spans(
                seeds, "--seeds", SEEDS_ALLOWED, last=options.OPTION_LIMITS.seed
            ),
            loss=None if loss is None else _parse_shares(loss),
            options=chosen,
            drones=None if drones is None else _parse_counts(drones),
            jobs=jobs,
            file=kept,
        )
        if csv is not None:
            with outputs.writing("--csv"):
                table.to_csv(csv)
        if picture is not None:
            with outputs.writing("--picture"):
                _draw(table, figure, picture)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    except KeyboardInterrupt as end:
        ended_runs = getattr(end, "table", None)
        text = _describe_interruption(kept, ended_runs)
        ended = {"success": False, "error": text, "kind": "KeyboardInterrupt"}
        _show(ended_runs, as_json, ended)
        ERROR_CONSOLE.print(text, markup=False, highlight=False, soft_wrap=True)
        raise typer.Exit(130) from None
    _show(table, as_json, {"success": not outputs.failed} | outputs.told)
    outputs.say()
    if outputs.failed:
        raise typer.Exit(1)


def _show(table: "Table | None", as_json: bool, told: dict[str, Any]) -> None:
    """Print the medians of the runs that have ended, or all runs as JSON.

    told: more values of the JSON object
    """
    runs: dict[str, Any] = {}
    if table:
        summary = table.summary()
        runs = {"runs": len(table), "rows": table.rows, "summary": summary.rows}
        if not as_json:
            ANSWER_CONSOLE.print(_build_summary_table(summary, table.figures))
            _show_failures(table)
    if as_json:
        write_json(runs | told)


def _draw(table: "Table", figure: str | None, path: Path) -> None:
    """Draw a figure over the input that varies; a second input that varies has a line a value."""
    if figure is None and not table.figures:
        raise ConfigError("--picture", "no figure of any run", "a run with a figure")
    varied = [
        name
        for name in table.inputs
        if name != "seed" and len({str(value) for value in table.column(name)}) > 1
    ]
    varied.sort(key=lambda name: isinstance(table.column(name)[0], str))
    across, by, *_ = [*varied, None, None]
    usual = [name for name in PICTURED_FIGURES if name in table.figures]
    drawn = figure or [*usual, *table.figures][0]
    shown = table.plot(drawn, across, by)
    save_figure(shown, path)


def parse_values(text: str) -> tuple[str, list[Any]]:
    """Return the name and the values of a text such as "gain=1,2" or "at=[0,1],[2,3]".

    A value that is no JSON is a text. Raises ConfigError without a name or a value.
    """
    name, _, listed = text.partition("=")
    if not (name.strip() and listed.strip()):
        raise ConfigError("--set", text, "NAME=V1,V2", "For example --set gain=1,2.")
    try:
        return name.strip(), list(json.loads(f"[{listed}]"))
    except json.JSONDecodeError:
        return name.strip(), [_parse_value(word) for word in listed.split(",")]


def _parse_value(word: str) -> Any:
    try:
        return json.loads(word)
    except json.JSONDecodeError:
        return word.strip()


def _parse_shares(text: str) -> list[float]:
    allowed = "probabilities, 0 to 1, as 0,0.2,0.4"
    return options.parse_finite_numbers(text, "--loss", allowed)


def _parse_counts(text: str) -> list[int]:
    allowed = "numbers of drones, as 4,11,30"
    return parse_spans(text, "--drones", allowed, last=options.OPTION_LIMITS.drones)


def _describe_interruption(kept: Path | None, table: "Table | None") -> str:
    """Return how the sweep goes on.

    kept: file of the runs
    table: the runs of this sweep that have ended; None before the first one could fly
    """
    if kept is None or not kept.is_file():
        return "Ctrl-C: the sweep ends here; name --csv or --file, and the next one can go on from there"
    runs = "the runs of before" if table is None else f"{len(table)} runs"
    return f"Ctrl-C: {runs} are kept in {kept}: the same command goes on from there"


def _build_summary_table(summary: "Table", figures: list[str]) -> ShownTable:
    """Return the medians with their quartiles: a row a figure, a column a group of runs."""
    groups = summary.rows[:MOST_SHOWN_GROUPS]
    varied = [n for n in summary.inputs if len({str(r[n]) for r in summary.rows}) > 1]
    heads = [", ".join(f"{name} {row[name]}" for name in varied) for row in groups]
    more = len(summary) - len(groups)
    table = ShownTable(
        "median (quartiles)",
        *(head or "all runs" for head in heads),
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
        caption=f"and {more} more groups: --json, or --csv with all runs"
        if more > 0
        else None,
    )
    succeeded = [f"{row['succeeded']} of {row['runs']}" for row in groups]
    table.add_row("succeeded", *succeeded)
    for name in figures:
        cells = [
            [row[f"{name}_{end}"] for end in ("median", "q1", "q3")] for row in groups
        ]
        texts = [[_format_figure(value) for value in cell] for cell in cells]
        table.add_row(name, *(f"{m} ({a}–{b})" if m else "" for m, a, b in texts))
    return table


def _format_figure(value: float | None) -> str:
    """Return a figure with three digits, large ones in whole numbers; empty for None."""
    if value is None:
        return ""
    return f"{value:.3g}" if abs(value) < LEAST_WHOLE_FIGURE else f"{value:.0f}"


def _show_failures(table: "Table") -> None:
    """Print each reason of failed runs once, with the number of runs."""
    counts: dict[str, int] = {}
    for row in table.rows:
        if not row["success"]:
            reason = str(row["reason"])
            counts[reason] = counts.get(reason, 0) + 1
    for reason, count in counts.items():
        text = f"{count} failed: {reason}"
        ANSWER_CONSOLE.print(text, markup=False, highlight=False, soft_wrap=True)
