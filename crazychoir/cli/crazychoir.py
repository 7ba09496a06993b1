"""crazychoir: run missions, solve instances, look into a running swarm."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from crazychoir.cli import bench, look, solve
from crazychoir.cli.agent import changed
from crazychoir.cli.show import STDERR, Progress, fail, set_up_logging, summary_table
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.guidance.mission import Mission, has, load
from crazychoir.launch import apart, fly_fast, fly_real
from crazychoir.swarm.config import SwarmConfig, default_swarm
from crazychoir.swarm.graph import span

FEW = 4
"""Drones of a mission that brings no swarm of its own."""
app = typer.Typer(add_completion=False, no_args_is_help=True, help="Swarms that optimise and fly together.")
app.command()(solve.solve)
app.add_typer(bench.app, name="bench")
for command in (look.topics, look.echo, look.hz, look.status, look.impair, look.stop):
    app.command()(command)


@app.command()
def run(
    what: Annotated[str, typer.Argument(help="Mission in agents/, mission file (.py) or swarm file (.toml).")],
    drones: Annotated[int | None, typer.Option(min=1, help="So many drones, if the mission can.")] = None,
    only: Annotated[str | None, typer.Option(help="Start only these drones here, e.g. 3,4.")] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="So many processes (else one a drone).")] = None,
    fast: Annotated[bool, typer.Option(help="Virtual time: one process, as fast as it goes, repeatable.")] = False,
    loss: Annotated[float | None, typer.Option(help="Share of messages between drones that is lost.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the swarm file's.")] = None,
    swarm: Annotated[str | None, typer.Option(help="Swarm file for a mission.")] = None,
    force: Annotated[bool, typer.Option(help="Fly a formation that is very slow.")] = False,
    picture: Annotated[Path | None, typer.Option(help="Where to draw the picture (PNG).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")] = False,
) -> None:
    """Fly a mission on this machine."""
    set_up_logging()
    try:
        config, mission = _chosen(what, drones, swarm, loss, seed)
        members = _members(only, config)
        warned = mission.check(config, force) if has(mission, "check") else []
        with Progress(enabled=not as_json) as progress:
            for text in warned:
                progress.say(text)
            if fast:
                result = fly_fast(config, mission, progress)
            else:
                flags = ["--force"] if force else []
                result = fly_real(apart(config, processes), mission, flags, progress, progress.say, members)
        result["picture"] = _drawn(mission, config, result, picture)
    except CrazyChoirError as error:
        fail(error, as_json)
    _show(result, as_json)
    raise typer.Exit(0 if result["success"] else 1)


def _chosen(
    what: str, drones: int | None, swarm: str | None, loss: float | None, seed: int | None
) -> tuple[SwarmConfig, Mission]:
    """The swarm and the mission that the command line means."""
    if what.endswith((".toml", ".json")):
        config = SwarmConfig.load(what)
        if config.mission is None:
            raise ConfigError(what, "no mission", 'mission = "name"')
        return changed(config, loss, seed, None), load(config.mission)
    mission = load(what)
    if swarm is not None:
        return changed(SwarmConfig.load(swarm), loss, seed, what), mission
    own = mission.swarm(drones) if has(mission, "swarm") else default_swarm(drones or FEW)
    config = changed(own, loss, seed, what)
    if drones not in (None, len(config.ids)):
        raise ConfigError("--drones", drones, f"{len(config.ids)}: mission {what} flies no other number")
    scatter = getattr(mission, "scatter", None)
    return (scatter(config) if scatter else config), mission


def _members(only: str | None, config: SwarmConfig) -> tuple[int, ...] | None:
    """The drones that `--only` names; None for all."""
    if only is None:
        return None
    try:
        return tuple(config.drone(int(word)).id for word in only.split(","))
    except ValueError as error:
        raise ConfigError("--only", only, f"drones {span(config.ids)}, with commas between") from error


def _drawn(mission: Mission, config: SwarmConfig, result: dict[str, Any], path: Path | None) -> str | None:
    if path is None or not has(mission, "picture"):
        return None
    path.parent.mkdir(parents=True, exist_ok=True)
    mission.picture(config, result["results"], str(path))
    return str(path) if path.exists() else None


def _show(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(result, default=str) + "\n")
    else:
        STDERR.print(summary_table(result))


def main() -> None:
    """Entry point."""
    app()


if __name__ == "__main__":
    main()
