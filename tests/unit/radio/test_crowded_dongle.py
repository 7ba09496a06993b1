"""Many virtual drones on one virtual dongle, in virtual time."""

import asyncio
import math

import numpy as np
import pytest
from dongle_flights import DongleFlight, crowd
from virtual_time import virtual

from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.upload import fit_upload
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.types import XYZ

HEIGHT, RADIUS, PERIOD = 0.6, 0.2, 3.0


def circle(flight):
    """The line of each drone on a circle that begins at its home, at each time."""

    def line(i, t):
        x, y, _ = flight.config.drone(i).home
        w = 2.0 * math.pi * min(t + 0.2, PERIOD) / PERIOD
        x += RADIUS * (1.0 - math.cos(w))
        y += RADIUS * math.sin(w)
        return XYZ("line", np.array([x, y, HEIGHT, 0.0, 0.2]))

    return line


@pytest.mark.parametrize(("inline", "loss"), [(True, 0.1), (False, 0.0)])
def test_twelve_drones_of_one_dongle_take_off_fly_a_figure_and_land(inline, loss):
    """On a Crazyradio 2.0 that loses a tenth of all packets, and on a Crazyradio PA."""

    @virtual
    async def check(clock):
        flight = DongleFlight(clock, crowd(12, inline), loss)
        assert flight.plan.broadcasts is inline
        await flight.take_off(HEIGHT)
        await flight.run(PERIOD + 1.0, circle(flight))
        for i, (x, y, z) in flight.farthest.items():
            assert 0.27 < x < 0.5, i
            assert 0.1 < y < 0.3, i
            assert z == pytest.approx(HEIGHT, abs=0.15), i
        await flight.land()
        assert flight.unwell() == {}
        assert flight.dongle.refused == 0
        told = [crazyflie.flight.told for crazyflie in flight.crazyflies.values()]
        rate = 1.0 - loss
        assert min(one.count for one in told) > 0.9 * rate * 10.0 * clock.now()
        assert max(one.longest_gap for one in told) < (0.25 if loss == 0.0 else 1.0)

    check()


@virtual
async def test_six_drones_of_one_dongle_fly_uploaded_trajectories(clock):
    flight = DongleFlight(clock, crowd(6, inline=False))
    firmware = {i: ConnectedFirmware(link) for i, link in flight.links.items()}
    flown = fit_upload(
        minimum_snap([[0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0]], [0.0, 1.0, 2.0])
    )
    await asyncio.gather(
        *(
            one.upload(flown.memory, 1, len(flown.pieces.durations))
            for one in firmware.values()
        )
    )
    await flight.take_off(HEIGHT)
    before = flight.dongle.exchanges
    await asyncio.gather(*(one.start(1, relative=True) for one in firmware.values()))
    await flight.run(3.0)
    assert (flight.dongle.exchanges - before) / 3.0 < 6 * 31.0, (
        "logs and poses; nothing else is sent while the planner on board flies"
    )
    for i in flight.drones:
        home = np.array(flight.config.drone(i).home)
        assert flight.truth(i)[:2] - home[:2] == pytest.approx([0.3, 0.3], abs=0.1)


@virtual
async def test_a_drone_that_hears_no_broadcast_is_told_nothing_and_the_others_all(
    clock,
):
    flight = DongleFlight(clock, crowd(4))
    flight.links[2].air.faults.loss = 1.0
    await flight.run(1.0)
    told = {i: crazyflie.flight.told for i, crazyflie in flight.crazyflies.items()}
    assert told[2].count == 0
    assert math.isinf(told[2].age)
    for i in (0, 1, 3):
        assert told[i].count == pytest.approx(10, abs=1)
        assert told[i].age < 0.12
    assert flight.dongle.broadcasts == pytest.approx(20, abs=2), "two poses a packet"
    assert flight.broadcast.age < 0.01


@virtual
async def test_a_drone_that_believes_itself_elsewhere_is_sent_its_own_pose_too(clock):
    flight = DongleFlight(clock, crowd(4))
    flight.links[2].hears_broadcasts = False
    flight.world.states[flight.world.row[2]][0] += 0.5
    await flight.run(1.5)
    told = {i: crazyflie.flight.told for i, crazyflie in flight.crazyflies.items()}
    assert 1 <= told[2].count < 10
    record = flight.crazyflies[2].onboard.record
    assert math.dist(flight.truth(2)[:2], (record["x"], record["y"])) < 0.25


@virtual
async def test_drones_of_a_loaded_machine_are_not_stopped_before_they_have_landed(
    clock,
):
    flight = DongleFlight(clock, crowd(2))
    await flight.take_off(HEIGHT)
    flight.slowness = 3.0
    sinks = 0.0
    for _ in range(23):
        await flight.land(0.2)
        sinks = min(sinks, *(flight.truth(i)[5] for i in flight.drones))
    assert sinks > -0.7, "m/s: a drone that falls is faster"
    assert flight.unwell() == {}
