"""crazychoir go-to and fly: fly waiting or held drones to a place, or along a drawing in a file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.agent.order_times import LOAD_TIMEOUT, ORDER_TIMEOUTS
from crazychoir.cli.operate.inspect import JsonOption, SwarmOption, run_as_operator
from crazychoir.cli.operate.orders import (
    DurationOption,
    WaitOption,
    parse_drones,
    parse_metres,
    print_answers,
)
from crazychoir.launch import number_options as options
from crazychoir.launch.console import ERROR_CONSOLE

if TYPE_CHECKING:
    from crazychoir.launch.observer import Answers, Window

DronesOption = Annotated[
    str, typer.Option("--drones", help="Which, as 3,5-7 or by name.")
]
OffsetOption = Annotated[
    str, typer.Option(help="From one drone to the next, as 0,0.5,0 (m).")
]


def go_to(
    place: Annotated[str, typer.Argument(help="Where to, as 1,0.5,1.2 (m).")],
    drones: DronesOption,
    offset: OffsetOption = "0,0.5,0",
    yaw: Annotated[
        float | None, options.real("Yaw in rad; else unchanged.", least=-7.0, most=7.0)
    ] = None,
    duration: DurationOption = 0.0,
    velocity: Annotated[
        float | None,
        options.real("m/s at most, on the way.", least=0.0, most=20.0, open_below=True),
    ] = None,
    relative: Annotated[
        bool,
        typer.Option(
            "--relative",
            help="From where each drone is, with its yaw; no --offset.",
        ),
    ] = False,
    swarm: SwarmOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly waiting or held drones to a place.

    The drones wait in the air for their start, are held, or fly the mission
    operator. Exits with 0 only if every drone arrives.
    """
    from crazychoir.agent.sketch import (
        flight_places,  # kernels: 1 s that --help does not need
    )

    p = parse_metres("PLACE", place)
    step = parse_metres("--offset", offset)
    choice = parse_drones(drones)
    given = {"yaw": yaw, "duration": duration, "relative": relative, "speed": velocity}
    seconds = ORDER_TIMEOUTS["go-to"] + duration if wait is None else wait

    async def work(window: "Window") -> "Answers":
        config = window.config
        chosen = tuple(choice.find(config))
        goals = (
            {i: list(p) for i in chosen}
            if relative
            else flight_places(p, step, chosen, config)
        )
        told = {i: {"p": goal, **given} for i, goal in goals.items()}
        return await window.command("go-to", told, seconds)

    print_answers(run_as_operator(swarm, work, as_json), as_json)


def fly(
    file: Annotated[
        Path,
        typer.Argument(
            help="Strokes: CSV (stroke, t, x, y) or SVG; or pieces: CSV (duration, x^0 ...)."
        ),
    ],
    drones: DronesOption,
    offset: OffsetOption = "0,0.5,0",
    height: Annotated[
        float | None,
        options.real(
            "Height in m of strokes, or of the start of a trajectory; else the take-off height, or as in the file.",
            least=0.0,
            most=100.0,
            open_below=True,
        ),
    ] = None,
    speed: Annotated[
        float,
        options.real(
            "m/s at most, along strokes.", least=0.0, most=20.0, open_below=True
        ),
    ] = 0.5,
    slower: Annotated[
        float,
        options.real(
            "Factor on the shortest duration that the limits allow, or on the duration of a trajectory.",
            least=0.05,
            most=1000.0,
        ),
    ] = 1.0,
    relative: Annotated[
        bool,
        typer.Option(
            "--relative", help="A trajectory begins where each drone is; no --offset."
        ),
    ] = False,
    on_board: Annotated[
        bool,
        typer.Option(
            "--on-board",
            help="The drone flies the trajectory from its own memory (31 pieces; sender xyz).",
        ),
    ] = False,
    reverse: Annotated[
        bool,
        typer.Option("--reverse", help="From its end to its start."),
    ] = False,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly waiting or held drones along a drawing or a trajectory, side by side.

    A trajectory is a CSV file of polynomials of degree 7, as Crazyswarm has
    them. Leaders may also fly it with their formation.
    """
    from crazychoir.agent.sketch import (
        flight_messages,
        on_board_messages,
        plan_file,
    )

    step = parse_metres("--offset", offset)
    choice = parse_drones(drones)
    told: dict[int, dict[str, Any]] = {}
    spent = ORDER_TIMEOUTS["fly"]

    async def work(window: "Window") -> "Answers":
        nonlocal spent
        config = window.config
        chosen = tuple(choice.find(config))
        plan = plan_file(file, config, height, speed, slower, reverse)
        messages = flight_messages(plan.path, chosen, step, config, relative)
        if on_board:
            messages = on_board_messages(messages, slower, reverse)
        told.update(messages)
        spent += plan.path.duration
        ERROR_CONSOLE.print(
            f"{plan.path.duration:.1f} s, at most {plan.speed:.2f} m/s, {plan.acceleration:.2f} m/s2"
        )
        if on_board:
            loaded = await window.command("load", told, LOAD_TIMEOUT)
            if not all(is_done for is_done, _ in loaded.values()):
                return loaded
        return await window.command("fly", told, spent)

    print_answers(run_as_operator(swarm, work, as_json), as_json)
