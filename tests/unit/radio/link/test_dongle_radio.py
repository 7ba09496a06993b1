"""A Crazyradio at its USB: packets to one drone, broadcasts to all, with settings told before or with the packet."""

import pytest
import usb.core
from cflib.drivers import crazyradio
from fake_dongle import FakeDongle, Receiver

from crazychoir.radio.link.dongle_radio import DongleRadio

FAST, RATE = 1e6, 2
NULL = bytes([0xFF])
TEXT = bytes([0x6C, 1, 2, 3])


@pytest.fixture
def plug(monkeypatch):
    """Make a fake dongle with two drones, and open it."""
    made = []

    def open_dongle(**how):
        drones = {(80, f"E7E7E7E70{i}"): Receiver(9) for i in (1, 2)}
        drones[81, "E7E7E7E703"] = Receiver(9)
        made.append(FakeDongle(drones, FAST, **how))
        monkeypatch.setattr(crazyradio, "_find_devices", lambda serial=None: [made[-1]])
        return DongleRadio(0), made[-1]

    yield open_dongle
    for dongle in made:
        for drone in dongle.drones.values():
            drone.close()


def exchange(radio, i, channel=80):
    return radio.exchange(channel, bytes.fromhex(f"E7E7E7E70{i}"), RATE, NULL)


@pytest.mark.parametrize("inline", [False, True])
def test_a_packet_reaches_its_drone_and_a_broadcast_all_of_its_channel(plug, inline):
    radio, dongle = plug(inline=inline)
    assert radio.is_inline is inline
    assert exchange(radio, 1).ack
    assert not exchange(radio, 3).ack, "it is on another channel"
    radio.broadcast(80, RATE, [TEXT, TEXT])
    assert [len(drone.up) for drone in dongle.drones.values()] == [2, 2, 0]
    answer = exchange(radio, 2)
    assert answer.ack, "acknowledgements are on again"
    assert tuple(answer.data)[:2] == (0xF3, 1)
    assert answer.retry == 0


def test_a_dongle_is_told_each_change_unless_it_takes_them_with_the_packet(plug):
    for inline, changes, spread in ((False, 3, 4), (True, 0, 0)):
        radio, dongle = plug(inline=inline)
        before = dongle.changes
        for i in (1, 2, 2, 1):
            exchange(radio, i)
        # The channel once, and three addresses.
        assert dongle.changes - before == changes + (not inline)
        before = dongle.changes
        radio.broadcast(80, RATE, [TEXT] * 6)
        exchange(radio, 1)
        # No acknowledgements, the address, acknowledgements, the next address.
        assert dongle.changes - before == spread


def test_a_dongle_that_refuses_the_inline_mode_is_told_its_settings(plug, monkeypatch):
    monkeypatch.setattr(
        FakeDongle,
        "ctrl_transfer",
        refuse_inline(FakeDongle.ctrl_transfer),
    )
    radio, dongle = plug(inline=True)
    assert not radio.is_inline
    assert exchange(radio, 1).ack
    assert dongle.changes > 0


def refuse_inline(transfer):
    def refuse(self, kind, request, *more, **named):
        if request == 0x23:
            raise usb.core.USBError("Pipe error", -9, 32)
        return transfer(self, kind, request, *more, **named)

    return refuse


def test_a_dongle_that_does_not_answer_broadcasts_is_not_waited_for(plug, monkeypatch):
    reads = []
    read = FakeDongle.read

    def silent(self, endpoint, length, timeout):
        if not self._acks:
            if self._users.locked():
                self._users.release()
                reads.append(timeout)
            raise usb.core.USBTimeoutError("timed out")
        return read(self, endpoint, length, timeout)

    monkeypatch.setattr(FakeDongle, "read", silent)
    radio, _ = plug(inline=True)
    assert radio.is_inline
    monkeypatch.setattr(
        FakeDongle, "_spread", lambda self, packet: self._users.release()
    )
    radio.broadcast(80, RATE, [TEXT, TEXT])
    assert len(reads) == 1, "when it was opened"


def test_a_late_answer_is_not_taken_for_the_one_to_the_next_packet(plug):
    radio, dongle = plug(inline=True)
    exchange(radio, 1)
    dongle.late = 1
    assert exchange(radio, 1) is None
    assert not exchange(radio, 3).ack, "no drone is there"
    assert exchange(radio, 2).ack


def test_a_late_answer_to_the_first_broadcast_is_not_taken_for_a_drones(plug):
    radio, _ = plug(inline=True, late=1)
    assert radio.is_inline
    assert exchange(radio, 1).ack


def test_an_older_dongle_is_not_asked_for_the_inline_mode(plug):
    radio, _ = plug()
    assert radio.version < 5.0
    assert not radio.is_inline
