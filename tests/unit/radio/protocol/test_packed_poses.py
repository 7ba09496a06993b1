"""Packets with the poses of several drones."""

import math

import numpy as np
import pytest

from crazychoir.errors import CodecError
from crazychoir.radio.protocol.compressed import unpack_quaternion
from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.radio.protocol.packed_poses import (
    PACKED_POSES,
    PACKED_POSITIONS,
    NumberedPose,
    is_packed,
    pack_poses,
)
from crazychoir.types import Pose


def numbered(i, has_attitude=True):
    half = 0.1 * i
    q = (0.0, 0.0, math.sin(half), math.cos(half))
    return NumberedPose(
        0xE7 + i, Pose(np.array([i, -0.5 * i, 0.0004, *q])), has_attitude
    )


def test_a_packet_holds_two_poses_or_four_positions():
    rows = [numbered(i, has_attitude=i < 5) for i in range(10)]
    packets = pack_poses(rows)
    assert [(one.port, one.channel, len(one.data)) for one in packets] == [
        (CrtpPort.LOCALIZATION, 1, 1 + 22),
        (CrtpPort.LOCALIZATION, 1, 1 + 22),
        (CrtpPort.LOCALIZATION, 1, 1 + 11),
        (CrtpPort.LOCALIZATION, 2, 28),
        (CrtpPort.LOCALIZATION, 2, 7),
    ]
    assert (PACKED_POSES.most, PACKED_POSITIONS.most) == (2, 4)
    assert all(is_packed(packet) for packet in packets)


def test_an_entry_has_the_number_the_place_in_mm_and_the_attitude():
    (packet,) = pack_poses([numbered(3)])
    number, x, y, z, word = PACKED_POSES.entry.unpack(packet.data[1:])
    assert (number, x, y, z) == (0xEA, 3000, -1500, 0)
    yaw = 2.0 * math.atan2(unpack_quaternion(word)[2], unpack_quaternion(word)[3])
    assert yaw == pytest.approx(0.6, abs=math.radians(0.2))


@pytest.mark.parametrize("x", [32.768, -40.0, math.nan, math.inf])
def test_a_place_that_does_not_fit_is_refused(x):
    pose = Pose(np.array([0.0, x, 0.0, 0.0, 0.0, 0.0, 1.0]))
    with pytest.raises(CodecError, match=r"allowed: 32\.767 m"):
        pack_poses([NumberedPose(1, pose)])


def test_other_packets_are_for_one_drone():
    pose = PACKET_FORMS["external_pose"].packet(0, 0, 0, 0, 0, 0, 1)
    stop = PACKET_FORMS["emergency_stop"].packet()
    assert not any(map(is_packed, (pose, stop, Packet(CrtpPort.LINK, 2, b"\x09"))))
