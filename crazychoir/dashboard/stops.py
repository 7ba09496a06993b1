"""Emergency stops and their clearing: each is sent until it is acknowledged or replaced."""

import asyncio
import math
from dataclasses import dataclass, field

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.dashboard.command_place import CommandPlace
from crazychoir.dashboard.receipts import RECEIPT_KINDS, Receipt, ReceiptBook

STOP_TIMEOUT = (
    10.0  # s, after which a drone without an acknowledgement is called silent
)
CHECK_PERIOD = 0.05  # s, between two looks at the acknowledgements


@dataclass(eq=False)
class _PendingStop:
    """A stop, or its clearing, that is still being sent."""

    receipt: Receipt
    """Receipt of the stop."""
    targets: list[int]
    """Addresses to which it is sent."""
    clear: bool
    """Whether it clears a stop."""
    alone: bool
    """Whether it stops only some drones, see emergency_stop."""
    obeyed: dict[int, None] = field(default_factory=dict)
    """Addresses that have obeyed."""

    def has_obeyed(self, i: int) -> bool:
        """Return whether drone i has obeyed: its agent, and its body if another process owns it."""
        return i in self.obeyed and (
            PORT_ADDRESSES.body_offset + i in self.obeyed
            or PORT_ADDRESSES.body_offset + i not in self.targets
        )


class StopSender:
    """Sends each stop, or its clearing, until all its drones have obeyed or a newer one replaces it.

    place: place on the network from which the stops are sent
    book: receipts of the stops
    """

    def __init__(self, place: CommandPlace, book: ReceiptBook) -> None:
        self.pending: dict[_PendingStop, asyncio.Task[None]] = {}
        """The stops that are still sent, with the task that sends each."""
        self._place = place
        self._book = book

    def send(self, receipt: Receipt, clear: bool, alone: bool) -> None:
        """Begin to send a stop to the agents of its drones, and to their bodies in other processes.

        receipt: of the stop
        clear: whether it clears a stop
        alone: whether it stops only some drones
        """
        bodies = [
            PORT_ADDRESSES.body_offset + i
            for i in self._place.config.topology.elsewhere
            if i in receipt.answers
        ]
        stop = _PendingStop(receipt, [*receipt.answers, *bodies], clear, alone)
        self._replace(stop)
        self._book.pin(receipt)
        self.pending[stop] = asyncio.get_running_loop().create_task(self._send(stop))

    def close(self) -> None:
        """Cancel all waiting."""
        for task in self.pending.values():
            task.cancel()

    def _replace(self, newer: _PendingStop) -> None:
        """Do not send older stops and clears to the targets of a newer stop any more.

        A stop of the whole swarm remains in force beside a stop of some drones.
        """
        told = dict.fromkeys(newer.targets)
        for older in self.pending:
            if newer.alone and not (older.alone or older.clear):
                continue
            older.targets[:] = [j for j in older.targets if j not in told]
            for i in newer.receipt.answers:
                if older.receipt.answers.get(i, (ANSWER_TEXTS.done, ""))[0] in (
                    RECEIPT_KINDS.sent,
                    RECEIPT_KINDS.silent,
                ):
                    self._book.withdraw(older.receipt, i, newer.receipt.verb)

    async def _send(self, stop: _PendingStop) -> None:
        """Send a stop to the agents, and to the bodies that other processes own.

        A drone has obeyed when both have. A clear is only sent for STOP_TIMEOUT s, because a late one is
        of no use.
        """
        clock = self._place.clock
        limit = STOP_TIMEOUT if stop.clear else math.inf
        timer = clock.call_at(
            clock.now_ns() + round(STOP_TIMEOUT * 1e9), self._silent, stop
        )
        order = self._place.commander.emergency_stop(
            stop.targets, stop.clear, limit, stop.alone, stop.obeyed
        )
        sending = asyncio.ensure_future(order)
        try:
            while not sending.done():
                self._tell_obeyed(stop)
                await clock.sleep(CHECK_PERIOD)
            self._tell_obeyed(stop)
        finally:
            sending.cancel()
            timer.cancel()
            del self.pending[stop]
            self._book.unpin(stop.receipt)

    def _silent(self, stop: _PendingStop) -> None:
        """Mark the drones that have not acknowledged as silent; a stop is still sent to them."""
        still = "" if stop.clear else ", still sent"
        for i, (kind, _) in stop.receipt.answers.items():
            if kind == RECEIPT_KINDS.sent:
                body = (
                    "; its body has obeyed"
                    if PORT_ADDRESSES.body_offset + i in stop.obeyed
                    else ""
                )
                self._book.answer(
                    stop.receipt,
                    i,
                    RECEIPT_KINDS.silent,
                    f"no acknowledgement within {STOP_TIMEOUT:g} s{still}{body}",
                )

    def _tell_obeyed(self, stop: _PendingStop) -> None:
        for i, (kind, _) in stop.receipt.answers.items():
            if kind in (RECEIPT_KINDS.sent, RECEIPT_KINDS.silent) and stop.has_obeyed(
                i
            ):
                self._book.answer(
                    stop.receipt,
                    i,
                    ANSWER_TEXTS.done,
                    "cleared" if stop.clear else "motors off",
                )
