"""crazychoir virtual: simulated Crazyflies for programs that speak to real ones."""

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.firmware.release import DESCRIBED_RELEASE
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    LiveTable,
    exit_with_error,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.radio.virtual.setup import VirtualSwarm

FIRST_VIRTUAL_PORT = 19850
"""Default UDP port of the first drone."""
app = typer.Typer(help="Run virtual Crazyflies on UDP, for any cflib program.")
PortOption = Annotated[
    int,
    options.whole(
        "UDP port of the first drone; poses: one below.", least=1025, most=65000
    ),
]
OfSwarm = Annotated[
    str | None,
    typer.Option("--swarm", help="Swarm file that they serve, instead of --port."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@app.callback(invoke_without_command=True)
def virtual(
    context: typer.Context,
    drones: Annotated[int, options.whole("Number of drones, on a grid.", most=200)] = 1,
    port: PortOption = FIRST_VIRTUAL_PORT,
    swarm: Annotated[
        str | None,
        typer.Option(
            help="Swarm file: its drones whose uri is udp:// on this machine, at their homes."
        ),
    ] = None,
    dongles: Annotated[
        str | None, typer.Option(help="Drones that share a radio, as 0,1|2,3.")
    ] = None,
    per_dongle: Annotated[
        int | None, options.size("Number of drones that share a radio.")
    ] = None,
    capacity: Annotated[
        float | None,
        options.real(
            "Packets a second of a radio, each to another drone (else 250; 1000 with one drone).",
            least=1.0,
            most=1e6,
        ),
    ] = None,
    deck: Annotated[
        str | None,
        typer.Option(
            help="Decks on board, as bcFlow2,bcLighthouse4 (a Lighthouse deck knows its position), or none."
        ),
    ] = None,
    firmware: Annotated[
        str,
        typer.Option(
            help="Release, as 2025.12; before 2025.10 the thrust map is another."
        ),
    ] = "",
    seed: Annotated[int, options.seed("Seed of all random draws.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Serve virtual Crazyflies until Ctrl-C."""
    if context.invoked_subcommand is not None:
        return
    set_up_logging()
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.launch.process.serving import serve_virtual_drones
    from crazychoir.radio.virtual.setup import (
        parse_decks,
        place_on_grid,
        select_from_swarm,
    )
    from crazychoir.runtime.clock import run_wall

    try:
        decks = None if deck is None else parse_decks(deck)
        release = firmware or DESCRIBED_RELEASE
        if not release.isascii() or len(release) > 29:
            raise ConfigError(
                "--firmware", release, "at most 29 plain characters, as 2025.12"
            )
        if swarm is None:
            hall = place_on_grid(drones, port, decks, release)
        else:
            hall = select_from_swarm(SwarmConfig.load(swarm), decks, release)
        shared = (
            _shared_dongles(hall, dongles, per_dongle, capacity)
            if swarm or dongles or per_dongle
            else []
        )
        with LiveTable(
            _table, enabled=not as_json and ERROR_CONSOLE.is_terminal
        ) as progress:
            report = run_wall(
                lambda clock: serve_virtual_drones(
                    clock, hall, shared, seed, release, progress
                )
            )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    if as_json:
        write_json(report)
    else:
        ANSWER_CONSOLE.print(_summary(report))
    raise typer.Exit(0 if report["success"] else 1)


Shared = list[tuple[tuple[int, ...], float | None]]


def _shared_dongles(
    hall: "VirtualSwarm", text: str | None, each: int | None, capacity: float | None
) -> Shared:
    from crazychoir.radio.virtual.setup import dongle_groups

    if text is not None and each is not None:
        raise ConfigError("--dongles and --per-dongle", "both", "one of them")
    return [(group, capacity or own) for group, own in dongle_groups(hall, text, each)]


def _table(states: dict[int, Any]) -> Table:
    """Return a table with one row a drone, for 80 columns.

    The columns for impacts and LEDs appear only if a drone has hit something or its LEDs are lit.
    """
    columns = [
        "drone",
        "port",
        "client",
        "supervisor",
        "x, y, z in m",
        "V",
        "packets",
        "lost",
    ]
    hit, lit = (
        any(state[name] for state in states.values()) for name in ("crashed", "led")
    )
    columns += ["hit"] * hit + ["LEDs"] * lit
    table = Table(*columns, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    table.columns[4].no_wrap = True
    for i, state in states.items():
        client = (state["client"] or "").removeprefix("127.0.0.1:")
        table.add_row(
            str(i),
            str(state["at"][1]),
            client,
            state["supervisor"].removeprefix("pre-flight "),
            " ".join(f"{x:.2f}" for x in state["p"]),
            f"{state['vbat']:.2f}",
            str(state["up"] + state["down"]),
            str(state["lost"]),
            *[f"{state['impact']:.1f} m/s" if state["crashed"] else ""] * hit,
            *["lit" if state["led"] else ""] * lit,
        )
    return table


def _summary(report: dict[str, Any]) -> Table:
    table = _table(report["drones"])
    table.title = f"{report['seconds']:.1f} s, {report['behind_s']:.2f} s behind, {report['busy']:.0%} of a processor"
    return table


@app.command()
def fault(
    drone: Annotated[
        str, typer.Argument(help="Id of the drone; several as 3,4; or all.")
    ],
    changes: Annotated[
        list[str],
        typer.Argument(
            help="As loss=0.3 delay=0.02 offset=0.2,0,0; `faults` lists them."
        ),
    ],
    port: PortOption = FIRST_VIRTUAL_PORT,
    swarm: OfSwarm = None,
    as_json: JsonOption = False,
) -> None:
    """Change the faults of a drone in flight."""
    wanted = _parse_faults(changes, as_json)
    _ask({"faults": {drone: wanted}}, port, swarm, as_json)
    if as_json:
        write_json({"success": True})


@app.command()
def faults(
    port: PortOption = FIRST_VIRTUAL_PORT,
    swarm: OfSwarm = None,
    as_json: JsonOption = False,
) -> None:
    """List the possible faults and the present ones."""
    from crazychoir.radio.virtual.faults import FAULT_SETTINGS

    answer = _ask({"ask": "faults"}, port, swarm, as_json)
    if as_json:
        write_json(answer)
        return
    table = Table("fault", "allowed", "what it does", "now", box=box.SIMPLE_HEAD)
    for name, knob in FAULT_SETTINGS.items():
        now = {
            i: row[name]
            for i, row in answer["drones"].items()
            if row.get(name) not in (None, 0.0, -1.0, [0.0] * 3)
        }
        table.add_row(
            name,
            knob.allowed,
            knob.means,
            ", ".join(f"{i}: {value}" for i, value in now.items()),
        )
    ANSWER_CONSOLE.print(table)


@app.command()
def state(
    port: PortOption = FIRST_VIRTUAL_PORT,
    swarm: OfSwarm = None,
    as_json: JsonOption = False,
) -> None:
    """Print the true state of each drone."""
    answer = _ask({"ask": "state"}, port, swarm, as_json)
    if as_json:
        write_json(answer)
    else:
        ANSWER_CONSOLE.print(_table(answer["drones"]))


def _parse_faults(changes: list[str], as_json: bool) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for change in changes:
        name, _, text = change.partition("=")
        try:
            numbers = options.parse_finite_numbers(
                text, f"fault {name}", "name=number, as loss=0.3, or offset=0.2,0,0"
            )
        except ConfigError as error:
            exit_with_error(error, as_json)
        found[name] = numbers if len(numbers) > 1 else numbers[0]
    return found


def _ask(
    question: dict[str, Any], port: int, swarm: str | None, as_json: bool
) -> dict[str, Any]:
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.radio.virtual.control import ask_server

    try:
        return ask_server(
            question,
            port=port - 1 if swarm is None else SwarmConfig.load(swarm).mocap.port,
        )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
