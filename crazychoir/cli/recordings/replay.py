"""crazychoir replay: publish a recorded flight again, as a swarm of its own that others observe."""

import contextlib
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    exit_with_error,
    set_up_logging,
    warn_of_gaps,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.recording.replayer import Step
    from crazychoir.runtime.clock import Clock


@dataclass(frozen=True, slots=True)
class ReplayTiming:
    """Times of `crazychoir replay` before the first message and after the last one."""

    observer_check_period: float = 0.1
    """Seconds between two looks for observers."""
    subscription_time: float = 1.0
    """Seconds that an observer which has just joined gets to subscribe, at most."""
    linger_time: float = 1.0
    """Seconds for which the swarm stays after the last message."""


REPLAY_TIMING = ReplayTiming()


def replay(
    file: Annotated[
        Path,
        typer.Argument(
            help="Recording of `crazychoir run --record` or `crazychoir record`."
        ),
    ],
    speed: Annotated[
        float,
        options.real(
            "Speed, as a multiple of the recorded one.", least=0.01, most=1000.0
        ),
    ] = 1.0,
    step: Annotated[
        float | None,
        options.seconds(
            "Advance by so many s at each Enter; a number before Enter replaces it.",
            least=0.001,
        ),
    ] = None,
    wait: Annotated[
        float, options.seconds("Begin when an observer joins, or after so many s.")
    ] = 2.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Publish a recorded flight again.

    The commands status, echo, hz and record see it like a flying swarm.
    """
    set_up_logging()
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.launch.network import (
        hold_isolated_swarm,
        write_swarm_file,
    )  # takes 1 s, which --help does not need
    from crazychoir.launch.run_registry import RunRecord, record_run
    from crazychoir.recording.mcap.reading import read_header
    from crazychoir.runtime.clock import run_wall

    try:
        recording = read_header(file)
        warn_of_gaps(recording, "what lies before is said")
        recorded_swarm = _local_swarm(
            SwarmConfig.loads(recording.swarm, f"{file}: swarm.json")
        )
        with (
            hold_isolated_swarm(recorded_swarm, 1) as config,
            write_swarm_file(config) as path,
            record_run(RunRecord(config.name, str(file), None, str(path))),
        ):
            ERROR_CONSOLE.print(
                f"Look at it (or echo, hz, record): crazychoir status --swarm {path}",
                soft_wrap=True,
            )
            told = run_wall(
                lambda clock: _replay(clock, config, file, speed, step, wait)
            )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    except KeyboardInterrupt:
        raise typer.Exit(130) from None
    if as_json:
        of_file = {"file": file, **recording.lacks}
        write_json({"success": told["messages"] > 0, **of_file, **told})
    else:
        ANSWER_CONSOLE.print(
            f"{told['messages']} messages, {told['seconds']:.2f} s of flight",
            highlight=False,
        )
    raise typer.Exit(0 if told["messages"] else 1)


def _local_swarm(config: "SwarmConfig") -> "SwarmConfig":
    """Return the same swarm on this machine alone: without hosts and keys."""
    import msgspec

    if not config.hosts:
        return config
    raw = msgspec.to_builtins(config)
    drones = [{**drone, "host": None} for drone in raw["drones"]]
    world, mocap = ({**raw[name], "host": None} for name in ("world", "mocap"))
    return config.replace(
        hosts={}, security={}, drones=drones, world=world, mocap=mocap
    )


async def _replay(
    clock: "Clock",
    config: "SwarmConfig",
    file: Path,
    speed: float,
    step: float | None,
    wait: float,
) -> dict[str, Any]:
    """Publish the recording as one process that holds all drones.

    speed: how many times faster than recorded
    step: s that each press of Enter advances, None to run through
    wait: s to wait for the first observer
    Returns the number of messages and the s of flight.
    """
    import random

    from crazychoir.bus.network.hello import PACKAGE_VERSION
    from crazychoir.bus.network.hello_review import Introduction
    from crazychoir.bus.network.zenoh_link import ZenohLink
    from crazychoir.bus.network.zenoh_session import SessionEndpoints
    from crazychoir.bus.port import Bus
    from crazychoir.bus.topics import OBSERVABLE_TOPICS, TOPIC_BY_NAME
    from crazychoir.config.addresses import Addresses
    from crazychoir.launch.network import REPLAY_HOST, run_attached
    from crazychoir.recording.replayer import Replayer

    incarnation = random.SystemRandom().getrandbits(62)
    bus = Bus(clock, process=f"replay-{incarnation & 0xFFFFFFFF:08x}", host=REPLAY_HOST)
    for i in config.ids:
        for address in sorted(
            {
                i,
                *(
                    config.topology.source(TOPIC_BY_NAME[name], i)
                    for name in OBSERVABLE_TOPICS
                ),
            }
        ):
            bus.port(address, incarnation)
    link = ZenohLink(
        bus,
        Introduction(config.name, incarnation, PACKAGE_VERSION),
        SessionEndpoints(
            listen=list(Addresses(config).endpoints().values()),
            connect=[],
            lease=config.lease,
        ),
    )
    replayer = Replayer(
        bus,
        file,
        speed,
        None if step is None else _read_steps(step),
        config.topology.source,
    )
    async with run_attached(link):
        latest = clock.now() + wait
        while not link.peers and clock.now() < latest:
            await clock.sleep(REPLAY_TIMING.observer_check_period)
        await clock.sleep(min(wait, REPLAY_TIMING.subscription_time))
        await replayer.run()
        await clock.sleep(REPLAY_TIMING.linger_time)
    return {"messages": replayer.said, "seconds": replayer.at}


def _read_steps(step: float) -> "Step":
    """Return a function that gives the next step, in s, as read from standard input.

    At the end of the input the step is infinite: the flight runs to its end.
    """
    at = 0.0

    async def next_step() -> float:
        nonlocal at
        seconds = await asked()
        at += seconds
        return seconds

    async def asked() -> float:
        ERROR_CONSOLE.print(
            f"at {at:.2f} s; Enter: on by {step:g} s; a number and Enter: by that many; Ctrl-C ends it",
            highlight=False,
            soft_wrap=True,
        )
        while line := await _next_input_line():
            if not line.strip():
                return step
            with contextlib.suppress(ValueError):
                if (seconds := float(line)) > 0.0:
                    return seconds
            found = line.decode(errors="replace").strip()
            error = ConfigError(
                "--step", found, "Enter, or a number of seconds above 0 and Enter"
            )
            ERROR_CONSOLE.print(error, markup=False, highlight=False, soft_wrap=True)
        return math.inf

    return next_step


async def _next_input_line() -> bytes:
    """Return the next line of standard input, empty at its end.

    A daemon thread reads, so that the caller can be cancelled and the program can end meanwhile.
    """
    import asyncio
    import threading

    loop = asyncio.get_running_loop()
    line: asyncio.Future[bytes] = loop.create_future()

    def hand_over(found: bytes) -> None:
        if not line.done():
            line.set_result(found)

    def read() -> None:
        found = sys.stdin.buffer.readline()
        # RuntimeError: the loop is closed, so no caller waits any more.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(hand_over, found)

    threading.Thread(target=read, name="standard input", daemon=True).start()
    return await line
