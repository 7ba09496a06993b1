"""The owner of a simulated world: what it shows, and how old that is."""

import numpy as np
import pytest

from crazychoir.bus.local import Bus
from crazychoir.bus.topics import POSE, TRUTH
from crazychoir.mocap.simulated import SimulatedMocap
from crazychoir.runtime.clock import run_virtual
from crazychoir.simulation.integrator import CFIntegrator
from crazychoir.simulation.owner import WorldOwner


def test_a_tick_that_comes_late_shows_the_world_as_it_was_when_it_was_due():
    async def main(clock):
        bus = Bus(clock)
        bus.port(0)
        boxes = {topic: topic.mailbox(clock) for topic in (POSE, TRUTH)}
        for topic, box in boxes.items():
            bus.subscribe(topic, 0, 0, box)
        owner = WorldOwner(bus, CFIntegrator([0], np.zeros((1, 3))), SimulatedMocap([0], 1), 100.0)
        for _ in range(5):  # truth comes with each fifth step
            owner.step(late=0.004)
        return boxes[POSE].peek().age, *(box.age() for box in boxes.values())

    assert run_virtual(main) == pytest.approx((0.004, 0.004, 0.004))
