"""What a drone that a radio reaches says of itself, as the guard is told it."""

import math
from dataclasses import replace
from functools import partial

import pytest
from virtual_time import virtual

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS
from crazychoir.runtime.clock import run_virtual
from crazychoir.safety.rules.guard import (
    ON_BOARD_SAFETY_TABLE,
    RADIO_SAFETY_TABLE,
    Action,
    Guard,
)
from crazychoir.safety.rules.radio_watch import RadioWatch
from crazychoir.types import LinkStatus, State

HOVER = State.at((0.0, 0.0, 1.0))
FLYING = 1 << 4


async def judged(
    clock, table, seconds: float = 0.0, platform=CRAZYFLIE_21, **said
) -> Action:
    """Return the worst action about a drone while its owner says `said` for `seconds`."""
    return (await watched(clock, table, seconds, platform, **said))[0]


async def watched(clock, table, seconds, platform, **said) -> tuple[Action, str]:
    """Return the worst action, and why the drone may not fly again."""
    bus = Bus(clock)
    owner, port, guard = (
        bus.port(PORT_ADDRESSES.body_offset + 3),
        bus.port(3),
        Guard(table=table),
    )
    watch = RadioWatch(port, PORT_ADDRESSES.body_offset + 3, guard, platform.firmware)
    action = Action.NOMINAL
    for _ in range(1 + round(seconds / 0.1)):
        status = LinkStatus(
            "up", **({"silence": 0.02, "battery": 3.9, "supervisor": FLYING} | said)
        )
        owner.publish(DRONE_TOPICS.link, status)
        await clock.sleep(0.1)
        watch.look()
        action = max(action, guard.check(clock.now(), HOVER, 0.01).action)
    return action, guard.latched


@pytest.mark.parametrize("table", [RADIO_SAFETY_TABLE, ON_BOARD_SAFETY_TABLE])
def test_what_it_says_and_what_follows(table) -> None:
    @virtual
    async def check(clock) -> None:
        assert await judged(clock, table) is Action.NOMINAL
        for bit in (5, 6, 7):  # on its back, locked, crashed
            assert (
                await judged(clock, table, supervisor=FLYING | 1 << bit) is Action.CUT
            )
        assert await judged(clock, table, 4.5, battery=3.1) is Action.NOMINAL
        assert await judged(clock, table, 5.5, battery=3.1) is Action.LAND
        assert await judged(clock, table, battery=2.9) is Action.LAND
        assert await judged(clock, table, battery=math.nan) is Action.NOMINAL, (
            "it has not said it yet"
        )
        silent = await judged(clock, table, silence=0.6)
        assert silent is (
            Action.BRAKE if table is RADIO_SAFETY_TABLE else Action.NOMINAL
        ), "its planner flies on anyway"
        assert await judged(clock, table, silence=4.1) is Action.LAND

    check()


@virtual
async def test_a_battery_is_low_when_the_firmware_of_its_platform_says_so(
    clock,
) -> None:
    assert await watched(clock, RADIO_SAFETY_TABLE, 6.0, CRAZYFLIE_21, battery=3.3) == (
        Action.NOMINAL,
        "",
    )
    action, reason = await watched(
        clock, RADIO_SAFETY_TABLE, 6.0, CRAZYFLIE_21_BRUSHLESS, battery=3.3
    )
    assert (action, reason[:26]) == (Action.LAND, "battery below 3.35 V for 5")
    action, reason = await watched(
        clock, RADIO_SAFETY_TABLE, 6.0, CRAZYFLIE_21, battery=3.1
    )
    assert (action, reason[:25]) == (Action.LAND, "battery below 3.2 V for 5")
    own = replace(CRAZYFLIE_21, firmware=replace(CRAZYFLIE_21.firmware, critical=3.12))
    assert (await watched(clock, RADIO_SAFETY_TABLE, 0.0, own, battery=3.1))[
        1
    ].startswith("battery 0.02 V below 3.12 V: landing")


@virtual
async def test_an_owner_that_is_started_again_and_has_not_heard_it_is_no_silence(
    clock,
) -> None:
    guard, action = await restarted(clock, 1.5, heard_again=True)
    assert (action, guard.latched) == (Action.BRAKE, "")
    assert guard.told("link") < 0.3


@virtual
async def test_a_drone_that_is_not_heard_again_is_silent_from_the_last_packet_on(
    clock,
) -> None:
    guard, action = await restarted(clock, 3.0, heard_again=False)
    assert (action, guard.latched) == (Action.BRAKE, "")
    assert guard.told("link") == pytest.approx(3.6, abs=0.15)
    guard, action = await restarted(clock, 4.0, heard_again=False)
    assert action is Action.LAND
    assert guard.latched.startswith("its radio is silent for 4.0"), guard.latched


@virtual
async def test_before_any_packet_it_is_silent_for_ever(clock) -> None:
    assert (
        await watched(clock, RADIO_SAFETY_TABLE, 0.0, CRAZYFLIE_21, silence=math.inf)
    )[0] is Action.LAND


async def restarted(clock, seconds: float, heard_again: bool) -> tuple[Guard, Action]:
    """Return the guard of a drone with a restarted owner, and its worst action.

    The owner is gone for 0.5 s. It then speaks for `seconds` without having heard the drone. After that it may hear
    the drone.
    """
    bus = Bus(clock)
    owner, port, guard = (
        bus.port(PORT_ADDRESSES.body_offset + 3),
        bus.port(3),
        Guard(table=RADIO_SAFETY_TABLE),
    )
    watch = RadioWatch(
        port, PORT_ADDRESSES.body_offset + 3, guard, CRAZYFLIE_21.firmware
    )
    unheard = round(seconds / 0.1)
    said = (
        [0.02] * 3
        + [None] * 5
        + [math.inf] * unheard
        + ([0.02] * 3 if heard_again else [])
    )
    worst = Action.NOMINAL
    for silence in said:
        if silence is not None:
            owner.publish(DRONE_TOPICS.link, LinkStatus("connecting", silence))
        await clock.sleep(0.1)
        watch.look()
        worst = max(worst, guard.check(clock.now(), HOVER, 0.01).action)
    return guard, worst


@pytest.mark.parametrize(
    "silence",
    [0.0, math.inf],
    ids=["heard again", "by an owner whose link is not up yet"],
)
def test_a_drone_locked_during_radio_silence_is_reported_as_locked(silence) -> None:
    run_virtual(partial(_locked, silence=silence))


async def _locked(clock, silence) -> None:
    bus = Bus(clock)
    owner, port, guard = (
        bus.port(PORT_ADDRESSES.body_offset + 3),
        bus.port(3),
        Guard(table=RADIO_SAFETY_TABLE),
    )
    watch = RadioWatch(
        port, PORT_ADDRESSES.body_offset + 3, guard, CRAZYFLIE_21.firmware
    )
    owner.publish(
        DRONE_TOPICS.link, LinkStatus("up", silence=0.0, battery=3.9, supervisor=FLYING)
    )
    for _ in range(23):
        await clock.sleep(0.1)
        watch.look()
        guard.check(clock.now(), HOVER, 0.01)
    assert guard.latched == ""
    owner.publish(
        DRONE_TOPICS.link,
        LinkStatus("up", silence=silence, battery=3.9, supervisor=1 << 6),
    )
    await clock.sleep(0.1)
    watch.look()
    guard.check(clock.now(), HOVER, 0.01)
    assert guard.latched.startswith("its radio was silent for 2.")
    assert (
        "s, it is tumbled, crashed or locked, as its firmware says: motors cut"
        in guard.latched
    )
