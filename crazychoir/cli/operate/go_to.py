"""crazychoir go-to and fly: fly waiting or held drones to a place, or along a drawing in a file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.cli.operate.inspect import JsonOption, SwarmOption, looking
from crazychoir.cli.operate.orders import conclude, numbers
from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import STDERR, fail

if TYPE_CHECKING:
    from crazychoir.cli.shared.observer import Answers, Window

LATE = 60.0
"""Seconds that drones get to reach the start of a drawing, beside the duration of the drawing."""
DronesOption = Annotated[str, typer.Option("--drones", help="Which, as 3,5-7.")]
OffsetOption = Annotated[
    str, typer.Option(help="From one drone to the next, as 0,0.5,0 (m).")
]


def go_to(
    place: Annotated[str, typer.Argument(help="Where to, as 1,0.5,1.2 (m).")],
    drones: DronesOption,
    offset: OffsetOption = "0,0.5,0",
    yaw: Annotated[
        float | None, options.real("rad; else as it is.", least=-7.0, most=7.0)
    ] = None,
    seconds: Annotated[
        float, options.seconds("How long it takes; 0: as fast as the limits allow.")
    ] = 0.0,
    swarm: SwarmOption = None,
    wait: Annotated[float, options.seconds("s to wait until it is done.")] = 120.0,
    as_json: JsonOption = False,
) -> None:
    """Fly drones to a place while they wait in the air for their start, or are held.

    Exits with 0 only if every drone arrives.
    """
    from crazychoir.agent.sketch import places  # kernels: 1 s that --help does not need

    p = _metres("PLACE", place)
    step = _metres("--offset", offset)
    chosen = tuple(numbers(drones) or ())

    async def work(window: "Window") -> "Answers":
        window.check("--drones", chosen)
        goals = places(p, step, chosen, window.config)
        told = {
            i: {"p": goal, "yaw": yaw, "duration": seconds} for i, goal in goals.items()
        }
        return await window.command("go-to", told, wait)

    conclude(looking(swarm, work, as_json), as_json)


def fly(
    file: Annotated[
        Path, typer.Argument(help="Strokes: CSV (stroke, t, x, y) or SVG.")
    ],
    drones: DronesOption,
    offset: OffsetOption = "0,0.5,0",
    height: Annotated[
        float | None,
        options.real(
            "m; else that of take-offs.", least=0.0, most=100.0, open_below=True
        ),
    ] = None,
    speed: Annotated[
        float, options.real("m/s at most.", least=0.0, most=20.0, open_below=True)
    ] = 0.5,
    slower: Annotated[
        float,
        options.real("Times as long as the limits ask for.", least=1.0, most=1000.0),
    ] = 1.0,
    swarm: SwarmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly drones along a drawing, side by side.

    The drones wait for their start or are held. Leaders may also fly it with
    their formation.
    """
    from crazychoir.agent.sketch import HAND, loaded_file, messages, planned
    from crazychoir.planning.drawing.drawing import Pen

    step = _metres("--offset", offset)
    chosen = tuple(numbers(drones) or ())
    told: dict[int, dict[str, Any]] = {}
    spent = LATE

    async def work(window: "Window") -> "Answers":
        nonlocal spent
        window.check("--drones", chosen)
        config = window.config
        level = (
            config.flight.ground + config.flight.takeoff_height
            if height is None
            else height
        )
        pen = Pen(height=level, smoothing=HAND)
        plan = planned(loaded_file(file), pen, config, v_max=speed, slower=slower)
        told.update(messages(plan.path, chosen, step, config))
        spent += plan.path.duration
        STDERR.print(
            f"{plan.path.duration:.1f} s, at most {plan.speed:.2f} m/s, {plan.acceleration:.2f} m/s2"
        )
        return await window.command("fly", told, spent)

    conclude(looking(swarm, work, as_json), as_json)


def _metres(option: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = options.finite_numbers(
            text, option, "three numbers of m, as 1,0.5,1.2", 3
        )
    except ConfigError as error:
        fail(error, as_json=False)
    return x, y, z
