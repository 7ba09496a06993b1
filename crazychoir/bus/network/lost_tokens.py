"""Connected processes after one has lost the liveliness token of the other.

Zenoh 1.10 sometimes loses a token when a link breaks and comes back on a busy machine. Frames then
arrive, but the token never comes back, neither by a query nor if it is declared again. A token with
another key does arrive.

Therefore a process without a token that sends frames, or had a token before, gets a HELLO now and
then, which tells this. Then the process declares one more token.
"""

from dataclasses import dataclass
from itertools import islice

from crazychoir.bus.network.peers import PEER_LIMITS


@dataclass(frozen=True, slots=True)
class LostTokenLimits:
    """When a process repairs tokens that were lost, and how many processes it keeps for that."""

    patience: int = 4
    """Times that HELLO of a process told that it lacks our token before we declare another one.

    Then twice as many each time. However many HELLOs arrive between two calls of `due`, they count
    as one: many processes that start together send each other many.
    """
    departed_processes: int = 64
    """Departed processes that are remembered, the newest: their links may come back."""
    answered_strangers: int = 64
    """Most strangers that are answered at once."""


LOST_TOKEN_LIMITS = LostTokenLimits()


class TokenRepair:
    """Decides which processes without a token get a HELLO, and
    when to declare another token of ours.
    """

    def __init__(self) -> None:
        self._strangers: dict[str, None] = {}
        self._gone: dict[str, None] = {}
        self._missing: dict[str, int] = {}
        self._counted: set[str] = set()
        """Processes that have told since the last call of `due` that they lack our token."""
        self._is_declared = False
        """True if a token was declared since then. It is for all processes."""

    def came(self, process: str) -> None:
        """Note that a token of the process exists."""
        self._strangers.pop(process, None)
        self._gone.pop(process, None)

    def went(self, process: str) -> None:
        """Note that its last token has disappeared."""
        self._missing.pop(process, None)
        self._gone[process] = None
        if len(self._gone) > LOST_TOKEN_LIMITS.departed_processes:
            del self._gone[next(iter(self._gone))]

    def heard(self, process: str) -> None:
        """Note that a frame of the process has arrived, but no token."""
        if len(self._strangers) < PEER_LIMITS.max_peers:
            self._strangers[process] = None

    def known(self, process: str) -> None:
        """Note that the process knows us."""
        self._missing.pop(process, None)

    def missed(self, process: str) -> bool:
        """Note that the process has no token of ours; return True if we should declare another one."""
        if process in self._counted:
            return False
        if process not in self._missing and len(self._missing) >= PEER_LIMITS.max_peers:
            return False
        self._counted.add(process)
        count = self._missing[process] = self._missing.get(process, 0) + 1
        is_due = count >= LOST_TOKEN_LIMITS.patience and count & (count - 1) == 0
        is_first = is_due and not self._is_declared
        self._is_declared = self._is_declared or is_due
        return is_first

    def due(self, gone_too: bool) -> list[str]:
        """Return the processes to send a HELLO to now.

        gone_too: True to add departed processes
        """
        self._counted.clear()
        self._is_declared = False
        some = list(islice(self._strangers, LOST_TOKEN_LIMITS.answered_strangers))
        for process in some:
            del self._strangers[process]
        return some + [
            process for process in self._gone if gone_too and process not in some
        ]
