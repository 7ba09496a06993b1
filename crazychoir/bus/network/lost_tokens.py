"""Processes that hear us or are heard while the liveliness token of one of the two is lost.

Zenoh 1.10 loses a token now and then when a link breaks and comes back on a busy machine: frames flow, the token never
comes again, neither by asking nor if it is declared anew; one with another key comes. So who is heard without a token,
or had one, is sent a HELLO now and then; who reads in those that it is not known declares one more token.
"""

from itertools import islice
from typing import Final

from crazychoir.bus.network.peers import MAX_PEERS

PATIENCE: Final = 4
"""HELLOs in which we are missing before we declare a token, and then twice as many each time."""
REMEMBERED: Final = 64
"""Processes that went, the newest: their links may come back."""
ANSWERS: Final = 64
"""Strangers answered at once."""


class Estranged:
    """Whom to send a HELLO though no token of it is there, and when to declare a token of ours. Pure."""

    def __init__(self) -> None:
        self._strangers: dict[str, None] = {}
        self._gone: dict[str, None] = {}
        self._missing: dict[str, int] = {}

    def came(self, process: str) -> None:
        """A token of it is there."""
        self._strangers.pop(process, None)
        self._gone.pop(process, None)

    def went(self, process: str) -> None:
        """Its last token has gone."""
        self._missing.pop(process, None)
        self._gone[process] = None
        if len(self._gone) > REMEMBERED:
            del self._gone[next(iter(self._gone))]

    def heard(self, process: str) -> None:
        """A frame has come from it, and no token."""
        if len(self._strangers) < MAX_PEERS:
            self._strangers[process] = None

    def greeted(self, process: str, knows_us: bool) -> bool:
        """A HELLO has come from it; returns whether a token of ours is to be declared once more."""
        if knows_us:
            self._missing.pop(process, None)
            return False
        if process not in self._missing and len(self._missing) >= MAX_PEERS:
            return False
        count = self._missing[process] = self._missing.get(process, 0) + 1
        return count >= PATIENCE and count & (count - 1) == 0

    def due(self, gone_too: bool) -> list[str]:
        """Who is to be sent a HELLO now; those that went are, if `gone_too`."""
        some = list(islice(self._strangers, ANSWERS))
        for process in some:
            del self._strangers[process]
        return some + [
            process for process in self._gone if gone_too and process not in some
        ]
