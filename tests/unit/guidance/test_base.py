"""CFGuidance: its verbs are those of the communicator, and a flight that is not flown raises."""

import asyncio
import inspect

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.local import Bus
from crazychoir.guidance.base import CFGuidance, Interrupted, Member
from crazychoir.safety.guard import Fence
from crazychoir.safety.pilot import Pilot
from crazychoir.simulation.integrator import CFIntegrator
from crazychoir.simulation.owner import SimulatedLink
from crazychoir.swarm import graph as graphs
from crazychoir.swarm.communicator import Communicator
from crazychoir.swarm.config import default_swarm
from crazychoir.types import Pose

VERBS = ("send", "receive", "asynchronous_receive", "neighbors_exchange")


def pair(clock):
    """Two guidances that hear each other, each with a pilot on the ground."""
    bus, config, world = Bus(clock), default_swarm(2), CFIntegrator((0, 1), np.zeros((2, 3)))
    fence = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))
    for i in (0, 1):
        bus.port(i)
    both = []
    for i in (0, 1):
        guidance = CFGuidance()
        pilot = Pilot(bus.ports[i], SimulatedLink(world, i), config.flight, fence)
        guidance.bind(Member(i, config, clock, Communicator(bus.ports[i], graphs.path(2)), pilot))
        both.append(guidance)
    return both


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_has_the_arguments_and_the_documentation_of_the_communicator(verb):
    assert inspect.signature(getattr(CFGuidance, verb)) == inspect.signature(getattr(Communicator, verb))
    assert inspect.getdoc(getattr(CFGuidance, verb)) == inspect.getdoc(getattr(Communicator, verb))


@virtual
async def test_the_verbs_talk_to_the_neighbours(clock):
    a, b = pair(clock)
    assert await asyncio.gather(a.neighbors_exchange("a"), b.neighbors_exchange("b")) == [{1: "b"}, {0: "a"}]
    await a.send(3, channel="x")
    assert await b.receive(channel="x") == {0: 3}
    await a.send(4, channel="y")
    await clock.sleep(0.01)
    assert await b.asynchronous_receive(channel="y") == {0: 4}


@virtual
async def test_a_take_off_that_is_not_flown_raises_with_the_reason(clock):
    a, _ = pair(clock)
    pilot = a.member.pilot
    pilot.tick(Pose(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])))
    pilot.port.bus.stopped = True
    with pytest.raises(Interrupted, match="drone 0: on ground: emergency stop in force"):
        await a.take_off()
    pilot.port.bus.stopped = False
    pilot.cut("emergency stop")
    with pytest.raises(Interrupted, match="drone 0: stopped: emergency stop: no take-off until its agent is started"):
        await a.take_off()
