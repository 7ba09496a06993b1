import asyncio

from virtual_time import virtual

from crazychoir.agent.dead_man import ConsoleReporter, DeadMan, is_console
from crazychoir.bus.commands import Commander, CommandServer
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.swarm_config import default_swarm


class Room:
    """A console for drones 1, which is there, and 9, which is not; when `landed` was called, and why."""

    def __init__(self, clock, patience=3.0):
        self.clock, self.bus, self.flies, self.landed = clock, Bus(clock), False, []
        self.dead_man = DeadMan(
            clock,
            patience,
            lambda: self.flies,
            lambda why: self.landed.append((clock.now(), why)),
        )
        CommandServer(self.bus.port(1), self.execute, lambda on: None)
        self.console = ConsoleReporter(
            Commander(self.bus.port(PORT_ADDRESSES.first_observer, 7)), (1, 9)
        )
        self.watching = asyncio.create_task(self.dead_man.run())

    async def execute(self, verb, arguments):
        assert verb == "watched"
        self.dead_man.heard()


@virtual
async def test_drones_fly_on_as_long_as_a_console_is_there_and_land_so_long_after_it_has_gone(
    clock,
):
    room = Room(clock)
    says = asyncio.create_task(room.console.run())
    await clock.sleep(0.5)
    room.flies = True
    await clock.sleep(60.0)
    assert room.landed == []
    says.cancel()
    await clock.sleep(10.0)
    ((at, why),) = room.landed
    assert 62.5 < at < 64.1
    assert why == "no operator's console for 3 s (flight.dead_man)"
    assert room.watching.done()


@virtual
async def test_a_drone_on_the_ground_waits_for_a_console_without_limit(clock):
    room = Room(clock)
    await clock.sleep(60.0)
    assert room.landed == []
    room.flies = True
    await clock.sleep(0.5)
    assert len(room.landed) == 1, "no console watches: the drone does not fly on"
    room.watching.cancel()


def test_only_an_operator_host_is_a_console_and_only_with_dead_man_set():
    watched = default_swarm(2).replace(flight={"dead_man": 2.0})
    assert is_console(watched, "here")
    assert not is_console(default_swarm(2), "here")
    drones = [{"id": i, "home": [i, 0, 0], "host": "far"} for i in range(2)]
    closed = watched.replace(
        drones=drones, hosts={"far": "10.0.0.1"}, security={"operators": ["desk"]}
    )
    assert is_console(closed, "desk")
    assert not is_console(closed, "here")
