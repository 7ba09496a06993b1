"""crazychoir param: read and change the parameters of flying drones."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from crazychoir.cli.operate.inspect import (
    JsonOption,
    SwarmOption,
    parse_drone,
    run_as_operator,
)
from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    exit_with_error,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.launch.observer import Answers, Window

app = typer.Typer(no_args_is_help=True, help="Read and change parameters in flight.")
FirmwareOption = Annotated[
    bool,
    typer.Option(
        "--firmware",
        help="Parameters of the drone's firmware, as ring.effect, also in flight.",
    ),
]
DroneOption = Annotated[
    str | None, typer.Option("--drone", help="Only this drone, by its id or name.")
]


@app.command(name="get")
def read(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Parameter, as control.kp; without: all. Of the firmware: a parameter or a group."
        ),
    ] = None,
    drone: DroneOption = None,
    firmware: FirmwareOption = False,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the parameters of each drone, or of its firmware."""
    if firmware and name is None:
        allowed = "a parameter of the firmware, as ring.effect, or a group, as ring"
        exit_with_error(ConfigError("NAME", "nothing", allowed), as_json)
    verb = "firmware_get" if firmware else "param_get"
    named = {} if name is None else {"name": name}
    _conclude(_ask_drones(swarm, drone, verb, as_json, **named), as_json)


@app.command(name="set")
def change(
    name: Annotated[str, typer.Argument(help="Parameter, as control.kr.")],
    value: Annotated[str, typer.Argument(help="A number, or three as 8,8,4.")],
    drone: DroneOption = None,
    firmware: FirmwareOption = False,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Change a parameter in flight, within its stable range.

    With --firmware it is a parameter of the firmware, such as ring.effect or
    led.bitmask; its value is read back. Exits with 0 only if every drone has
    changed it.
    """
    verb = "firmware_set" if firmware else "param_set"
    answers = _ask_drones(swarm, drone, verb, as_json, name=name, value=_value(value))
    _conclude(answers, as_json)


def _ask_drones(
    swarm: str | None, text: str | None, verb: str, as_json: bool, **arguments: Any
) -> "Answers":
    choice = parse_drone(text)

    async def work(window: "Window") -> "Answers":
        chosen = None if choice is None else choice.find(window.config)
        return await window.request(verb, chosen, **arguments)

    answers: Answers = run_as_operator(swarm, work, as_json)
    return answers


def _value(text: str) -> Any:
    """Return the number in the text, or a list if there are several."""
    try:
        found = options.parse_finite_numbers(
            text, "VALUE", "a number, or three as 8,8,4"
        )
    except ConfigError as error:
        exit_with_error(error, as_json=False)
    return found if len(found) > 1 else found[0]


def _conclude(answers: "Answers", as_json: bool) -> None:
    """Print the answers; exit with code 1 unless every drone has done what was requested."""
    if as_json:
        write_json({i: said for i, (_, said) in answers.items()})
    else:
        ANSWER_CONSOLE.print(_table(answers))
    raise typer.Exit(0 if all(done for done, _ in answers.values()) else 1)


def _table(answers: "Answers") -> Table:
    """Return a table with a row a parameter and a column a drone.

    A cell is empty if the drone has no such parameter. The reason of a drone that refuses is
    printed to standard error.
    """
    good = {
        i: said if isinstance(said, dict) else {"value": said}
        for i, (done, said) in answers.items()
        if done
    }
    table = Table("parameter", *(f"drone {i}" for i in good))
    for name in _parameter_names(good.values()):
        table.add_row(
            Text(name),
            *(
                Text(_format_parameter(said[name]) if name in said else "")
                for said in good.values()
            ),
        )
    for i, (done, said) in answers.items():
        if not done:
            ERROR_CONSOLE.print(f"drone {i}: {said}", markup=False)
    return table


def _parameter_names(answers: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return all parameter names, first those of the drone that has the most parameters."""
    most_first = sorted(answers, key=len, reverse=True)
    return list(dict.fromkeys(name for said in most_first for name in said))


def _format_parameter(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_format_parameter, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
