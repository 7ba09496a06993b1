"""The kinds of the messages of rounds, and the flags of a message: its kind, how late it is, and its
epoch.
"""

from enum import IntEnum
from typing import Final


class MessageKind(IntEnum):
    """The kind of a message. The kinds above ANSWER have no content."""

    DATA = 0
    """A round's message; the sender has finished all rounds before it."""
    REPEAT = 1
    """The same message again; the sender lacks ours of this round."""
    AHEAD = 2
    """A round's message that says nothing about the sender's progress."""
    ANSWER = 3
    """A round's message again, for a drone that may lack it; says nothing about the progress."""
    WANT = 4
    """The sender lacks our message of this round."""
    CREDIT = 5
    """The sender has finished all rounds before this one."""
    FIN = 6
    """The sender has finished the channel."""
    FIN_TOO = 7
    """The sender has finished the channel and asks if we have too."""
    GONE = 8
    """The sender no longer has the rounds before this one."""


KIND_BITS: Final = 4
"""Bits of the kind in a message's flags; the lateness is above them."""
KIND_MASK: Final = (1 << KIND_BITS) - 1
"""Mask of the kind in the flags."""
LATENESS_BITS: Final = 8
"""Bits of the lateness in the flags; the epoch is above them."""
MOST_LATENESS: Final = (1 << LATENESS_BITS) - 1
"""Largest lateness in the flags; also its mask."""
LATENESS_UNIT: Final = 0.004
"""Seconds of lateness in one unit of the flags."""
EPOCH_SHIFT: Final = KIND_BITS + LATENESS_BITS
"""Bits below the epoch in the flags."""
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

NO_MESSAGE: Final = int(MessageKind.GONE)
"""Flags that stand for the absence of a message with content."""


def is_sent_again(flags: int) -> bool:
    """Return True unless the message with these flags has content and was sent for the first time."""
    return flags & KIND_MASK not in (DATA_KIND, AHEAD_KIND)


def flag_lateness(seconds: float) -> int:
    """Return the bits of the flags that say by how many seconds lost messages delayed a message."""
    return min(MOST_LATENESS, int(seconds / LATENESS_UNIT)) << KIND_BITS


def read_lateness(flags: int) -> float:
    """Return the seconds by which lost messages have delayed the message with these flags."""
    return LATENESS_UNIT * (flags >> KIND_BITS & MOST_LATENESS)
