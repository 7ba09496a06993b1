"""Trajectories of drones that agree on their paths: how long they wait for each other."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_time import run_virtual, virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import CollisionTable
from crazychoir.flight.batch import Batch
from crazychoir.flight.clearance import Clearance
from crazychoir.flight.point_flights import PointFlights
from crazychoir.flight.setup import FlightSetup
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.collision.agreed.path_limits import PathLimits
from crazychoir.safety.collision.agreed.planned import PlannedFlights
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import State

FENCE = Fence.box((-3.0, -3.0, 0.25), (3.0, 3.0, 2.5))
SETUP = FlightSetup()
TICK = 0.01
LEFT = np.array([-1.0, 0.0, 1.0])
RIGHT = np.array([1.0, 0.0, 1.0])
FLIGHT_TIME = 5.0
CLEAR = 0.24


class OnTrajectory:
    """A drone that is always where its clearance lets it fly on its trajectory."""

    def __init__(self, airspace, i, trajectory, lands=False):
        port = airspace.bus.ports[i]
        self.traffic = Neighbours(airspace, i, keeps_all=True)
        limits = PathLimits(FENCE, a_max=2.0, v_max=1.0, ground=0.0)
        self.planned = PlannedFlights(
            port, CollisionTable(), self.traffic, (0, 1), limits
        )
        row = Batch(1).add(i)
        self.flights = PointFlights(SETUP.limits, FENCE, SETUP.a_max, row.plan)
        self.clearance = Clearance(self.planned, self.flights, TICK, row)
        self.trajectory = trajectory
        self.lands = lands
        self.state = State.at(trajectory.sample(0.0).p)
        self.places = []
        self.ended_early = False

    def tick(self, now):
        """Fly for a tick at `now` s."""
        if self.flights.plan is None:
            self.flights.fly(self.trajectory, now)
        self.traffic.publish(self.state, 0.0)
        self.traffic.airspace.step()
        wanted = self.flights.sample(now)
        flown = self.clearance.planned_flight(
            self.planned, self.state, wanted, now, self.lands
        )
        self.state = State.at(flown.p, flown.v)
        self.places.append(flown.p)
        self.ended_early |= self.flights.done(now) and not self.is_at_end()

    def is_at_end(self):
        """Return whether the drone is where its trajectory ends."""
        return math.dist(self.state.p, self.trajectory.end[0:3]) < 0.05


@virtual
async def test_trajectory_goes_on_round_a_drone_that_waits_for_this_one(clock):
    bus = Bus(clock)
    for i in (0, 1):
        bus.port(i)
    airspace = Airspace(bus, [0, 1], AirspaceRules(CollisionTable(), 1.0, 0.0, (0, 1)))
    drones = [
        OnTrajectory(airspace, i, minimum_snap(ends, [0.0, FLIGHT_TIME]))
        for i, ends in enumerate(([LEFT, RIGHT], [RIGHT, LEFT]))
    ]
    ticks = 0
    while ticks * TICK < 12.0 and not all(drone.is_at_end() for drone in drones):
        await clock.sleep(TICK)
        for drone in drones:
            drone.tick(clock.now())
        ticks += 1
    assert ticks * TICK < 12.0
    assert not any(drone.ended_early for drone in drones)
    gaps = np.subtract(*(np.array(drone.places) for drone in drones)) * [1.0, 1.0, 0.4]
    assert np.linalg.norm(gaps, axis=1).min() >= CLEAR


@pytest.mark.parametrize(
    ("lands", "longest"), [(True, 4.0), (False, 2.0)], ids=["landing", "trajectory"]
)
def test_landing_waits_as_long_as_it_must_and_a_trajectory_for_two_seconds(
    lands, longest
):
    async def main(clock):
        bus = Bus(clock)
        bus.port(0)
        rules = AirspaceRules(CollisionTable(), 1.0, 0.0, (0, 1))
        ends = minimum_snap([LEFT, RIGHT], [0.0, 9.0])
        drone = OnTrajectory(Airspace(bus, [0], rules), 0, ends, lands)
        drone.clearance.agreed = lambda state, wanted, *told: wanted
        drone.planned = SimpleNamespace(delayed=True, hears=lambda state, now: True)
        for _ in range(round(4.0 / TICK)):
            await clock.sleep(TICK)
            drone.tick(clock.now())
        return drone.flights.waited

    assert run_virtual(main) == pytest.approx(longest, abs=0.05)
