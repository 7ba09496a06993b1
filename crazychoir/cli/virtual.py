"""crazychoir virtual: Crazyflies that are not there, for programs that speak to real ones."""

import asyncio
import signal
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.cli.show import STDERR, fail, set_up_logging, write_json
from crazychoir.errors import CrazyChoirError

if TYPE_CHECKING:
    from crazychoir.radio.virtual.server import VirtualServer
    from crazychoir.runtime.clock import Clock

app = typer.Typer(help="Virtual Crazyflies on UDP, and what goes wrong with them.")


@app.callback(invoke_without_command=True)
def virtual(
    context: typer.Context,
    drones: Annotated[int, typer.Option(min=1, max=100, help="So many.")] = 1,
    port: Annotated[int, typer.Option(min=1025, max=65000, help="UDP port of the first; each has one more.")] = 19_850,
    seed: Annotated[int, typer.Option(min=0, help="Of all that is drawn.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Serve virtual Crazyflies as udp://127.0.0.1:PORT until Ctrl-C."""
    if context.invoked_subcommand is not None:
        return
    set_up_logging()
    from crazychoir.radio.virtual.server import grid  # kernels: 1 s that --help does not need
    from crazychoir.runtime.clock import run_wall

    async def main(clock: "Clock") -> dict[str, Any]:
        server = grid(clock, drones, port, seed=seed)
        await server.listen()
        if not as_json:
            STDERR.print(f"virtual Crazyflies: udp://127.0.0.1:{port}" + (f" to {port + drones - 1}" * (drones > 1)))
        await _serve(clock, server)
        return server.report()

    try:
        report = run_wall(main)
    except CrazyChoirError as error:
        fail(error, as_json)
    if as_json:
        write_json(report)


async def _serve(clock: "Clock", server: "VirtualServer") -> None:
    from crazychoir.runtime.supervisor import Supervisor

    supervisor = Supervisor(clock, "virtual")
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, supervisor.stop)
    await supervisor.run([server])
