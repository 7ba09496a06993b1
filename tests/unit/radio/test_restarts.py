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


@pytest.mark.parametrize(
    ("what", "packet"),
    [
        ("memory 99", Packet(CrtpPort.MEMORY, 0, bytes([2, 99]))),
        ("memory 99", Packet(CrtpPort.MEMORY, 1, bytes([99, 0, 0, 0, 0, 1]))),
        ("memory 99", Packet(CrtpPort.MEMORY, 2, bytes([99, 0, 0, 0, 0, 1]))),
        ("31 bytes", Packet(CrtpPort.MEMORY, 1, bytes([0, 0, 0, 0, 0, 25]))),
        ("31 bytes", Packet(CrtpPort.LINK, 0, bytes(31))),
        ("1 bytes", Packet(CrtpPort.SETPOINT, 1, b"\0")),
        ("0 bytes", Packet(CrtpPort.SETPOINT, 1)),
    ],
    ids=[
        "description",
        "read",
        "write",
        "long read",
        "long echo",
        "short notice",
        "empty notice",
    ],
)
def test_an_assertion_of_the_firmware_resets_it(what, packet, caplog):
    """crazyflie-firmware: mem.c and crtp.c assert on these packets."""
    hangar = Hangar().run(0.3)
    assert list(hangar.drone.take(packet)) == []
    assert (hangar.drone.starts, hangar.drone.booting) == (2, True)
    assert what in caplog.text


def test_roll_and_pitch_in_the_carefree_mode_reset_it():
    """crazyflie-firmware: crtp_commander_rpyt.c asserts if flightmode.yawMode is 0."""
    hangar = Hangar()
    hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    assert hangar.drone.starts == 1
    hangar.drone.parameters.set("flightmode.yawMode", 0.0)
    hangar.send("hover", 0.0, 0.0, 0.0, 0.0)
    assert hangar.drone.starts == 1
    hangar.send("rpyt", 0.0, 0.0, 0.0, 0)
    assert hangar.drone.starts == 2


@pytest.mark.parametrize(
    "packet",
    [
        Packet(CrtpPort.MEMORY, 1, bytes([0, 0, 0, 0, 0, 24])),
        Packet(CrtpPort.LINK, 0, bytes(30)),
    ],
)
def test_the_longest_answer_has_30_bytes(packet):
    hangar = Hangar()
    (answer,) = hangar.drone.take(packet)
    assert (len(answer.data), hangar.drone.starts) == (30, 1)


def _console(hangar):
    return b"".join(packet.data for packet in hangar.said if packet.port == 0).decode()


def test_a_flying_drone_that_restarts_falls_and_comes_back_with_all_forgotten():
    hangar = Hangar().hovering()
    hangar.drone.kept.parameters["pid_rate.roll_kp"] = 240.0
    hangar.drone.parameters.set("pid_attitude.roll_kp", 4.0)
    hangar.drone.restart()
    hangar.run(0.5)
    assert not hangar.motors
    assert hangar.state[2] == 0.0
    assert list(hangar.drone.take(Packet(CrtpPort.PARAMETERS, 1, b"\0\0"))) == []
    hangar.run(1e-3 * BOOT_TIME)
    assert len(list(hangar.drone.take(Packet(CrtpPort.PARAMETERS, 1, b"\0\0")))) == 1
    assert hangar.drone.parameters.read("pid_rate.roll_kp") == 240.0
    assert hangar.drone.parameters.read("pid_attitude.roll_kp") == 6.0
    assert hangar.hovering().state[2] == pytest.approx(0.5, abs=0.05)


def test_after_a_failed_assertion_it_answers_but_flies_only_once_it_was_switched_off():
    """crazyflie-firmware: cfAssertNormalStartTest fails the self-test of the next start."""
    hangar = Hangar().hovering()
    list(hangar.drone.take(Packet(CrtpPort.SETPOINT, 0, b"\x0a")))
    hangar.run(1e-3 * BOOT_TIME + 0.5)
    assert not hangar.motors
    said = _console(hangar)
    assert "SYS: The system resumed after a failed assert [WARNING]" in said
    assert "SYS: Assert failed: CRTP hover: 1 bytes" in said
    assert hangar.drone.parameters.read("system.selftestPassed") == 0.0
    assert hangar.hovering().state[2] == 0.0
    assert (hangar.supervisor, hangar.onboard.info) == ("not initialised", 0)
    hangar.drone.restart()
    hangar.run(1e-3 * BOOT_TIME)
    assert hangar.drone.parameters.read("system.selftestPassed") == 1.0
    assert hangar.hovering().state[2] == pytest.approx(0.5, abs=0.05)


def test_the_firmware_reads_the_rest_of_a_short_packet_from_the_one_before():
    """crazyflie-firmware: crtp_commander_high_level.c does not ask how long a packet is."""
    hangar = Hangar().hovering()
    whole = PACKET_FORMS["go_to"].packet(0, 0, 0, 0.0, 0.0, 0.8, 0.0, 1.0)
    list(hangar.drone.take(Packet(CrtpPort.LINK, 0, whole.data)))
    short = Packet(whole.port, whole.channel, whole.data[:2])
    (answer,) = hangar.drone.take(short)
    assert answer.data == whole.data[:3] + b"\0"
    hangar.run(4.0)
    assert hangar.state[2] == pytest.approx(0.8, abs=0.1)


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
