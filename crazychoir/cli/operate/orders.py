"""Command the drones of a running swarm: arm, take-off, start, hold, go, land, home, stop."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from crazychoir.agent.order_times import LONGEST_VELOCITY, ORDER_TIMEOUTS
from crazychoir.cli.operate.inspect import JsonOption, SwarmOption, run_as_operator
from crazychoir.cli.shared.drone_choice import DroneChoice, parse_choice
from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import ANSWER_CONSOLE, exit_with_error, write_json

if TYPE_CHECKING:
    from crazychoir.launch.observer import Answers, Window

DronesOption = Annotated[
    str | None,
    typer.Option("--drones", help="Only these drones, as 3,5-7 or by name; else all."),
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


Rows = dict[int, dict[str, str]]
ORDER_HELP = {
    "arm": "Check whether drones can take off, and arm motors that need it.",
    "start": "Start the missions of hovering drones, in a run with `--wait`.",
    "hold": "Stop drones in the air; their missions wait, at most 300 s.",
    "go": "Let held drones continue their missions.",
    "home": "Fly drones back above the others, land, and end their missions.",
}


WaitOption = Annotated[
    float | None,
    options.seconds("s to wait until it is done; else as long as it may take."),
]
DurationOption = Annotated[
    float, options.seconds("How long it takes in s; 0: as fast as the limits allow.")
]


def make_order_command(verb: str) -> Callable[..., None]:
    """Return the command line of a flight command without arguments."""

    def command(
        drones: DronesOption = None,
        swarm: SwarmOption = None,
        wait: WaitOption = None,
        as_json: JsonOption = False,
    ) -> None:
        _give_order(verb, drones, swarm, wait, as_json)

    command.__doc__ = (
        f"{ORDER_HELP[verb]}\n\nExits with 0 only if every drone reports done."
    )
    return command


def take_off(
    drones: DronesOption = None,
    height: Annotated[
        float | None,
        options.real(
            "m above the ground; else the height that the mission wants.",
            least=0.0,
            most=1000.0,
        ),
    ] = None,
    duration: DurationOption = 0.0,
    swarm: SwarmOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Take off and hover, in a run with `--wait`, or of the mission operator.

    Exits with 0 only if every drone reports done.
    """
    _give_order(
        "take-off", drones, swarm, wait, as_json, height=height, duration=duration
    )


def land(
    drones: DronesOption = None,
    height: Annotated[
        float,
        options.real(
            "m above the ground: height of the floor, such as a table, on which they land.",
            least=0.0,
            most=1000.0,
        ),
    ] = 0.0,
    duration: DurationOption = 0.0,
    swarm: SwarmOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Land drones where they are, and end their missions.

    Exits with 0 only if every drone reports done.
    """
    _give_order("land", drones, swarm, wait, as_json, height=height, duration=duration)


def velocity(
    v: Annotated[str, typer.Argument(help="Velocity, as 0.3,0,0 (m/s).")],
    drones: Annotated[
        str, typer.Option("--drones", help="Which, as 3,5-7 or by name.")
    ],
    duration: Annotated[
        float,
        options.seconds(
            "s, after which they stop.", open_below=True, most=LONGEST_VELOCITY
        ),
    ] = 1.0,
    yaw_rate: Annotated[
        float, options.real("Yaw rate in rad/s.", least=-7.0, most=7.0)
    ] = 0.0,
    swarm: SwarmOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly waiting or held drones with a velocity, then stop them.

    Fence and collision filter act as always. Exits with 0 only if every drone
    reports done.
    """
    wanted = parse_metres("VELOCITY", v, "three numbers of m/s, as 0.3,0,0")
    given = {"v": wanted, "yaw_rate": yaw_rate, "duration": duration}
    _give_order("velocity", drones, swarm, wait, as_json, **given)


def _give_order(
    verb: str,
    drones: str | None,
    swarm: str | None,
    wait: float | None,
    as_json: bool,
    **arguments: Any,
) -> None:
    """Send a flight command, and print what each drone answers.

    arguments: of the command; its `duration` prolongs the wait
    """
    choice = None if drones is None else parse_drones(drones)
    spent: float = arguments.get("duration", 0.0)
    seconds = ORDER_TIMEOUTS[verb] + spent if wait is None else wait

    async def work(window: "Window") -> "Answers":
        chosen = None if choice is None else choice.find(window.config)
        return await window.order(verb, chosen, seconds, **arguments)

    print_answers(run_as_operator(swarm, work, as_json), as_json)


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
    choice = None if drones is None else parse_drones(drones)

    async def work(window: "Window") -> "Answers":
        chosen = None if choice is None else choice.find(window.config)
        return await window.emergency_stop(clear, chosen)

    answers: Answers = run_as_operator(swarm, work, as_json)
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


def parse_drones(text: str) -> DroneChoice:
    """Return the drones of a text such as "3,5-7,cf231"."""
    try:
        return parse_choice(text, "--drones")
    except ConfigError as error:
        exit_with_error(error, as_json=False)


def parse_metres(
    option: str, text: str, allowed: str = "three numbers of m, as 1,0.5,1.2"
) -> tuple[float, float, float]:
    """Return the three numbers of a text such as "1,0.5,1.2"."""
    try:
        x, y, z = options.parse_finite_numbers(text, option, allowed, 3)
    except ConfigError as error:
        exit_with_error(error, as_json=False)
    return x, y, z
