"""crazychoir identify: find a drone among others by its LEDs."""

from functools import partial
from typing import Annotated

import typer

from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.cli.shared.drone_choice import parse_single_drone
from crazychoir.errors import CrazyChoirError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ERROR_CONSOLE,
    exit_interrupted,
    exit_with_error,
    redirect_prints,
    require_reached,
    set_up_logging,
    write_json,
)


def identify(
    drone: Annotated[str, typer.Argument(help="The drone, by its id or name.")],
    swarm: Annotated[
        str | None, typer.Option(help="Swarm file; else ./swarm.toml.")
    ] = None,
    seconds: Annotated[
        float, options.seconds("How long, in s.", least=0.1, most=600.0)
    ] = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Light the LEDs of a drone, to find it.

    The dongle must be free: no crazychoir-radio uses it.
    """
    set_up_logging()
    from crazychoir.config.swarm_config import find_swarm
    from crazychoir.radio import identify as leds  # cflib: --help does not need it
    from crazychoir.radio.link.ownership import own_dongle
    from crazychoir.radio.link.toc_cache import TableOfContents, tables_folder
    from crazychoir.runtime.clock import Clock, run_wall

    try:
        config, which = find_swarm(swarm)
        i = parse_single_drone(drone, "DRONE").find(config)[0]
        require_reached(config, which, i)
        uri = config.drone(i).uri
        dongle = next(
            dongle for dongle, ids in config.topology.dongles.items() if i in ids
        )

        def say(text: str) -> None:
            ERROR_CONSOLE.print(f"drone {i} ({uri}): {text}", highlight=False)

        async def light(clock: Clock) -> dict[str, float]:
            contents = TableOfContents(tables_folder())
            deadline = config.radio.connect_deadline
            lit_now = partial(say, f"its LEDs are lit for {seconds:g} s")
            return await leds.identify(clock, uri, contents, seconds, deadline, lit_now)

        with own_dongle(config, dongle), redirect_prints():
            say(f"is being connected, within {config.radio.connect_deadline:g} s")
            lit = run_wall(light)
            say("its LEDs are as they were")
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    except KeyboardInterrupt:
        exit_interrupted(as_json)
    if as_json:
        write_json(
            {
                "success": True,
                "drone": i,
                "uri": uri,
                "seconds": seconds,
                "parameters": lit,
            }
        )
