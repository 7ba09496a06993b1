"""The owner of a dongle and drones that receive no commands."""

import asyncio

import numpy as np
import pytest
from radio_drones import READY, Kept, head
from virtual_time import virtual

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.timing import SILENCE_LIMITS
from crazychoir.radio.link.dongles import PROCESS_DONGLES
from crazychoir.radio.owner import OWNER_LIMITS, RadioProcess
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.types import Pose


@virtual
async def test_an_uncommanded_drone_is_cut_only_beyond_the_limit(clock) -> None:
    raw = {
        "name": "a",
        "drones": [{"id": 0, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850"}],
    }
    owner = RadioProcess(clock, SwarmConfig.of(raw), 0, "radio", "here", 1)
    drone, body, kept = owner.drones[0], owner.bodies[0], Kept()
    drone.link.connection, drone.estimate.health["supervisor.info"] = (
        kept,
        READY | SUPERVISOR_BITS.flying,
    )
    await clock.sleep(5.0)
    for x, cut in ((1.0, False), (20.0, True)):
        drone.view.see(Pose(np.array([x, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
        drone.view.gate = PoseGate()
        owner._keep_inside(0, body)
        assert (head("emergency_stop") in kept.sent) is cut


@virtual
async def test_an_owner_that_ends_names_the_drones_that_have_not_landed(clock) -> None:
    raw = {
        "name": "a",
        "drones": [{"id": 7, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850"}],
    }
    owner = RadioProcess(clock, SwarmConfig.of(raw), 0, "radio", "here", 1)
    owner.drones[7].estimate.health["supervisor.info"] = READY | SUPERVISOR_BITS.flying
    running = asyncio.ensure_future(owner.run())
    owner.end("")
    await clock.sleep(OWNER_LIMITS.landing_time - 1.0)
    assert not owner.failure
    await clock.sleep(2.0)
    assert owner.failure.endswith("not known to have landed: 7")
    running.cancel()


@virtual
async def test_a_silent_drone_beyond_the_limit_is_not_cut(clock) -> None:
    raw = {
        "name": "a",
        "drones": [{"id": 0, "home": [0, 0, 0], "uri": "udp://127.0.0.1:19850"}],
    }
    owner = RadioProcess(clock, SwarmConfig.of(raw), 0, "radio", "here", 1)
    drone, body, kept = owner.drones[0], owner.bodies[0], Kept()
    drone.link.connection, drone.estimate.health["supervisor.info"] = (
        kept,
        READY | SUPERVISOR_BITS.flying,
    )
    kept.silence = SILENCE_LIMITS.link_lost + 0.1
    await clock.sleep(5.0)
    drone.view.see(Pose(np.array([20.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
    owner._keep_inside(0, body)
    assert head("emergency_stop") not in kept.sent


@virtual
async def test_an_owner_refuses_a_dongle_that_lacks_the_promised_inline_mode(
    clock,
) -> None:
    for is_inline, says in ((None, ""), (True, ""), (False, "no Crazyradio 2.0")):
        rows = [
            {"id": i, "home": [i, 0, 0], "uri": f"radio://0/80/2M/E7E7E7E70{i}"}
            for i in range(2)
        ]
        raw = {"name": "a", "drones": rows, "radio": {"inline": True}}
        owner = RadioProcess(clock, SwarmConfig.of(raw), 0, "radio", "here", 1)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                PROCESS_DONGLES, "is_inline", lambda uri, found=is_inline: found
            )
            patch.setattr(PROCESS_DONGLES, "failure", lambda uri: "")
            owner._look_at_dongle(1.0)
        assert says in owner.failure
        assert bool(owner.failure) is bool(says)
