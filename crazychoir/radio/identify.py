"""Light the LEDs of a drone that does not fly, so that a user finds it among others."""

import contextlib
from collections.abc import Callable

from crazychoir.errors import Refused
from crazychoir.firmware.requests import SUPERVISOR_REQUESTS
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.protocol.crtp import PACKET_FORMS, Packet
from crazychoir.runtime.clock import Clock

BOARD_LEDS: dict[str, float] = {"led.bitmask": 0xFF}
"""Parameters that light all LEDs of the board; the upper bit takes the LEDs from the firmware."""
RING_LEDS: dict[str, float] = {
    "ring.solidRed": 255,
    "ring.solidGreen": 255,
    "ring.solidBlue": 255,
    "ring.effect": 7,
}
"""Parameters that light the LED ring deck, in one colour."""
RING_DECK_PARAMETER = "deck.bcLedRing"
"""Parameter that is there if the drone has the LED ring deck."""
STATE_REQUEST = PACKET_FORMS["supervisor_info"].packet()
"""Packet that asks the supervisor for its state."""
STATE_ANSWER = bytes([SUPERVISOR_REQUESTS.answer | SUPERVISOR_REQUESTS.all_bits])
"""First byte of its answer."""
STATE_DEADLINE = 0.5
"""Seconds for the supervisor to answer whether the drone flies.

Older firmware has no such answer.
"""


async def identify(
    clock: Clock,
    uri: str,
    contents: TableOfContents,
    seconds: float,
    deadline: float,
    lit_now: Callable[[], None] = lambda: None,
) -> dict[str, float]:
    """Light the LEDs of a drone for a while.

    Return the parameters that did it; their old values are restored in every case.

    seconds: s: how long the LEDs are lit
    deadline: s: longest time until the drone is connected
    lit_now: called when the LEDs are lit
    Raises LinkFailed if the link fails.
    Raises Refused while the drone flies.
    """
    connection = Connection(clock, uri, contents)
    try:
        await connection.open(deadline)
        await _require_rest(connection)
        firmware = ConnectedFirmware(connection)
        lit = BOARD_LEDS | (
            RING_LEDS if await firmware.has(RING_DECK_PARAMETER) else {}
        )
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
    """Raise Refused if the drone answers that it flies."""

    def answers(packet: Packet) -> bool:
        return packet[:2] == STATE_REQUEST[:2] and packet.data[:1] == STATE_ANSWER

    with contextlib.suppress(TimeoutError):
        answer = await connection.ask(STATE_REQUEST, answers, STATE_DEADLINE)
        if int.from_bytes(answer.data[1:3], "little") & SUPERVISOR_BITS.flying:
            raise Refused(connection.uri, "it flies: do not look for its LEDs now")
