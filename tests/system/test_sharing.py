"""Places that several drones want at once: flights by `go_to`, a take-off and a landing, all of them by the filter."""

import json

import numpy as np
import pytest
from system.flights import fly, mission_of

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_fast
from crazychoir.safety.rules.modes import Mode

pytestmark = pytest.mark.system
N = 4


def depot(path):
    """Four robots on a circle bring goods, two of them 0.2 m apart, to one place in the middle."""
    angles = 2.0 * np.pi * np.arange(N) / N
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    pickup = circle.copy()
    pickup[1] = pickup[0] + [0.2, 0.0]
    instance = {
        "home": (2.0 * circle).tolist(),
        "pickup": pickup.tolist(),
        "delivery": [[0.0, 0.0]] * N,
        "load": [1.0] * N,
        "capacity": [1.0] * N,
        "capability": np.eye(N, dtype=bool).tolist(),
    }
    path.write_text(json.dumps(instance))
    return path


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 12))]
)
def test_all_bring_their_goods_to_one_place_one_after_the_other(seed, tmp_path):
    mission = load_mission("pickup_delivery")
    config = mission.swarm(None, depot(tmp_path / "depot.json")).replace(
        seed=seed, network={"loss": 0.2}
    )
    result = fly_fast(config, mission)
    assert result["success"], result["reasons"]
    assert result["tasks"] == {"total": N, "served": N}
    assert result["min_separation_m"] > 0.24, "two semi-axes"
    assert result["simulated_s"] < 70.0


def flown(does, *homes):
    """Drones that do this, at motor level; their flights."""
    rows = [
        {"id": i, "home": [*home, 0.0], "uri": "sim://motors"}
        for i, home in enumerate(homes)
    ]
    config = SwarmConfig.of(
        {
            "name": "some",
            "drones": rows,
            "fence": {"min": [-3, -3, 0], "max": [3, 3, 3]},
        }
    )
    flights = fly(config, mission_of(does))
    assert all(flight.result["success"] for flight in flights.values()), [
        f.result for f in flights.values()
    ]
    return flights


def two(does, *homes):
    """Two drones that do this, and keep clear of each other; their flights."""
    flights = flown(does, *homes)
    n = min(len(flight.t) for flight in flights.values())
    apart = (flights[0].p[:n] - flights[1].p[:n]) * [1.0, 1.0, 0.4]
    up = np.minimum(flights[0].p[:n, 2], flights[1].p[:n, 2]) > 0.1
    assert np.linalg.norm(apart[up], axis=1).min(initial=np.inf) > 0.24, (
        "their ellipsoids do not meet"
    )
    return flights


def test_two_change_places_on_one_line():
    async def does(self):
        await self.take_off()
        await self.go_to([2.0 * (self.id == 0), 0.0, 0.5])
        arrived = self.member.clock.now()
        await self.sleep(1.0)
        await self.land()
        return {"arrived": arrived}

    flights = two(does, (0.0, 0.0), (2.0, 0.0))
    assert max(flight.result["arrived"] for flight in flights.values()) < 15.0


def test_two_that_stand_side_by_side_are_flown_round():
    """The drone does not wait between them, and does not circle round both until they leave."""

    async def does(self):
        await self.take_off()
        if self.id == 0:
            await self.go_to([1.2, 0.0, 0.5])
        else:
            await self.sleep(20.0)
        arrived = self.member.clock.now()
        await self.land()
        return {"arrived": arrived}

    flights = flown(does, (-1.2, 0.0), (0.0, 0.18), (0.0, -0.18))
    assert flights[0].result["arrived"] < 18.0


def test_a_drone_waits_for_an_occupied_place():
    """The drone does not give up and land after some short attempts."""

    async def does(self):
        await self.take_off()
        if self.id == 1:
            await self.sleep(15.0)
            await self.go_to([-1.5, 0.0, 0.5])
        else:
            await self.go_to([0.0, 0.0, 0.5])
        arrived = self.member.clock.now()
        await self.land()
        return {"arrived": arrived, "at": self.state.p[:2].tolist()}

    flights = two(does, (1.5, 0.0), (0.0, 0.0))
    assert 15.0 < flights[0].result["arrived"] < 30.0
    assert flights[0].result["at"] == pytest.approx([0.0, 0.0], abs=0.1)


def test_a_drone_does_not_take_off_into_or_land_on_another_in_its_way():
    """Drone 0 stands over the home of drone 1, first while that takes off, then while it lands, with motors on."""

    async def does(self):
        if self.id == 0:
            await self.take_off()
            await self.go_to([1.0, 0.0, 0.6])
            await self.sleep(8.0)
            await self.go_to([0.0, 0.0, 0.6])
            await self.sleep(6.0)
            await self.go_to([1.0, 0.0, 0.6])
            await self.sleep(15.0)
            await self.go_to([0.0, 0.0, 0.6])
        else:
            await self.sleep(8.0)
            await self.take_off(1.6)
            await self.go_to([1.0, 0.0, 1.6])
            await self.sleep(10.0)
        await self.land()
        return {}

    flights = two(does, (0.0, 0.0), (1.0, 0.0))
    landed = flights[1].during(Mode.GROUND) & (np.array(flights[1].t) > 20.0)
    assert flights[1].p[landed][:, 2].max() < 0.05, (
        "its motors stop on the ground, and not above another"
    )
