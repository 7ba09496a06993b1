"""Filter, plan and controller of a drone give the same bits, whichever drones share its batch."""

import numpy as np
import pytest
from pilots import make_pilot
from virtual_time import run_virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import FlightTable
from crazychoir.filters.velocity import VelocityFilter
from crazychoir.flight.tick import FlightTick
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import Mode
from crazychoir.simulation.common.links import SimulatedLink
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.types import Acceleration, Pose, Velocity

TICK = 0.01  # s
FENCE = Fence.box((-9.0, -9.0, -0.2), (9.0, 9.0, 2.5))
DRONES = range(5)
PLANS = {
    0.1: lambda pilot, k: pilot.take_off(),
    3.0: lambda pilot, k: pilot.go_to([k + 0.7, 0.3 * k, 1.2]),
    5.0: lambda pilot, k: pilot.hold(k % 2 == 0),
    6.0: lambda pilot, k: pilot.hold(False),
    8.5: lambda pilot, k: pilot.land(),
}
"""{time in s: what drone k does then}."""


class FlownDrone:
    """Drone k in a world of its own, and its story.

    shared: the tick that it shares with others; None for one of its own
    """

    def __init__(self, bus, k, shared):
        self.k = k
        self.world = CFIntegrator((k,), np.array([[float(k), 0.0, 0.0]]), np.zeros(1))
        self.draw = np.random.default_rng(k)
        self.pilot = make_pilot(
            bus.port(k),
            SimulatedLink(self.world, k),
            FlightTable(),
            FENCE,
            state_filter=VelocityFilter() if k % 2 else None,
            shared=shared,
        )
        self.story = []

    def step(self, now):
        """Move the body, follow the plan, and see a noisy pose, or none now and then."""
        for _ in range(round(TICK / self.world.dt)):
            self.world.step()
        plan = PLANS.get(round(now, 3))
        if plan is not None:
            plan(self.pilot, self.k)
        if self.pilot.mode is Mode.HOVER and 6.5 < now < 8.0:
            push = [0.3, 0.1 * self.k, 0.0]
            kind = Velocity if self.k % 3 else Acceleration
            self.pilot.follow(kind(np.array(push)))
        seen = self.world.state(self.k).flat[[0, 1, 2, 6, 7, 8, 9]]
        seen = seen + 0.001 * self.draw.standard_normal(7)
        is_seen = self.draw.random() > 0.05
        pose = Pose(seen, 0.0) if is_seen else None
        self.pilot.tick.see(self.pilot.row.index, pose)

    def note(self):
        """Write down its mode, where it is, and what it flies."""
        row = self.pilot.row
        self.story.append(
            (
                self.pilot.mode,
                self.world.state(self.k).flat.tobytes(),
                None if row.flown is None else row.flown.flat.tobytes(),
            )
        )


def fly(groups):
    """Return the story of each drone; the drones of a group share a batch."""

    async def flight(clock):
        bus = Bus(clock)
        drones = {}
        for group in groups:
            shared = FlightTick(bus, len(group))
            for k in group:
                drones[k] = FlownDrone(bus, k, shared)
        while clock.now() < 12.0:
            await clock.sleep(TICK)
            for k in DRONES:
                drones[k].step(clock.now())
            await clock.sleep(0.0)
            for drone in drones.values():
                drone.note()
        return {k: drones[k].story for k in DRONES}

    return run_virtual(flight)


@pytest.mark.parametrize(
    "groups",
    [[[0, 1, 2, 3, 4]], [[4, 2, 0], [1, 3]], [[3, 4, 1, 0, 2]]],
    ids=["all", "two", "another order"],
)
def test_a_flight_has_the_same_bits_whichever_drones_share_a_batch(groups):
    alone = fly([[k] for k in DRONES])
    modes = {mode for mode, *_ in alone[0]}
    assert modes == set(Mode) - {Mode.RETURN, Mode.CUT}
    assert fly(groups) == alone
