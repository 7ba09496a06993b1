"""The thread that sends."""

import threading

from crazychoir.radio.link.writer import LONGEST_QUEUE, PacketWriter
from crazychoir.radio.protocol.crtp import Packet


def packet(number: int) -> Packet:
    return Packet(0, 0, bytes([number]))


class Slow:
    """A driver that holds each sender until `free` is set."""

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.busy, self.free = threading.Event(), threading.Event()

    def until(self, count: int) -> None:
        """Wait until so many packets are sent."""
        for _ in range(500):
            if len(self.sent) >= count:
                return
            threading.Event().wait(0.01)
        raise AssertionError(f"only {self.sent} sent")

    def __call__(self, packet: Packet) -> bool:
        self.busy.set()
        assert self.free.wait(5.0)
        self.sent.append(packet.data[0])
        return True


def test_orders_keep_their_order_and_of_each_kind_the_newest_is_sent() -> None:
    slow = Slow()
    writer = PacketWriter("test", slow)
    writer.put(packet(1))
    assert slow.busy.wait(5.0)
    for number in (10, 11, 12):
        writer.newest("pose", packet(number))
    writer.newest("command", packet(20))
    writer.put(packet(2))
    writer.put(packet(3))
    slow.free.set()
    slow.until(5)
    writer.end()
    assert writer.join(5.0)
    assert slow.sent == [1, 2, 3, 12, 20]


def test_what_waits_in_order_is_sent_before_its_end() -> None:
    slow = Slow()
    writer = PacketWriter("test", slow)
    for number in (1, 2, 3):
        writer.put(packet(number))
    writer.newest("pose", packet(9))
    writer.end()
    slow.free.set()
    assert writer.join(5.0)
    assert slow.sent in ([1, 2, 3], [9, 1, 2, 3])


def test_a_driver_that_raises_is_tried_again() -> None:
    sent: list[int] = []

    def send(one: Packet) -> bool:
        if one.data == b"\x01":
            raise OSError("USB")
        sent.append(one.data[0])
        return True

    writer = PacketWriter("test", send)
    writer.put(packet(1))
    writer.put(packet(2))
    writer.end()
    assert writer.join(5.0)
    assert (sent, writer.failed(), writer.failed()) == ([2], "OSError: USB", "")


def test_a_link_that_takes_nothing_does_not_grow() -> None:
    slow = Slow()
    writer = PacketWriter("test", slow)
    assert all(writer.put(packet(0)) for _ in range(LONGEST_QUEUE))
    assert slow.busy.wait(5.0)
    writer.put(packet(0))
    assert not writer.put(packet(0))
    slow.free.set()
    writer.end()
    assert writer.join(5.0)


def test_what_is_forgotten_is_not_sent() -> None:
    slow = Slow()
    writer = PacketWriter("test", slow)
    writer.put(packet(1))
    assert slow.busy.wait(5.0)
    writer.newest("command", packet(20))
    writer.newest("pose", packet(10))
    writer.forget("command")
    writer.put(packet(2))
    slow.free.set()
    slow.until(3)
    writer.end()
    assert writer.join(5.0)
    assert slow.sent == [1, 2, 10]


def test_a_link_without_room_gets_what_is_newest_and_most_urgent_when_it_has_some() -> (
    None
):
    sent: list[int] = []
    room, looked = threading.Event(), threading.Event()

    def has_room() -> bool:
        looked.set()
        return room.wait(0.005)

    writer = PacketWriter(
        "test", lambda one: not sent.append(one.data[0]), room=has_room
    )
    writer.newest("command", packet(1))
    assert looked.wait(5.0)
    writer.put(packet(2))
    for number in (3, 4):
        writer.newest("command", packet(number))
    for first in (90, 95):  # said again before it could go: once is enough
        writer.urgent([packet(first), packet(first + 1)])
    room.set()
    writer.end()
    assert writer.join(5.0)
    assert sent in ([95, 96, 2], [95, 96, 2, 4])


def test_what_finds_no_room_is_sent_again_unless_it_is_forgotten_meanwhile() -> None:
    tried: list[int] = []
    full, next_one, free = threading.Event(), threading.Event(), threading.Event()

    def send(one: Packet) -> bool:
        tried.append(one.data[0])
        (next_one if one.data[0] == 8 else full).set()
        return free.wait(0.005)

    writer = PacketWriter("test", send)
    writer.newest("command", packet(7))
    assert full.wait(5.0)
    writer.forget("command")
    writer.put(packet(8))
    assert next_one.wait(5.0)
    before = len(tried)
    free.set()
    writer.end()
    assert writer.join(5.0)
    assert set(tried[before - 1 :]) == {8}
