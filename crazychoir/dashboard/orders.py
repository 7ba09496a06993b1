"""Orders to drones: how long they are sent, and which later orders withdraw them."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from crazychoir.agent.order_times import ORDER_TIMEOUTS
from crazychoir.bus.commands import ANSWER_TEXTS, Answer
from crazychoir.dashboard.command_place import CommandPlace
from crazychoir.dashboard.receipts import (
    RECEIPT_KINDS,
    RECEIPT_TEXTS,
    Receipt,
    ReceiptBook,
)
from crazychoir.errors import CrazyChoirError, error_text


@dataclass(frozen=True, slots=True)
class OrderLimits:
    """Times that the drones get for an order."""

    acknowledge_timeout: float = 2.0
    """Seconds within which a drone should acknowledge a command.

    The command is resent before and after that time.
    """
    request_timeout: float = 5.0
    """Seconds to wait for a command that is not a motion."""
    ready_timeout: float = 15.0
    """Seconds for which a drone that is not ready yet is asked again."""
    retry_period: float = 0.3
    """Seconds between two such requests."""


ORDER_LIMITS = OrderLimits()


MOTION_ORDERS = tuple(ORDER_TIMEOUTS)
"""Orders that move a drone or let it move; a stop of the drone withdraws them."""
COMPATIBLE_ORDERS = {
    "arm": MOTION_ORDERS,
    "take-off": ("arm", "start", "go"),
    "start": ("arm", "take-off", "hold", "go"),
    "go": ("arm", "take-off", "start"),
    "go-to": ("take-off", "hold"),
    "fly": ("take-off", "hold"),
}
"""For each order, the older orders that remain valid beside it.

It withdraws all other orders that are not acknowledged yet.
"""
SEQUENTIAL_ORDER = "impair"
"""A drone gets the next order of this kind only after it has answered the previous one.

Some of these orders add up, others do not, so their sequence matters.
"""


@dataclass(eq=False)
class _PendingOrder:
    """An order to one drone that is still being sent or carried out."""

    receipt: Receipt
    """Receipt of the order."""
    drone: int
    """Id of the drone."""
    begun: bool = False
    """Whether the drone has acknowledged it."""
    outdone: str = ""
    """Name of a later, contrary order after which it is not sent again; empty if there is none."""


class OrderSender:
    """Sends orders to drones, each until it is acknowledged, answered or withdrawn.

    place: place on the network from which the orders are sent
    book: receipts of the orders
    """

    def __init__(self, place: CommandPlace, book: ReceiptBook) -> None:
        self.pending: dict[_PendingOrder, asyncio.Task[None]] = {}
        """The open orders, with the task that sends each."""
        self._place = place
        self._book = book

    def send(
        self,
        receipt: Receipt,
        seconds: float | None,
        each: Callable[[int], Mapping[str, Any]],
        says: Callable[[Any], Any],
        first: asyncio.Task[Any] | None,
    ) -> None:
        """Begin to send an order to the drones of its receipt.

        It withdraws the older orders that it contradicts.

        receipt: of the order
        seconds: s, time until it should be done; None for the default of the command
        each: returns the arguments for a drone
        says: turns the detail of an answer into text for the receipt
        first: task that must end before a drone is asked
        """
        verb = receipt.verb
        if seconds is None:
            seconds = ORDER_TIMEOUTS.get(verb, ORDER_LIMITS.request_timeout)
        if verb in MOTION_ORDERS:
            self._outdo(receipt, COMPATIBLE_ORDERS.get(verb, ()))
        before = {
            order.drone: task
            for order, task in self.pending.items()
            if order.receipt.verb == verb == SEQUENTIAL_ORDER
        }
        loop = asyncio.get_running_loop()
        for i in receipt.answers:
            order = _PendingOrder(receipt, i)
            self.pending[order] = loop.create_task(
                self._ask(order, seconds, each, says, before.get(i, first))
            )

    def withdraw(self, stop: Receipt) -> None:
        """Withdraw all open orders that could move a drone that is to stop."""
        for order in self._motions(stop):
            self._drop(order, "stop")

    def close(self) -> None:
        """Cancel all waiting."""
        for task in self.pending.values():
            task.cancel()

    def _motions(self, newer: Receipt) -> list[_PendingOrder]:
        """Return the open orders that could move a drone of a newer order."""
        return [
            order
            for order in self.pending
            if order.drone in newer.answers and order.receipt.verb in MOTION_ORDERS
        ]

    def _outdo(self, newer: Receipt, beside: Sequence[str]) -> None:
        """Withdraw the open orders that a newer order contradicts.

        An order that was already acknowledged stays open, and its drone reports the outcome.

        newer: receipt of the newer order
        beside: names of the orders that remain valid beside it
        """
        for order in self._motions(newer):
            if order.receipt.verb in beside:
                continue
            if order.begun:
                order.outdone = newer.verb
            else:
                self._drop(order, newer.verb)

    def _drop(self, order: _PendingOrder, by: str) -> None:
        self.pending.pop(order).cancel()
        self._book.withdraw(order.receipt, order.drone, by)

    async def _ask(
        self,
        order: _PendingOrder,
        seconds: float,
        each: Callable[[int], Mapping[str, Any]],
        says: Callable[[Any], Any],
        first: asyncio.Task[Any] | None,
    ) -> None:
        clock = self._place.clock
        receipt = order.receipt
        i = order.drone
        ends = clock.now() + seconds
        try:
            if first is not None:
                await asyncio.wait([first])
            answer = await self._heard(order, ends, each(i))
        except TimeoutError:
            self._book.answer(
                receipt,
                i,
                RECEIPT_KINDS.silent,
                f"no answer within {seconds:g} s; is its agent running?",
            )
            return
        except CrazyChoirError as error:
            self._book.answer(receipt, i, ANSWER_TEXTS.refused, str(error))
            return
        except Exception as error:  # noqa: BLE001 - its receipt tells it
            self._book.answer(receipt, i, ANSWER_TEXTS.refused, error_text(error))
            return
        finally:
            self.pending.pop(order, None)
        if order.outdone and answer.kind == ANSWER_TEXTS.refused:
            self._book.withdraw(receipt, i, order.outdone)
        elif answer.kind == ANSWER_TEXTS.accepted:
            self._book.answer(
                receipt,
                i,
                RECEIPT_KINDS.unfinished,
                f"accepted, not done within {seconds:g} s",
            )
        else:
            detail = (
                says(answer.detail)
                if answer.kind == ANSWER_TEXTS.done
                else answer.detail
            )
            self._book.answer(receipt, i, answer.kind, "" if detail is None else detail)

    async def _heard(
        self, order: _PendingOrder, ends: float, arguments: Mapping[str, Any]
    ) -> Answer:
        """Return the last answer of a drone; report if it does not acknowledge in time."""
        clock = self._place.clock
        i = order.drone
        timer = clock.call_at(
            clock.now_ns() + round(ORDER_LIMITS.acknowledge_timeout * 1e9),
            self._unheard,
            order.receipt,
            i,
            drone=i,
        )
        try:
            return await self._answered(order, ends, arguments)
        finally:
            timer.cancel()

    async def _answered(
        self, order: _PendingOrder, ends: float, arguments: Mapping[str, Any]
    ) -> Answer:
        """Return the last answer of a drone; ask again for ORDER_LIMITS.ready_timeout s if it is not ready yet."""
        clock = self._place.clock
        commander = self._place.commander
        verb = order.receipt.verb
        asks = min(ends, clock.now() + ORDER_LIMITS.ready_timeout)
        while True:
            left = ends - clock.now()
            answer = await commander.request(
                order.drone, verb, left, lambda: self._begun(order), **arguments
            )
            if (
                not _may_be_repeated(answer)
                or order.outdone
                or clock.now() + ORDER_LIMITS.retry_period >= asks
            ):
                return answer
            order.begun = False
            await clock.sleep(ORDER_LIMITS.retry_period)

    def _begun(self, order: _PendingOrder) -> None:
        order.begun = True
        self._book.answer(order.receipt, order.drone, ANSWER_TEXTS.accepted)

    def _unheard(self, receipt: Receipt, i: int) -> None:
        if receipt.answers[i][0] == RECEIPT_KINDS.sent:
            why = (
                f"not acknowledged within {ORDER_LIMITS.acknowledge_timeout:g} s"
                if self._place.is_there(i)
                else RECEIPT_TEXTS.absent
            )
            self._book.answer(receipt, i, RECEIPT_KINDS.sent, f"{why}; resent")


def _may_be_repeated(answer: Answer) -> bool:
    """Return whether the command may be repeated soon."""
    return answer.kind == ANSWER_TEXTS.refused and str(answer.detail).startswith(
        ANSWER_TEXTS.not_ready
    )
