"""What the cameras see of a drone, and what the drone is told of it."""

import math

import numpy as np
import pytest
from radio_drones import LINE, READY, head, made, seen, tell, up
from virtual_time import virtual

from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.camera_view import CAMERA_POSE_LIMITS
from crazychoir.radio.protocol.crtp import PACKET_FORMS
from crazychoir.safety.identity.takeoff_check import TiltTrack
from crazychoir.types import Pose


@virtual
async def test_in_its_ascent_it_is_told_places_until_its_body_is_known_to_move_as_it_does(
    clock,
) -> None:
    drone, kept = made(clock)

    async def said_for(seconds: float, supervisor: int) -> list[tuple[int, int, int]]:
        kept.sent.clear()
        for _ in range(round(20 * seconds)):
            tell(drone, supervisor)
            seen(drone)
            await clock.sleep(0.05)
        return [
            (port, channel, -1 if channel == 0 else first)
            for port, channel, first in kept.sent
            if port == 6
        ]

    pose, place = (
        head("external_pose"),
        (
            PACKET_FORMS["external_position"].port,
            PACKET_FORMS["external_position"].channel,
            -1,
        ),
    )
    assert set(await said_for(1.0, READY)) == {pose}
    drone.commands.send(LINE)
    told = await said_for(4.0, READY | SUPERVISOR_BITS.flying)
    assert set(told) == {place}
    assert 38 <= len(told) <= 42, "as often as [radio] says"
    assert set((await said_for(6.0, READY | SUPERVISOR_BITS.flying))[-10:]) == {pose}, (
        "it has been watched for long enough"
    )
    await said_for(0.5, READY)
    drone.commands.send(LINE)
    assert set(await said_for(1.0, READY | SUPERVISOR_BITS.flying)) == {place}, (
        "so is its next ascent"
    )


@virtual
async def test_a_drone_that_moves_unlike_its_body_is_silenced_and_may_not_take_off(
    clock,
) -> None:
    drone, kept = made(clock)
    drone.preparation.is_prepared = drone.preparation.is_placed = True
    for k in range(60):
        tell(drone, READY | SUPERVISOR_BITS.flying * (k > 20))
        swing = 0.05 * max(k - 22, 0) / 2.0
        drone.view.take_off.sights.tracks[0].add(
            clock.now(), complex(0.0, swing), 0.0
        )  # its own tilt stays
        if k == 20:
            drone.commands.send(LINE)
        await clock.sleep(0.05)
    assert drone.report.make_status().astray == "it does not tilt as its body does"
    assert any(
        text.startswith(drone.report.make_status().astray)
        for text in drone.report.find_problems()
    )
    kept.sent.clear()
    seen(drone)
    assert kept.sent == []
    drone.view.forgive_fault()
    assert drone.report.make_status().astray, "it may fly"
    tell(drone, READY)
    drone.view.pose.put(Pose(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])), 0.0)
    drone.view.forgive_fault()
    assert drone.report.make_status().astray, "no operator has touched it"
    await clock.sleep(CAMERA_POSE_LIMITS.longest_gap + 0.1)
    drone.view.forgive_fault()
    assert drone.report.make_status().astray == ""


@pytest.mark.parametrize("exchanged", [False, True])
def test_what_it_says_late_is_compared_with_what_the_cameras_saw_then(
    exchanged,
) -> None:
    @virtual
    async def check(clock) -> None:
        drone, _ = made(clock)
        tracks, held = drone.view.take_off.sights.tracks, []
        tracks[1] = TiltTrack()

        def tilted(j: int, t: float) -> float:
            return 0.3 * max(t - 1.0, 0.0) * math.sin((7.0 + 4.0 * j) * t)

        for k in range(110):
            t = clock.now()
            for j, track in tracks.items():
                track.add(t, complex(0.0, tilted(1 - j if exchanged else j, t)))
            roll = 0.5 * tilted(0, t)
            if k == 50:
                drone.commands.send(LINE)
            held.append(
                (
                    np.array([math.sin(roll), 0.0, 0.0, math.cos(roll)]),
                    k > 55,
                    round(1000 * t) + 3000,
                )
            )
            if not 60 <= k < 105:
                for q, flies, at in held:
                    drone.view.take_off.note(
                        drone.estimate.uptime.taken(t, at), q, flies, 0.01
                    )
                held.clear()
            await clock.sleep(0.02)
        assert bool(drone.view.take_off.found) is exchanged

    check()


@virtual
async def test_one_wrong_pose_does_not_end_the_watch_of_a_take_off(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY)
    drone.commands.send(LINE)
    tell(drone, READY | SUPERVISOR_BITS.flying)
    for k in range(60):
        drone.view.see(up(5.0 if k == 10 or k >= 40 else 0.0), 0.0)
        assert drone.view.take_off.watched is (
            k <= 40 + round(CAMERA_POSE_LIMITS.longest_jump / 0.01)
        ), k
        await clock.sleep(0.01)
