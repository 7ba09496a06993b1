"""The process 0-1 of host a, which holds drone 0 and knows the process 1-1 of host b with drone 1."""

from typing import Any

from crazychoir.bus.frames import Envelope, Frame, encode_frame
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.hello_review import Introduction
from crazychoir.bus.network.peers import Peers
from crazychoir.bus.port import Bus
from crazychoir.bus.topics import MessageClass
from crazychoir.runtime.clock import Clock

FRAME_KEY = "choir/s/f/0-1/b/1-1/control"
"""Key of the frames of process 1-1."""
OWN_INTRODUCTION = Introduction("s", incarnation=1, version="1")


class HeldClock(Clock):
    """Goes on when it is told."""

    ns = 0

    def now_ns(self) -> int:
        return self.ns


def make_bus() -> Bus:
    """Return the bus of process 0-1."""
    bus = Bus(HeldClock(), process="0-1", host="a")
    bus.port(0)
    return bus


def make_table(bus: Bus, access: NetworkAccess | None = None) -> Peers:
    """Return the processes that 0-1 knows: 1-1, with HELLO gone both ways."""

    def ignore(*arguments: object) -> None:
        pass

    table = Peers(bus, OWN_INTRODUCTION, access, ignore, ignore)
    meet(table, make_hello())
    return table


def meet(table: Peers, hello: Hello) -> None:
    """Let the token and the HELLO of a process arrive."""
    peer = table.came(hello.host, hello.process, "token")
    assert peer is not None
    table.greeted(peer, hello.payload(), 0.0)


def make_hello(process: str = "1-1", host: str = "b", **changes: Any) -> Hello:
    """Return the HELLO of another process that has received ours."""
    fields = {
        "incarnation": 2,
        "version": "1",
        "uptime": 1.0,
        "drones": [1],
        "observers": [],
        "interests": [],
        "hears_receiver": True,
        "stopped": False,
    }
    return Hello(process=process, host=host, **{**fields, **changes})


def make_frame(
    *messages: Envelope,
    process: str = "1-1",
    klass: MessageClass = MessageClass.CONTROL,
) -> bytes:
    """Return a frame of another process."""
    return encode_frame(Frame(process, 2, klass, list(messages)))
