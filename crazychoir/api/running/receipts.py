"""What drones have answered to a command, and the error for drones that did not obey."""

from collections.abc import Iterable
from dataclasses import dataclass

from crazychoir.errors import CrazyChoirError


@dataclass(frozen=True, slots=True)
class OrderReceipt:
    """What one drone has answered to a command."""

    drone: int
    """Id of the drone."""
    verb: str
    """The command."""
    answer: str
    """"refused", "silent" (no answer), "absent" (its agent was not found), or "accepted" (obeys, but
    not done in time).
    """
    reason: str
    """Why, in words."""

    def __str__(self) -> str:
        why = f": {self.reason}" if self.reason else ""
        return f"drone {self.drone}: {self.verb} {self.answer}{why}"


class OrderFailed(CrazyChoirError, RuntimeError):
    """Drones have not done what they were told.

    receipts: one for each of these drones.
    """

    def __init__(self, receipts: Iterable[OrderReceipt]) -> None:
        self.receipts = tuple(receipts)
        super().__init__("; ".join(map(str, self.receipts)))
