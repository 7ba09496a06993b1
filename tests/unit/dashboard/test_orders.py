import asyncio

from virtual_time import virtual

from crazychoir.agent.order_times import ORDER_TIMEOUTS
from crazychoir.bus.commands import ANSWER_TEXTS, Answer
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.orders import ORDER_LIMITS, OrderSender
from crazychoir.dashboard.receipts import RECEIPT_KINDS, ReceiptBook


class DeafPlace:
    """A place with drones that never answer; it notes the time that each command gets."""

    def __init__(self, clock):
        self.clock = clock
        self.commander = self
        self.timeouts = []

    def is_there(self, i):
        return True

    async def request(self, i, verb, seconds, accepted, **arguments):
        self.timeouts.append(round(seconds, 3))
        await self.clock.sleep(seconds)
        raise TimeoutError


class WillingPlace(DeafPlace):
    """A place with drones that accept each command at once, and do it after 1 s."""

    async def request(self, i, verb, seconds, accepted, **arguments):
        accepted()
        await self.clock.sleep(1.0)
        return Answer(i, ANSWER_TEXTS.done, "there")


def sender(clock, kind=DeafPlace):
    place = kind(clock)
    book = ReceiptBook(clock, EventLog(clock))
    return place, book, OrderSender(place, book)


def send(orders, receipt, seconds=None):
    orders.send(receipt, seconds, lambda i: {}, str.upper, None)


@virtual
async def test_each_order_gets_the_time_of_its_kind(clock):
    place, book, orders = sender(clock)
    send(orders, book.add("land", [0], ""))
    send(orders, book.add("link", [1], ""))
    send(orders, book.add("hold", [2], ""), 1.5)
    await clock.sleep(0.1)
    assert place.timeouts == [
        ORDER_TIMEOUTS["land"],
        ORDER_LIMITS.request_timeout,
        1.5,
    ]
    orders.close()


@virtual
async def test_a_done_order_is_not_pending_and_its_detail_is_put_in_words(clock):
    _, book, orders = sender(clock, WillingPlace)
    receipt = book.add("land", [0], "")
    send(orders, receipt)
    await clock.sleep(0.5)
    assert receipt.answers == {0: (ANSWER_TEXTS.accepted, "")}
    assert len(orders.pending) == 1
    await clock.sleep(1.0)
    assert receipt.answers == {0: (ANSWER_TEXTS.done, "THERE")}
    assert orders.pending == {}


@virtual
async def test_a_later_motion_withdraws_an_unacknowledged_contrary_motion(clock):
    place, book, orders = sender(clock)
    going, flying = book.add("go", [0, 1], ""), book.add("land", [1], "")
    send(orders, going)
    send(orders, flying)
    assert going.answers == {
        0: (RECEIPT_KINDS.sent, ""),
        1: (RECEIPT_KINDS.withdrawn, "by land"),
    }
    assert [order.drone for order in orders.pending] == [0, 1]
    await clock.sleep(0.1)
    assert len(place.timeouts) == 2, "the withdrawn order is not sent"
    orders.close()


@virtual
async def test_a_stop_withdraws_motions_of_its_drones_and_nothing_else(clock):
    _, book, orders = sender(clock, WillingPlace)
    landing, asking = book.add("land", [0, 1], ""), book.add("link", [0], "")
    send(orders, landing)
    send(orders, asking)
    await clock.sleep(0.1)
    orders.withdraw(book.add("emergency stop", [0], ""))
    assert landing.answers == {
        0: (RECEIPT_KINDS.withdrawn, "by stop"),
        1: (ANSWER_TEXTS.accepted, ""),
    }
    assert asking.answers == {0: (ANSWER_TEXTS.accepted, "")}
    orders.close()


@virtual
async def test_a_closed_sender_asks_no_drone_any_more(clock):
    place, book, orders = sender(clock)
    send(orders, book.add("land", [0], ""))
    orders.close()
    await asyncio.sleep(0)
    assert place.timeouts == []
