"""The kinds of the messages of rounds, and the flags of a message: its kind, how late it is, and its
epoch.

    flags = kind (4 bits), lateness (4), relays (4), epoch (20)
"""

from bisect import bisect_right
from enum import IntEnum
from typing import Final

from crazychoir.errors import CodecError


class MessageKind(IntEnum):
    """The kind of a message. The kinds above DOUBLE have no content."""

    DATA = 0
    """A round's message; the sender has finished all rounds before it."""
    REPEAT = 1
    """The same message again; the sender lacks ours of this round."""
    AHEAD = 2
    """A round's message that says nothing about the sender's progress."""
    ANSWER = 3
    """A round's message again, for a drone that may lack it; says nothing about the progress."""
    DOUBLE = 4
    """A REPEAT of this round and an ANSWER of the round before, in one message."""
    WANT = 5
    """The sender lacks our message of this round."""
    CREDIT = 6
    """The sender has finished all rounds before this one."""
    FIN = 7
    """The sender has finished the channel."""
    FIN_TOO = 8
    """The sender has finished the channel and asks if we have too."""
    GONE = 9
    """The sender no longer has the rounds before this one."""


KIND_BITS: Final = 4
"""Bits of the kind in a message's flags; the lateness is above them."""
KIND_MASK: Final = (1 << KIND_BITS) - 1
"""Mask of the kind in the flags."""
LATENESS_STEPS: Final = (0.0, *(0.004 * 1.5**n for n in range(15)))
"""Seconds of lateness that the flags can tell, 0 to 1.17; a lateness counts as the step below it."""
LATENESS_BITS: Final = 4
"""Bits of the lateness in the flags: its step. The relays are above them."""
RELAY_BITS: Final = 4
"""Bits of the relays in the flags; the epoch is above them."""
MOST_RELAYS: Final = (1 << RELAY_BITS) - 1
"""Most drones that may tell one after the other that a lost message has delayed them.

In a ring of thirty drones the last one is so far away.
"""
EPOCH_SHIFT: Final = KIND_BITS + LATENESS_BITS + RELAY_BITS
"""Bits below the epoch in the flags."""
MOST_EPOCHS: Final = 1 << (32 - EPOCH_SHIFT)
"""First epoch that does not fit into the flags."""
DELAY_MASK: Final = (1 << EPOCH_SHIFT) - 1
"""Mask of kind and lateness in the flags: 0 for DATA that no lost message has delayed."""

# Every message meets these kinds, and in Python 3.11 the access to a member of an enum costs more
# than all comparisons of a message: these are plain ints.
DATA_KIND: Final = int(MessageKind.DATA)
"""`MessageKind.DATA` as a plain int."""
REPEAT_KIND: Final = int(MessageKind.REPEAT)
"""`MessageKind.REPEAT` as a plain int."""
AHEAD_KIND: Final = int(MessageKind.AHEAD)
"""`MessageKind.AHEAD` as a plain int."""
ANSWER_KIND: Final = int(MessageKind.ANSWER)
"""`MessageKind.ANSWER` as a plain int."""
DOUBLE_KIND: Final = int(MessageKind.DOUBLE)
"""`MessageKind.DOUBLE` as a plain int."""

LENGTH_SIZE: Final = 4
"""Bytes of the length of the first content of a DOUBLE."""
LAST_KIND: Final = int(MessageKind.GONE)
"""Largest number of a kind."""
NO_MESSAGE: Final = LAST_KIND
"""Flags that stand for the absence of a message with content."""


def join_contents(own: bytes, before: bytes) -> bytes:
    """Return the content of a DOUBLE.

    own: content of its round
    before: content of the round before
    """
    return len(own).to_bytes(LENGTH_SIZE, "little") + own + before


def split_contents(content: bytes) -> tuple[bytes, bytes]:
    """Return the contents of the round of a DOUBLE, and of the round before.

    Raises CodecError if it is shorter than it says.
    """
    own = LENGTH_SIZE + int.from_bytes(content[:LENGTH_SIZE], "little")
    if len(content) < own:
        where = "message of two rounds"
        raise CodecError(f"{where}: {len(content)} bytes; allowed: at least {own}.")
    return content[LENGTH_SIZE:own], content[own:]


def is_sent_again(flags: int) -> bool:
    """Return True unless the message with these flags has content and was sent for the first time."""
    return flags & KIND_MASK not in (DATA_KIND, AHEAD_KIND)


def flag_lateness(seconds: float, relays: int) -> int:
    """Return the bits of the flags that tell how late a message is.

    seconds: by which lost messages have delayed it
    relays: drones that may pass this lateness on
    """
    step = bisect_right(LATENESS_STEPS, seconds) - 1
    if step <= 0 or relays <= 0:
        return 0
    return (relays << LATENESS_BITS | step) << KIND_BITS


def read_lateness(flags: int) -> tuple[float, int]:
    """Return the seconds by which lost messages have delayed the message with these flags, and the
    number of drones that may pass this lateness on.
    """
    step = flags >> KIND_BITS & (1 << LATENESS_BITS) - 1
    relays = flags >> KIND_BITS + LATENESS_BITS & MOST_RELAYS
    return LATENESS_STEPS[step], relays
