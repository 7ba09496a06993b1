"""The state of a link across the connections that follow one another."""

import math

import pytest
from radio_drones import Kept, made
from virtual_time import virtual

from crazychoir.errors import ConfigError, LinkFailed
from crazychoir.radio.drone.timing import SILENCE_LIMITS


@virtual
async def test_a_failure_before_the_deadline_is_not_reported_as_an_absent_drone(
    clock,
) -> None:
    link = made(clock)[0].link
    deadline = made(clock)[0].setup.config.radio.connect_deadline
    failure = LinkFailed("udp", "no answer")
    began = clock.now()
    link.fail(failure, False, began)
    assert (link.state, link.problem) == ("connecting", str(failure))
    await clock.sleep(deadline + 0.1)
    link.fail(failure, False, began)
    assert link.state == "absent"


@pytest.mark.parametrize(
    ("error", "state"),
    [
        (LinkFailed("udp", "silent"), "lost"),
        (ConfigError("drone 0", "version 8", "9", ""), "refused"),
    ],
)
def test_the_state_of_a_prepared_drone_names_the_kind_of_failure(error, state) -> None:
    @virtual
    async def check(clock) -> None:
        link = made(clock)[0].link
        link.fail(error, True, clock.now())
        assert (link.state, link.problem) == (state, str(error))

    check()


@virtual
async def test_only_a_connection_after_a_loss_counts_as_a_reconnection(clock) -> None:
    drone, kept = made(clock)
    drone.link.take_up(kept, "2025.12")
    assert (drone.link.state, drone.link.reconnected) == ("up", 0)
    drone.link.fail(LinkFailed("udp", "silent"), True, clock.now())
    drone.link.take_up(kept, "2025.12")
    assert (drone.link.state, drone.link.reconnected) == ("up", 1)
    assert drone.link.problem == ""


@virtual
async def test_silence_counts_from_the_last_packet_of_a_dropped_connection(
    clock,
) -> None:
    drone, kept = made(clock)
    kept.silence = 0.5
    drone.link.drop(kept)
    await clock.sleep(1.0)
    assert drone.link.silence == pytest.approx(1.5)
    assert drone.link.is_quiet()


@virtual
async def test_a_drone_that_was_never_heard_is_silent_for_ever(clock) -> None:
    drone, _ = made(clock)
    drone.link.connection = None
    assert math.isinf(drone.link.silence)


@virtual
async def test_a_long_silence_starts_the_time_without_commands_again(clock) -> None:
    link = made(clock)[0].link
    await clock.sleep(5.0)
    link.note_silence(SILENCE_LIMITS.link_degraded + 0.1)
    assert (link.state, link.up_ns) == ("degraded", 0)
    link.note_silence(SILENCE_LIMITS.drone_unreached + 0.1)
    assert link.up_ns == clock.now_ns()
    link.note_silence(0.0)
    assert link.state == "up"


@virtual
async def test_packets_without_a_connection_are_dropped(clock) -> None:
    drone, kept = made(clock)
    drone.link.connection = None
    drone.link.send_all(drone.handler.relax)
    assert isinstance(kept, Kept)
    assert kept.sent == []
