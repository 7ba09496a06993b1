"""crazychoir mocap: find which tracked body belongs to which drone, and how it is mounted."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from crazychoir.cli.fly.mocap import SourceOption, with_source
from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.cli.shared.drone_choice import DroneChoice, parse_single_drone
from crazychoir.errors import ConfigError, CrazyChoirError, Refused
from crazychoir.files.output_files import require_writable_file
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    CommandOutputs,
    exit_with_error,
    require_reached,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.mocap.calibration import RestEstimate, TurnEstimate
    from crazychoir.mocap.frames import PoseFrame
    from crazychoir.mocap.naming import BodyMatch, BodyMeasurement

app = typer.Typer(
    no_args_is_help=True,
    help="Assign motion-capture bodies to drones, and calibrate them.",
)
SwarmFile = Annotated[
    str | None, typer.Option("--swarm", help="Swarm file; else ./swarm.toml.")
]
SecondsOption = Annotated[float, options.seconds("How long to look, in s.", least=0.2)]
WriteOption = Annotated[
    bool,
    typer.Option(
        "--write",
        help="Write it into the swarm file; the rest of the file is unchanged.",
    ),
]
Changes = dict[int, dict[str, object]]
SWARM_FILE_DECIMALS = 5
"""Decimals of the numbers in the swarm file."""


@app.command()
def names(
    swarm: SwarmFile = None,
    source: SourceOption = None,
    seconds: SecondsOption = 2.0,
    write: WriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """List the bodies that the cameras see, and propose the drone of each.

    The drones must stand at their homes.
    """
    set_up_logging()
    from crazychoir.mocap.naming import (
        match_bodies,
        measure_bodies,
    )  # takes long, and --help does not need it

    outputs = CommandOutputs()
    try:
        file = _file(swarm, write)
        config, frames = _gather_frames(swarm, source, seconds)
        seen = measure_bodies(frames, seconds)
        matches = match_bodies(
            seen, {i: config.drone(i).home for i in config.topology.seen}
        )
        sure = [match for match in matches if match.sure]
        changes: Changes = {
            m.drone: {"body": m.name}
            for m in sure
            if m.name != config.body_name(m.drone)
        }
        _write(file, changes if write else {}, outputs)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    written = write and not outputs.failed
    if as_json:
        rows = [
            {"name": s.name, "p": s.p, "spread_m": s.spread, "rate_hz": s.rate}
            for s in seen
        ]
        proposed = {
            m.drone: {"body": m.name, "distance_m": m.distance, "sure": m.sure}
            for m in matches
        }
        write_json(
            {"bodies": rows, "proposed": proposed, "written": written, **outputs.told}
        )
    else:
        ANSWER_CONSOLE.print(_table(seen, matches))
        _print_lines(changes, written)
        _say_left(config, matches)
    outputs.say()
    raise typer.Exit(
        0 if len(sure) == len(config.topology.seen) and not outputs.failed else 1
    )


@app.command()
def calibrate(
    drone: Annotated[str, typer.Argument(help="The drone, by its id or name.")],
    turn: Annotated[
        bool,
        typer.Option(
            "--turn",
            help="Find the offset: turn the drone once about its own centre, on the floor, or in hover by its "
            "own estimate. A drone that flies by these poses gives no offset, because it holds the body still.",
        ),
    ] = False,
    heading: Annotated[
        bool,
        typer.Option(
            "--heading",
            help="Find the body's yaw too: the drone points along its yaw in the swarm file.",
        ),
    ] = False,
    swarm: SwarmFile = None,
    source: SourceOption = None,
    seconds: Annotated[
        float | None,
        options.seconds("How long to look, in s; else 3, to turn 20.", least=0.2),
    ] = None,
    write: WriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find how a body is mounted on its drone.

    A drone at rest at home, level, gives the rotation and height of its body;
    --turn its offset.
    """
    set_up_logging()
    outputs = CommandOutputs()
    try:
        file = _file(swarm, write)
        choice = parse_single_drone(drone, "DRONE")
        config, frames = _gather_frames(
            swarm, source, seconds or (20.0 if turn else 3.0), choice
        )
        (i,) = choice.find(config)
        found = (
            _from_turn(config, i, frames)
            if turn
            else _from_rest(config, i, frames, heading)
        )
        keys = _measured_keys(config, i, found)
        _write(file, {i: keys} if write else {}, outputs)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    written = write and not outputs.failed
    if as_json:
        write_json(
            {"drone": i, **keys, "found": found, "written": written, **outputs.told}
        )
    else:
        ERROR_CONSOLE.print(
            f"drone {i}: {_in_words(found)}", highlight=False, soft_wrap=True
        )
        _print_lines({i: keys}, written)
    outputs.say()
    if outputs.failed:
        raise typer.Exit(1)


def _gather_frames(
    swarm: str | None,
    source: str | None,
    seconds: float,
    choice: DroneChoice | None = None,
) -> "tuple[SwarmConfig, list[PoseFrame]]":
    """Return the swarm, and the frames that its cameras see for `seconds`.

    choice: the drone to calibrate, None for all drones that motion capture sees
    """
    from crazychoir.config.swarm_config import find_swarm
    from crazychoir.mocap.gathering import gather_frames
    from crazychoir.mocap.process import make_frame_filter, make_source
    from crazychoir.runtime.clock import Clock, run_wall

    found, which = find_swarm(swarm)
    config = with_source(found, source)
    if choice is None and not config.topology.seen:
        do = "Name another swarm file by --swarm."
        raise ConfigError(
            which,
            "no drone that motion capture sees",
            'uri = "udp://..." or "radio://..."',
            do,
        )
    if choice is not None:
        # A drone that flies by its own estimate may have a body too.
        require_reached(config, which, choice.find(config)[0])
    ERROR_CONSOLE.print(
        f"looking for {seconds:g} s ({which}, source {config.mocap.source})",
        highlight=False,
    )

    async def main(clock: Clock) -> "list[PoseFrame]":
        return await gather_frames(
            clock, make_source(clock, config), make_frame_filter(config), seconds
        )

    return config, run_wall(main)


def _file(swarm: str | None, write: bool) -> Path:
    """Return the swarm file.

    Raises ConfigError, before anything is measured, if it must be written and cannot be.
    """
    file = Path(swarm or "swarm.toml")
    if write:
        if not file.is_file():
            raise ConfigError(
                "--write",
                "no swarm file",
                "a swarm file in TOML",
                "Name it with --swarm.",
            )
        require_writable_file(file, "--write")
    return file


def _poses(
    config: "SwarmConfig", drone: int, frames: "list[PoseFrame]"
) -> tuple[Any, Any]:
    """Return the times and poses of the drone's body: (k,) s and (k, 7)."""
    import numpy as np

    name = config.body_name(drone)
    seen = [frame for frame in frames if name in frame.bodies]
    if not seen:
        there = (
            ", ".join(sorted({name: None for frame in frames for name in frame.bodies}))
            or "none"
        )
        raise Refused(
            f"body {name} of drone {drone}",
            f"it is not visible; visible are: {there}.",
        )
    return np.array([frame.time for frame in seen]), np.array(
        [frame.bodies[name] for frame in seen]
    )


def _from_rest(
    config: "SwarmConfig", drone: int, frames: "list[PoseFrame]", heading: bool
) -> "RestEstimate":
    from crazychoir.mocap.calibration import estimate_from_rest

    one = config.drone(drone)
    looks = one.yaw if heading else None
    return estimate_from_rest(
        _poses(config, drone, frames)[1], one.home[2], looks, one.body_rotation[2]
    )


def _from_turn(
    config: "SwarmConfig", drone: int, frames: "list[PoseFrame]"
) -> "TurnEstimate":
    from crazychoir.mocap.calibration import estimate_from_turn

    one = config.drone(drone)
    return estimate_from_turn(
        *_poses(config, drone, frames), one.body_rotation, one.body_offset[2]
    )


def _measured_keys(
    config: "SwarmConfig", drone: int, found: "RestEstimate | TurnEstimate"
) -> dict[str, object]:
    """Return the keys of [[drones]] that the measurement determines."""
    from crazychoir.mocap.calibration import TurnEstimate

    if isinstance(found, TurnEstimate):
        return {"body_offset": _round_values(found.offset)}
    x, y, _ = config.drone(drone).body_offset
    return {
        "body_rotation": _round_values(found.rotation),
        "body_offset": _round_values((x, y, found.height)),
    }


def _in_words(found: "RestEstimate | TurnEstimate") -> str:
    from math import degrees

    from crazychoir.mocap.calibration import RestEstimate

    if isinstance(found, RestEstimate):
        roll, pitch, _ = (f"{degrees(angle):.2f}" for angle in found.rotation)
        tilted = f"its body is tilted by roll {roll} and pitch {pitch} deg, {found.height:.4f} m above its centre"
        return f"{tilted} ({found.poses} poses, {1e3 * found.spread:.1f} mm of noise)"
    x, y, _ = (f"{1e3 * c:.1f}" for c in found.offset)
    turned = f"turned by {degrees(found.angle):.0f} deg: tracked {x} mm ahead of its centre and {y} mm to its left"
    return f"{turned}, to {2e3 * found.error:.1f} mm (two standard errors; {1e3 * found.deviation:.1f} mm from the fit)"


def _round_values(values: tuple[float, float, float]) -> list[float]:
    return [round(value, SWARM_FILE_DECIMALS) + 0.0 for value in values]


def _write(
    file: Path, changes: Mapping[int, Mapping[str, object]], outputs: CommandOutputs
) -> None:
    from crazychoir.config.editing import write_keys

    if changes:
        with outputs.writing("--write"):
            write_keys(file, changes)


def _print_lines(changes: Changes, written: bool) -> None:
    from crazychoir.config.editing import lines_of

    if changes:
        ERROR_CONSOLE.print(
            "written:" if written else "for the swarm file (--write writes it):"
        )
    for i, keys in changes.items():
        ANSWER_CONSOLE.print(
            lines_of(i, keys), markup=False, highlight=False, soft_wrap=True
        )


def _table(seen: "list[BodyMeasurement]", matches: "list[BodyMatch]") -> Table:
    table = Table("body", "Hz", "x", "y", "z", "moved m", "drone", "from its home m")
    match_by_name = {match.name: match for match in matches}
    for body in seen:
        match = match_by_name.get(body.name)
        drone = "-"
        far = ""
        if match is not None:
            mark = "" if match.sure else "?"
            drone = f"{match.drone}{mark}"
            far = f"{match.distance:.3f}"
        table.add_row(
            body.name,
            f"{body.rate:.0f}",
            *(f"{c:.3f}" for c in body.p),
            f"{body.spread:.3f}",
            drone,
            far,
        )
    return table


def _say_left(config: "SwarmConfig", matches: "list[BodyMatch]") -> None:
    """Say which drones have no body near their homes."""
    from crazychoir.mocap.naming import HOME_RADIUS

    sure = {m.drone: m.name for m in matches if m.sure}
    if all(sure.get(i) == config.body_name(i) for i in config.topology.seen):
        ERROR_CONSOLE.print("the swarm file has these names")
    left = [i for i in config.topology.seen if i not in sure]
    if left:
        names = ", ".join(map(str, left))
        ERROR_CONSOLE.print(
            f"no body within {HOME_RADIUS:g} m of the home of drone(s) {names}: put them there, or correct `home`."
        )
