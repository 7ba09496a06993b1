"""Drones that tell their ways land and keep clear, even if another drone stands there or does not answer."""

import numpy as np
import pytest
from system.flights import fly, mission_of

from crazychoir.bus.impairment.rules import ImpairmentRule
from crazychoir.config.swarm_config import SwarmConfig

pytestmark = [pytest.mark.system, pytest.mark.slow]
HOMES = ((-1.2, 0.02, 0.0), (1.2, 0.0, 0.0))


def pair(homes=HOMES, **tables):
    """Two drones that fly by their planners on board."""
    drones = [
        {
            "id": k,
            "home": list(home),
            "uri": "sim://motors",
            "platform": "cf21",
            "role": "xyz",
        }
        for k, home in enumerate(homes)
    ]
    return SwarmConfig.of(
        {
            "name": "pair",
            "drones": drones,
            "roles": [{"name": "xyz", "sender": "xyz"}],
            "graph": "complete",
            **tables,
        }
    )


def nearest(flights, scale=(1.0, 1.0, 1.0)):
    n = min(len(flight.t) for flight in flights.values())
    return float(
        np.linalg.norm((flights[0].p[:n] - flights[1].p[:n]) * scale, axis=1).min()
    )


def test_a_drone_that_wants_to_land_on_another_lands_beside_it():
    async def does(guidance):
        await guidance.rendezvous()
        if guidance.id == 0:
            await guidance.sleep(12.0)
            return {}
        await guidance.take_off(0.8)
        await guidance.go_to((0.0, 0.0, 0.8))
        await guidance.land()
        return {}

    flights = fly(pair(((0.0, 0.0, 0.0), (1.2, 0.0, 0.0))), mission_of(does))
    assert all(
        flight.result["success"] and not flight.harm for flight in flights.values()
    )
    assert nearest(flights) > 0.3
    assert flights[1].t[-1] < 30.0


def test_two_that_are_parted_for_long_wait_for_each_other():
    async def does(guidance):
        await guidance.take_off(1.0)
        await guidance.rendezvous()
        while guidance.member.clock.now() < 9.0:
            await guidance.sleep(0.05)
        await guidance.go_to((HOMES[1 - guidance.id][0], 0.0, 1.0), duration=6.0)
        await guidance.land()
        return {}

    parted = {"partitions": [{"at": 8.0, "until": 20.0, "groups": [[0], [1]]}]}
    flights = fly(pair(network=parted, lost_after=30.0), mission_of(does))
    assert nearest(flights, (1.0, 1.0, 0.4)) > 0.3
    assert not any(flight.harm for flight in flights.values())
    assert "drone 0 does not answer" in flights[1].result["reason"]


@pytest.mark.parametrize("edge", [(0, 1), (1, 0)])
def test_a_drone_without_an_answer_lands_after_some_seconds(edge):
    async def does(guidance):
        await guidance.take_off(1.0)
        await guidance.rendezvous()
        if guidance.id == 0:
            impairment = guidance.member.communicator.port.bus.impairment
            impairment.replace(
                [ImpairmentRule({"loss": 1.0}, edge=edge, directed=True)]
            )
        await guidance.sleep(20.0 * (1 - guidance.id) + 5.0)
        begins = guidance.member.clock.now()
        await guidance.land()
        return {"took": guidance.member.clock.now() - begins}

    flights = fly(pair(lost_after=60.0), mission_of(does))
    assert all(
        flight.result["success"] and not flight.harm for flight in flights.values()
    )
    assert flights[1].result["took"] < 12.0
