"""crazychoir missions: what can be flown, and the options of a mission."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.table import Table

from crazychoir.errors import CrazyChoirError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    exit_with_error,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.guidance.mission_listing import (
        MissionDescription,
        OptionDescription,
    )


def missions(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Mission in agents/, or mission file (.py): list its options."
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """List the missions, or the options of one of them."""
    set_up_logging()
    from crazychoir.guidance.mission_listing import (  # takes 1 s, which --help does not need
        describe_mission,
        list_summaries,
    )

    try:
        if name is None:
            _show_missions(list_summaries(), as_json)
        else:
            _show_options(describe_mission(name), as_json)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)


def _show_missions(summaries: dict[str, str], as_json: bool) -> None:
    if as_json:
        write_json(summaries)
        return
    table = Table("mission", "", box=box.SIMPLE_HEAD, padding=0)
    for name, summary in summaries.items():
        table.add_row(name, summary)
    ANSWER_CONSOLE.print(table)


def _show_options(mission: "MissionDescription", as_json: bool) -> None:
    if as_json:
        write_json(asdict(mission))
        return
    ANSWER_CONSOLE.print(mission.summary)
    _show_table("[mission_options]", mission.mission_options)
    _show_table("options of a drone", mission.drone_options)


def _show_table(title: str, options: "tuple[OptionDescription, ...]") -> None:
    from crazychoir.config.reader import show_value

    if not options:
        ANSWER_CONSOLE.print(f"\n{title}: none")
        return
    ANSWER_CONSOLE.print(f"\n{title}:")
    table = Table("option", "value", "default", "meaning", box=box.SIMPLE_HEAD)
    for entry in options:
        default = "" if entry.default is None else show_value(entry.default)
        table.add_row(entry.option, entry.value, default, entry.meaning)
    ANSWER_CONSOLE.print(table)
