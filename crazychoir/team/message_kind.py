"""The kinds of the messages of rounds, and their place in a message's flags."""

from enum import IntEnum
from typing import Final


class MessageKind(IntEnum):
    """The kind of a message. The kinds above AHEAD have no content."""

    DATA = 0
    """A round's message; the sender has finished all rounds before it."""
    REPEAT = 1
    """The same message again; the sender lacks ours of this round."""
    AHEAD = 2
    """A round's message that says nothing about the sender's progress."""
    WANT = 3
    """The sender lacks our message of this round."""
    CREDIT = 4
    """The sender has finished all rounds before this one."""
    FIN = 5
    """The sender has finished the channel."""
    FIN_TOO = 6
    """The sender has finished the channel and asks if we have too."""
    GONE = 7
    """The sender no longer has the rounds before this one."""


KIND_BITS: Final = 3
"""Bits of the kind in a message's flags; the epoch is above them."""
KIND_MASK: Final = (1 << KIND_BITS) - 1
"""Mask of the kind in the flags."""

# Every message meets these kinds, and in Python 3.11 the access to a member of an enum costs more
# than all comparisons of a message: these are plain ints.
DATA_KIND: Final = int(MessageKind.DATA)
"""`MessageKind.DATA` as a plain int."""
REPEAT_KIND: Final = int(MessageKind.REPEAT)
"""`MessageKind.REPEAT` as a plain int."""
AHEAD_KIND: Final = int(MessageKind.AHEAD)
"""`MessageKind.AHEAD` as a plain int."""
