"""crazychoir-agent: one drone of a swarm, or a few, in this process."""

import asyncio
import ctypes
import json
import logging
import random
import signal
import sys
from dataclasses import asdict
from typing import Annotated, Any

import typer

from crazychoir.agent import VERSION, Agent
from crazychoir.bus.public import PublicCopies
from crazychoir.bus.zenoh import ZenohLink
from crazychoir.cli.show import STDERR, fail, result_table, set_up_logging
from crazychoir.errors import ConfigError, CrazyChoirError, Refused
from crazychoir.guidance.mission import Mission, has, load
from crazychoir.runtime.clock import SECOND, Clock, run_wall
from crazychoir.runtime.watchdog import Watchdog
from crazychoir.swarm.config import SwarmConfig, find_swarm

log = logging.getLogger(__name__)
PR_SET_PDEATHSIG = 1
AGAIN = 2.0
app = typer.Typer(add_completion=False)


@app.command()
def agent(
    ids: Annotated[list[int], typer.Option("--id", help="Drone to fly; several times for several drones.")],
    swarm: Annotated[str | None, typer.Option(help="Swarm file; else ./swarm.toml, else the demo swarm.")] = None,
    mission: Annotated[str | None, typer.Option(help="Mission, instead of the swarm file's.")] = None,
    loss: Annotated[float | None, typer.Option(help="Share of messages between drones that is lost.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the swarm file's.")] = None,
    force: Annotated[bool, typer.Option(help="Fly a formation that is very slow.")] = False,
    listen: Annotated[str | None, typer.Option(help="Zenoh endpoint to listen on.")] = None,
    connect: Annotated[list[str] | None, typer.Option(help="Zenoh endpoint to connect to; several times.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    child: Annotated[bool, typer.Option(hidden=True)] = False,
) -> None:
    """Fly drones of a swarm; Ctrl-C lands them."""
    set_up_logging()
    if child:
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    try:
        config, which = configured(swarm, mission, loss, seed)
        flown = load(str(config.mission))
        members = tuple(sorted({config.drone(i).id: None for i in ids}))
        warned = flown.check(config, force) if has(flown, "check") else []
        if not as_json:
            STDERR.print(f"swarm {config.name} ({which}), mission {config.mission}, drone(s) {ids}")
        for text in warned:
            log.warning("%s", text)
        results = run_agent(config, flown, members, listen, connect)
    except CrazyChoirError as error:
        fail(error, as_json)
    show(results, as_json)
    raise typer.Exit(0 if all(r.get("success") for r in results["results"].values()) else 1)


def configured(swarm: str | None, mission: str | None, loss: float | None, seed: int | None) -> tuple[SwarmConfig, str]:
    """The swarm file with what the command line says instead; without a file, the mission's own swarm."""
    config, which = chosen_swarm(swarm, mission)
    if mission is None and config.mission is None:
        raise ConfigError(which, "no mission", 'mission = "name" in the swarm file, or --mission')
    return changed(config, loss, seed, mission), which


def chosen_swarm(swarm: str | None, mission: str | None = None) -> tuple[SwarmConfig, str]:
    """The swarm file; without one, the swarm of the mission, or of the demo's mission."""
    config, which = find_swarm(swarm)
    if which.startswith("the built-in demo"):
        found = load(str(mission or config.mission))
        config = found.swarm(None) if has(found, "swarm") else config
    return config, which


def changed(config: SwarmConfig, loss: float | None, seed: int | None, mission: str | None) -> SwarmConfig:
    """The same swarm with other values where they are given."""
    changes: dict[str, Any] = {}
    if loss is not None:
        network = json.loads(config.dumps())["network"]
        changes["network"] = {key: value for key, value in network.items() if value is not None} | {"loss": loss}
    if seed is not None:
        changes["seed"] = seed
    if mission is not None:
        changes["mission"] = mission
    return config.replace(**changes) if changes else config


def run_agent(
    config: SwarmConfig, mission: Mission, ids: tuple[int, ...], listen: str | None, connect: list[str] | None
) -> dict[str, Any]:
    """Fly these drones in real time, over Zenoh; returns results and counters."""

    async def main(clock: Clock) -> dict[str, Any]:
        incarnation = random.SystemRandom().getrandbits(62)
        process = f"{ids[0]}-{incarnation & 0xFFFFFFFF:08x}"
        agent = Agent(clock, config, mission, ids, process=process, incarnation=incarnation)
        link = _link(agent, config, ids, listen, connect)
        link.open()
        agent.alarm = link.alarm
        agent.watchdog = Watchdog(clock, agent.stalled)
        agent.watchdog.start()
        agent.services += [link, *(PublicCopies(link, i) for i in ids)]
        _obey_signals(clock, agent)
        try:
            results = await agent.run()
            await clock.sleep(0.3)  # the last statuses leave
        finally:
            agent.watchdog.stop()
        return {
            "results": results,
            "network": asdict(link.counters),
            "worst_put_s": link.counters.worst_put_s,
            "late_s": agent.watchdog.worst,
            "presence": {i: drone.barrier.history for i, drone in agent.drones.items()},
        }

    return run_wall(main)


def _link(
    agent: Agent, config: SwarmConfig, ids: tuple[int, ...], listen: str | None, connect: list[str] | None
) -> ZenohLink:
    """Listen on the endpoint of the lowest drone; connect to every lower one: so each pair has one link."""
    host = config.endpoint(ids[0]).rsplit(":", 1)[0]
    own = f"{host}:{config.base_port + ids[0]}"
    lower = [endpoint for process, endpoint in config.endpoints().items() if process < ids[0]]

    def on_token(drones: list[int], there: bool) -> None:
        for drone in agent.drones.values():
            for j in drones:
                (drone.barrier.monitor.token_back if there else drone.barrier.monitor.token_gone)(j)

    def on_refused(refused: Refused) -> None:
        agent.refuse(refused)

    return ZenohLink(
        agent.bus, config.name, listen=[listen or own], connect=lower if connect is None else connect,
        incarnation=agent.incarnation, version=VERSION, lease=config.lease, on_token=on_token, on_refused=on_refused,
    )  # fmt: skip


def _obey_signals(clock: Clock, agent: Agent) -> None:
    """The first signal lands; a second within 2 s warns; a third cuts the motors."""
    loop = asyncio.get_running_loop()
    times: list[int] = []

    def on_signal(number: int) -> None:
        times.append(clock.now_ns())
        recent = [t for t in times if t > times[-1] - AGAIN * SECOND]
        if len(recent) >= 3:
            agent.cut_all("third signal")
        elif len(recent) == 2:
            log.warning("landing; once more within %g s cuts the motors", AGAIN)
        else:
            agent.land_all(f"{signal.Signals(number).name}: landing")

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, on_signal, number)


def show(results: dict[str, Any], as_json: bool) -> None:
    """The result of this process."""
    if as_json:
        sys.stdout.write(json.dumps(results, default=str) + "\n")
    else:
        STDERR.print(result_table(results["results"]))


def main() -> None:
    """Entry point."""
    app()


if __name__ == "__main__":
    main()
