"""crazychoir: fly missions, solve instances, inspect and command a running swarm."""

from collections.abc import Callable
from enum import StrEnum
from importlib.metadata import version
from typing import Annotated

import typer

from crazychoir.cli.compute import simulate, solve
from crazychoir.cli.fly import missions, run, sweep, virtual
from crazychoir.cli.operate import (
    dashboard,
    foxglove,
    go_to,
    inspect,
    orders,
    param,
    task,
)
from crazychoir.cli.recordings import (
    calibrate,
    convert,
    plot,
    record,
    render,
    replay,
    rerun,
    ros,
    validate,
)
from crazychoir.cli.setup import (
    compile_laws,
    doctor,
    examples,
    identify,
    import_swarm,
    keys,
    new,
    push,
    radio,
    radio_maintenance,
    rigid_bodies,
    router,
)
from crazychoir.launch.console import ANSWER_CONSOLE
from crazychoir.launch.process import ending


class CommandGroup(StrEnum):
    """Groups of the commands in --help, in the order in which a user needs them."""

    fly = "Fly"
    operate = "Operate a running swarm"
    recordings = "Work with recordings"
    compute = "Compute without flight"
    setup = "Set up hosts and drones"


ORDER_COMMANDS = {verb: orders.make_order_command(verb) for verb in orders.ORDER_HELP}
"""The flight commands, by name."""
COMMANDS_BY_GROUP: dict[CommandGroup, dict[str, Callable[..., None]]] = {
    CommandGroup.fly: {
        "run": run.run,
        "new": new.new,
        "examples": examples.examples,
        "sweep": sweep.sweep,
        "missions": missions.missions,
    },
    CommandGroup.operate: {
        "status": inspect.status,
        "dashboard": dashboard.dashboard,
        "take-off": orders.take_off,
        "land": orders.land,
        **ORDER_COMMANDS,
        "stop": orders.stop,
        "go-to": go_to.go_to,
        "velocity": orders.velocity,
        "fly": go_to.fly,
        "impair": inspect.impair,
        "topics": inspect.topics,
        "echo": inspect.echo,
        "hz": inspect.hz,
        "foxglove": foxglove.foxglove,
        "ros": ros.ros,
    },
    CommandGroup.recordings: {
        "record": record.record,
        "replay": replay.replay,
        "plot": plot.plot,
        "render": render.render,
        "rerun": rerun.rerun,
        "convert": convert.convert,
        "validate": validate.validate,
        "calibrate": calibrate.calibrate,
    },
    CommandGroup.compute: {"solve": solve.solve, "simulate": simulate.simulate},
    CommandGroup.setup: {
        "doctor": doctor.doctor,
        "compile": compile_laws.compile_laws,
        "push": push.push,
        "router": router.router,
        "identify": identify.identify,
        "import": import_swarm.import_swarm,
    },
}
"""The commands of each group, by name, in the order of --help."""
COMMANDS_WITH_PARTS: dict[CommandGroup, dict[str, typer.Typer]] = {
    CommandGroup.operate: {"param": param.app, "task": task.app},
    CommandGroup.setup: {
        "keys": keys.app,
        "radio": radio.app,
        "mocap": rigid_bodies.app,
        "virtual": virtual.app,
    },
}
"""The commands of each group that have commands of their own."""

radio_maintenance.add_commands(radio.app)
app = typer.Typer(add_completion=False, no_args_is_help=True)
for group, commands in COMMANDS_BY_GROUP.items():
    for name, command in commands.items():
        app.command(name=name, rich_help_panel=group)(command)
for group, parts in COMMANDS_WITH_PARTS.items():
    for name, part in parts.items():
        app.add_typer(part, name=name, rich_help_panel=group)


def _print_version(wanted: bool) -> None:
    if wanted:
        ANSWER_CONSOLE.print(f"crazychoir {version('crazychoir')}", highlight=False)
        raise typer.Exit


@app.callback()
def crazychoir(
    tell: Annotated[
        bool,
        typer.Option(
            "--version",
            is_eager=True,
            callback=_print_version,
            help="Print the version and exit.",
        ),
    ] = False,
) -> None:
    """Swarms of drones that optimise and fly together."""


@app.command(
    rich_help_panel=CommandGroup.compute,
    add_help_option=False,
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)
def bench(context: typer.Context) -> None:
    """Measure speed and accuracy, beside other programs."""
    # The import takes 1 s, for which other commands need not wait.
    from crazychoir.cli.compute.bench import (
        app as benches,
    )

    benches(context.args, prog_name=context.command_path)


def main() -> None:
    """Run the command line."""
    ending.run_to_exit(app)


if __name__ == "__main__":
    main()
