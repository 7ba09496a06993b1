"""crazychoir task: add a task to a swarm in flight, or cancel one."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.cli.operate.inspect import (
    JsonOption,
    SwarmOption,
    parse_drone,
    run_as_operator,
)
from crazychoir.config.number_lists import parse_spans
from crazychoir.errors import ConfigError, Refused
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    exit_with_error,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.launch.observer import Answers, Window


@dataclass(frozen=True, slots=True)
class TaskTexts:
    """Texts of the answers to `crazychoir task`."""

    refused: str = "refused"
    """First word of a refusal."""
    unsure: str = (
        "It may have done it all the same: look at the report of the mission before "
        "you ask another with --drone."
    )
    """Advice if a drone may have accepted the task."""
    start_command: str = "crazychoir run online_delivery"
    """Command that starts a swarm with tasks."""


TASK_TEXTS = TaskTexts()


app = typer.Typer(no_args_is_help=True, help="Add and cancel tasks in flight.")
DroneOption = Annotated[
    str | None,
    typer.Option(
        "--drone",
        help="Send it to this drone, by its id or name; else to the first that answers. The drone tells all others.",
    ),
]


@app.command()
def add(
    pickup: Annotated[str, typer.Option(help="Where the goods are, as 1.5,2 (m).")],
    delivery: Annotated[
        str | None,
        typer.Option(
            help="Where the goods go, as 3,0.5 (m); leave it out for a task at one place."
        ),
    ] = None,
    load: Annotated[
        float, options.real("Load, in the unit of the capacities.", least=0.0)
    ] = 1.0,
    robots: Annotated[
        str | None, typer.Option(help="Only these may serve it, as 0,3; else all.")
    ] = None,
    drone: DroneOption = None,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add a task and print its id, which `cancel` needs."""
    arguments = {
        "pickup": _place("--pickup", pickup),
        "delivery": None if delivery is None else _place("--delivery", delivery),
        "load": load,
        "robots": [] if robots is None else _robots(robots),
    }
    _ask(swarm, drone, "task_add", as_json, arguments)


@app.command()
def cancel(
    task: Annotated[int, typer.Argument(help="Id of the task.")],
    drone: DroneOption = None,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Cancel a task. Goods that are already aboard are still delivered."""
    _ask(swarm, drone, "task_cancel", as_json, {"id": task})


def _ask(
    swarm: str | None,
    text: str | None,
    verb: str,
    as_json: bool,
    arguments: dict[str, Any],
) -> None:
    """Ask one drone, or one after the other until one has done it; exit with code 1 if none has.

    A drone that does not answer may still have added the task. Then no other drone is asked,
    because the task could exist twice.
    """
    choice = parse_drone(text)

    async def work(window: "Window") -> "Answers":
        drone = None if choice is None else choice.find(window.config)[0]
        there = await _find_drones(window)
        if drone is not None and drone not in there:
            raise Refused(
                f"drone {drone}", f"absent; there are {', '.join(map(str, there))}"
            )
        answers: Answers = {}
        for i in there if drone is None else [drone]:
            answers |= await window.request(verb, (i,), **arguments)
            done, said = answers[i]
            if done or not str(said).startswith(TASK_TEXTS.refused):
                break
        return answers

    answers: Answers = run_as_operator(swarm, work, as_json)
    done = [said for good, said in answers.values() if good]
    if as_json:
        write_json(
            done[0] if done else {str(i): said for i, (_, said) in answers.items()}
        )
    else:
        for line in _lines(answers):
            (ANSWER_CONSOLE if done else ERROR_CONSOLE).print(
                line, markup=False, highlight=False, soft_wrap=True
            )
    raise typer.Exit(0 if done else 1)


async def _find_drones(window: "Window") -> list[int]:
    """Return the drones that are there.

    Raises Refused, with the command that starts a swarm, if no drone flies.
    """
    try:
        return await window.find()
    except Refused as refused:
        do = (
            "Only a swarm that flies takes tasks: start one in real time, as with "
            f"`{TASK_TEXTS.start_command}`, and name it by --swarm."
        )
        raise Refused(refused.by, f"{refused.reason} {do}") from None


def _lines(answers: "Answers") -> list[str]:
    """Return the answers as lines: those of the drones that are done, else each reason once."""
    if done := [
        f"drone {i}: {_in_words(said)}" for i, (good, said) in answers.items() if good
    ]:
        return done
    by_word: dict[str, list[str]] = {}
    for i, (_, said) in answers.items():
        text = str(said).removeprefix(f"drone {i}: ")
        by_word.setdefault(
            text
            if text.startswith(TASK_TEXTS.refused)
            else f"{text} {TASK_TEXTS.unsure}",
            [],
        ).append(str(i))
    return [f"drone {', '.join(ids)}: {said}" for said, ids in by_word.items()]


def _in_words(said: dict[str, Any]) -> str:
    return f"task {said['id']}" + (f": {said['note']}" if "note" in said else "")


def _place(option: str, text: str) -> list[float]:
    try:
        return options.parse_finite_numbers(text, option, "2 numbers, as 1.5,2", 2)
    except ConfigError as error:
        exit_with_error(error, as_json=False)


def _robots(text: str) -> list[int]:
    try:
        return parse_spans(
            text.strip().strip("[]()"), "--robots", "whole numbers, as 0,3"
        )
    except ConfigError as error:
        exit_with_error(error, as_json=False)
