"""What an agent is told about a drone and its link."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
from radio_drones import READY, made, tell
from virtual_time import virtual

from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.platforms import Battery
from crazychoir.radio.drone.link_report import PROBLEM_TEXTS
from crazychoir.radio.link.connection import AWAITING_LOG
from crazychoir.runtime.mailbox import Call
from crazychoir.types import Body


@virtual
async def test_nothing_is_said_of_its_body_before_it_has_said_whether_it_flies(
    clock,
) -> None:
    drone, _ = made(clock)
    said = []
    reader = drone.setup.bus.port(5).address
    drone.setup.bus.subscribe(
        DRONE_TOPICS.body,
        PORT_ADDRESSES.body_offset,
        reader,
        Call(clock, lambda body, age: said.append(body.flying)),
    )
    drone.report.publish()
    await clock.sleep(0.5)
    assert said == []
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.report.publish()
    await clock.sleep(0.5)
    assert said == [True]


@virtual
async def test_why_it_may_not_take_off(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY)
    assert drone.report.find_problems() == ["the cameras do not see it"]
    drone.preparation.is_prepared = drone.preparation.is_placed = True
    assert drone.report.find_problems() == ["the cameras do not see it"]
    drone.link.connection, drone.link.problem = None, "no answer within 2 s"
    assert drone.report.find_problems() == ["no answer within 2 s"]
    drone, _ = made(clock)
    tell(drone, READY | SUPERVISOR_BITS.flying)
    assert drone.report.find_problems() == []
    drone.commands.cut()
    assert drone.report.find_problems() == [PROBLEM_TEXTS.motors_cut]


@virtual
async def test_a_drone_that_has_spoken_is_being_prepared(clock) -> None:
    drone, _ = made(clock)
    drone.link.connection = None
    assert drone.report.find_problems() == ["is being connected"]
    drone.link.opening = SimpleNamespace(stage="no answer")
    assert drone.report.find_problems() == ["is being connected, no answer so far"]
    drone.link.opening, drone.estimate.logs_ns = (
        SimpleNamespace(stage=AWAITING_LOG),
        clock.now_ns(),
    )
    assert drone.report.find_problems() == [
        "is being connected, no word of itself so far"
    ]
    await clock.sleep(0.1)
    tell(drone, READY)
    assert drone.report.find_problems() == ["is being prepared"], (
        "its parameters take up to 2 s each"
    )


@virtual
async def test_a_locked_virtual_drone_is_power_cycled_by_a_command(
    clock,
) -> None:
    drone, _ = made(clock)
    await clock.sleep(0.1)
    tell(drone, READY)
    drone.preparation.is_prepared = drone.preparation.is_placed = True
    tell(drone, SUPERVISOR_BITS.locked)
    locked = "locked by its firmware until it is switched off and on"
    assert (
        drone.report.find_problems()[0]
        == f"{locked} (`crazychoir virtual fault 0 reboot=1`)"
    )
    said: list[Body] = []
    drone.setup.bus.port(1)
    drone.setup.bus.subscribe(
        DRONE_TOPICS.body,
        PORT_ADDRESSES.body_offset,
        1,
        Call(clock, lambda body, age: said.append(body), "body"),
    )
    drone.report.publish()
    await clock.sleep(0.1)
    assert said[-1].harm == drone.report.find_problems()[0]
    drone.setup.row = msgspec.structs.replace(
        drone.setup.row, uri="radio://0/80/2M/E7E7E7E701"
    )
    assert drone.report.find_problems()[0] == locked


@virtual
async def test_the_battery_that_it_needs_to_begin_is_its_platforms(clock) -> None:
    drone, _ = made(clock)
    tell(drone, READY | SUPERVISOR_BITS.flying)
    drone.estimate.health["pm.vbat"] = 3.65
    assert drone.report.find_problems() == [
        "battery at 3.65 V, 3.7 V are needed to start"
    ]
    drone.setup.platform = replace(drone.setup.platform, battery=Battery(begin=3.6))
    assert drone.report.find_problems() == []


@virtual
async def test_homes_count_again_once_it_was_switched_off(clock) -> None:
    drone, _ = made(clock)
    for at, flying, flown in (
        (1000, SUPERVISOR_BITS.flying, True),
        (1100, 0, True),
        (40, 0, False),
    ):
        tell(drone, READY | flying, at)
        drone.report.publish()
        assert drone.report.has_flown is flown
