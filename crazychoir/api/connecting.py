"""Connect to a running swarm, or start one, from a script or a notebook."""

from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from functools import partial
from pathlib import Path
from typing import Any

from crazychoir.api.flight_request import FlightRequest
from crazychoir.api.running.async_swarm import AsyncSwarm, join_swarm
from crazychoir.api.running.blocking import LoopThread
from crazychoir.api.running.running_swarm import RunningSwarm
from crazychoir.api.running.swarm_run import BODY_KINDS, SwarmRun
from crazychoir.errors import ProcessFailed
from crazychoir.recording.mcap.file import require_new_recording


def connect(swarm: str | Path | None = None, *, console: bool = False) -> RunningSwarm:
    """Connect to a running swarm, and return it when its drones are found.

    swarm: swarm file, or its run on this machine; None: ./swarm.toml, else your only run
    console: whether this program counts as an operator's console until it leaves the swarm; drones
        with `flight.dead_man` then fly on without another one
    Raises Refused if there is none, or if several could be meant.
    """
    file = None if swarm is None else str(swarm)
    return RunningSwarm(LoopThread(partial(join_swarm, file, console)))


def connect_async(
    swarm: str | Path | None = None, *, console: bool = False
) -> AbstractAsyncContextManager[AsyncSwarm]:
    """Connect to a running swarm in the present event loop.

        async with connect_async() as swarm: ...

    swarm: as in `connect`
    console: as in `connect`
    Raises all errors of `connect`.
    """
    return join_swarm(None if swarm is None else str(swarm), console)


def launch(
    mission: str = "operator",
    drones: int | None = None,
    swarm: str | Path | None = None,
    processes: int | None = None,
    bodies: str = BODY_KINDS.simulated,
    record: str | Path | None = None,
) -> RunningSwarm:
    """Start a run in real time, in processes of its own, and return its swarm.

    This program counts as an operator's console until it leaves the swarm (`flight.dead_man`).

    mission: name of a mission, or a mission file
    drones: number of drones; None: as many as the mission has by itself
    swarm: swarm file; None: the mission's own swarm
    processes: number of processes; None: one a drone
    bodies: "sim", or "virtual" for virtual Crazyflies behind cflib
    record: new file to record the flight into (.mcap)
    Raises ConfigError for what cannot fly, ProcessFailed if the run does not start.
    """
    if record is not None:
        require_new_recording(Path(record))
    file = None if swarm is None else str(swarm)
    config, _ = FlightRequest(mission, drones, file).choose()
    run = SwarmRun(config, bodies, processes, record)
    try:
        thread = LoopThread(partial(join_swarm, run.file, console=True))
    except BaseException:
        run.end()
        raise
    launched = RunningSwarm(thread, run)
    try:
        thread.call(thread.value.wait_until_ready(run.has_ended))
    except BaseException:
        launched.close()
        raise
    if run.has_ended():
        launched.close()
        _check_success(launched.result)
    return launched


def _check_success(result: Mapping[str, Any] | None) -> None:
    """Raise ProcessFailed for a run that has ended without success, before its drones could be told anything."""
    if result is not None and not result["success"]:
        reasons = "; ".join(result.get("reasons", {}).values())
        why = result.get("reason") or result.get("error") or reasons
        raise ProcessFailed("the run", why)
