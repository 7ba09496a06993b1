"""Look into a running swarm, and change its simulated network: topics, echo, hz, status, impair, stop."""

import asyncio
import json
import random
import sys
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Annotated, Any

import msgspec
import numpy as np
import typer
from rich.live import Live
from rich.table import Table

from crazychoir.bus.commands import Commander
from crazychoir.bus.local import OBSERVER, Bus
from crazychoir.bus.topics import BY_NAME, OBSERVABLE, TOPICS
from crazychoir.bus.zenoh import ZenohLink
from crazychoir.cli.agent import chosen_swarm
from crazychoir.cli.show import STDERR, fail, set_up_logging, status_table
from crazychoir.errors import ConfigError, CrazyChoirError, Refused
from crazychoir.launch import Call, Score, observer_link
from crazychoir.runtime.clock import Clock, run_wall
from crazychoir.runtime.supervisor import Supervisor
from crazychoir.swarm.config import SwarmConfig

DISCOVERY = 4.0
"""s to find the swarm's processes."""
SwarmOption = Annotated[str | None, typer.Option(help="Swarm file; else ./swarm.toml, else the demo swarm.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on standard output, nothing else.")]
SecondsOption = Annotated[float, typer.Option(help="How long to look, in s.")]
Work = Callable[["Window"], Awaitable[Any]]


class Window:
    """An observer's place in a running swarm."""

    def __init__(self, clock: Clock, config: SwarmConfig, link: ZenohLink) -> None:
        self.clock, self.config, self.link, self.bus = clock, config, link, link.bus

    @property
    def drones(self) -> list[int]:
        """Drones that were found, in order."""
        return sorted(j for j in self.link.directory if j < OBSERVER)

    async def find(self) -> list[int]:
        """Wait until all drones are found, at most DISCOVERY s; raises Refused if there are none."""
        ends = self.clock.now() + DISCOVERY
        while len(self.drones) < len(self.config.ids) and self.clock.now() < ends:
            await self.clock.sleep(0.02)
        if not self.drones:
            endpoints = ", ".join(list(self.config.endpoints().values())[:3])
            raise Refused(f"swarm {self.config.name}", f"no agent found at {endpoints} ...; is it running?")
        return self.drones


def looking(swarm: str | None, work: Work) -> Any:
    """Join the swarm as an observer, do the work, leave; ends with a clear error if there is no swarm."""
    set_up_logging()

    async def main(clock: Clock) -> Any:
        config, _ = chosen_swarm(swarm)
        bus = Bus(clock, process=f"observer-{random.SystemRandom().getrandbits(32):08x}", host="observer")
        bus.port(OBSERVER + 1 + random.SystemRandom().getrandbits(24), random.SystemRandom().getrandbits(32))
        link = observer_link(bus, config)
        link.open()
        serving = asyncio.create_task(Supervisor(clock, "observer").run([link]))
        try:
            return await work(Window(clock, config, link))
        finally:
            serving.cancel()
            await asyncio.wait([serving])

    try:
        return run_wall(main)
    except CrazyChoirError as error:
        fail(error, as_json=False)


def topics(as_json: JsonOption = False) -> None:
    """The table of topics."""
    rows = [
        {
            "topic": topic.name, "type": topic.type.__name__ if topic.type else "any", "rate_hz": topic.rate,
            "max_age_s": topic.max_age, "class": topic.klass.name.lower(), "latched": topic.latched,
            "impaired": topic.impaired, "public_hz": topic.public,
        }
        for topic in TOPICS
    ]  # fmt: skip
    if as_json:
        sys.stdout.write(json.dumps(rows, default=str).replace("Infinity", "null") + "\n")
        return
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    STDERR.print(table)


def echo(
    topic: Annotated[str, typer.Argument(help="Topic, see `crazychoir topics`.")],
    drone: Annotated[int | None, typer.Option(help="Only this drone.")] = None,
    swarm: SwarmOption = None,
    seconds: SecondsOption = 3600.0,
    rate: Annotated[float, typer.Option(help="At most so many values a second and drone.")] = 10.0,
) -> None:
    """Print the values of a topic, one JSON object a line."""
    chosen = _topic(topic)

    async def work(window: Window) -> None:
        for i in await window.find() if drone is None else [drone]:
            box = Call(window.clock, partial(_print_value, i))
            window.bus.subscribe(chosen, i, next(iter(window.bus.ports)), box, rate)
        await window.clock.sleep(seconds)

    looking(swarm, work)


def hz(
    topic: Annotated[str, typer.Argument(help="Topic, see `crazychoir topics`.")],
    swarm: SwarmOption = None,
    seconds: SecondsOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Rates at which a topic arrives, drone by drone."""
    chosen = _topic(topic)

    async def work(window: Window) -> dict[int, float]:
        boxes = {}
        for i in await window.find():
            boxes[i] = Call(window.clock, lambda value, age: None)
            window.bus.subscribe(chosen, i, next(iter(window.bus.ports)), boxes[i])
        await window.clock.sleep(0.5)
        before = {i: box.received for i, box in boxes.items()}
        await window.clock.sleep(seconds)
        return {i: (box.received - before[i]) / seconds for i, box in boxes.items()}

    _print_pairs(looking(swarm, work), ("drone", "Hz"), as_json)


def status(
    swarm: SwarmOption = None,
    watch: Annotated[bool, typer.Option(help="Go on.")] = False,
    as_json: JsonOption = False,
) -> None:
    """How the drones are."""

    async def work(window: Window) -> Score:
        await window.find()
        score = Score(window.bus, window.config.ids, address=next(iter(window.bus.ports)))
        await window.clock.sleep(1.0)
        if watch:
            with Live(console=STDERR, refresh_per_second=4) as live:
                async for _ in window.clock.ticks(4.0):
                    live.update(status_table(score))
        return score

    score = looking(swarm, work)
    if as_json:
        rows = {i: msgspec.structs.asdict(status) for i, status in sorted(score.statuses.items())}
        sys.stdout.write(json.dumps(_plain(rows)) + "\n")
    else:
        STDERR.print(status_table(score))


def impair(
    swarm: SwarmOption = None,
    loss: Annotated[float | None, typer.Option(help="Probability that a message is lost.")] = None,
    delay: Annotated[float | None, typer.Option(help="Delay in s.")] = None,
    jitter: Annotated[float | None, typer.Option(help="Jitter in s.")] = None,
    duplicate: Annotated[float | None, typer.Option(help="Probability of a second delivery.")] = None,
    reorder: Annotated[float | None, typer.Option(help="Probability of being late.")] = None,
    bandwidth: Annotated[float | None, typer.Option(help="Bytes a second.")] = None,
    edge: Annotated[str | None, typer.Option(help="Only between these two drones, e.g. 1,2.")] = None,
    drone: Annotated[int | None, typer.Option(help="Only at this drone.")] = None,
    clear: Annotated[bool, typer.Option(help="Take everything back first.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Change the simulated network while the swarm runs."""
    changes: dict[str, Any] = {
        "loss": loss, "delay": delay, "jitter": jitter, "duplicate": duplicate, "reorder": reorder,
        "bandwidth": bandwidth, "edge": _edge(edge), "drone": drone,
        "clear": clear or None,
    }  # fmt: skip
    given = {key: value for key, value in changes.items() if value is not None}
    _print_pairs(looking(swarm, _ask_all("impair", given)), ("drone", "simulated network"), as_json)


def stop(
    swarm: SwarmOption = None,
    land: Annotated[bool, typer.Option(help="Land instead of cutting the motors.")] = False,
    clear: Annotated[bool, typer.Option(help="Clear an emergency stop.")] = False,
) -> None:
    """Emergency stop of all drones: motors off, until cleared; or --land."""

    async def work(window: Window) -> dict[int, Any]:
        drones = await window.find()
        if land:
            answered: dict[int, Any] = await _ask_all("land", {})(window)
            return answered
        commander = Commander(next(iter(window.bus.ports.values())))
        missing = await commander.emergency_stop(drones, clear=clear)
        return {i: "no acknowledgement" if i in missing else "acknowledged" for i in drones}

    _print_pairs(looking(swarm, work), ("drone", "answer"), as_json=False)


def _ask_all(verb: str, arguments: dict[str, Any]) -> Callable[[Window], Awaitable[dict[int, Any]]]:
    async def work(window: Window) -> dict[int, Any]:
        commander = Commander(next(iter(window.bus.ports.values())))
        drones = await window.find()
        answers = await asyncio.gather(
            *(commander.request(i, verb, **arguments) for i in drones), return_exceptions=True
        )
        return {i: _words(answer) for i, answer in zip(drones, answers, strict=True)}

    return work


def _words(answer: Any) -> Any:
    if isinstance(answer, BaseException):
        return str(answer)
    return answer.detail if answer.kind == "done" else f"refused: {answer.detail}"


def _edge(text: str | None) -> list[int] | None:
    if text is None:
        return None
    pair = text.split(",")
    if len(pair) != 2 or not all(word.strip().isdecimal() for word in pair):
        fail(ConfigError("--edge", text, "two drones, for example 1,2"), as_json=False)
    return [int(word) for word in pair]


def _topic(name: str) -> Any:
    if name not in OBSERVABLE:
        fail(ConfigError("topic", name, ", ".join(OBSERVABLE)), as_json=False)
    return BY_NAME[name]


def _print_value(i: int, value: Any, age: float) -> None:
    fields = msgspec.structs.asdict(value) if isinstance(value, msgspec.Struct) else {"value": value}
    sys.stdout.write(json.dumps(_plain({"drone": i, "age": round(age, 4), **fields})) + "\n")
    sys.stdout.flush()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return None if isinstance(value, float) and value != value else value


def _print_pairs(pairs: dict[int, Any], heads: tuple[str, str], as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps({str(i): value for i, value in pairs.items()}) + "\n")
        return
    table = Table(*heads)
    for i, value in pairs.items():
        table.add_row(str(i), f"{value:.1f}" if isinstance(value, float) else str(value))
    STDERR.print(table)
