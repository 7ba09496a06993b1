"""How a drone is connected, looked after and connected again; its connection keeps what it is given."""

import asyncio

import numpy as np
import pytest
from radio_drones import LAND, LINE, READY, STOP, Slow, head, made, tell, up
from virtual_time import virtual

from crazychoir.errors import ConfigError, LinkFailed
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.radio_drone import RadioDrone
from crazychoir.radio.drone.timing import REPEAT_RULES, SILENCE_LIMITS
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.safety.identity.pose_gate import PoseGate
from crazychoir.types import FPQR, Vel


@virtual
async def test_a_flying_drone_without_commands_is_an_orphan(clock) -> None:
    drone, _ = made(clock)
    drone.link.up_ns = clock.now_ns()
    tell(drone, READY | SUPERVISOR_BITS.flying)
    assert not drone.is_orphan
    await clock.sleep(SILENCE_LIMITS.drone_orphaned + 0.1)
    assert drone.is_orphan
    drone.commands.send(LINE)
    assert not drone.is_orphan
    drone.commands.has_flown_here = False
    assert drone.is_orphan
    drone.commands.cut()
    assert not drone.is_orphan, "nothing is left to be done"


@virtual
async def test_a_restarted_drone_is_prepared_again(clock) -> None:
    drone, _ = made(clock)
    drone.preparation.release, drone.preparation.is_prepared = "2025.12", True
    for at in (1000, 1100):
        tell(drone, READY, at)
    assert (
        drone.link.why,
        drone.preparation.release,
        drone.preparation.is_prepared,
    ) == ("", "2025.12", True)
    tell(drone, READY, 40)
    assert (
        drone.link.why,
        drone.preparation.release,
        drone.preparation.is_prepared,
    ) == (
        "it has been started again",
        "",
        False,
    )


@virtual
async def test_a_cut_leaves_at_once_while_its_link_is_being_asked(clock) -> None:
    drone, _ = made(clock)
    drone.link.connection, slow = None, Slow()
    connecting = asyncio.ensure_future(drone._connect(slow, clock.now()))
    await clock.sleep(0.1)
    assert (slow.begun, drone.link.connection, slow.sent) == (1, None, [])
    drone.commands.cut()
    assert slow.sent[0] == head("emergency_stop")
    connecting.cancel()


class Asked(Slow):
    """A connection to a drone, on the ground unless it says otherwise, which says its release."""

    def __init__(
        self,
        drone: RadioDrone,
        release: str = "2025.12",
        version: int = 12,
        supervisor: int = READY,
    ) -> None:
        super().__init__()
        self.drone, self.release, self.version, self.supervisor = (
            drone,
            release,
            version,
            supervisor,
        )

    async def log(self, name, variables, period, data, seconds) -> None:
        self.begun += 1
        await self.drone.clock.sleep(0.1)
        tell(self.drone, self.supervisor)

    async def ask(self, packet, answers, seconds, again) -> Packet:
        answer = Packet(CrtpPort.PLATFORM, 1, b"\x01" + self.release.encode())
        assert answers(answer)
        return answer


@virtual
async def test_a_drone_with_unknown_thrust_is_refused_each_time(clock) -> None:
    drone, _ = made(clock, "fpqr")
    drone.link.connection = None
    for _ in range(3):
        with pytest.raises(ConfigError, match=r"found 2025\.09; .* set thrust_map"):
            await drone._connect(Asked(drone, "2025.09"), clock.now())
        assert drone.link.connection is None


@virtual
async def test_a_drone_with_too_old_a_protocol_is_refused(clock) -> None:
    drone, _ = made(clock, "vel")
    drone.link.connection, old = None, Asked(drone, version=8)
    with pytest.raises(
        ConfigError, match=r"drone 0: protocol .* found version 8; allowed: 9 or newer"
    ) as e:
        await drone._connect(old, clock.now())
    assert drone.link.connection is None
    drone.link.fail(e.value, False, clock.now())
    assert drone.link.state == "refused"


@virtual
async def test_a_drone_that_is_refused_while_it_flies_is_landed_first(clock) -> None:
    for kind, link in (("vel", {"version": 8}), ("fpqr", {"release": "2025.09"})):
        drone, _ = made(clock, kind)
        drone.link.connection, old = (
            None,
            Asked(drone, supervisor=READY | SUPERVISOR_BITS.flying, **link),
        )
        await drone._connect(old, clock.now())
        assert drone.link.connection is old
        assert "2025.09" in drone.link.problem or "version 8" in drone.link.problem
        await clock.sleep(SILENCE_LIMITS.drone_orphaned + 0.1)
        tell(drone, READY | SUPERVISOR_BITS.flying)
        drone.commands.send(
            Vel(np.array([0.1, 0.0, 0.0, 0.0]))
            if kind == "vel"
            else FPQR(np.array([0.3, 0.0, 0.0, 0.0]))
        )
        assert old.sent == []
        assert drone.is_orphan
        drone.commands.send(LAND)
        drone.landing.go_on()
        assert old.sent[0] == head("land")
        drone.commands.cut()
        assert head("emergency_stop") in old.sent
        tell(drone, READY)
        with pytest.raises(LinkFailed, match=r"2025\.09|version 8"):
            await drone._look_after(old)


@virtual
async def test_a_drone_without_logs_is_still_landed_and_its_watchdog_fed(
    clock,
) -> None:
    drone, _ = made(clock, watchdog=True)
    drone.preparation.is_prepared = drone.preparation.is_placed = True
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.link.connection = slow = Slow()
    drone.commands.send(LAND)
    looking = asyncio.ensure_future(drone._look_after(slow))
    await clock.sleep(2.5)
    assert slow.begun == 0, "its logs are being reset"
    slow.sent.clear()
    await clock.sleep(2.0)
    assert slow.sent.count(head("land")) == 8
    assert slow.sent.count(head("emergency_stop_watchdog")) == 8
    slow.goes_on.set()
    await clock.sleep(0.1)
    assert slow.begun == 1, "one at a time"
    looking.cancel()
    await asyncio.wait([looking])
    await drone._end_work()


@virtual
async def test_a_link_that_is_late_in_flight_is_said_now_and_then(clock) -> None:
    drone, kept = made(clock)
    drone.preparation.is_prepared = drone.preparation.is_placed = True
    kept.failure = kept.dongle_failure = ""
    kept.latency, said = 0.4, []
    drone.setup.warn = lambda topic, text: said.append(text)
    looking = asyncio.ensure_future(drone._look_after(kept))
    for supervisor, texts in (
        (READY, set()),
        (
            READY | SUPERVISOR_BITS.flying,
            {"its link takes 0.40 s for a round trip"},
        ),
    ):
        tell(drone, supervisor)
        await clock.sleep(0.5)
        assert {text.split(",")[0] for text in said} == texts
    looking.cancel()


@virtual
async def test_what_fails_beside_ends_the_link(clock) -> None:
    drone, _ = made(clock)
    slow = Slow()

    async def fails(connection) -> None:
        raise LinkFailed("udp", "no answer")

    drone._begin_logs_again = fails
    await clock.sleep(2.0)
    with pytest.raises(LinkFailed, match="no answer"):
        await drone._look_after(slow)


@virtual
async def test_what_an_attempt_to_connect_failed_by_is_said_and_does_not_fail_the_next(
    clock,
) -> None:
    drone, _ = made(clock)
    drone.link.connection, before = None, []

    async def fails(connection, began) -> None:
        before.append(drone.link.why)
        drone.link.lose("the driver has given up")
        raise LinkFailed("udp://127.0.0.1:19850", "no answer within 1.5 s")

    drone._connect = fails
    running = asyncio.ensure_future(drone.run())
    await clock.sleep(1.0)
    running.cancel()
    assert len(before) > 2
    assert set(before) == {""}
    (problem,) = drone.report.find_problems()
    assert "no answer within 1.5 s" in problem


@virtual
async def test_a_flying_drone_that_was_out_of_reach_is_not_stopped_by_a_stale_stop(
    clock,
) -> None:
    drone, kept = made(clock)
    drone.preparation.is_prepared = drone.preparation.is_placed = True
    kept.failure = kept.dongle_failure = ""
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.commands.send(LINE)
    drone.commands.send(STOP)
    assert kept.sent[-1] == head("planner_stop"), (
        "a pilot that has flown it may stop it"
    )
    await clock.sleep(REPEAT_RULES.stop_period)
    drone.commands.send(LINE)
    looking = asyncio.ensure_future(drone._look_after(kept))
    kept.silence = SILENCE_LIMITS.drone_unreached + 0.1
    await clock.sleep(0.1)
    drone.commands.send(LINE)
    kept.silence = 0.0
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.view.see(up(1.0), 0.0)
    kept.sent.clear()
    drone.commands.send(STOP)
    assert kept.sent == []
    assert not drone.is_orphan, "its pilot may fly it on"
    await clock.sleep(SILENCE_LIMITS.drone_orphaned + 0.1)
    assert drone.is_orphan
    drone.view.gate = PoseGate()
    drone.view.see(up(0.05), 0.0)
    drone.commands.send(STOP)
    assert head("planner_stop") in kept.sent, "it stands"
    looking.cancel()
    await asyncio.wait([looking])
    await drone._end_work()
