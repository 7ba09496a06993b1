"""Worlds of robots that do not fly."""

import numpy as np
import pytest
from robots import world_of

from crazychoir.config.checks import WORLD_URIS
from crazychoir.errors import ConfigError
from crazychoir.simulation.common.world import COMMAND_TYPES
from crazychoir.simulation.remote import COMMAND_SIZES
from crazychoir.types import XYZ, Acc, Drive, Vel

COMMANDS = {
    WORLD_URIS.single_integrator: Vel(np.array([1.0, 0.0, 0.0, 0.0])),
    WORLD_URIS.double_integrator: Acc(np.ones(3)),
    WORLD_URIS.unicycle: Drive(np.array([1.0, 0.0])),
}


@pytest.mark.parametrize(("uri", "command"), COMMANDS.items())
def test_it_obeys_its_own_kind_and_what_is_cut_stands_for_good(uri, command):
    world = world_of(uri, [(0.0, 0.0, 0.5), (1.0, 0.0, 0.0)])
    link = world.link(1, world.kind)
    assert isinstance(command, COMMAND_TYPES[world.kind])
    assert command.flat.shape == (COMMAND_SIZES[type(command)],)
    with pytest.raises(ConfigError, match="fpqr"):
        world.link(1, "fpqr")
    link.send(command)
    world.step()
    assert world.state(1).p[0] > 1.0
    assert world.state(0).p.tolist() == [0.0, 0.0, 0.5], "no command was sent to it"
    assert (world.resting(0), world.resting(1)) == (True, False)
    before = world.state(1).v
    link.send(type(command)(np.full(len(command.flat), np.nan)))
    world.step()
    assert np.all(np.isfinite(world.states))
    assert world.state(1).v[0] >= before[0], "what is not finite counts for nothing"
    link.cut()
    world.step()
    stands = world.state(1)
    link.send(command)
    world.step()
    assert np.linalg.norm(stands.v) == 0.0
    assert np.array_equal(world.state(1).flat, stands.flat)
    assert (world.crashed, world.harm(1)) == ([], "")


@pytest.mark.parametrize(
    "uri", [WORLD_URIS.single_integrator, WORLD_URIS.double_integrator]
)
def test_a_velocity_and_an_acceleration_end_with_the_command_that_stops(uri):
    world = world_of(uri)
    link = world.link(0, world.kind)
    link.send(COMMANDS[uri])
    world.step()
    link.send(XYZ("stop", np.zeros(5)))
    world.step()
    assert world.resting(0)
    assert world.time == pytest.approx(0.02)
