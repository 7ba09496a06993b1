"""Flights of the online mission in virtual time: drones are killed, and each delivery is noted with its drone."""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from crazychoir.agent.agent import Agent
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.guidance.tasks.task_book import Fate
from crazychoir.launch.flight_observer import FlightScore
from crazychoir.runtime.clock import run_virtual

FALL = 1.5
"""s after it is killed within which a drone has come down: it falls 2.2 m in 0.7 s, if nothing holds it."""
LONGEST = 300.0
"""s of virtual time after which a mission hangs."""


def crash(agent: Agent, i: int) -> None:
    """End drone i's program without a word, as by kill -9, and take the thrust off its body.

    From now on the other drones hear only where its body is, and drone i hears nothing.
    """
    drone = agent.drones[i]
    port, send = drone.port, drone.port.send
    port.send = lambda message, *args, **named: (
        send(message, *args, **named) if message.topic.of_body else None
    )
    agent.bus.close(i)
    drone.pilot.cut("killed")
    # It ticks no more: no other drone of this process hears its states.
    drone.pilot.row.drone["is_running"] = 0
    agent.runners[i].abort("killed")


def carried(agent: Agent, i: int) -> list[int]:
    """Goods that drone i has picked up and, as far as the team has confirmed, not delivered."""
    guidance = agent.drones[i].guidance
    picked = [deed.task for deed in guidance.news.record.deeds if deed.kind == "pickup"]
    return [
        j
        for j in picked
        if {"task": j, "kind": "delivery"} not in guidance.service.served
    ]


@dataclass
class Outcome:
    """How a flight has ended.

    results: the result of each drone;  aboard: the goods that each killed drone carried when it was killed;  delivered:
    the drones that delivered each task;  touching: pairs of flying drones that came so near that they may have touched,
    with their distance in m;  struck: the same for a killed drone that fell past another drone: no plan can keep
    drones from below it, as no plan knows the moment, see agents/README.md;  reasons: what is wrong with the flight,
    sentence by sentence.
    """

    config: SwarmConfig
    results: dict[int, dict[str, Any]]
    aboard: dict[int, list[int]]
    delivered: dict[int, list[int]]
    simulated: float
    min_separation: float
    touching: dict[tuple[int, int], float]
    struck: dict[tuple[int, int], float]
    reasons: list[str]

    @property
    def living(self) -> list[int]:
        return [i for i in self.config.ids if i not in self.aboard]

    @property
    def fates(self) -> dict[int, list[Any]]:
        """What the lowest living drone says of each task."""
        return {
            int(j): value for j, value in self.results[self.living[0]]["tasks"].items()
        }


def killed_at(
    config: SwarmConfig, kills: int, soonest: float = 3.0, latest: float = 30.0
) -> dict[int, float]:
    """So many drones and times in s after the start, from the seed."""
    draw = np.random.default_rng([config.seed, 2])
    who = draw.choice(config.ids, size=kills, replace=False).tolist()
    return dict(
        zip(who, draw.uniform(soonest, latest, size=kills).tolist(), strict=True)
    )


def fly_online(
    config: SwarmConfig,
    kills: dict[int, float],
    prepare: Any = None,
    killed: dict[int, list[int]] | None = None,
) -> Outcome:
    """Fly the mission, and kill drones.

    kills: {drone: s};  prepare: called with the agent, before it runs;  killed: the goods that each drone carried when
    `prepare` killed it.
    """
    mission = load_mission("online_delivery")
    mission.check(config, False)

    async def main(clock: Any) -> Outcome:
        agent = Agent(clock, config, mission, config.ids)
        score = FlightScore(agent.bus, config.ids, {})
        agent.services.append(score)
        aboard: dict[int, list[int]] = {} if killed is None else killed
        struck: dict[tuple[int, int], float] = {}

        def kill(i: int) -> None:
            if not agent.drones[i].result:
                aboard[i] = carried(agent, i)
                crash(agent, i)
                clock.call_at(
                    clock.now_ns() + round(FALL * 1e9), fallen, i, list(score.touching)
                )

        def fallen(i: int, before: list[tuple[int, int]]) -> None:
            for pair in [
                pair for pair in score.touching if i in pair and pair not in before
            ]:
                struck[pair] = score.touching.pop(pair)

        for i, t in kills.items():
            clock.call_at(round(t * 1e9), kill, i)
        if prepare is not None:
            prepare(agent)
        async with asyncio.timeout(LONGEST):
            results = await agent.run()
        delivered: dict[int, list[int]] = {}
        for i in config.ids:
            guidance = agent.drones[i].guidance
            for stop in guidance.service.served:
                if stop["kind"] == "delivery":
                    delivered.setdefault(stop["task"], []).append(i)
        touching = {
            pair: gap for pair, gap in score.touching.items() if pair not in struck
        }  # it may lie there
        return Outcome(
            config,
            results,
            aboard,
            delivered,
            clock.now(),
            score.min_separation,
            touching,
            struck,
            [],
        )

    outcome = run_virtual(main)
    outcome.reasons = list(faults(outcome))
    return outcome


def faults(outcome: Outcome) -> Iterator[str]:
    """What is wrong: a living drone that failed, other stories, goods twice or not delivered, drones that touch."""
    for i in outcome.living:
        if not outcome.results[i].get("success"):
            yield f"drone {i}: {outcome.results[i].get('reason')}"
            return
        if outcome.results[i]["tasks"] != outcome.results[outcome.living[0]]["tasks"]:
            yield f"drone {i} tells of other ends than drone {outcome.living[0]}"
    for (i, j), gap in outcome.touching.items():
        yield f"drones {i} and {j} came within {gap:.3f} m"
    for j, by in outcome.delivered.items():
        if len(by) != 1:
            yield f"task {j} was delivered by {by}"
    yield from task_faults(outcome)


def task_faults(outcome: Outcome) -> Iterator[str]:
    """Yield what is wrong with the end of each task."""
    config = outcome.config
    hooks = load_mission("online_delivery").hooks
    instance = hooks.instance(config)
    events = hooks.events(config)
    tasks = {task.id: task for task in hooks.known(config)}
    tasks |= {event.task.id: event.task for event in events if not event.task.cancelled}
    fates = outcome.fates
    for j, task in tasks.items():
        if j in fates:
            able = [i for i in outcome.living if may(instance, i, task)]
            yield from fate_faults(outcome, j, able)
            continue
        heard = [event.robots for event in events if event.task.id == j]
        if any(i in outcome.living for robots in heard for i in robots):
            yield f"task {j} is not known"


def fate_faults(outcome: Outcome, j: int, able: list[int]) -> Iterator[str]:
    """Yield what is wrong with the told end of task j; able: living drones that could serve it."""
    name, robot = outcome.fates[j]
    fate = Fate(name)
    gone = any(j in goods for goods in outcome.aboard.values())
    if fate is Fate.LOST and gone and not outcome.config.mission_options.get("recover"):
        return
    if fate is Fate.DELIVERED:
        if not outcome.delivered.get(j) and robot not in outcome.aboard:
            yield f"task {j} is said to be delivered, and no robot has delivered it"
    elif fate is not Fate.CANCELLED and able:
        yield f"task {j} is {fate.value}, though drones {able} could serve it"


def may(instance: Any, i: int, task: Any) -> bool:
    """Whether drone i could serve a task alone."""
    capable = (
        instance.capability[i][task.id]
        if task.id < len(instance.tasks)
        else not task.robots or i in task.robots
    )
    return bool(capable) and task.load <= instance.capacity[i]


def drawn(
    seed: int, loss: float = 0.2, drones: int = 10, **options: Any
) -> SwarmConfig:
    """The mission's own swarm with this seed."""
    mission = load_mission("online_delivery")
    return mission.swarm(drones).replace(
        seed=seed, network={"loss": loss}, mission_options=options
    )


def wilson(successes: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Return the 95 % interval of a probability after `successes` in n trials (Wilson 1927).

    (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)
    """
    p, q = successes / n, z * z / n
    middle, half = p + q / 2, z * ((p * (1 - p) + q / 4) / n) ** 0.5
    return (middle - half) / (1 + q), (middle + half) / (1 + q)
