"""The console of the firmware, in lines for the log and the page."""

from radio_drones import made
from virtual_drones import Hangar
from virtual_time import virtual

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.radio.drone.console_reader import LONGEST_LINE, ConsoleReader
from crazychoir.radio.protocol.crtp import CrtpPort, Packet


def reader(clock):
    drone, _ = made(clock)
    told, others = [], []
    drone.setup.port.publish = lambda topic, value: told.append((topic, value))
    return ConsoleReader(drone.setup, others.append), told, others


@virtual
async def test_packets_of_the_console_become_whole_lines(clock):
    console, told, others = reader(clock)
    hangar = Hangar().run(0.5)
    hangar.drone.console.say("SYS: a line that is longer than one packet can carry\n")
    for packet in hangar.drone.console.take():
        console.hear(packet)
    assert told[-1] == (
        DRONE_TOPICS.console,
        "drone 0: firmware: SYS: a line that is longer than one packet can carry",
    )
    assert others == []


@virtual
async def test_a_line_without_an_end_is_told_and_other_packets_are_passed_on(clock):
    console, told, others = reader(clock)
    other = Packet(CrtpPort.HIGH_LEVEL, 0, b"\x08\x00\x00\x00")
    console.hear(other)
    assert others == [other]
    for _ in range(LONGEST_LINE // 20 + 1):
        console.hear(Packet(CrtpPort.CONSOLE, 0, b"x" * 20))
    assert len(told) == 1
