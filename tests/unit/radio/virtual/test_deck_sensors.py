"""What decks on board tell the estimator of a virtual drone."""

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.radio.virtual.deck_sensors import DECK_MODEL, DeckSensors
from crazychoir.radio.virtual.server import VirtualServer
from crazychoir.radio.virtual.setup import place_on_grid


def make_measurements(clock, decks: tuple[str, ...], lost: bool = False, seed=0):
    """Return what 200 measurements tell the drone: velocities, and positions."""
    hall = place_on_grid(1, 19850, decks)
    server = VirtualServer(clock, hall.world(0), hall.seats, hall.poses)
    (i,) = server.ports
    server.faults[i].deck_lost = float(lost)
    server.world.states[server.world.row[i], :6] = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
    velocities, positions = [], []
    onboard = server.ports[i].drone.onboard
    onboard.measured_velocity = lambda v, std: velocities.append(v)
    onboard.external_pose = lambda p, q: positions.append(p)
    sensors = DeckSensors(server.world, server.ports, server.faults, seed)
    for _ in range(200):
        sensors.measure()
    return np.array(velocities), np.array(positions)


@virtual
async def test_a_lighthouse_deck_measures_the_position_with_its_noise(clock) -> None:
    velocities, positions = make_measurements(clock, ("bcLighthouse4",))
    assert len(velocities) == 0
    assert positions.mean(axis=0) == pytest.approx([1.0, 2.0, 3.0], abs=5e-4)
    assert positions.std(axis=0) == pytest.approx(
        [DECK_MODEL.position_noise] * 3, rel=0.2
    )


@virtual
async def test_a_flow_deck_measures_the_velocity_only(clock) -> None:
    velocities, positions = make_measurements(clock, ("bcFlow2",))
    assert len(positions) == 0
    assert velocities.mean(axis=0) == pytest.approx([0.1, 0.2, 0.3], abs=0.01)


@virtual
async def test_a_deck_that_is_lost_measures_nothing(clock) -> None:
    velocities, positions = make_measurements(clock, ("bcLighthouse4",), lost=True)
    assert len(velocities) == len(positions) == 0


@virtual
async def test_the_noise_depends_on_the_seed_only(clock) -> None:
    first = make_measurements(clock, ("bcLighthouse4",))[1]
    assert np.array_equal(make_measurements(clock, ("bcLighthouse4",))[1], first)
    other = make_measurements(clock, ("bcLighthouse4",), seed=1)[1]
    assert not np.array_equal(other, first)
