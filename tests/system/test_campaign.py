"""Some seeds of the fault campaign; `make campaign` runs ten thousand."""

import asyncio
import time

import numpy as np
import pytest
from campaign import flights, seeds
from campaign.report import LIGHTWEIGHT, Report

from crazychoir.agent.agent import Agent
from crazychoir.flight.judge import Judge
from crazychoir.guidance.mission import load_mission
from crazychoir.runtime.clock import run_virtual

pytestmark = pytest.mark.system


FOUND = [103, 272, 978, 4057, 5962, 6444, 6878, 8921, 9578]
"""Seeds that have found something."""


@pytest.mark.parametrize("seed", [*range(40), *FOUND])
def test_invariants_hold_whatever_goes_wrong(seed):
    report = seeds.run(seed)
    assert report.wrong == [], f"again: cd tests && python -m campaign {seed}"
    assert report.checks > 0


@pytest.mark.parametrize("seed", [17, 18, 19])
def test_invariants_hold_with_typical_drones_at_the_level_of_motors(seed):
    report = seeds.run(seed, "sim://motors")
    assert report.wrong == []
    assert report.checks > 0


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 17, 18, 19])
def test_a_seed_repeats_its_story(seed):
    assert seeds.run(seed).digest == seeds.run(seed).digest != ""


def test_three_of_twenty_seeds_fly_and_no_kind_is_left_out():
    kinds = [seeds.kind_of(seed) for seed in range(10_000)]
    assert {kind: kinds.count(kind) for kind in seeds.KINDS} == {
        **dict.fromkeys(("rounds", "allocation", "plan", "members", "commands"), 1700),
        **dict.fromkeys(("formation", "crossing", "delivery"), 500),
    }


def test_a_scenario_that_hangs_is_a_finding(monkeypatch):
    """Wherever it does: what raises in a callback of an event loop does not end the loop."""

    def busy():
        while time.process_time() < ends:
            pass

    def hanging(report, draw):
        async def main(clock):
            asyncio.get_running_loop().call_soon(busy)
            await clock.sleep(1.0)

        run_virtual(main)

    monkeypatch.setattr(seeds, "PATIENCE", 1)
    monkeypatch.setitem(seeds.KINDS, seeds.kind_of(0), hanging)
    ends = time.process_time() + 3.0
    report, _ = seeds.timed((0, LIGHTWEIGHT))
    assert report.wrong == ["Hangs: 1 s of the processor, or 10 of the wall clock"]


def formation():
    """Half a minute of it."""
    mission = load_mission("bearing_formation")
    made = mission.swarm(None).replace(
        flight=flights.BRISK, mission_options={"duration": 30.0}
    )
    return mission.scatter(made)


def test_all_are_told_to_land_once(monkeypatch):
    told = []
    land = Agent.land_all
    monkeypatch.setattr(
        Agent, "land_all", lambda self, why: (told.append(why), land(self, why))[1]
    )
    report = Report(17, "formation")
    flights.flown(
        report,
        np.random.default_rng(1),
        formation(),
        load_mission("bearing_formation"),
        0,
        5.0,
    )
    assert report.wrong == []
    assert told == ["the scenario is over"]


def test_injected_faults_reach_the_drones(monkeypatch):
    measures = set()
    obey = Judge.obey

    def note_measure(self, verdict, now):
        measures.add(verdict.measure)
        obey(self, verdict, now)

    monkeypatch.setattr(Judge, "obey", note_measure)
    report = Report(17, "formation")
    mission = load_mission("bearing_formation")
    draw = np.random.default_rng(42)
    agent = flights.flown(report, draw, formation(), mission, 0, 12.0)
    faults = {"bad link of one drone", "mocap dropouts", "partitions", "runaway laws"}
    assert faults < report.injected.keys()
    assert "pose" in measures, "the cameras do not see a drone for some time"
    assert "stop" in measures, "a law leads its drone to the fence"
    edges = agent.bus.impairment.counters.values()
    lost = sum(edge.lost for edge in edges)
    assert lost > 5000, "states are lost as well, not only the few other messages"


def test_a_drone_that_is_nowhere_is_a_finding(monkeypatch):
    look = flights.Invariants.look

    def lost(self, now):
        if now > 3.0:
            self.agent.owner_of[0].world.states[
                self.agent.owner_of[0].world.row[0], 0
            ] = np.nan
        look(self, now)

    monkeypatch.setattr(flights.Invariants, "look", lost)
    report = Report(17, "formation")
    seeds.KINDS["formation"](report, np.random.default_rng([17, 8]))
    assert any(
        said.startswith("drone 0 is at") and "nan" in said for said in report.wrong
    ), report.wrong
