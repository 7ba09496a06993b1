"""Packets with the positions of several drones: a drone corrects its own, and hears of the others."""

import struct

import numpy as np
import pytest
from virtual_drones import Hangar

from crazychoir.radio.protocol.compressed import pack_quaternion
from crazychoir.radio.protocol.crtp import CrtpPort, Packet

OWN, PEER = 7, 9
LEVEL = pack_quaternion(np.array([0.0, 0.0, 0.0, 1.0]))


def positions(*rows):
    return Packet(
        CrtpPort.LOCALIZATION, 2, b"".join(struct.pack("<Bhhh", *row) for row in rows)
    )


def poses(*rows):
    packed = b"".join(struct.pack("<BhhhI", *row, LEVEL) for row in rows)
    return Packet(CrtpPort.LOCALIZATION, 1, b"\x09" + packed)


@pytest.mark.parametrize("packet", [positions, poses])
def test_the_drone_hears_the_positions_of_the_others(packet):
    hangar = Hangar(number=OWN)
    list(hangar.drone.take(packet((PEER, 500, -20, 600), (OWN, 100, 0, 0))))
    av = hangar.onboard.record["avoidance"]
    assert av["peers"].tolist() == [PEER] + 9 * [0]
    assert av["positions"][0] == pytest.approx([0.5, -0.02, 0.6])
    assert hangar.drone.flight.told.count == 1
    assert hangar.log("stateEstimate.x") == pytest.approx(0.1, abs=0.01)


def test_a_restart_forgets_the_others():
    hangar = Hangar(number=OWN)
    list(hangar.drone.take(positions((PEER, 500, 0, 600))))
    hangar.drone.restart()
    assert not hangar.onboard.record["avoidance"]["peers"].any()


def test_the_parameters_of_the_avoidance_act():
    hangar = Hangar(number=OWN)
    for name, value in (("enable", 1.0), ("maxPeerLocAge", -1.0), ("horizon", 2.0)):
        hangar.drone.parameters.set(f"colAv.{name}", value)
        assert hangar.drone.parameters.read(f"colAv.{name}") == value
    assert hangar.onboard.record["avoids"] == 1
    assert hangar.onboard.record["avoidance"]["horizon"] == 2.0
