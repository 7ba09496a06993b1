"""crazychoir radio scan, battery, reboot and power-off: look after drones that do not fly."""

import contextlib
import time
from collections.abc import Awaitable, Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.cli.operate.orders import parse_drones
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    exit_interrupted,
    exit_with_error,
    group_reasons,
    redirect_prints,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.radio.link.toc_cache import TableOfContents
    from crazychoir.radio.maintenance import DroneCondition
    from crazychoir.runtime.clock import Clock

SwarmOption = Annotated[str | None, typer.Option(help="Swarm file; else ./swarm.toml.")]
DronesOption = Annotated[
    str | None,
    typer.Option("--drones", help="Only these drones, as 3,5-7 or by name; else all."),
]
Row = dict[str, Any]
"""What is known of a drone, by column."""
SCAN_ECHOES = 5
"""Echoes to each drone of a scan."""
SCAN_DEADLINE = 8.0
"""s after which a scan ends."""


def add_commands(app: typer.Typer) -> None:
    """Add the commands to those of `crazychoir radio`."""
    app.command(name="scan")(scan)
    app.command(name="battery")(battery)
    app.command(name="reboot")(reboot)
    app.command(name="power-off")(power_off)


def scan(
    swarm: Annotated[
        str | None,
        typer.Option(
            help="Swarm file: look for its drones; else for drones with the address of a new one."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find drones that are on.

    Without a swarm file all channels are searched for the address of a new
    drone, and UDP ports 19850 to 19859 for virtual ones. Exits with 0 only if
    all drones of the swarm file, or any drone, are found.
    """
    set_up_logging()

    def work() -> dict[str, Row]:
        return _scan_around() if swarm is None else _scan_swarm(swarm)

    _conclude(_run(work, as_json), as_json)


def battery(
    swarm: SwarmOption = None, drones: DronesOption = None, as_json: JsonOption = False
) -> None:
    """Read the battery, the state and the firmware of drones that do not fly.

    No crazychoir-radio may have their dongle. Exits with 0 only if all answer.
    """

    async def work(
        clock: "Clock", uri: str, contents: "TableOfContents", deadline: float
    ) -> "DroneCondition":
        from crazychoir.radio.maintenance import read_condition

        return await read_condition(clock, uri, contents, deadline)

    _maintain(swarm, drones, as_json, work, "ready")


def reboot(
    swarm: SwarmOption = None, drones: DronesOption = None, as_json: JsonOption = False
) -> None:
    """Switch the main processor of drones off and on, unless they fly.

    No crazychoir-radio may have their dongle. Exits with 0 only if all did.
    """
    _switch(swarm, drones, as_json, "RESTART", "restarted")


def power_off(
    swarm: SwarmOption = None, drones: DronesOption = None, as_json: JsonOption = False
) -> None:
    """Switch drones off, unless they fly; only their button switches them on.

    No crazychoir-radio may have their dongle. Exits with 0 only if all did.
    """
    _switch(swarm, drones, as_json, "OFF", "off")


def _switch(
    swarm: str | None, drones: str | None, as_json: bool, action: str, done: str
) -> None:
    async def work(
        clock: "Clock", uri: str, contents: "TableOfContents", deadline: float
    ) -> "DroneCondition":
        from crazychoir.radio.maintenance import PowerAction, switch_power

        return await switch_power(clock, uri, contents, deadline, PowerAction[action])

    _maintain(swarm, drones, as_json, work, done)


Work = Callable[["Clock", str, "TableOfContents", float], Awaitable["DroneCondition"]]
"""Does something with the drone of a uri, within a deadline in s, and returns its condition before."""


def _maintain(
    swarm: str | None, drones: str | None, as_json: bool, work: Work, done: str
) -> None:
    """Do the work with each drone, and print the conditions; exit with 0 only if none failed."""
    set_up_logging()
    choice = None if drones is None else parse_drones(drones)

    def maintain() -> dict[str, Row]:
        from crazychoir.config.swarm_config import find_swarm
        from crazychoir.launch.console import require_reached

        config, which = find_swarm(swarm)
        reached = list(config.topology.reached)
        ids = reached if choice is None else choice.find(config)
        if not ids:
            raise ConfigError(which, "no drone with a radio", "uris udp:// or radio://")
        for i in ids:
            require_reached(config, which, i)
        with _owned_dongles(config, ids):
            return _work_on_all(config, ids, work, done)

    _conclude(_run(maintain, as_json), as_json)


@contextlib.contextmanager
def _owned_dongles(config: "SwarmConfig", ids: Iterable[int]) -> Iterator[None]:
    """Hold the dongles of the drones. Raises an error if another process has one."""
    from crazychoir.radio.link.ownership import own_dongle

    with contextlib.ExitStack() as held:
        for dongle, reached in config.topology.dongles.items():
            if set(reached) & set(ids):
                held.enter_context(own_dongle(config, dongle))
        yield


def _work_on_all(
    config: "SwarmConfig", ids: list[int], work: Work, done: str
) -> dict[str, Row]:
    """Do the work with each drone, one after the other, and return a row for each."""
    from crazychoir.radio.link.toc_cache import TableOfContents, tables_folder
    from crazychoir.runtime.clock import run_wall

    async def go_through(clock: "Clock") -> dict[str, Row]:
        contents = TableOfContents(tables_folder())
        return {
            f"drone {i}": await _try(clock, config, i, contents, work, done)
            for i in ids
        }

    return run_wall(go_through)


async def _try(
    clock: "Clock",
    config: "SwarmConfig",
    i: int,
    contents: "TableOfContents",
    work: Work,
    done: str,
) -> Row:
    """Do the work with one drone; a failure is its answer."""
    row = config.drone(i)
    told: Row = {"uri": row.uri}
    try:
        found = await work(clock, row.uri, contents, config.radio.connect_deadline)
    except CrazyChoirError as error:
        says = str(error).removeprefix(f"{row.uri}: ")
        return told | {"success": False, "says": says}
    says = "; ".join(found.problems) or done
    told |= {"battery_v": round(found.volts, 2), "release": found.release}
    return told | {"success": True, "says": says}


def _scan_around() -> dict[str, Row]:
    """Return the drones that are on."""
    from crazychoir.radio.maintenance import find_drones

    return {
        uri: {"uri": uri, "success": True, "says": "is on"} for uri in find_drones()
    }


def _scan_swarm(swarm: str) -> dict[str, Row]:
    """Return whether each drone of a swarm file answers echoes."""
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.radio.survey.ping import ping

    config = SwarmConfig.load(swarm)
    uris = {i: config.drone(i).uri for i in config.topology.reached}
    with _owned_dongles(config, uris):
        results = ping(
            list(uris.values()), time.perf_counter, SCAN_ECHOES, SCAN_DEADLINE
        )
    rows = {}
    for (i, uri), result in zip(uris.items(), results, strict=True):
        answers = len(result.round_trip)
        says = f"answers {answers} of {result.sent} echoes"
        rows[f"drone {i}"] = {
            "uri": uri,
            "success": answers > 0,
            "says": result.error or says,
        }
    return rows


def _run(work: Callable[[], dict[str, Row]], as_json: bool) -> dict[str, Row]:
    try:
        with redirect_prints():
            return work()
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    except KeyboardInterrupt:
        exit_interrupted(as_json)


def _conclude(rows: dict[str, Row], as_json: bool) -> None:
    """Print the rows; exit with 0 only if there are some and all have succeeded."""
    success = bool(rows) and all(row["success"] for row in rows.values())
    if as_json:
        write_json({"success": success, "drones": rows})
    else:
        table = Table("drone")
        table.add_column("uri", no_wrap=True)
        for heading in ("battery", "firmware", "says"):
            table.add_column(heading)
        for name, row in rows.items():
            volts = row.get("battery_v")
            table.add_row(
                name,
                row["uri"],
                "" if volts is None else f"{volts:.2f} V",
                row.get("release", ""),
                row["says"] if row["success"] else "failed",
            )
        ANSWER_CONSOLE.print(table if rows else "No drone is found.")
        failures = {
            int(name.removeprefix("drone ")): row["says"]
            for name, row in rows.items()
            if not row["success"]
        }
        for names, says in group_reasons(failures):
            text = Text(f"{names}: {says}", "red")
            ANSWER_CONSOLE.print(text, soft_wrap=True)
    raise typer.Exit(0 if success else 1)
