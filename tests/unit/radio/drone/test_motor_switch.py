"""Motors that are armed, or cut for good."""

import asyncio
from dataclasses import replace

import pytest
from radio_drones import LAND, LINE, READY, Kept, Slow, head, made, tell
from virtual_time import virtual

from crazychoir.errors import Refused
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.link_report import PROBLEM_TEXTS
from crazychoir.radio.protocol.crtp import Packet


@virtual
async def test_a_cut_is_repeated_until_the_drone_is_locked_or_power_cycled(
    clock,
) -> None:
    for said, at in ((SUPERVISOR_BITS.locked, None), (READY, 40)):
        drone, kept = made(clock)
        tell(drone, READY | SUPERVISOR_BITS.flying, 5000)
        insisting = asyncio.create_task(drone.motors.insist(kept))
        drone.commands.cut()
        await clock.sleep(1.0)
        assert len(kept.sent) > 10
        tell(drone, said, 6000 if at is None else at)
        kept.sent.clear()
        drone.commands.cut()
        await clock.sleep(1.0)
        insisting.cancel()
        assert kept.sent == [], "a drone that is switched off and on is flown again"
        drone.preparation.is_prepared = drone.preparation.is_placed = True
        assert PROBLEM_TEXTS.motors_cut in drone.report.find_problems()


@virtual
async def test_a_cut_is_for_good_and_nothing_leaves_after_it(clock) -> None:
    drone, kept = made(clock)
    drone.commands.send(LINE)
    drone.commands.cut()
    drone.commands.send(LINE)
    drone.commands.send(LAND)
    drone.landing.go_on()
    assert kept.sent[-2:] == [head("emergency_stop"), head("supervisor_stop")]
    assert kept.sent.count(head("go_to")) == 1


@virtual
async def test_a_cut_is_said_again_until_it_was_heard_also_while_its_link_is_being_opened(
    clock,
) -> None:
    drone, _ = made(clock)
    drone.link.connection, opening = None, Slow()
    drone.link.opening = opening
    insisting = asyncio.ensure_future(drone.motors.insist(opening))
    await clock.sleep(0.5)
    assert opening.sent == []
    drone.commands.cut()
    opening.sent.clear()
    await clock.sleep(0.5)
    assert opening.sent.count(head("emergency_stop")) == 10
    tell(drone, SUPERVISOR_BITS.locked)
    opening.sent.clear()
    await clock.sleep(0.5)
    assert opening.sent == []
    insisting.cancel()


class Arms(Kept):
    """A connection to a drone that arms, or refuses to."""

    uri = "udp://127.0.0.1:19850"

    def __init__(self, lets: bool) -> None:
        super().__init__()
        self.lets = lets

    async def ask(self, packet, answers, seconds, again) -> Packet:
        self._keep(packet)
        answer = Packet(
            packet.port,
            packet.channel,
            bytes([0x80 | packet.data[0], self.lets, packet.data[1]]),
        )
        assert answers(answer)
        return answer


@virtual
async def test_motors_that_wait_for_it_are_armed_or_it_is_said_why_not(clock) -> None:
    drone, _ = made(clock)
    assert await drone.motors.arm() == "ready: its firmware needs no arming"
    drone.setup.platform = replace(
        drone.setup.platform,
        firmware=replace(drone.setup.platform.firmware, needs_arming=True),
    )
    drone.link.connection = arms = Arms(True)
    assert await drone.motors.arm() == "armed"
    assert arms.sent == [head("arm")]
    drone.link.connection = Arms(False)
    with pytest.raises(Refused, match=r"drone 0: .*refuses to arm"):
        await drone.motors.arm()
    drone.link.connection, drone.link.why = None, "no answer within 3 s"
    with pytest.raises(Refused, match=r"drone 0: .*no answer within 3 s"):
        await drone.motors.arm()
