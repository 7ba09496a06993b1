"""Random faults, several at once, of drones that a radio reaches: none outside, none collides, none hangs."""

import asyncio
import itertools
import json
import math
import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from system.agents import Program
from system.hall import Hall, processes, reached

from crazychoir.config.checks import limit_area
from crazychoir.config.link_loss import TILT_TIMES, describe_crowding, fence_inset
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.control.robots import find_sender
from crazychoir.safety.rules.guard import Fence

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.timeout(240),
    pytest.mark.usefixtures("compiled"),
]
DRONES = 4
TOUCH = 0.137
"""m between the centres of two drones that touch."""
SENDERS = ("fpqr", "frpy", "xyz")
HOMES = ((0.0, 0.0), (0.85, 0.85), (0.85, 0.0), (0.0, 0.85))
"""m: neighbours have different dongles, those of one are far enough apart to stray, both, without touching."""
LASTING: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "loss": ({"loss": 0.3}, {}),
    "battery": ({"voltage": 3.35}, {}),
    "empty": ({"voltage": 3.1}, {}),
    "tumble": ({"tumble": 1}, {}),
    "motor": ({"motor": 1}, {}),
}
"""Faults that stay: what begins them, what ends them."""
PASSING: dict[str, tuple[float, dict[str, Any], dict[str, Any]]] = {
    "silent for 1 s": (1.0, {"silent": 1}, {"silent": 0}),
    "silent for 5 s": (5.0, {"silent": 1}, {"silent": 0}),
    "unseen for 0.2 s": (0.2, {"pose_lost": 1}, {"pose_lost": 0}),
    "unseen for 1 s": (1.0, {"pose_lost": 1}, {"pose_lost": 0}),
    "unseen for 5 s": (5.0, {"pose_lost": 1}, {"pose_lost": 0}),
    "seen elsewhere": (5.0, {"offset": [0.5, 0.3, 0.0]}, {"offset": [0.0, 0.0, 0.0]}),
    "exchanged": (5.0, {"swap": None}, {"swap": -1}),
    "delayed": (5.0, {"delay": 0.1}, {"delay": 0.0}),
}
"""Faults that end: s."""
KILLED = {
    "its agent": "[c]li.agent --swarm .*{name}.* --id {first} ",
    "its owner": "[c]li.radios --swarm .*{name}.* --dongle {group} ",
    "motion capture": "[c]li.mocap --swarm .*{name}",
}
"""Processes that are killed, by their command lines; a dongle and a process for two drones."""
STOPPED = "an operator's stop"
KINDS = (*LASTING, *PASSING, *KILLED, STOPPED)


@dataclass(frozen=True)
class Fault:
    """At t s a kind of fault of a drone."""

    t: float
    kind: str
    drone: int


def drawn(seed: int) -> tuple[SwarmConfig, list[Fault]]:
    """A swarm, each drone sent its commands in some way, and one to three faults."""
    draws = np.random.default_rng(seed)
    raw = json.loads(default_swarm(DRONES).dumps())
    for row, home in zip(raw["drones"], HOMES, strict=True):
        row |= {"role": str(draws.choice(SENDERS)), "home": [*home, 0.0]}
    raw |= {
        "roles": [{"name": sender, "sender": sender} for sender in SENDERS],
        "mission": "figure",
        "mission_options": {"size": 0.3, "laps": 1.0, "period": 8.0},
        "flight": {
            "takeoff_height": 0.8,
            "speed_limit": 0.5,
            "acceleration_limit": 1.0,
        },
        "processes": [[0, 1], [2, 3]],
    }
    faults = [
        Fault(
            draws.uniform(0.0, 6.0),
            str(draws.choice(KINDS)),
            int(draws.integers(DRONES)),
        )
        for _ in range(draws.choice((1, 2, 2, 3)))
    ]
    raw["radio"] = {"watchdog": bool(draws.integers(2))}
    return reached(SwarmConfig.of(raw)), sorted(faults, key=lambda fault: fault.t)


@dataclass
class Watched:
    """The worst that was seen.

    apart: m, the least distance of two drones that did not rest;  outside: m, the most beyond the limit with motors on;
    resting: whether all drones rest.
    """

    limit: Fence
    apart: float = math.inf
    outside: float = -math.inf
    resting: bool = False
    told: list[str] = field(default_factory=list)

    def look(self, state: dict[int, dict[str, Any]]) -> None:
        up = [said["p"] for said in state.values() if not said["resting"]]
        self.apart = min(
            [self.apart, *itertools.starmap(math.dist, itertools.combinations(up, 2))]
        )
        for said in state.values():
            if max(said["motors"]) > 0.0 and not said["resting"]:
                self.outside = max(self.outside, self.limit.outside(*said["p"]))
        self.resting = not up


def begin(
    fault: Fault, hall: Hall, run: Program
) -> Iterator[tuple[float, dict[str, Any]]]:
    """Cause the fault; if it passes, yield after how many s it ends, and what ends it."""
    i, kind = fault.drone, fault.kind
    if kind in LASTING:
        hall.fault(i, **LASTING[kind][0])
    elif kind in PASSING:
        seconds, begins, ends = PASSING[kind]
        hall.fault(
            i,
            **{
                name: (i + 1) % DRONES if value is None else value
                for name, value in begins.items()
            },
        )
        yield seconds, ends
    elif kind == STOPPED:
        hall.interrupt(run)
    else:
        pattern = KILLED[kind].format(
            name=hall.config.name, first=i - i % 2, group=i // 2
        )
        found = processes(pattern)
        ended = (
            run.process.returncode is not None or kind == "its agent"
        )  # no program starts it again
        assert found or ended, (pattern, "no process to kill")
        for process in found:
            os.kill(process, signal.SIGKILL)


@pytest.mark.parametrize("seed", range(100))
async def test_no_fault_makes_a_drone_leave_the_fence_collide_or_hang(
    tmp_path, seed
) -> None:
    config, faults = drawn(seed)
    for sender in TILT_TIMES:
        margin = fence_inset(config, sender)
        assert margin.given == margin.needed, "drones start inside the inset fence"
    streamed = {
        i: kind for i in config.ids if (kind := find_sender(config, i)) in TILT_TIMES
    }
    assert not any(describe_crowding(config, i, streamed) for i in streamed)
    loop = asyncio.get_running_loop()
    watched = Watched(Fence.box(*limit_area(config)))
    async with Hall(config, tmp_path) as hall:
        run = await hall.fly()
        await hall.until(
            lambda state: all(said["p"][2] > 0.6 for said in state.values()), 90.0
        )
        began, todo = loop.time(), list(faults)
        ends: list[tuple[float, int, dict[str, Any]]] = []
        while not watched.resting or todo:
            t = loop.time() - began
            while todo and todo[0].t <= t:
                fault = todo.pop(0)
                ends += [
                    (t + seconds, fault.drone, right)
                    for seconds, right in begin(fault, hall, run)
                ]
            for end in [end for end in ends if end[0] <= t]:
                ends.remove(end)
                hall.fault(end[1], **end[2])
            watched.look(hall.state())
            assert t < 60.0, ("hangs in the air", faults, hall.state(), run.text)
            await asyncio.sleep(0.02)
        result = await run.end(60.0)
    assert watched.apart > TOUCH, (faults, watched, result, run.text)
    assert watched.outside < 0.0, (faults, watched, result, run.text)
