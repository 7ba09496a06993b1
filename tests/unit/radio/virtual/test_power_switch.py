"""The packets by which the chip of the radio switches a drone off and on."""

from types import SimpleNamespace

import pytest
from virtual_drones import Hangar

from crazychoir.firmware.requests import LINK_CHANNELS, POWER_PACKETS
from crazychoir.radio.protocol.crtp import CrtpPort, Packet
from crazychoir.radio.virtual.port import DronePort


@pytest.fixture
def port():
    air = SimpleNamespace(faults=SimpleNamespace(off=False))
    found = DronePort(Hangar().run(0.5).drone, air, ("127.0.0.1", 1))
    found.said = []
    found.say = found.said.append
    return found


def power(command):
    data = bytes([POWER_PACKETS.mark, command])
    return Packet(CrtpPort.LINK, LINK_CHANNELS.null, data)


def test_a_drone_that_is_switched_off_stays_off_and_confirms(port):
    port._arrive(power(POWER_PACKETS.all_off))
    assert port.air.faults.off
    assert port.said == [Packet(CrtpPort.LINK, LINK_CHANNELS.null)]


def test_a_drone_with_its_main_processor_switched_off_starts_anew(port):
    starts = port.drone.starts
    port._arrive(power(POWER_PACKETS.system_off))
    port._arrive(power(POWER_PACKETS.system_on))
    assert port.drone.starts == starts + 1
    assert not port.air.faults.off
    assert len(port.said) == 2


def test_other_packets_of_the_null_channel_do_nothing(port):
    port._arrive(Packet(CrtpPort.LINK, LINK_CHANNELS.null, b"\x05"))
    assert port.said == []
    assert not port.air.faults.off
