"""Flights of whole drones in virtual time, with the truth beside what was wanted."""

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from system.agents import BRISK

from crazychoir.agent.agent import Agent
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import load_mission
from crazychoir.numerics.math3d import wrap_angle, yaw_of
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import run_virtual
from crazychoir.safety.rules.modes import Mode

TICK = 0.01
PERFECT = {"imperfections": 0.0}
"""The table [motors] for drones that obey their controllers exactly: what is measured is the controllers."""
STRAIGHT = {"tilt_spread": 0.0}
"""Keys of [mocap] for bodies that are mounted straight."""


@dataclass(
    repr=False
)  # asyncio asks for that of a task's result, twice: seconds, for so many arrays
class Flight:
    """What one drone did, tick by tick.

    t: s;  modes: of its pilot;  truth: (13,);  wanted: (14,), NaN without a reference;  motors: the sum of what the
    firmware asks of them;  onboard: what its supervisor says;  resting: whether it stands on the floor.
    """

    t: list[float] = field(default_factory=list)
    modes: list[Mode] = field(default_factory=list)
    truth: list[np.ndarray] = field(default_factory=list)
    wanted: list[np.ndarray] = field(default_factory=list)
    motors: list[float] = field(default_factory=list)
    onboard: list[str] = field(default_factory=list)
    resting: list[bool] = field(default_factory=list)
    harm: str = ""
    result: dict[str, Any] = field(default_factory=dict)

    def during(self, *modes: Mode) -> np.ndarray:
        """Ticks in one of these modes."""
        return np.array([mode in modes for mode in self.modes])

    @property
    def p(self) -> np.ndarray:
        """(n, 3) m, true."""
        return np.array(self.truth)[:, 0:3]

    @property
    def errors(self) -> np.ndarray:
        """(n, 3) m, place minus reference."""
        return self.p - np.array(self.wanted)[:, 0:3]

    @property
    def tilts(self) -> np.ndarray:
        """(n,) rad, of the true z axis from the vertical."""
        q = np.array(self.truth)[:, 6:10]
        return np.arccos(np.clip(1.0 - 2.0 * (q[:, 0] ** 2 + q[:, 1] ** 2), -1.0, 1.0))

    @property
    def yaws(self) -> np.ndarray:
        """(n,) rad, true."""
        return np.array([yaw_of(x[6:10]) for x in self.truth])

    @property
    def yaw_errors_deg(self) -> np.ndarray:
        """(n,) true yaw minus reference, the short way."""
        pairs = zip(self.yaws, np.array(self.wanted)[:, 12], strict=True)
        return np.degrees([wrap_angle(yaw - wanted) for yaw, wanted in pairs])


class Observer(Actor):
    """Writes down the truth and the references of all drones, every tick."""

    name = "observer"

    def __init__(self, agent: Agent) -> None:
        self.agent, self.flights = agent, {i: Flight() for i in agent.ids}

    async def run(self) -> None:
        nothing = np.full(14, math.nan)
        async for _ in self.agent.clock.ticks(1.0 / TICK):
            for i, flight in self.flights.items():
                pilot, world = self.agent.drones[i].pilot, self.agent.owner_of[i].world
                flown = pilot.row.flown
                flight.t.append(self.agent.clock.now())
                flight.modes.append(pilot.mode)
                flight.truth.append(world.states[world.row[i]].copy())
                flight.wanted.append(nothing if flown is None else flown.flat.copy())
                flight.motors.append(float(sum(world.onboard[i].record["motors"])))
                flight.onboard.append(world.onboard[i].state)
                flight.resting.append(world.resting(i))
                flight.harm = world.harm(i)


class Does(CFGuidance):
    """A mission that is one coroutine function of the test."""

    def __init__(self, does: Any) -> None:
        self.does = does

    async def mission(self) -> Any:
        return await self.does(self)


def swarm_of(rows: list[tuple[str, str]], yaw: float, **tables: Any) -> SwarmConfig:
    """Whole drones 1.5 m apart, row by row of (platform, sender): perfect ones without other tables."""
    drones = [
        {
            "id": k,
            "home": [1.5 * (k % 4), 1.5 * (k // 4), 0.0],
            "uri": "sim://motors",
            "platform": platform,
            "role": sender,
            "yaw": yaw,
        }
        for k, (platform, sender) in enumerate(rows)
    ]
    roles = [
        {"name": sender, "sender": sender}
        for sender in dict.fromkeys(sender for _, sender in rows)
    ]
    fence = {"min": [-3.0, -3.0, 0.0], "max": [9.0, 9.0, 3.0]}
    whole = {"name": "whole", "drones": drones, "roles": roles, "fence": fence}
    return SwarmConfig.of({**whole, "motors": PERFECT, "mocap": STRAIGHT, **tables})


def scattered(seed: int) -> SwarmConfig:
    """The formation with a quick take-off and landing; the law has 18 s."""
    mission = load_mission("bearing_formation")
    return mission.scatter(
        mission.swarm(None).replace(
            seed=seed, flight=BRISK, mission_options={"duration": 18.0}
        )
    )


def mission_of(does: Any) -> SimpleNamespace:
    """A mission of one coroutine function for all drones."""
    return SimpleNamespace(guidance=lambda i, config: Does(does))


def fly(config, mission, prepare=lambda agent: None) -> dict[int, Flight]:
    """All drones of a swarm in virtual time, to the end of the last one; prepare: called with the agent."""

    async def main(clock):
        agent = Agent(clock, config, mission, config.ids)
        observer = Observer(agent)
        agent.services.append(observer)
        prepare(agent)
        results = await agent.run()
        for i, flight in observer.flights.items():
            flight.result = results[i]
        return observer.flights

    return run_virtual(main)
