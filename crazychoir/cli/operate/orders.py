"""Command the drones of a running swarm: arm, take-off, start, hold, go, land, home, stop."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from crazychoir.cli.operate.inspect import JsonOption, SwarmOption, run_as_observer
from crazychoir.config.number_lists import parse_spans
from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import ANSWER_CONSOLE, exit_with_error, write_json

if TYPE_CHECKING:
    from crazychoir.launch.observer import Answers, Window

DronesOption = Annotated[
    str | None, typer.Option("--drones", help="Only these drones, as 3,5-7; else all.")
]


@dataclass(frozen=True, slots=True)
class OrderAnswers:
    """Words for what a drone answers to a flight command."""

    done: str = "done"
    """The drone has done it."""
    absent: str = "absent"
    """No agent of the drone was found."""
    silent: str = "silent"
    """The drone does not answer."""


ORDER_ANSWERS = OrderAnswers()


ORDER_TIMEOUTS = {
    "arm": 5.0,
    "take-off": 30.0,
    "start": 5.0,
    "hold": 5.0,
    "go": 5.0,
    "land": 60.0,
    "home": 120.0,
}
"""Default seconds to wait until a command is done, by command."""
Rows = dict[int, dict[str, str]]
ORDER_HELP = {
    "arm": "Check whether drones can take off, and arm motors that need it.",
    "take-off": "Take off and hover, in a run with `--wait`.",
    "start": "Start the missions of hovering drones, in a run with `--wait`.",
    "hold": "Stop drones in the air; their missions wait, at most 300 s.",
    "go": "Let held drones continue their missions.",
    "land": "Land drones where they are, and end their missions.",
    "home": "Fly drones back above the others, land, and end their missions.",
}


def make_order_command(verb: str, seconds: float) -> Callable[..., None]:
    """Return the command line of a flight command; seconds: default of its option --wait."""

    def command(
        drones: DronesOption = None,
        swarm: SwarmOption = None,
        wait: Annotated[
            float, options.seconds("s to wait until it is done.")
        ] = seconds,
        as_json: JsonOption = False,
    ) -> None:
        chosen = parse_drones(drones)

        async def work(window: "Window") -> "Answers":
            window.check("--drones", chosen or ())
            return await window.order(verb, chosen, wait)

        print_answers(run_as_observer(swarm, work, as_json), as_json)

    command.__doc__ = (
        f"{ORDER_HELP[verb]}\n\nExits with 0 only if every drone reports done."
    )
    return command


def stop(
    drones: DronesOption = None,
    swarm: SwarmOption = None,
    clear: Annotated[bool, typer.Option(help="Clear an emergency stop.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Stop the motors at once (emergency stop).

    A stop of all drones stays in force until it is cleared. Exits with 0 only
    if every drone obeys.
    """
    chosen = parse_drones(drones)

    async def work(window: "Window") -> "Answers":
        window.check("--drones", chosen or ())
        return await window.emergency_stop(clear, chosen)

    answers: Answers = run_as_observer(swarm, work, as_json)
    words = "cleared" if clear else "motors off"
    rows = {
        i: {"answer": ORDER_ANSWERS.done, "says": words} if obeyed else _row(said)
        for i, (obeyed, said) in answers.items()
    }
    _conclude(rows, as_json)


def print_answers(answers: "Answers", as_json: bool) -> None:
    """Print what each drone answers to a flight command; exit with 0 only if all have done it."""
    _conclude({i: _row(said) for i, (_, said) in answers.items()}, as_json)


def _row(said: "tuple[str, str] | list[str] | str") -> dict[str, str]:
    if not isinstance(said, str):
        return {"answer": said[0], "says": said[1]}
    absent = said.startswith(ORDER_ANSWERS.absent)
    return {
        "answer": ORDER_ANSWERS.absent if absent else ORDER_ANSWERS.silent,
        "says": said.removeprefix(ORDER_ANSWERS.absent).lstrip("; "),
    }


def _conclude(rows: Rows, as_json: bool) -> None:
    """Print the answers; exit with code 1 unless there is a drone and all are done."""
    if as_json:
        write_json(rows)
    else:
        table = Table("drone", "answer", "says")
        for i, row in rows.items():
            table.add_row(str(i), row["answer"], row["says"])
        ANSWER_CONSOLE.print(table)
    raise typer.Exit(
        0
        if rows and all(row["answer"] == ORDER_ANSWERS.done for row in rows.values())
        else 1
    )


def parse_drones(text: str | None) -> list[int] | None:
    """Return the drones of a text such as "3,5-7"; None, for all drones, without a text."""
    if text is None:
        return None
    try:
        return parse_spans(text, "--drones", "drones with commas between, as 3,5-7")
    except ConfigError as error:
        exit_with_error(error, as_json=False)
