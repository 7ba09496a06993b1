"""Packets that restart a real firmware, and packets that it passes over."""

import pytest
from virtual_drones import Hangar

from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.radio.virtual.drone import BOOT_TIME
from crazychoir.radio.virtual.flight import SPECIAL_FORMS

CHECKED = [
    form
    for form in PACKET_FORMS.values()
    if (form.port, form.channel) == (CrtpPort.SETPOINT, 0)
    and form.name not in SPECIAL_FORMS.unchecked
]


@pytest.mark.parametrize("form", CHECKED, ids=lambda form: form.name)
@pytest.mark.parametrize("more", [-1, 1])
def test_a_set_point_of_another_length_restarts_it(form, more, caplog):
    hangar = Hangar().run(0.3)
    data = form.head + bytes(form.layout.size + more)
    assert list(hangar.drone.take(Packet(CrtpPort.SETPOINT, 0, data))) == []
    assert (hangar.drone.starts, hangar.drone.uptime, hangar.drone.booting) == (
        2,
        0,
        True,
    )
    assert f"{len(data)} bytes" in caplog.text


@pytest.mark.parametrize("data", [b"\x0a\x00", b"\x03", b"\x03\x01" + bytes(8), b""])
def test_a_packet_without_enough_or_with_nothing_restarts_it(data):
    hangar = Hangar()
    list(hangar.drone.take(Packet(CrtpPort.SETPOINT, 0, data)))
    assert hangar.drone.starts == 2


@pytest.mark.parametrize(
    "name",
    [
        "rpyt",
        "position",
        "stop",
        "external_pose",
        "external_position",
        "take_off",
        "arm",
    ],
)
def test_packets_with_an_unchecked_length_are_counted_as_malformed(name):
    hangar, form = Hangar(), PACKET_FORMS[name]
    list(
        hangar.drone.take(
            Packet(form.port, form.channel, form.head + bytes(form.layout.size + 1))
        )
    )
    assert (hangar.drone.starts, hangar.drone.flight.malformed) == (1, 1)


def test_a_flying_drone_that_restarts_falls_and_comes_back_with_all_forgotten():
    hangar = Hangar().hovering()
    hangar.drone.kept.parameters["pid_rate.roll_kp"] = 240.0
    hangar.drone.parameters.set("pid_attitude.roll_kp", 4.0)
    list(hangar.drone.take(Packet(CrtpPort.SETPOINT, 0, b"\x0a")))
    hangar.run(0.5)
    assert not hangar.motors
    assert hangar.state[2] == 0.0
    assert list(hangar.drone.take(Packet(CrtpPort.PARAMETERS, 1, b"\0\0"))) == []
    hangar.run(1e-3 * BOOT_TIME)
    assert len(list(hangar.drone.take(Packet(CrtpPort.PARAMETERS, 1, b"\0\0")))) == 1
    assert hangar.drone.parameters.read("pid_rate.roll_kp") == 240.0
    assert hangar.drone.parameters.read("pid_attitude.roll_kp") == 6.0
    assert (
        "failed assert"
        in b"".join(packet.data for packet in hangar.said if packet.port == 0).decode()
    )
    assert hangar.hovering().state[2] == pytest.approx(0.5, abs=0.05)


def test_a_parameter_asserts_on_purpose():
    hangar = Hangar()
    index = hangar.drone.parameters.toc.index["system.doAssert"].to_bytes(2, "little")
    list(hangar.drone.take(Packet(CrtpPort.PARAMETERS, 2, index + b"\1")))
    assert hangar.drone.starts == 2
    assert hangar.drone.parameters.read("system.doAssert") == 0.0


def test_an_unknown_set_point_is_one_without_thrust():
    hangar = Hangar().hovering()
    list(hangar.drone.take(Packet(CrtpPort.SETPOINT, 0, b"\x63\1\2")))
    hangar.run(0.1)
    assert not hangar.motors
    assert hangar.drone.flight.unknown == 1
