"""Commands from pages: orders to drones, and emergency stops."""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.dashboard.command_place import CommandPlace
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.orders import MOTION_ORDERS, OrderSender
from crazychoir.dashboard.receipts import RECEIPT_TEXTS, Receipt, ReceiptBook
from crazychoir.dashboard.stick import STICK_VERB, StickSender
from crazychoir.dashboard.stops import CHECK_PERIOD, StopSender
from crazychoir.types import Point


class CommandDesk:
    """Gives commands without waiting for them; their receipts are updated as answers come.

    A later order takes precedence. A stop withdraws every open order that could move its drones.
    An order withdraws older orders that it contradicts, unless a drone has acknowledged them. It is
    not repeated to a drone that was not ready either. Therefore no outdated order arrives late after
    an outage of the network.
    """

    def __init__(self, place: CommandPlace, watch: EventLog) -> None:
        self.place = place
        self.book = ReceiptBook(place.clock, watch)
        """Receipts of all commands."""
        self._orders = OrderSender(place, self.book)
        self._stops = StopSender(place, self.book)
        self._stick = StickSender(place, self.book)

    def ended(self) -> str:
        """Return the reason why no drone can obey; empty if a drone may."""
        if self.place.replays:
            return RECEIPT_TEXTS.replayed
        return (
            ""
            if any(map(self.place.is_there, self.place.config.ids))
            else RECEIPT_TEXTS.ended
        )

    def order(
        self,
        verb: str,
        drones: Iterable[int] | None = None,
        seconds: float | None = None,
        words: str = "",
        each: Callable[[int], Mapping[str, Any]] = lambda i: {},
        says: Callable[[Any], Any] = lambda detail: detail,
        first: asyncio.Task[Any] | None = None,
    ) -> Receipt:
        """Send a command to drones.

        verb: name of the command.
        drones: ids, None for all.
        seconds: s, time until it should be done; None for the default of the command.
        words: its arguments, for display.
        each: returns the arguments for a drone.
        says: turns the detail of an answer into text for the receipt.
        first: task that must end before a drone is asked; a later order or a stop takes effect
            meanwhile.
        """
        ids = self.place.config.ids if drones is None else drones
        receipt = self.book.add(verb, ids, words)
        if self.place.replays:
            for i in receipt.answers:
                self.book.answer(
                    receipt, i, ANSWER_TEXTS.refused, RECEIPT_TEXTS.replayed
                )
        else:
            if verb in MOTION_ORDERS:
                self._stick.end(receipt.answers, verb)
            self._orders.send(receipt, seconds, each, says, first)
        return receipt

    def steer(self, drone: int, v: Point, yaw_rate: float) -> Receipt:
        """Let a drone fly with a velocity of the page's stick, until the next one comes.

        drone: id
        v: (3,) m/s, world
        yaw_rate: rad/s
        """
        if self.place.replays:
            receipt = self.book.add(STICK_VERB, (drone,), "by hand")
            why = RECEIPT_TEXTS.replayed
            self.book.answer(receipt, drone, ANSWER_TEXTS.refused, why)
            return receipt
        return self._stick.steer(drone, v, yaw_rate)

    def flies_by_hand(self, drone: int) -> bool:
        """Return whether a drone flies with velocities of `steer`."""
        return self._stick.flies(drone)

    def stop(
        self, drones: Iterable[int] | None = None, clear: bool = False, key: str = ""
    ) -> Receipt:
        """Stop drones at once until the stop is cleared, or clear a stop.

        The stop is sent until it is acknowledged, cleared here, or given again. If the key is
        known the existing receipt is returned: the page repeats its message, and the stop may
        have been cleared meanwhile.

        drones: ids, None for the whole swarm.
        clear: whether to clear a stop.
        key: key of the page's message.
        """
        known = self.book.find(key)
        if known is not None:
            return known
        verb = "clear stop" if clear else "emergency stop"
        ids = self.place.config.ids if drones is None else drones
        receipt = self.book.add(verb, ids, "", key)
        if not clear:
            self._orders.withdraw(receipt)
            self._stick.end(receipt.answers, "stop")
        self._stops.send(receipt, clear, alone=drones is not None and not clear)
        return receipt

    async def settled(self, receipt: Receipt) -> Receipt:
        """Wait until no further answer can come, and return the receipt."""
        while receipt.open:
            await self.place.clock.sleep(CHECK_PERIOD)
        return receipt

    def close(self) -> None:
        """Cancel all waiting."""
        self._orders.close()
        self._stick.close()
        self._stops.close()
