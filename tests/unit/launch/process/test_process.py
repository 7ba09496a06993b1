"""Signals: what an operator insists on, and what only says that the parent has gone."""

import os
import signal

import pytest

from crazychoir.config.swarm_config import default_swarm
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.network import isolate_swarm
from crazychoir.launch.process.process import _obey_signals, run_agent
from crazychoir.launch.process.signals import end_on_signals
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import run_wall


class Told:
    """In an agent's place: what it is told."""

    def __init__(self):
        self.calls = []

    def land_all(self, reason):
        self.calls.append(("land", reason))

    def cut_all(self, reason):
        self.calls.append(("cut", reason))

    def end(self, reason):
        self.calls.append(("end", reason))

    def abort(self, reason):
        self.calls.append(("abort", reason))


def told(number, times, obey=_obey_signals):
    """What an agent, or a world, is told when its process gets a signal several times in a row."""

    async def main(clock):
        agent = Told()
        obey(clock, agent)
        for _ in range(times):
            os.kill(os.getpid(), number)
            await clock.sleep(0.02)
        return agent.calls

    return run_wall(main)


@pytest.mark.parametrize(
    ("number", "name"),
    [(signal.SIGINT, "Ctrl-C (SIGINT)"), (signal.SIGTERM, "SIGTERM")],
)
def test_the_first_signal_lands_and_the_third_cuts(number, name):
    assert told(number, 3) == [("land", f"{name}: landing"), ("cut", "third signal")]


def test_however_often_the_parent_is_said_to_be_gone_the_drones_land():
    """A killed parent of many threads sends it several times, as they die one after the other."""
    assert told(signal.SIGHUP, 5) == [("land", "SIGHUP: landing")] * 5


def test_a_world_ends_gently_on_one_signal_and_at_once_on_a_second():
    assert told(signal.SIGINT, 2, end_on_signals) == [
        ("end", "Ctrl-C (SIGINT)"),
        ("abort", "a second signal"),
    ]
    assert told(signal.SIGTERM, 1, end_on_signals) == [("end", "SIGTERM")]


def test_a_world_that_loses_its_parent_lets_its_drones_land():
    assert told(signal.SIGHUP, 3, end_on_signals) == [("end", "SIGHUP")] * 3


class EndMission(Actor):
    """Ends the missions of an agent at once."""

    name = "end"

    def __init__(self, agent):
        self.agent = agent

    async def run(self):
        await self.agent.clock.sleep(0.1)
        self.agent.land_all("seen")


@pytest.mark.real_time
def test_further_actors_of_a_process_run_beside_its_drones():
    config = isolate_swarm(default_swarm(1), 1)
    mission = load_mission("figure")

    def make_services(agent):
        return [EndMission(agent)]

    flown = run_agent(config, mission, (0,), None, None, make_services)
    assert "seen" in flown["results"][0]["reason"]
