"""crazychoir record: record the messages of a running swarm into a file, as an observer."""

import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crazychoir.cli.operate.inspect import SwarmOption, run_as_observer
from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    exit_with_error,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.launch.observer import Window
    from crazychoir.recording.recorder import Recorder

PRESENCE_CHECK_PERIOD = 0.25
"""Seconds between two checks for drones that are still there."""


def record(
    file: Annotated[Path, typer.Argument(help="New file (.mcap).")],
    topics: Annotated[
        str | None, typer.Option(help="Only these, as state,status; else all.")
    ] = None,
    swarm: SwarmOption = None,
    seconds: Annotated[
        float | None, options.seconds("s; else until its drones have gone.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Record a running swarm until its agents end, or until Ctrl-C."""
    recorders: list[Recorder] = []
    try:
        chosen = _topics(topics)
    except ConfigError as error:
        exit_with_error(error, as_json)

    async def work(window: "Window") -> None:
        import asyncio

        from crazychoir.launch.recording import make_recording
        from crazychoir.recording.recorder import Recorder
        from crazychoir.runtime.supervisor import Supervisor

        with contextlib.closing(
            make_recording(file, window.config, None, virtual=False)
        ) as opened:
            await window.find()
            config = window.config
            bus = window.link.bus
            recorder = Recorder(
                bus,
                config.ids,
                opened,
                window.address,
                config.topology.source,
                topics=chosen,
            )
            recorder.ended = "Ctrl-C"
            recorders.append(recorder)
            ERROR_CONSOLE.print(
                f"recording {file}; Ctrl-C ends it",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
            running = asyncio.create_task(
                Supervisor(window.clock, "record").run([recorder])
            )
            try:
                recorder.ended = await _wait_until_gone(
                    window, recorder, math.inf if seconds is None else seconds
                )
            finally:
                running.cancel()
                await asyncio.wait([running])

    try:
        run_as_observer(swarm, work, as_json)
    except KeyboardInterrupt:
        if not recorders:
            raise
    told = recorders[0].result()
    ended = recorders[0].ended
    if not (told["messages"] or told["error"]):
        told["error"] = _no_message_text(topics)
    success = not (told["error"] or told["lost"])
    if as_json:
        write_json({"success": success, **told, "ended": ended})
    else:
        figures = ", ".join(
            f"{told[name]} {name}" for name in ("messages", "lost", "missed")
        )
        text = f"{told['file']}: {figures}; it ended: {ended}"
        ANSWER_CONSOLE.print(text, markup=False, highlight=False, soft_wrap=True)
        if not told["messages"]:
            ERROR_CONSOLE.print(
                f"There is no file: {told['error']}",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
    raise typer.Exit(0 if success else 1)


def _no_message_text(named: str | None) -> str:
    """Return why the recording has no message, and what to do."""
    of = f" of {named}" if named else ""
    do = "Record for longer, or more topics; a result is said only at the end of a mission."
    return f"no message{of} came while it was recorded. {do}"


async def _wait_until_gone(
    window: "Window", recorder: "Recorder", seconds: float
) -> str:
    """Wait until the file fails, the time is over, or no drone has been there for too long.

    seconds: s after which the recording ends
    The limit without a drone is longer than the network may be interrupted.
    Returns a text that says which of the three it was.
    """
    from crazychoir.launch.running_swarm import (
        NEXT_PROCESS_TIMEOUT,
    )  # takes 1 s, which --help does not need

    clock = window.clock
    patience = window.config.lost_after + NEXT_PROCESS_TIMEOUT
    ends = clock.now() + seconds
    seen = clock.now()
    waiting = False
    while clock.now() < ends and not recorder.file.error:
        if window.drones:
            seen = clock.now()
            waiting = False
        elif clock.now() - seen >= patience:
            return f"no drone was there for {patience:g} s"
        elif not waiting:
            ERROR_CONSOLE.print(
                f"no drone is there: it ends in {patience:g} s, unless one comes back",
                soft_wrap=True,
            )
            waiting = True
        await clock.sleep(min(PRESENCE_CHECK_PERIOD, ends - clock.now()))
    return recorder.file.error or f"after {seconds:g} s"


def _topics(named: str | None) -> tuple[str, ...]:
    from crazychoir.bus.topics import OBSERVABLE_TOPICS

    if named is None:
        return OBSERVABLE_TOPICS
    chosen = tuple(named.split(","))
    for name in chosen:
        if name not in OBSERVABLE_TOPICS:
            raise ConfigError(
                "--topics",
                name,
                ", ".join(OBSERVABLE_TOPICS),
                "Name some of them, with commas between.",
            )
    return chosen
