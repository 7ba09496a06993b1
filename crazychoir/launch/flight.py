"""A mission flown by all its drones, in virtual time or in real time; and the object that `run --json` prints."""

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.agent.agent import Agent
from crazychoir.agent.dead_man import Console, is_console
from crazychoir.agent.drone import WAITING
from crazychoir.agent.mission_runner import ENDED, NO_REASON
from crazychoir.bus.commands import Commander
from crazychoir.config.checks import TOUCHING
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import spoken
from crazychoir.guidance.feedback import idle
from crazychoir.guidance.mission import Mission, has
from crazychoir.launch.flight_observer import Score, Watch, goal_of
from crazychoir.launch.network import attached, observer
from crazychoir.launch.processes import WORLD_OWNER, Owner, run_children
from crazychoir.recording.mcap.file import RecordingFile
from crazychoir.recording.recorder import Recorder
from crazychoir.runtime.clock import Clock, run_virtual, run_wall
from crazychoir.runtime.user_code_guard import HangWatch
from crazychoir.simulation.trace import Trace

log = logging.getLogger(__name__)
NO_REASONS = "the mission's report returned success = False, without reasons"
HELD = {
    "kept_clear_s": "the collision filter has flown it for {:g} s",
    "at_fence_s": "held at the fence for {:g} s",
    "apart": "at its end the {}",
    "refused_references": "{:g} references of its law could not be flown",
}
"""What has kept a drone from where it wanted to be, by the key of its result."""
NO_RESULT = "its process has ended without a result; the log says how"
NOBODY_MOVED = (
    "the law returned None in every step of every drone: all hovered, nobody moved"
)
Results = dict[int, dict[str, Any]]


def fly_fast(
    config: SwarmConfig,
    mission: Mission,
    watch: Watch | None = None,
    file: RecordingFile | None = None,
) -> dict[str, Any]:
    """The whole swarm in this process, in virtual time; recorded into `file`."""
    began = time.perf_counter()

    async def main(clock: Clock) -> dict[str, Any]:
        trace = Trace()
        agent = Agent(clock, config, mission, config.ids, trace=trace)
        score = Score(
            agent.bus,
            config.ids,
            goal_of(mission, config),
            watch or (lambda score: None),
        )
        agent.services.append(score)
        outcome = lambda: {"digest": trace.digest()}  # noqa: E731 - of the whole flight, when the drones have ended
        recorder = (
            Recorder(agent.bus, config.ids, file, outcome=outcome) if file else None
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
        return summary(config, mission, results, score, clock.now(), wall) | {
            "startup_s": ready - began,
            "messages": messages,
            "rounds": rounds,
            "digest": trace.digest(),
            "recording": recorder.result() if recorder else None,
        }

    return run_virtual(main)


def fly_real(
    path: Path,
    config: SwarmConfig,
    mission: Mission,
    options: Iterable[str] = (),
    watch: Watch | None = None,
    say: Callable[[str], None] = lambda line: None,
    started: tuple[int, ...] | None = None,
    file: RecordingFile | None = None,
) -> dict[str, Any]:
    """One process a group of the swarm file, over Zenoh; this process looks on, and records into `file`.

    path: the file of `config`, for the processes;  started: the drones to start, None for all: whole groups.
    """
    groups = [
        group
        for group in config.groups()
        if started is None or any(i in started for i in group)
    ]

    async def main(clock: Clock) -> dict[str, Any]:
        link = observer(clock, config)
        began = clock.now()
        address = next(iter(link.bus.ports))
        watched = watch or (lambda score: None)
        score = Score(
            link.bus,
            config.ids,
            goal_of(mission, config),
            watched,
            address=address,
            source=config.source,
            unseen=config.unseen,
        )
        recorder = (
            Recorder(link.bus, config.ids, file, address, config.source)
            if file
            else None
        )
        console = (
            [Console(Commander(link.bus.ports[address]), config.ids)]
            if is_console(config, link.bus.host)
            else []
        )
        async with attached(link, score, *([recorder] if recorder else []), *console):
            results = await run_children(
                groups,
                path,
                config,
                list(options),
                say,
                lambda: all_wait(config, score),
                owners(config, started),
            )
        ready = began if score.go_at is None else score.go_at
        wall = clock.now() - ready
        return summary(config, mission, results, score, wall, wall, started) | {
            "startup_s": ready - began,
            "recording": recorder.result() if recorder else None,
        }

    return run_wall(main)


def summary(
    config: SwarmConfig,
    mission: Mission,
    results: Results,
    score: Score,
    simulated: float,
    wall: float,
    started: tuple[int, ...] | None = None,
) -> dict[str, Any]:
    """The object that `run --json` prints; what the mission reports is added to the figures of the run.

    wall: s, from GO; before it drones are made, and laws are compiled if they were not: `startup_s`.
    started: the drones that were started here, None for all: they decide on the success. What is measured from outside
    is of the whole swarm. The mission's own report needs the results of all drones, and is left out without them.
    """
    started = config.ids if started is None else started
    ended = {i: r[ENDED] for i, r in sorted(results.items()) if ENDED in r}
    report = (
        mission.report(config, unended(results))
        if started == config.ids and has(mission, "report")
        else {}
    )
    reached = bool(report.pop("success", True))
    off = report.pop("reasons", {})
    said = report.pop("reason", None)
    if ended and not reached:
        of_all = said is not None and any(i not in ended for i in config.ids)
        reached, off, ended = excused(off, ended)
        reached = reached and not of_all
        said = said if of_all else None
    held = hindrances(results)
    failed = failures(results, score.touching, started)
    absent = [i for i in started if i not in results]
    told = {i: spoken(text, NO_REASON) for i, text in (off | failed).items()}
    reasons = {i: "; ".join([text, *held.get(i, [])]) for i, text in told.items()}
    reasons |= dict.fromkeys(absent, NO_RESULT)
    if not (reached or reasons):
        said = spoken(said, NO_REASONS)
    reasons |= {
        i: str(r["refused"])
        for i, r in sorted(results.items())
        if "refused" in r and i not in reasons
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
    if idle(results):
        log.warning(NOBODY_MOVED)
        score.log.append(NOBODY_MOVED)
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
            for key in HELD
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


def owners(config: SwarmConfig, started: tuple[int, ...] | None) -> list[Owner]:
    """Those that are started here: with all drones, or with the lowest one of their host."""
    found = (
        [WORLD_OWNER]
        if config.owned and _starts(config, config.world.host, started)
        else []
    )
    if config.seen and _starts(config, config.mocap.host, started):
        found.append(Owner("mocap", "crazychoir.cli.fly.mocap", again=True))
    for k in dongles(config, started):
        options = ("--dongle", str(k))
        found.append(
            Owner(
                f"dongle {k}",
                "crazychoir.cli.fly.radio_owner",
                options,
                again=True,
                ids=config.dongles[k],
            )
        )
    return found


def dongles(config: SwarmConfig, started: tuple[int, ...] | None) -> list[int]:
    """Those whose owners are started here."""
    return [
        k for k in config.dongles if _starts(config, config.dongle_host(k), started)
    ]


def _starts(
    config: SwarmConfig, host: str | None, started: tuple[int, ...] | None
) -> bool:
    here = config.ids if started is None else started
    beside = [i for i in config.ids if config.drone(i).host == host]
    return here == config.ids or any(i in here for i in beside[:1])


def all_wait(config: SwarmConfig, score: Score) -> bool:
    """Whether every drone must be there for the start, and none is known to have begun."""
    return config.start == "all" and all(
        status.task == WAITING for status in score.statuses.values()
    )


def hindrances(results: Results) -> dict[int, list[str]]:
    """What has kept each drone from where it wanted to be, of those that something has."""
    told = {
        i: [text.format(r[key]) for key, text in HELD.items() if key in r]
        for i, r in sorted(results.items())
    }
    return {i: texts for i, texts in told.items() if texts}


def unended(results: Results) -> Results:
    """The results as the mission's report sees them: a drone that its operator has ended did not do its part."""
    return {i: {**r, "success": False} if ENDED in r else r for i, r in results.items()}


def excused(
    off: Mapping[int, object], ended: Mapping[int, str]
) -> tuple[bool, dict[int, object], dict[int, str]]:
    """Take the consequences of an operator's end from the reasons of a report that is no success.

    off: the report's reasons, by drone;  ended: by drone, how its operator has ended it.
    Returns whether no reason is left; the reasons that are left, of drones that were not ended; and `ended` with the
    reasons that were taken.
    """
    others = {i: text for i, text in off.items() if i not in ended}
    words = {
        i: "; ".join([text, *([str(off[i])] if i in off else [])])
        for i, text in ended.items()
    }
    return not others, others, words


def failures(
    results: Results,
    touching: Mapping[tuple[int, int], float],
    started: tuple[int, ...],
) -> dict[int, str]:
    """Why each drone has failed: by its own result, or because it came near enough to others to touch them."""
    reasons = {
        i: [spoken(r.get("reason"), NO_REASON)]
        for i, r in sorted(results.items())
        if not r.get("success")
    }
    for (i, j), gap in touching.items():
        for one, other in ((i, j), (j, i)):
            if one in started:
                text = f"came within {gap:.3f} m of drone {other}, and may have touched it: allowed {TOUCHING:g} m"
                reasons.setdefault(one, []).append(text)
    return {i: "; ".join(texts) for i, texts in sorted(reasons.items())}
