"""Lights the LEDs of a drone that nobody flies, so that one finds it among others."""

import contextlib
from collections.abc import Callable

from crazychoir.errors import Refused
from crazychoir.radio import checks
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.firmware import Firmware
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.crtp import SUPERVISOR, Packet
from crazychoir.runtime.clock import Clock

BOARD: dict[str, float] = {"led.bitmask": 0xFF}
"""All of the board: the upper bit takes them from the firmware."""
RING: dict[str, float] = {
    "ring.solidRed": 255,
    "ring.solidGreen": 255,
    "ring.solidBlue": 255,
    "ring.effect": 7,
}
"""The deck below it: one colour."""
RING_DECK = "deck.bcLedRing"
ASKED = Packet(SUPERVISOR, 0, b"\x0c")
SAYS = 0.5
"""s that its supervisor gets to say whether it flies; older firmware has none that could."""


async def identify(
    clock: Clock,
    uri: str,
    contents: TableOfContents,
    seconds: float,
    deadline: float,
    lit_now: Callable[[], None] = lambda: None,
) -> dict[str, float]:
    """Light them for so long; returns the parameters that it was done by. They are put back, whatever happens.

    deadline: s until it is connected;  lit_now: called once they are lit.

    Raises LinkFailed, and Refused while it flies.
    """
    connection = Connection(clock, uri, contents)
    try:
        await connection.open(deadline)
        await _require_rest(connection)
        firmware = Firmware(connection)
        lit = BOARD | (RING if await firmware.has(RING_DECK) else {})
        before = {name: await firmware.get(name) for name in lit}
        try:
            await firmware.set_all(lit)
            lit_now()
            await clock.sleep(seconds)
        finally:
            await firmware.set_all(dict(reversed(before.items())))
        return lit
    finally:
        await connection.close()


async def _require_rest(connection: Connection) -> None:
    """Refused if it says that it flies."""

    def answers(packet: Packet) -> bool:
        return packet[:2] == ASKED[:2] and packet.data[:1] == b"\x8c"

    with contextlib.suppress(TimeoutError):
        answer = await connection.ask(ASKED, answers, SAYS)
        if int.from_bytes(answer.data[1:3], "little") & checks.FLYING:
            raise Refused(connection.uri, "it flies: nobody should look for its LEDs")
