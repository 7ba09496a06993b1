"""The flight state machine: its table is whole, and the pilot does in each mode what the table says of each event."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from pilots import make_pilot, tick
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import FlightTable
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import (
    MODE_TABLE,
    OPERATOR_EVENTS,
    Mode,
    ModeEvent,
    get_next_mode,
    get_refusal,
)
from crazychoir.types import Acceleration, FullState, Pose

HIGH, LOW, HOME = 1.0, 0.01, (0.5, 0.0, 0.0)
EVERY = list(product(Mode, ModeEvent))


def test_the_table_says_of_every_mode_and_event_what_follows_or_why_not():
    assert [
        (mode, event)
        for mode, row in MODE_TABLE.items()
        for event in ModeEvent
        if event in row
    ] == EVERY
    assert {len(row) for row in MODE_TABLE.values()} == {len(ModeEvent)}
    for mode, event in EVERY:
        why = get_refusal(mode, event)
        assert bool(why) != isinstance(MODE_TABLE[mode][event], Mode)
        assert not why or get_next_mode(mode, event) is mode


def test_every_mode_is_reached_from_the_ground_motors_always_stop_and_then_stay_off():
    reached = [Mode.GROUND]
    for mode in reached:
        reached += [
            found
            for event in ModeEvent
            if (found := get_next_mode(mode, event)) not in reached
        ]
    assert set(reached) == set(Mode)
    assert {get_next_mode(mode, ModeEvent.STOP) for mode in Mode} == {Mode.CUT}
    assert {get_next_mode(Mode.CUT, event) for event in ModeEvent} == {Mode.CUT}
    assert all(
        get_refusal(Mode.CUT, event)
        for event in OPERATOR_EVENTS
        if event is not ModeEvent.STOP
    )


def the_pilot(clock, mode, z):
    """A pilot that sees its drone at z m, in this mode, between two flights."""
    bus = Bus(clock)
    link = SimpleNamespace(send=lambda command: None, cut=lambda: None)
    pilot = make_pilot(
        bus.port(0), link, FlightTable(), Fence.box((-2.0, -2.0, 0.0), (2.0, 2.0, 2.5))
    )
    see(pilot, z)
    pilot.row.mode = mode
    return pilot


def see(pilot, z):
    tick(pilot, Pose(np.array([0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0])))


async def arrive(pilot, z):
    """A flight to where it is ends."""
    pilot.flights.go_to(
        FullState.at((0.0, 0.0, z)),
        np.array([0.0, 0.0, z]),
        0.0,
        0.01,
        pilot.clock.now(),
    )
    await pilot.clock.sleep(0.12)
    see(pilot, z)


async def happens(pilot, event, z):
    match event:
        case ModeEvent.ARM:
            assert pilot.unready() == ("", "") or pilot.mode is Mode.CUT
        case ModeEvent.TAKE_OFF:
            pilot.take_off()
        case ModeEvent.START:
            pilot.permission.start()
        case ModeEvent.HOLD | ModeEvent.GO:
            pilot.hold(event is ModeEvent.HOLD)
        case ModeEvent.LAND:
            pilot.land("on command")
        case ModeEvent.HOME:
            pilot.go_home(HOME, 1.0)
        case ModeEvent.STOP:
            pilot.cut("on command")
        case ModeEvent.FLY:
            pilot.go_to(HOME)
        case ModeEvent.ARRIVED:
            await arrive(pilot, z)
        case ModeEvent.DOWN:
            see(pilot, z)
        case ModeEvent.FOUND:
            pilot.take_over()
            see(pilot, z)


@pytest.mark.parametrize(("mode", "event"), EVERY, ids=lambda value: value.value)
def test_the_pilot_does_what_the_table_says(mode, event):
    @virtual
    async def case(clock):
        z = (
            LOW
            if event is ModeEvent.DOWN
            or (mode is Mode.GROUND and event is not ModeEvent.FOUND)
            else HIGH
        )
        pilot = the_pilot(clock, mode, z)
        await happens(pilot, event, z)
        expected = get_next_mode(mode, event)
        if (mode, event) == (Mode.GROUND, ModeEvent.FOUND):
            expected = get_next_mode(expected, ModeEvent.LAND)  # at once
        assert pilot.mode is expected
        assert bool(pilot.permission.refuses(event)) == bool(
            get_refusal(expected, event)
        )

    case()


@pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.value)
@pytest.mark.parametrize("fly", ["follow", "fly"])
def test_each_way_to_fly_is_the_same_event(mode, fly):
    @virtual
    async def case(clock):
        pilot = the_pilot(clock, mode, HIGH)
        if fly == "follow":
            pilot.follow(Acceleration(np.zeros(3)))
        else:
            whole = SimpleNamespace(
                duration=1.0,
                sample=lambda t: FullState.at((0.0, 0.0, HIGH)),
                done=lambda t: t > 1,
            )
            pilot.fly(whole)
        assert pilot.mode is get_next_mode(mode, ModeEvent.FLY)

    case()


@pytest.mark.parametrize("kept", ["is_held", "awaits_start"])
def test_a_held_or_waiting_drone_does_not_fly_where_guidance_wants(
    kept,
):
    @virtual
    async def case(clock):
        pilot = the_pilot(clock, Mode.HOVER, HIGH)
        pilot.row.drone[kept] = 1
        assert pilot.go_to(HOME) == 0.0
        pilot.follow(Acceleration(np.zeros(3)))
        assert pilot.mode is Mode.HOVER

    case()
