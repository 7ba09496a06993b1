"""The watchdog that needs a packet now and then."""

from radio_drones import READY, head, made
from virtual_time import virtual

from crazychoir.firmware.supervision import SUPERVISOR_BITS


@virtual
async def test_the_watchdog_is_fed_for_a_drone_that_is_sent_places_if_requested(
    clock,
) -> None:
    for kind, pose, radio, fed in (
        ("xyz", "mocap", {"watchdog": True}, 6),
        ("xyz", "onboard", {}, 0),
        ("xyz", "onboard", {"watchdog": True}, 6),
        ("frpy", "mocap", {"watchdog": True}, 0),
    ):
        drone, kept = made(clock, kind, pose=pose, **radio)
        drone.watchdog.feed()
        assert not kept.sent, "on the ground no landing begins"
        drone.estimate.health["supervisor.info"] = READY | SUPERVISOR_BITS.flying
        for _ in range(30):
            drone.watchdog.feed()
            await clock.sleep(0.05)
        assert kept.sent.count(head("emergency_stop_watchdog")) == fed, (
            kind,
            pose,
            radio,
        )
