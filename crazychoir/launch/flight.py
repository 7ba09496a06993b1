"""Fly a mission with all its drones, in virtual or real time, and return the result of the run."""

import importlib.util
import json
import logging
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.agent.agent import Agent
from crazychoir.agent.dead_man import ConsoleReporter, is_console
from crazychoir.agent.drone import WAITING_TASK
from crazychoir.agent.mission_result import ENDED_KEY, MISSION_REASONS
from crazychoir.bus.commands import Commander
from crazychoir.bus.json_view import to_plain_values
from crazychoir.config.addresses import Addresses
from crazychoir.config.checks import SWARM_LIMITS, WORLD_URIS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, reason_or
from crazychoir.guidance.feedback import are_all_idle
from crazychoir.guidance.mission import Mission, has_hook
from crazychoir.launch.flight_observer import FlightScore, Watch, list_goals
from crazychoir.launch.network import make_observer_link, run_attached
from crazychoir.launch.processes import WORLD_OWNER, Owner, SwarmLauncher, run_children
from crazychoir.launch.virtual_bodies import (
    VirtualBodies,
    add_crashes,
    explain_absent,
)
from crazychoir.mocap.system import MOCAP_EXTRA, MOCAP_LIBRARY
from crazychoir.recording.mcap.file import RecordingFile
from crazychoir.recording.recorder import Recorder
from crazychoir.runtime.clock import Clock, run_virtual, run_wall
from crazychoir.runtime.user_code_guard import HangWatch
from crazychoir.simulation.trace import Trace

log = logging.getLogger(__name__)
NO_REASONS = "the mission's report returned success = False, without reasons"
HINDRANCE_TEXTS = {
    "kept_clear_s": "the collision filter has flown it for {:g} s",
    "at_fence_s": "held at the fence for {:g} s",
    "apart": "at its end the {}",
    "refused_references": "{:g} references of its law could not be flown",
}
"""Text for each key of a result that says what has kept the drone from its target."""
NO_RESULT = "its process has ended without a result; the log says how"
NO_DRONE_MOVED = (
    "the law returned None in every step of every drone: all hovered, no drone moved"
)
FIGURES_KEY = "figures"
"""Key of a recording's outcome for the figures of the flight, as JSON."""
UNRECORDED_FIGURES = ("wall_s", "startup_s", "real_time_factor", "tracks", "log")
"""Figures that the outcome leaves out.

The times on the wall clock would make recordings of equal flights differ. Tracks and log lines are in the messages.
"""
SOURCES_WITHOUT_EXTRA = ("virtual", "replay")
"""Sources of [mocap] that need no extra."""
Results = dict[int, dict[str, Any]]


def fly_fast(
    config: SwarmConfig,
    mission: Mission,
    watch: Watch | None = None,
    file: RecordingFile | None = None,
) -> dict[str, Any]:
    """Fly the whole swarm in this process, in virtual time.

    config: the swarm
    mission: its mission
    watch: called with the score at every tick, None for no view
    file: recording of the flight, None for none
    Returns the object of `summarise_flight`, with the figures of the whole flight.
    """
    began = time.perf_counter()

    async def main(clock: Clock) -> dict[str, Any]:
        trace = Trace()
        agent = Agent(clock, config, mission, config.ids, trace=trace)
        score = FlightScore(
            agent.bus,
            config.ids,
            list_goals(mission, config),
            watch or (lambda score: None),
            worlds=[owner.world for owner in agent.owners],
        )
        agent.services.append(score)
        recorder = (
            Recorder(agent.bus, config.ids, file, leaves_open=True) if file else None
        )
        agent.services += [recorder] if recorder else []
        ready = time.perf_counter()
        with HangWatch() as agent.watchdog:
            results = await agent.run()
        rounds = max(drone.communicator.rounds for drone in agent.drones.values())
        counters = [drone.port.counters for drone in agent.drones.values()]
        messages = {
            name: sum(getattr(c, name) for c in counters)
            for name in ("sent", "lost", "resent")
        }
        wall = time.perf_counter() - ready
        flown = summarise_flight(config, mission, results, score, clock.now(), wall)
        flown |= {
            "startup_s": ready - began,
            "messages": messages,
            "rounds": rounds,
            "digest": trace.digest(),
        }
        return flown | {"recording": _end_recording(recorder, flown)}

    return run_virtual(main)


def _end_recording(
    recorder: Recorder | None, flown: Mapping[str, Any]
) -> dict[str, Any] | None:
    """End the file of a recorder with the figures of the flight; return the recorder's outcome.

    Returns None without a recorder.
    """
    if recorder is None:
        return None
    figures = {name: x for name, x in flown.items() if name not in UNRECORDED_FIGURES}
    told = {FIGURES_KEY: json.dumps(to_plain_values(figures), default=str)}
    if flown["digest"] is not None:
        told["digest"] = flown["digest"]
    recorder.file.note(told)
    recorder.file.close()
    return recorder.result()


@dataclass(frozen=True, slots=True)
class FlightDisplay:
    """Shows a flight in real time to the operator."""

    watch: Watch | None = None
    """Called with the score at every tick, None for no view."""
    say: Callable[[str], None] = lambda line: None
    """Called with each line that a process prints."""


NO_DISPLAY = FlightDisplay()


def fly_real(
    launcher: SwarmLauncher,
    config: SwarmConfig,
    mission: Mission,
    display: FlightDisplay = NO_DISPLAY,
    started: tuple[int, ...] | None = None,
    file: RecordingFile | None = None,
) -> dict[str, Any]:
    """Fly a swarm in real time, with one process for each group of drones in the swarm file.

    The processes are connected by Zenoh. This process starts them, observes the swarm and records
    it into `file`.

    launcher: starts the processes with the file of `config`
    config: the swarm
    mission: its mission
    display: shows the flight
    started: drones to start, None for all; all drones of a group start if one of them is named
    file: recording of the flight, None for none
    Returns the object of `summarise_flight`, with `startup_s` and the state of the recording.
    """
    groups = [
        group
        for group in Addresses(config).groups()
        if started is None or any(i in started for i in group)
    ]

    async def main(clock: Clock) -> dict[str, Any]:
        link = make_observer_link(clock, config)
        began = clock.now()
        address = next(iter(link.bus.ports))
        watched = display.watch or (lambda score: None)
        score = FlightScore(
            link.bus,
            config.ids,
            list_goals(mission, config),
            watched,
            address=address,
            source=config.topology.source,
            unseen=config.topology.unseen,
        )
        recorder = (
            Recorder(
                link.bus,
                config.ids,
                file,
                address,
                config.topology.source,
                leaves_open=True,
            )
            if file
            else None
        )
        console = (
            [ConsoleReporter(Commander(link.bus.ports[address]), config.ids)]
            if is_console(config, link.bus.host)
            else []
        )
        async with run_attached(
            link, score, *([recorder] if recorder else []), *console
        ):
            results = await run_children(
                launcher,
                groups,
                config,
                display.say,
                lambda: do_all_wait(config, score),
                list_owners(config, started),
            )
        crashes = bodies.find_crashes()
        results = add_crashes(results, crashes)
        ready = began if score.go_at is None else score.go_at
        wall = clock.now() - ready
        flown = summarise_flight(config, mission, results, score, wall, wall, started)
        explain_absent(flown, crashes)
        flown["startup_s"] = ready - began
        return flown | {"recording": _end_recording(recorder, flown)}

    bodies = VirtualBodies(config)
    return run_wall(main)


def summarise_flight(
    config: SwarmConfig,
    mission: Mission,
    results: Results,
    score: FlightScore,
    simulated: float,
    wall: float,
    started: tuple[int, ...] | None = None,
) -> dict[str, Any]:
    """Return the object that `run --json` prints: the figures of the run and the mission's report.

    config: the swarm
    mission: its mission
    results: result of each drone that has one
    score: what the observer measured, which covers the whole swarm
    simulated: s of flight
    wall: s on the wall clock; in real time since GO, without `startup_s`, the time in which the
        processes start and laws may be compiled
    started: drones that were started here, None for all; the success depends on these
    The mission's own report needs the results of all drones. It is left out if some are missing.
    """
    started = config.ids if started is None else started
    ended = {i: r[ENDED_KEY] for i, r in sorted(results.items()) if ENDED_KEY in r}
    report = (
        mission.report(config, mark_operator_ends(results))
        if started == config.ids and has_hook(mission, "report")
        else {}
    )
    reached = bool(report.pop("success", True))
    off = report.pop("reasons", {})
    said = report.pop("reason", None)
    if ended and not reached:
        of_all = said is not None and any(i not in ended for i in config.ids)
        reached, off, ended = excuse_operator_ends(off, ended)
        reached = reached and not of_all
        said = said if of_all else None
    held = describe_hindrances(results)
    failed = list_failures(results, score.touching, started)
    absent = [i for i in started if i not in results]
    told = {
        i: reason_or(text, MISSION_REASONS.unsaid) for i, text in (off | failed).items()
    }
    reasons = {i: "; ".join([text, *held.get(i, [])]) for i, text in told.items()}
    reasons |= dict.fromkeys(absent, NO_RESULT)
    if not (reached or reasons):
        said = reason_or(said, NO_REASONS)
    reasons |= {
        i: str(r["refused"])
        for i, r in sorted(results.items())
        if isinstance(r.get("refused"), str) and i not in reasons
    }
    for_all = [
        str(said),
        *(
            f"drone {i}: {', '.join(texts)}"
            for i, texts in held.items()
            if i not in reasons
        ),
    ]
    separation = score.min_separation
    if are_all_idle(results):
        log.warning(NO_DRONE_MOVED)
        score.log.append(NO_DRONE_MOVED)
    return {
        **report,
        "report": list(report),
        "mission": config.mission,
        "success": reached and not failed and not absent,
        "drones": len(config.ids),
        "here": list(started),
        "simulated_s": simulated,
        "wall_s": wall,
        "real_time_factor": simulated / wall,
        "min_separation_m": separation if np.isfinite(separation) else None,
        **{
            key: {i: r[key] for i, r in sorted(results.items()) if key in r} or None
            for key in HINDRANCE_TEXTS
        },
        "messages": score.messages(),
        "rounds": max((status.round for status in score.statuses.values()), default=0),
        "digest": None,
        "reason": None if said is None else "; ".join(for_all),
        "reasons": reasons,
        "ended": ended,
        "absent": absent,
        "flown_m": {i: round(length, 4) for i, length in score.flown.items()},
        "log": list(score.log),
        "results": results,
        "tracks": score.tracks,
        **score.formation(),
    }


def list_owners(config: SwarmConfig, started: tuple[int, ...] | None) -> list[Owner]:
    """Return the processes that own the world, the cameras and the dongles, as far as they start here.

    An owner starts here if all drones start, or if the drone with the lowest id on the host of the
    owner does.
    """
    found = (
        [WORLD_OWNER]
        if config.topology.owned and _is_start_here(config, config.world.host, started)
        else []
    )
    if config.topology.seen and _is_start_here(config, config.mocap.host, started):
        found.append(Owner("mocap", "crazychoir.cli.fly.mocap", again=True))
    for k in list_dongles(config, started):
        options = ("--dongle", str(k))
        found.append(
            Owner(
                f"dongle {k}",
                "crazychoir.cli.fly.radio_owner",
                options,
                again=True,
                ids=config.topology.dongles[k],
            )
        )
    return found


def list_dongles(config: SwarmConfig, started: tuple[int, ...] | None) -> list[int]:
    """Return the numbers of the dongles with an owner process that starts here."""
    return [
        k
        for k in config.topology.dongles
        if _is_start_here(config, config.topology.dongle_host(k), started)
    ]


def require_extras(config: SwarmConfig, owners: Iterable[Owner], fast: bool) -> None:
    """Raise ConfigError for an extra that this run needs on this machine and that is not installed.

    config: the swarm
    owners: owner processes that this run starts
    fast: whether it flies in this process, in virtual time
    """
    started = {owner.name for owner in owners}
    in_mujoco = [
        drone.id for drone in config.drones if drone.uri.startswith(WORLD_URIS.mujoco)
    ]
    if in_mujoco and (fast or WORLD_OWNER.name in started):
        where = f'swarm {config.name}: drone {in_mujoco[0]}: uri = "{config.drone(in_mujoco[0]).uri}"'
        _require_module(where, "mujoco", "mujoco")
    source = config.mocap.source
    if not fast and "mocap" in started and source not in SOURCES_WITHOUT_EXTRA:
        _require_module(
            f'swarm {config.name}: [mocap] source = "{source}"',
            MOCAP_LIBRARY,
            MOCAP_EXTRA,
        )


def _require_module(where: str, module: str, extra: str) -> None:
    """Raise ConfigError if a module of this extra is not installed."""
    if importlib.util.find_spec(module) is None:
        do = f"pip install 'crazychoir[{extra}]'."
        raise ConfigError(
            where,
            f"no module {module}",
            f"the extra {extra}, installed on this machine",
            do,
        )


def _is_start_here(
    config: SwarmConfig, host: str | None, started: tuple[int, ...] | None
) -> bool:
    here = config.ids if started is None else started
    beside = [i for i in config.ids if config.drone(i).host == host]
    return here == config.ids or any(i in here for i in beside[:1])


def do_all_wait(config: SwarmConfig, score: FlightScore) -> bool:
    """Return whether the team starts only with all drones, and every drone still waits for the start."""
    return config.start == "all" and all(
        status.task == WAITING_TASK for status in score.statuses.values()
    )


def describe_hindrances(results: Results) -> dict[int, list[str]]:
    """Return for each hindered drone the texts that say what has kept it from its target."""
    told = {
        i: [
            text.format(r[key])
            for key, text in HINDRANCE_TEXTS.items()
            if _is_ours(key, r)
        ]
        for i, r in sorted(results.items())
    }
    return {i: texts for i, texts in told.items() if texts}


def _is_ours(key: str, result: Mapping[str, Any]) -> bool:
    """Return whether a value comes from the flight, by its type: a mission may use the same key."""
    value = result.get(key)
    return isinstance(value, str) if key == "apart" else isinstance(value, int | float)


def mark_operator_ends(results: Results) -> Results:
    """Return the results for the mission's report.

    A drone that its operator has ended counts as failed.
    """
    return {
        i: {**r, "success": False} if ENDED_KEY in r else r for i, r in results.items()
    }


def excuse_operator_ends(
    off: Mapping[int, object], ended: Mapping[int, str]
) -> tuple[bool, dict[int, object], dict[int, str]]:
    """Excuse the failures of drones, where the operator has ended their missions.

    off: {drone id: reason} of the mission's report, for each drone that failed
    ended: {drone id: text that says how the operator has ended its mission}
    Returns
    - whether no reason is left
    - the reasons that are left, of drones that were not ended
    - `ended`, with the removed reasons added to its texts
    """
    others = {i: text for i, text in off.items() if i not in ended}
    words = {
        i: "; ".join([text, *([str(off[i])] if i in off else [])])
        for i, text in ended.items()
    }
    return not others, others, words


def list_failures(
    results: Results,
    touching: Mapping[tuple[int, int], float],
    started: tuple[int, ...],
) -> dict[int, str]:
    """Return why each failed drone has failed: its own result, or a distance that is too small.

    results: result of each drone that has one
    touching: m: least distance of each pair that came nearer than touching_distance
    started: drones that were started here
    """
    reasons = {
        i: [reason_or(r.get("reason"), MISSION_REASONS.unsaid)]
        for i, r in sorted(results.items())
        if not r.get("success")
    }
    for (i, j), gap in touching.items():
        for one, other in ((i, j), (j, i)):
            if one in started:
                text = (
                    f"came within {gap:.3f} m of drone {other}, and may have touched it: "
                    f"allowed {SWARM_LIMITS.touching_distance:g} m"
                )
                reasons.setdefault(one, []).append(text)
    return {i: "; ".join(texts) for i, texts in sorted(reasons.items())}
