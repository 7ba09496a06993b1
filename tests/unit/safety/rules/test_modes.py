"""The flight state machine: its table is whole, and the pilot does in each mode what the table says of each event."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.port import Bus
from crazychoir.config.tables import Flight
from crazychoir.flight.pilot import Pilot
from crazychoir.safety.rules.guard import Fence
from crazychoir.safety.rules.modes import COMMANDS, TABLE, Event, Mode, after, refusal
from crazychoir.types import Acceleration, FullState, Pose

HIGH, LOW, HOME = 1.0, 0.01, (0.5, 0.0, 0.0)
EVERY = list(product(Mode, Event))


def test_the_table_says_of_every_mode_and_event_what_follows_or_why_not():
    assert [
        (mode, event) for mode, row in TABLE.items() for event in Event if event in row
    ] == EVERY
    assert {len(row) for row in TABLE.values()} == {len(Event)}
    for mode, event in EVERY:
        why = refusal(mode, event)
        assert bool(why) != isinstance(TABLE[mode][event], Mode)
        assert not why or after(mode, event) is mode


def test_every_mode_is_reached_from_the_ground_motors_always_stop_and_then_stay_off():
    reached = [Mode.GROUND]
    for mode in reached:
        reached += [
            found for event in Event if (found := after(mode, event)) not in reached
        ]
    assert set(reached) == set(Mode)
    assert {after(mode, Event.STOP) for mode in Mode} == {Mode.CUT}
    assert {after(Mode.CUT, event) for event in Event} == {Mode.CUT}
    assert all(
        refusal(Mode.CUT, event) for event in COMMANDS if event is not Event.STOP
    )


def the_pilot(clock, mode, z):
    """A pilot that sees its drone at z m, in this mode, between two flights."""
    bus = Bus(clock)
    link = SimpleNamespace(send=lambda command: None, cut=lambda: None)
    pilot = Pilot(
        bus.port(0), link, Flight(), Fence.box((-2.0, -2.0, 0.0), (2.0, 2.0, 2.5))
    )
    see(pilot, z)
    pilot.mode = mode
    return pilot


def see(pilot, z):
    pilot.tick(Pose(np.array([0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0])))
    pilot.port.bus.stages.run()


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
        case Event.ARM:
            assert pilot.unready() == ("", "") or pilot.mode is Mode.CUT
        case Event.TAKE_OFF:
            pilot.take_off()
        case Event.START:
            pilot.start()
        case Event.HOLD | Event.GO:
            pilot.hold(event is Event.HOLD)
        case Event.LAND:
            pilot.land("on command")
        case Event.HOME:
            pilot.go_home(HOME, 1.0)
        case Event.STOP:
            pilot.cut("on command")
        case Event.FLY:
            pilot.go_to(HOME)
        case Event.ARRIVED:
            await arrive(pilot, z)
        case Event.DOWN:
            see(pilot, z)
        case Event.FOUND:
            pilot.take_over()
            see(pilot, z)


@pytest.mark.parametrize(("mode", "event"), EVERY, ids=lambda value: value.value)
def test_the_pilot_does_what_the_table_says(mode, event):
    @virtual
    async def case(clock):
        z = (
            LOW
            if event is Event.DOWN or (mode is Mode.GROUND and event is not Event.FOUND)
            else HIGH
        )
        pilot = the_pilot(clock, mode, z)
        await happens(pilot, event, z)
        expected = after(mode, event)
        if (mode, event) == (Mode.GROUND, Event.FOUND):
            expected = after(expected, Event.LAND)  # at once
        assert pilot.mode is expected
        assert bool(pilot.refuses(event)) == bool(refusal(expected, event))

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
        assert pilot.mode is after(mode, Event.FLY)

    case()


@pytest.mark.parametrize("kept", ["held", "awaits_start"])
def test_one_that_is_held_or_waits_for_its_start_does_not_fly_where_guidance_wants(
    kept,
):
    @virtual
    async def case(clock):
        pilot = the_pilot(clock, Mode.HOVER, HIGH)
        setattr(pilot, kept, True)
        assert pilot.go_to(HOME) == 0.0
        pilot.follow(Acceleration(np.zeros(3)))
        assert pilot.mode is Mode.HOVER

    case()
