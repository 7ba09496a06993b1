"""Receipts of commands: which drones acknowledged, finished or are silent."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.dashboard.event_log import EventLog
from crazychoir.runtime.clock import Clock

MOST_RECEIPTS = 50  # receipts that are kept


@dataclass(frozen=True, slots=True)
class ReceiptKinds:
    """Kinds of answers in a receipt that come from this program, not from a drone."""

    sent: str = "sent"
    """Kind of answer: not acknowledged yet."""
    silent: str = "silent"
    """Kind of answer: not acknowledged in time."""
    unfinished: str = "unfinished"
    """Kind of answer: accepted, not done in time; the drone may still do it."""
    withdrawn: str = "withdrawn"
    """Kind of answer: withdrawn by a later order."""


RECEIPT_KINDS = ReceiptKinds()


@dataclass(frozen=True, slots=True)
class ReceiptTexts:
    """Words for why a drone, or the whole swarm, does not obey."""

    absent: str = "no agent of it is there"
    """Words of a receipt if no agent answers for the drone."""
    replayed: str = "REPLAY: no drone obeys"
    """Words of a refusal if the messages come from a recording."""
    ended: str = "ENDED: no drone is there"
    """Notice of the page if no drone is there any more."""


RECEIPT_TEXTS = ReceiptTexts()


@dataclass
class Receipt:
    """A command and the answers of the drones."""

    number: int
    """Number of the command, from 1."""
    verb: str
    """Name of the command."""
    words: str
    """Its arguments, for display."""
    t: float
    """s, when it was given."""
    answers: dict[int, tuple[str, Any]] = field(default_factory=dict)
    """By drone, (kind, words).

    The kind is "sent" until the drone acknowledges, then "accepted", "done", "refused", "unfinished" or "withdrawn".
    It is "silent" if the drone has not acknowledged in time.
    """
    version: int = 0
    """Number of the change after which this receipt was last changed, over all receipts."""
    key: str = ""
    """Key that the page gave the command. If the page repeats it, no second command is given."""

    @property
    def open(self) -> bool:
        """Whether a drone may still answer."""
        return any(
            kind in (RECEIPT_KINDS.sent, ANSWER_TEXTS.accepted)
            for kind, _ in self.answers.values()
        )

    def done(self) -> bool:
        """Return whether all drones have done it."""
        return bool(self.answers) and all(
            kind == ANSWER_TEXTS.done for kind, _ in self.answers.values()
        )


class ReceiptBook:
    """Keeps the newest receipts, and numbers every change of their answers.

    clock: tells the time at which a command is given
    watch: log of the pages; it gets a line when a drone does not obey
    """

    def __init__(self, clock: Clock, watch: EventLog) -> None:
        self.receipts: deque[Receipt] = deque()
        """The receipts, oldest first."""
        self.version = 0
        """Number of changes so far, over all receipts."""
        self._clock = clock
        self._watch = watch
        self._count = 0
        self._pinned: dict[int, None] = {}

    def after(self, version: int) -> list[Receipt]:
        """Return the receipts that have changed since `version`, oldest first."""
        return [receipt for receipt in self.receipts if receipt.version > version]

    def find(self, key: str) -> Receipt | None:
        """Return the oldest receipt with this key (see `Receipt.key`); None if there is none."""
        if not key:
            return None
        return next((receipt for receipt in self.receipts if receipt.key == key), None)

    def add(
        self, verb: str, drones: Iterable[int], words: str, key: str = ""
    ) -> Receipt:
        """Add the receipt of a new command.

        verb: name of the command
        drones: ids of the drones that it is for
        words: its arguments, for display
        key: key of the page's message
        """
        self._count += 1
        receipt = Receipt(self._count, verb, words, round(self._clock.now(), 2))
        receipt.answers = {i: (RECEIPT_KINDS.sent, "") for i in drones}
        receipt.key = key
        if len(self.receipts) == MOST_RECEIPTS:
            self._forget()
        self.receipts.append(receipt)
        self._note_change(receipt)
        return receipt

    def pin(self, receipt: Receipt) -> None:
        """Keep a receipt longer than the others, because its command is still sent."""
        self._pinned[receipt.number] = None

    def unpin(self, receipt: Receipt) -> None:
        """Keep a receipt no longer than the others."""
        self._pinned.pop(receipt.number, None)

    def answer(self, receipt: Receipt, i: int, kind: str, words: Any = "") -> None:
        """Note the answer of drone i, and log it if the drone does not obey.

        receipt: of the command
        i: id of the drone
        kind: kind of the answer
        words: detail of the answer
        """
        if receipt.answers[i] == (kind, words):
            return
        receipt.answers[i] = kind, words
        self._note_change(receipt)
        if kind in (
            ANSWER_TEXTS.refused,
            RECEIPT_KINDS.silent,
            RECEIPT_KINDS.unfinished,
        ):
            self._watch.add(f"{receipt.verb}: {kind}: {words}", "warning", i)

    def withdraw(self, receipt: Receipt, i: int, by: str) -> None:
        """Mark an order as withdrawn, without a line in the log.

        receipt: of the order
        i: id of the drone
        by: name of the command that withdraws it
        """
        receipt.answers[i] = RECEIPT_KINDS.withdrawn, f"by {by}"
        self._note_change(receipt)

    def _forget(self) -> None:
        """Remove the oldest receipt; pinned receipts are removed last."""
        self.receipts.remove(
            next(
                (one for one in self.receipts if one.number not in self._pinned),
                self.receipts[0],
            )
        )

    def _note_change(self, receipt: Receipt) -> None:
        self.version += 1
        receipt.version = self.version
