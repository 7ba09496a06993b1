"""Packets: what is written is read again, at the lengths that the firmware expects."""

import struct

import numpy as np
import pytest
from cflib.utils.encoding import compress_quaternion, decompress_quaternion

from crazychoir.errors import CodecError
from crazychoir.radio.protocol.compressed import pack_quaternion, unpack_quaternion
from crazychoir.radio.protocol.crtp import (
    CRTP_FORMAT,
    PACKET_FORMS,
    Packet,
    parse_packet,
)

LENGTHS = {
    "rpyt": 14,
    "stop": 1,
    "altitude_hold": 17,
    "full_state": 29,
    "velocity_world": 17,
    "z_distance": 17,
    "hover": 17,
    "position": 17,
    "manual": 16,
    "notify_setpoint_stop": 5,
    "group_mask": 2,
    "planner_stop": 2,
    "define_trajectory": 9,
    "take_off": 15,
    "land": 15,
    "take_off_with_velocity": 16,
    "land_with_velocity": 16,
    "spiral": 24,
    "go_to": 24,
    "start_trajectory": 10,
    "external_position": 12,
    "emergency_stop": 1,
    "emergency_stop_watchdog": 1,
    "external_pose": 29,
    "arm": 2,
    "recover": 1,
    "supervisor_stop": 1,
    "supervisor_watchdog": 1,
    "supervisor_info": 1,
    "platform_arm": 2,
    "platform_recover": 1,
}
"""Bytes behind the header, by the firmware's documentation."""


def _values(form):
    return [
        {"f": 0.5, "B": 3, "H": 7, "h": -9, "I": 11, "?": True}[field[-1]]
        for field in form.fields.split()
    ]


@pytest.mark.parametrize("name", LENGTHS)
def test_a_form_writes_what_it_reads(name):
    form = PACKET_FORMS[name]
    packet = form.packet(*_values(form))
    assert len(packet.data) == LENGTHS[name] <= CRTP_FORMAT.payload_size
    assert list(form.values(parse_packet(packet.framed()))) == _values(form)


@pytest.mark.parametrize("name", LENGTHS)
def test_another_length_is_an_error_that_says_both(name):
    form = PACKET_FORMS[name]
    packet = form.packet(*_values(form))
    with pytest.raises(
        CodecError, match=f"{name}: {LENGTHS[name] + 1} bytes; allowed: {LENGTHS[name]}"
    ):
        form.values(packet._replace(data=packet.data + b"\0"))


def test_a_value_that_does_not_fit_is_an_error():
    with pytest.raises(CodecError, match="full_state"):
        PACKET_FORMS["full_state"].packet(*[40000] * 13)


@pytest.mark.parametrize("datagram", [b"", bytes(33)])
def test_what_no_radio_carries_is_an_error(datagram):
    with pytest.raises(CodecError, match=f"{len(datagram)} bytes; allowed: 1 to 32"):
        parse_packet(datagram)


def test_the_header_is_port_and_channel_with_or_without_safelinks_bits():
    assert (
        parse_packet(b"\x5d\x05") == parse_packet(b"\x51\x05") == Packet(5, 1, b"\x05")
    )
    assert Packet(15, 1, b"\0").framed() == b"\xfd\0"


def test_a_quaternion_of_32_bits_is_the_same_rotation():
    random = np.random.default_rng(1)
    for q in random.normal(size=(50, 4)):
        q /= np.linalg.norm(q)
        again = unpack_quaternion(pack_quaternion(q))
        assert abs(again @ q) > 1.0 - 2e-5
        assert np.linalg.norm(again) == pytest.approx(1.0, abs=1e-6)


def test_cflib_packs_the_same_bits():
    for q in np.random.default_rng(2).normal(size=(50, 4)):
        q /= np.linalg.norm(q)
        ours, theirs = (
            unpack_quaternion(pack_quaternion(q)),
            np.array(decompress_quaternion(pack_quaternion(q))),
        )
        assert np.allclose(ours, theirs, atol=1e-6)
        assert np.allclose(unpack_quaternion(compress_quaternion(q)), ours, atol=3e-3)


def test_forms_are_told_apart_by_their_first_bytes():
    assert len(
        {(form.port, form.channel, form.head) for form in PACKET_FORMS.values()}
    ) == len(PACKET_FORMS)
    assert struct.calcsize("<fffH") == PACKET_FORMS["rpyt"].layout.size
